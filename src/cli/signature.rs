//! `boresight effects --signature ID`: what an effect on pixels does to measured stars, found by rendering and measuring, beside the formula of its page.

use std::path::Path;

use anyhow::{Result, anyhow, bail};
use boresight::detect::{FixedBackground, fit_forced};
use boresight::effects::ids;
use boresight::effects::pixel::{AnyPixelEffect, pixel_effect};
use boresight::effects::{AnyDisplacement, Context, Light, Observation, StarImage, StarState, displacement};
use boresight::frame::Frame;
use boresight::imaging::EffectSetting;
use boresight::provenance::Provenance;
use boresight::render::{
    MeasuredStar, SIGNATURE_FORMAT, SignatureResult, SignatureStar, SignatureSummary, StampRenderer, TestStar, signature,
};
use boresight::report::table;
use boresight::scene::Scene;

use super::output;

/// Stars along each side of the design, and how many electrons they send.
const ALONG: usize = 7;
const BRIGHTNESSES_E: [f64; 3] = [1e3, 1e4, 1e5];

/// The smallest frame with room for them.
const MIN_SIDE_PX: usize = 128;

/// Where no scene is given: one exposure of a second of a small camera.
const SCENE: &str = r#"
format = "boresight-scene/1"
camera = { width_px = 192, height_px = 192, focal_length_px = 2000.0 }
detector = { psf_sigma_px = 0.9, read_noise_e = 5.0 }
sky = { background_e_per_px_s = 50.0, physics = "none" }
[[frames]]
exposure_s = 1.0
boresight_radec_deg = [80.0, 10.0]
"#;

/// Prints the columns of an effect's parameter (the first, unless another is named), in the camera of a scene.
pub(crate) fn print(id: &str, parameter: Option<&str>, scene: Option<&Path>, (json, directory): (bool, Option<&Path>)) -> Result<()> {
    let effect =
        pixel_effect(id).ok_or_else(|| anyhow!("{id} is no effect on pixels, and only what pixels do is rendered and measured here"))?;
    let mut provenance = output::provenance();
    let scene = match scene {
        Some(path) => {
            provenance.add_input(path)?;
            Scene::open(path)?
        }
        None => Scene::parse("the scene of the signatures", SCENE)?,
    };
    if scene.camera.width_px.min(scene.camera.height_px) < MIN_SIDE_PX {
        bail!("the scene has frames of less than {MIN_SIDE_PX} px; stars of a signature need room for seven in a row");
    }
    let object = of(effect, parameter, &scene, provenance)?;
    output::deliver("signature", &object, json, directory, || text(&object))
}

fn of(effect: &dyn AnyPixelEffect, parameter: Option<&str>, scene: &Scene, provenance: Provenance) -> Result<SignatureResult> {
    let (id, specs) = (effect.id().to_owned(), effect.parameters());
    let names = || specs.iter().map(|spec| spec.name).collect::<Vec<_>>().join(", ");
    let spec = match parameter {
        None => specs.first().ok_or_else(|| anyhow!("{id} has no parameter, so nothing to compare it by"))?,
        Some(name) => {
            specs.iter().find(|spec| spec.name == name).ok_or_else(|| anyhow!("{id} has no parameter {name}; it has: {}", names()))?
        }
    };
    let half = if spec.typical == 0.0 { 0.5 } else { 0.5 * spec.typical.abs() };
    let values = [spec.typical - half, spec.typical + half].map(|value| value.clamp(spec.range.0, spec.range.1));
    let design = design(scene);
    let dark_e = dark_level_e(scene, effect)?;
    let read_noise_e = scene.detector.read_noise_e;
    let sky = FixedBackground {
        background_dn: dark_e,
        noise_dn: (dark_e.max(0.0) + read_noise_e * read_noise_e).sqrt().max(1.0),
        gain_e_per_dn: 1.0, // the frames of a bench are in electrons
        psf_sigma_px: scene.detector.psf_sigma_px,
    };
    let measure = |frame: &Frame, stars: &[TestStar]| fitted(&sky, frame, stars);
    let [weaker, stronger] = values.map(|value| with(scene, effect, spec.name, value));
    let benches = [StampRenderer::new(&weaker)?, StampRenderer::new(&stronger)?];
    let step = values[1] - values[0];
    let found = signature(&benches[0], &benches[1], step, &design, measure)?;
    let dark = [benches[0].frame(&[])?, benches[1].frame(&[])?];
    let formula = displacement(&id);
    let column = |(star, found): (&TestStar, Option<MeasuredStar>)| {
        let found = found?;
        let shift = formula.map(|formula| by_formula(formula, scene, star, gradient_e_px(&dark, step, star)));
        Some(SignatureStar {
            x_px: star.x_px,
            y_px: star.y_px,
            electrons: star.electrons,
            dx_px: found.x_px,
            dy_px: found.y_px,
            flux_relative: found.flux_e / star.electrons,
            formula_dx_px: shift.map(|shift| shift[0]),
            formula_dy_px: shift.map(|shift| shift[1]),
        })
    };
    let stars: Vec<SignatureStar> = design.iter().flatten().zip(found).filter_map(column).collect();
    if stars.is_empty() {
        bail!("no star of the design can be measured in this scene; its sky or its images are beyond the fit");
    }
    let mut summary: Vec<SignatureSummary> =
        BRIGHTNESSES_E.into_iter().filter_map(|electrons| summary_of(&stars, Some(electrons))).collect();
    summary.extend(summary_of(&stars, None));
    let formula = formula.and_then(|formula| formula.parameters().first()).map(|spec| format!("{id}.{}", spec.name));
    let format = SIGNATURE_FORMAT;
    Ok(SignatureResult { format, effect: id, parameter: spec.name, unit: spec.unit, values, formula, summary, stars, provenance })
}

/// The scene with the effect at this value of a parameter, the others typical.
fn with(scene: &Scene, effect: &dyn AnyPixelEffect, parameter: &str, value: f64) -> Scene {
    let mut scene = without(scene, effect);
    let of = |name: &'static str, typical| (name, if name == parameter { value } else { typical });
    let parameters: Vec<_> = effect.parameters().iter().map(|spec| of(spec.name, spec.typical)).collect();
    scene.pixel_effects.push(EffectSetting::new(effect.id(), &parameters));
    scene
}

fn without(scene: &Scene, effect: &dyn AnyPixelEffect) -> Scene {
    let mut scene = scene.clone();
    scene.pixel_effects.retain(|setting| setting.id != effect.id());
    scene
}

/// Level of a frame without stars and without the effect, unless that is the sky itself.
fn dark_level_e(scene: &Scene, effect: &dyn AnyPixelEffect) -> Result<f64> {
    let plain = if effect.id() == ids::BACKGROUND { scene.clone() } else { without(scene, effect) };
    let mut pixels = StampRenderer::new(&plain)?.frame(&[])?.pixels_dn;
    pixels.sort_by(f32::total_cmp);
    Ok(f64::from(pixels[pixels.len() / 2]))
}

/// Frames of seven stars in columns and rows of their own, at phases within the pixel that fill it evenly, seven for each brightness.
fn design(scene: &Scene) -> Vec<Vec<TestStar>> {
    /// From the edge to the outermost star, px.
    const MARGIN_PX: f64 = 24.0;
    let side = |length: usize| (length as f64 - 2.0 * MARGIN_PX).max(0.0) / (ALONG - 1) as f64;
    let [step_x, step_y] = [side(scene.camera.width_px), side(scene.camera.height_px)];
    let phase = |k: usize, step: f64| (step * k as f64).fract() - 0.5;
    let stars = |frame: usize, electrons: f64| -> Vec<TestStar> {
        let star = |k: usize| {
            let (number, row) = (ALONG * frame + k, (3 * k + frame) % ALONG);
            let x_px = (MARGIN_PX + step_x * k as f64).round() + phase(number, 0.754_877_666);
            let y_px = (MARGIN_PX + step_y * row as f64).round() + phase(number, 0.569_840_291);
            TestStar { x_px, y_px, electrons, colour: Some(1.6) } // one magnitude redder than the Sun
        };
        (0..ALONG).map(star).collect()
    };
    BRIGHTNESSES_E.iter().flat_map(|electrons| (0..ALONG).map(move |frame| (frame, *electrons))).map(|(frame, e)| stars(frame, e)).collect()
}

/// The program's own fit.
fn fitted(sky: &FixedBackground, frame: &Frame, stars: &[TestStar]) -> Vec<Option<MeasuredStar>> {
    let places: Vec<[f64; 2]> = stars.iter().map(|star| [star.x_px.round(), star.y_px.round()]).collect();
    let measured = |fit: Option<boresight::detect::ForcedFit>| {
        fit.map(|fit| MeasuredStar { x_px: fit.x_px, y_px: fit.y_px, flux_e: fit.flux_dn, variance_px2: fit.width_px * fit.width_px })
    };
    fit_forced(frame, &places, sky).into_iter().map(measured).collect()
}

/// Slope under a star that a unit of the parameter adds to the frame without stars, electrons per pixel.
fn gradient_e_px([weaker, stronger]: &[Frame; 2], step: f64, star: &TestStar) -> [f64; 2] {
    /// How far to both sides, px.
    const REACH_PX: usize = 4;
    let (x, y) = (star.x_px.round() as usize, star.y_px.round() as usize);
    let added = |x: usize, y: usize| f64::from(stronger.at(x, y) - weaker.at(x, y)) / step;
    let both = 2.0 * REACH_PX as f64;
    [(added(x + REACH_PX, y) - added(x - REACH_PX, y)) / both, (added(x, y + REACH_PX) - added(x, y - REACH_PX)) / both]
}

/// The shift of a unit of the formula's first parameter. The star's image is measured as the fit would: electrons, width, slope under it.
fn by_formula(formula: &dyn AnyDisplacement, scene: &Scene, star: &TestStar, gradient_e_px: [f64; 2]) -> [f64; 2] {
    let [width, height] = [scene.camera.width_px, scene.camera.height_px];
    let image = StarImage {
        flux_e: Some(star.electrons),
        psf_sigma_px: Some(scene.detector.psf_sigma_px),
        background_gradient_e_px: Some(gradient_e_px),
        recording_gradient_e_px: Some(1.0), // so that a unit of the parameter is the slope itself
        ..StarImage::default()
    };
    // A magnitude of 5 stands for 10 000 electrons.
    let state = StarState { magnitude: 5.0 - 2.5 * (1e-4 * star.electrons).log10(), colour: star.colour, ..StarState::default() };
    let context = Context::new(state, Observation::of_sensor(width, height)).with_image(image);
    let point_px = [star.x_px - 0.5 * (width as f64 - 1.0), star.y_px - 0.5 * (height as f64 - 1.0)];
    let focal_length_px = scene.camera.focal_length_px;
    let light = Light { direction: [0.0, 0.0, 1.0], point_px, pixel_px: [star.x_px, star.y_px], focal_length_px };
    let mut parameters = vec![0.0; formula.parameters().len()];
    parameters[0] = 1.0;
    let moved = formula.displace(&parameters, light, &context).point_px;
    [point_px[0] - moved[0], point_px[1] - moved[1]]
}

/// The columns over stars of this brightness, or of all; `None` where there are none.
fn summary_of(stars: &[SignatureStar], electrons: Option<f64>) -> Option<SignatureSummary> {
    let stars: Vec<&SignatureStar> = stars.iter().filter(|star| electrons.is_none_or(|electrons| star.electrons == electrons)).collect();
    if stars.is_empty() {
        return None;
    }
    let count = stars.len() as f64;
    let mean = |of: &dyn Fn(&SignatureStar) -> f64| stars.iter().map(|star| of(star)).sum::<f64>() / count;
    let square = mean(&|star| star.dx_px.powi(2) + star.dy_px.powi(2));
    let formula = |star: &SignatureStar| [star.formula_dx_px.unwrap_or_default(), star.formula_dy_px.unwrap_or_default()];
    let formula_square = mean(&|star| formula(star).map(|along| along * along).iter().sum());
    let product = mean(&|star| star.dx_px * formula(star)[0] + star.dy_px * formula(star)[1]);
    let is_comparable = square > 0.0 && formula_square > 0.0;
    Some(SignatureSummary {
        electrons,
        stars: stars.len(),
        mean_dx_px: mean(&|star| star.dx_px),
        mean_dy_px: mean(&|star| star.dy_px),
        rms_px: square.sqrt(),
        flux_relative: mean(&|star| star.flux_relative),
        cosine: is_comparable.then(|| product / (square * formula_square).sqrt()),
        ratio: is_comparable.then(|| product / formula_square),
    })
}

fn text(signature: &SignatureResult) -> String {
    let SignatureResult { effect, parameter, unit, values: [low, high], .. } = signature;
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    let beside = match &signature.formula {
        Some(formula) => format!("; beside a unit of {formula} by its page"),
        None => "; its page has no formula of a displacement".to_owned(),
    };
    let mut text = format!(
        "{effect}: {parameter} from {low} to {high}{unit}, noise-free stars rendered and fitted; changes per unit of it{beside}\n\n"
    );
    let number = |value: f64| format!("{value:+.3e}");
    let maybe = |value: Option<f64>, digits: usize| value.map_or_else(|| "–".to_owned(), |value| format!("{value:+.digits$}"));
    let rows: Vec<Vec<String>> = signature
        .summary
        .iter()
        .map(|row| {
            vec![
                row.electrons.map_or_else(|| "all".to_owned(), |electrons| format!("{electrons:.0e}")),
                row.stars.to_string(),
                number(row.mean_dx_px),
                number(row.mean_dy_px),
                number(row.rms_px),
                number(row.flux_relative),
                maybe(row.cosine, 4),
                row.ratio.map_or_else(|| "–".to_owned(), number),
            ]
        })
        .collect();
    text += &table(&["electrons", "stars", "mean dx (px)", "mean dy (px)", "rms (px)", "dF/F", "cosine", "ratio"], &rows);
    text += "\nstars of one frame of each brightness\n\n";
    let shown = |(index, _): &(usize, &SignatureStar)| index % (ALONG * ALONG) < ALONG;
    let rows: Vec<Vec<String>> = signature
        .stars
        .iter()
        .enumerate()
        .filter(shown)
        .map(|(_, star)| {
            vec![
                format!("{:.2}", star.x_px),
                format!("{:.2}", star.y_px),
                format!("{:.0e}", star.electrons),
                number(star.dx_px),
                number(star.dy_px),
                number(star.flux_relative),
                star.formula_dx_px.map_or_else(|| "–".to_owned(), number),
                star.formula_dy_px.map_or_else(|| "–".to_owned(), number),
            ]
        })
        .collect();
    let heads = ["x (px)", "y (px)", "electrons", "dx (px)", "dy (px)", "dF/F", "formula dx (px)", "formula dy (px)"];
    text + &table(&heads, &rows)
}
