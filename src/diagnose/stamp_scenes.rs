//! Scenes in which the stars of a recording are rendered for the columns of effects on pixels, and how many stars share one.

use std::collections::BTreeMap;

use super::options::ImageConditions;
use crate::camera::Camera;
use crate::effects::pixel::pixel_effect;
use crate::effects::{AnyDisplacement, Context, Light, Observation, REFERENCE_FLUX_E, REFERENCE_MAGNITUDE, StarImage, StarState};
use crate::imaging::EffectSetting;
use crate::render::TestStar;
use crate::scene::Scene;

/// Stars of one frame are at least so far apart, in widths of an image, and px: their light, and the rings that tell the sky, do not touch.
const ROOM_SIGMAS: f64 = 24.0;
const MIN_ROOM_PX: f64 = 24.0;
/// λN of a wavefront whose image a Gaussian of σ = 1 px fits, px.
const LAMBDA_N_OF_SIGMA: f64 = 2.13;

/// So many widths are followed of the light of a wavefront.
const REACH_SIGMAS: f64 = 12.0;

/// Stars that are rendered together: each with its number among the star images.
pub(super) type StarLayout = Vec<(usize, TestStar)>;

/// Places that are taken, by the cell that they lie in.
type Taken = BTreeMap<[i64; 2], Vec<[f64; 2]>>;

/// Distributes stars over few frames, on each no two nearer than `room_px`. Stars beside the frame are left out.
pub(super) fn layouts(stars: impl Iterator<Item = (usize, TestStar)>, size_px: [usize; 2], room_px: f64) -> Vec<StarLayout> {
    let cell = |star: &TestStar| [star.x_px, star.y_px].map(|at| (at / room_px).floor() as i64);
    let is_inside = |star: &TestStar| [star.x_px, star.y_px].iter().zip(size_px).all(|(at, side)| *at > -0.5 && *at < side as f64 - 0.5);
    let mut found: Vec<(StarLayout, Taken)> = Vec::new();
    for (index, star) in stars.filter(|(_, star)| is_inside(star)) {
        let [column, row] = cell(&star);
        let has_room = |taken: &Taken| {
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [column + dx, row + dy]));
            near.filter_map(|cell| taken.get(&cell)).flatten().all(|at| (at[0] - star.x_px).hypot(at[1] - star.y_px) >= room_px)
        };
        let free = found.iter().position(|(_, taken)| has_room(taken)).unwrap_or_else(|| {
            found.push(Default::default());
            found.len() - 1
        });
        found[free].0.push((index, star));
        found[free].1.entry([column, row]).or_default().push([star.x_px, star.y_px]);
    }
    found.into_iter().map(|(layout, _)| layout).collect()
}

/// Stars of so many electrons in columns and rows over the frame, at phases within the pixel that fill it evenly.
pub(super) fn grid(electrons: f64, camera: &Camera, looks: &ImageConditions) -> StarLayout {
    const ALONG: usize = 7;
    let room_px = room_px(looks);
    let line = |length: usize| -> Vec<f64> {
        let free = (length as f64 - 2.0 * room_px).max(0.0);
        let count = ((free / room_px) as usize + 1).min(ALONG);
        (0..count).map(|k| room_px.min(length as f64 / 2.0) + free * (k as f64 + 0.5) / count as f64).collect()
    };
    let (columns, rows) = (line(camera.width_px), line(camera.height_px));
    let phase = |k: usize, step: f64| (step * k as f64).fract() - 0.5;
    let places = rows.iter().flat_map(|y| columns.iter().map(move |x| (*x, *y))).enumerate();
    let colour = Some(StarState::REFERENCE_COLOUR + 1.0);
    let star = |(k, (x, y)): (usize, (f64, f64))| {
        let [x_px, y_px] = [x.round() + phase(k, 0.754_877_666), y.round() + phase(k, 0.569_840_291)];
        (k, TestStar { x_px, y_px, electrons, colour })
    };
    places.map(star).collect()
}

/// The formula's shift of a star for a unit of a parameter.
pub(super) fn unit_shift(
    effect: &dyn AnyDisplacement,
    parameter: usize,
    star: &TestStar,
    camera: &Camera,
    looks: &ImageConditions,
) -> [f64; 2] {
    let pixel_px = [star.x_px, star.y_px];
    let point_px = [0, 1].map(|axis| pixel_px[axis] - camera.principal_point_px[axis]);
    let light = Light { direction: [0.0, 0.0, 1.0], point_px, pixel_px, focal_length_px: camera.focal_length_px };
    let magnitude = REFERENCE_MAGNITUDE - 2.5 * (star.electrons / REFERENCE_FLUX_E).log10();
    let state = StarState { magnitude, colour: star.colour, ..StarState::default() };
    let image = StarImage { flux_e: Some(star.electrons), psf_sigma_px: Some(looks.psf_sigma_px), ..StarImage::default() };
    let context = Context::new(state, Observation::of_sensor(camera.width_px, camera.height_px)).with_image(image);
    let mut unit = vec![0.0; effect.parameters().len()];
    unit[parameter] = 1.0;
    let moved = effect.displace(&unit, light, &context).point_px;
    [0, 1].map(|axis| point_px[axis] - moved[axis])
}

/// Side of the square that a star has for itself, px.
pub(super) fn room_px(looks: &ImageConditions) -> f64 {
    (ROOM_SIGMAS * looks.psf_sigma_px).max(MIN_ROOM_PX)
}

/// What was made, or nothing, and then the reason in the log: the formula stands in.
pub(super) fn told<T, E: std::fmt::Display>(made: Result<T, E>) -> Option<T> {
    made.inspect_err(|error| tracing::warn!("the column of an effect on pixels is not rendered, its formula stands in: {error}")).ok()
}

/// One exposure of a second by a camera of this size.
pub(super) fn scene([width, height]: [usize; 2], psf: &str, sky_e: f64) -> Option<Scene> {
    let text = format!(
        "format = \"boresight-scene/1\"\ncamera = {{ width_px = {width}, height_px = {height}, focal_length_px = {width}.0 }}\n\
         sky = {{ background_e_per_px_s = {sky_e:?}, physics = \"none\" }}\n{psf}\n\
         [[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [0.0, 0.0]\n"
    );
    told(Scene::parse("the scene of the rendered columns", &text))
}

pub(super) fn gaussian(looks: &ImageConditions, pixel: &str) -> String {
    format!("[psf]\nkind = \"gaussian\"\nparameters = {{ sigma_px = {:?} }}\n{pixel}", looks.psf_sigma_px)
}

pub(super) fn coma(looks: &ImageConditions, waves: f64) -> String {
    // Moments are taken within a few widths; tables of twice the reach take four times as long to make.
    let reach_px = (REACH_SIGMAS * looks.psf_sigma_px).ceil().clamp(8.0, 36.0);
    let lambda_n_px = LAMBDA_N_OF_SIGMA * looks.psf_sigma_px;
    let vary = |name: &str, axis: &str| format!("{{ parameter = \"{name}\", coefficient = {waves:?}, {axis} = 1 }}");
    let terms = [vary("z8_waves", "x"), vary("z7_waves", "y")].join(", ");
    format!(
        "[psf]\nkind = \"zernike\"\nreach_px = {reach_px}\nfield_nodes = [2, 2]\nparameters = {{ lambda_n_px = {lambda_n_px:?} }}\nvary = [{terms}]\n"
    )
}

/// The scene with a stage of these parameters, the others typical; `which`: less or more.
pub(super) fn with_stage(mut scene: Scene, effect: &str, parameters: &[(&str, [f64; 2])], which: usize) -> Scene {
    if let Some(stage) = pixel_effect(effect) {
        let value = |name: &str, typical| parameters.iter().find(|(own, _)| *own == name).map_or(typical, |(_, values)| values[which]);
        let all: Vec<_> = stage.parameters().iter().map(|spec| (spec.name, value(spec.name, spec.typical))).collect();
        scene.pixel_effects.push(EffectSetting::new(stage.id(), &all));
    }
    scene
}
