//! Design columns by rendering: the shift that an effect on pixels gives to the measured centres of this recording's stars.
//!
//! Stars with the recording's own places, pixel phases, electrons and colours are rendered without noise with a little less and a little more of an
//! effect, and measured by the fit that measured the recording. The difference is the design column; it contains the bias of the estimator. Its
//! parameter keeps the unit of the effect's page: where that is no quantity of the rendering (as the slope of a background is, or the gain of a
//! column), the column is scaled so that stars of the brightness that the page speaks of move as far as the formula says. Formula and rendered
//! column are then two variants of one hypothesis, and the recording decides: the stars of a star list may have been measured by another estimator.
//!
//! Star images of all frames share the rendered ones, as many on each as have room without touching: cost grows with the images and not with the
//! frames.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::options::ImageConditions;
use super::stamp_scenes::{StarLayout, coma, gaussian, grid, layouts, room_px, scene, told, unit_shift, with_stage};
use super::star_images::{StarImages, WITHIN_REACH_PX};
use crate::calibrate::{BundleImage, BundleSolution};
use crate::detect::{FixedBackground, fit_forced};
use crate::effects::ids;
use crate::effects::pixel::pixel_effect;
use crate::effects::{AnyDisplacement, DISPLACEMENTS, MAX_SHIFTS, REFERENCE_FLUX_E, Rendering, Signature};
use crate::frame::Frame;
use crate::identify::ControlPoints;
use crate::imaging::EffectSetting;
use crate::parallel;
use crate::render::{MeasuredStar, PsfTables, StampRenderer, TestStar, signature};
use crate::scene::Scene;

/// A rendered difference smaller than this (rms, px) is no more than the rounding of the pixels.
const MIN_PX: f64 = 1e-5;
/// A rendered column and a formula that are less alike than this have no common unit.
const MIN_COSINE: f64 = 0.3;
/// Fewer stars tell no column.
const MIN_STARS: usize = 20;
/// More star images take longer to render than their diagnosis is worth (minutes).
pub(super) const MAX_IMAGES: usize = 30_000;
/// A step that moves the stars which tell its unit by less (rms, px) is too small for one: the rounding of faint stars is a part of it.
const MIN_STEP_PX: f64 = 1e-4;
/// Stars that move farther than this when rendered with more of an effect have been lost by the fit.
const LOST_PX: f64 = 1.0;

/// Shifts per unit of an effect's parameters, by control point.
pub(super) type Shifts = Arc<BTreeMap<usize, Signature>>;

/// The columns that could be rendered, by the effect's id.
#[derive(Clone, Debug, Default)]
pub(super) struct Rendered(BTreeMap<&'static str, Shifts>);

impl Rendered {
    /// Renders and measures the star images of a baseline solution; nothing where their image conditions are not known, or where their electrons are
    /// not known.
    pub(super) fn new(stars: &StarImages, joint: &BundleSolution, points: &ControlPoints, looks: Option<&ImageConditions>) -> Self {
        let Some(looks) = looks.filter(|_| stars.images.len() <= MAX_IMAGES) else { return Self::default() };
        let studio =
            ColumnRenderer { stars, joint, points, looks, plates: star_layouts(stars, joint, points, looks), tables: PsfTables::default() };
        let ids = DISPLACEMENTS.iter().filter(|effect| effect.rendering(0).is_some());
        Self(ids.filter_map(|effect| Some((effect.id(), studio.shifts(*effect)?))).collect())
    }

    /// Those of an effect.
    pub(super) fn of(&self, id: &str) -> Option<&Shifts> {
        self.0.get(id)
    }
}

/// That nothing was rendered because there is too much of it.
pub(super) fn left_out(stars: &StarImages, looks: Option<&ImageConditions>) -> Option<String> {
    let images = stars.images.len();
    looks.filter(|_| images > MAX_IMAGES).map(|_| {
        format!(
            "{images} star images are too many to render them for the columns of effects on pixels (at most {MAX_IMAGES}): the formulas of their pages stand in; give fewer frames"
        )
    })
}

/// Shifts, px, by the image's number.
type Moved = BTreeMap<usize, [f64; 2]>;

/// Distributes the star images over as few star layouts as have room for them.
fn star_layouts(stars: &StarImages, joint: &BundleSolution, points: &ControlPoints, looks: &ImageConditions) -> Vec<StarLayout> {
    let camera = joint.model().camera();
    let star = |(index, (image, [x_px, y_px])): (usize, (&BundleImage, [f64; 2]))| {
        let point = &points.points[image.point];
        let electrons = point.image.flux_e.filter(|flux| *flux > 0.0 && flux.is_finite())?;
        Some((index, TestStar { x_px, y_px, electrons, colour: point.star.colour }))
    };
    let places = stars.images.iter().zip(stars.predicted_px(WITHIN_REACH_PX)).enumerate();
    layouts(places.filter_map(star), [camera.width_px, camera.height_px], room_px(looks))
}

/// What is rendered.
enum Pair {
    /// Less and more of one thing.
    Same(Box<[Scene; 2]>),
    /// A background that falls and that rises by so much a pixel: along x, along y.
    Slopes(Box<[[Scene; 2]; 2]>, f64),
}

/// Everything that a column is rendered from.
struct ColumnRenderer<'a> {
    stars: &'a StarImages,
    joint: &'a BundleSolution,
    points: &'a ControlPoints,
    looks: &'a ImageConditions,
    plates: Vec<StarLayout>,
    /// The images of a pair of cameras serve the stars of the recording and those that tell the unit.
    tables: PsfTables,
}

impl ColumnRenderer<'_> {
    /// The shifts of all parameters of an effect, in the units of its page; `None` where one cannot be rendered to any use.
    fn shifts(&self, effect: &'static dyn AnyDisplacement) -> Option<Shifts> {
        let columns: Vec<Moved> = (0..effect.parameters().len()).map(|parameter| self.column(effect, parameter)).collect::<Option<_>>()?;
        let signature = |index: usize| {
            let mut shift_px = [[0.0; 2]; MAX_SHIFTS];
            for (shift, column) in shift_px.iter_mut().zip(&columns) {
                *shift = *column.get(&index)?; // an image that one of the parameters lacks keeps the formula for all
            }
            Some((self.stars.images[index].point, Signature { effect: effect.id(), shift_px }))
        };
        Some(Arc::new(columns.first()?.keys().filter_map(|index| signature(*index)).collect()))
    }

    /// Shift of each image for a unit of a parameter.
    fn column(&self, effect: &dyn AnyDisplacement, parameter: usize) -> Option<Moved> {
        let rendering = effect.rendering(parameter)?;
        let (mut found, unit) = match self.pair(&rendering)? {
            Pair::Same(pair) => {
                let mut found = self.difference(&pair, &self.plates)?;
                let mut known = None;
                if let Rendering::Stage { step, by_colour, .. } = rendering {
                    known = step;
                    for (index, shift) in found.iter_mut().filter(|_| by_colour) {
                        let offset = self.points.points[self.stars.images[*index].point].star.colour_offset();
                        *shift = shift.map(|along| along * offset);
                    }
                }
                (found, known.or_else(|| self.unit(effect, parameter, &pair)))
            }
            Pair::Slopes(along, slope) => (self.by_own_slope(&along)?, Some(2.0 * slope)),
        };
        found.retain(|_, shift| shift.iter().all(|along| along.abs() < LOST_PX));
        let square: f64 = found.values().flatten().map(|along| along * along).sum();
        if found.len() < MIN_STARS || square < MIN_PX * MIN_PX * found.len() as f64 {
            return None;
        }
        let unit = unit?;
        tracing::debug!("{}: {} star images rendered; the step is {unit:.3e} of its unit", effect.id(), found.len());
        Some(found.into_iter().map(|(index, shift)| (index, shift.map(|along| along / unit))).collect())
    }

    /// The cameras with less and with more of it.
    fn pair(&self, rendering: &Rendering) -> Option<Pair> {
        let (looks, camera) = (self.looks, self.joint.model().camera());
        let size = [camera.width_px, camera.height_px];
        let plain = |sky_e: f64| scene(size, &gaussian(looks, ""), sky_e);
        let of = |which: usize| match rendering {
            // What acts by a star's colour leaves the sky, which has a colour of its own, as it is.
            Rendering::Stage { effect, parameters, by_colour, .. } => {
                Some(with_stage(plain(if *by_colour { 0.0 } else { looks.background_e })?, effect, parameters, which))
            }
            Rendering::WithinPixel { axis, cosine } => {
                let mut response = [0.0; 2];
                response[*axis] = cosine[which];
                scene(size, &gaussian(looks, &format!("[psf.pixel]\ncosine = {response:?}\n")), looks.background_e)
            }
            Rendering::Coma { waves } => scene(size, &coma(looks, waves[which]), looks.background_e),
            Rendering::Slope => None,
        };
        if !matches!(rendering, Rendering::Slope) {
            return Some(Pair::Same(Box::new([of(0)?, of(1)?])));
        }
        // As steep as leaves the sky alight over most of the frame, so that nothing is cut at zero.
        let slope = 0.4 * looks.background_e / size[0].max(size[1]) as f64;
        let sloped = |name: &str, sign: f64| {
            let effect = pixel_effect(ids::STRAY_LIGHT)?;
            let value = |own: &str| if own == name { sign * slope } else { 0.0 };
            let parameters: Vec<_> = effect.parameters().iter().map(|spec| (spec.name, value(spec.name))).collect();
            let mut scene = plain(looks.background_e)?;
            scene.pixel_effects.push(EffectSetting::new(effect.id(), &parameters));
            Some(scene)
        };
        let along = |name: &str| Some([sloped(name, -1.0)?, sloped(name, 1.0)?]);
        Some(Pair::Slopes(Box::new([along("slope_x_e_per_px_s")?, along("slope_y_e_per_px_s")?]), slope))
    }

    /// Shift of each image by its own measured slope, in units of the recording's mean one.
    fn by_own_slope(&self, along: &[[Scene; 2]; 2]) -> Option<Moved> {
        let [x, y] = [&along[0], &along[1]].map(|pair| self.difference(pair, &self.plates));
        let (x, y) = (x?, y?);
        let of_image = |(index, by_x): (usize, [f64; 2])| {
            let image = &self.points.points[self.stars.images[index].point].image;
            let (gradient, by_y) = (image.background_gradient_e_px?, y.get(&index)?);
            let scale = image.recording_gradient_e_px.unwrap_or(gradient[0].hypot(gradient[1]));
            let share = gradient.map(|along| along / scale);
            let is_finite = share.iter().all(|share| share.is_finite());
            is_finite.then(|| (index, [0, 1].map(|axis| by_x[axis] * share[0] + by_y[axis] * share[1])))
        };
        Some(x.into_iter().filter_map(of_image).collect())
    }

    /// The step from less to more in units of a parameter: by the formula, at stars of the brightness that its page speaks of, all over the
    /// frame; where those are not moved since the parameter is a slope in magnitude, at stars a magnitude brighter and fainter. So the unit is
    /// the camera's and not that of the stars that happen to be there.
    fn unit(&self, effect: &dyn AnyDisplacement, parameter: usize, pair: &[Scene; 2]) -> Option<f64> {
        let camera = self.joint.model().camera();
        let at = |offset: f64| -> StarLayout { grid(REFERENCE_FLUX_E * 10.0_f64.powf(-0.4 * offset), camera, self.looks) };
        let formula = |plate: &StarLayout| -> Moved {
            plate.iter().map(|(k, star)| (*k, unit_shift(effect, parameter, star, camera, self.looks))).collect()
        };
        let one = at(0.0);
        let is_moved = formula(&one).values().flatten().any(|along| *along != 0.0);
        let (found, formula) = if is_moved {
            (self.difference(pair, std::slice::from_ref(&one))?, formula(&one))
        } else {
            let (bright, faint) = (at(-1.0), at(1.0));
            let [first, second] = [&bright, &faint].map(|plate| self.difference(pair, std::slice::from_ref(plate)));
            (change(&first?, &second?), change(&formula(&bright), &formula(&faint)))
        };
        let (mut own, mut along, mut square) = (0.0, 0.0, 0.0);
        for (shift, formula) in found.iter().filter_map(|(k, shift)| Some((shift, formula.get(k)?))) {
            for axis in 0..2 {
                own += shift[axis] * shift[axis];
                along += shift[axis] * formula[axis];
                square += formula[axis] * formula[axis];
            }
        }
        let cosine = along / (own * square).sqrt();
        let is_seen = own > MIN_STEP_PX * MIN_STEP_PX * found.len() as f64;
        (is_seen && cosine.is_finite() && cosine.abs() > MIN_COSINE).then(|| along / square)
    }

    /// Renders and measures every star layout with two cameras; the change of each star's centre, by its number.
    fn difference(&self, scenes: &[Scene; 2], plates: &[StarLayout]) -> Option<Moved> {
        let looks = self.looks;
        let renderer = |scene| told(StampRenderer::with_tables(scene, &self.tables));
        let [less, more] = [renderer(&scenes[0])?, renderer(&scenes[1])?];
        let known = |sky_e: f64| FixedBackground {
            background_dn: sky_e,
            noise_dn: looks.noise_e,
            gain_e_per_dn: 1.0,
            psf_sigma_px: looks.psf_sigma_px,
        };
        let sky = known(scenes[0].sky.background_e_per_px_s.unwrap_or(0.0));
        let measure = |frame: &Frame, stars: &[TestStar]| -> Vec<Option<MeasuredStar>> {
            let places: Vec<[f64; 2]> = stars.iter().map(|star| [star.x_px.round(), star.y_px.round()]).collect();
            let measured = |fit: crate::detect::ForcedFit| MeasuredStar {
                x_px: fit.x_px,
                y_px: fit.y_px,
                flux_e: fit.flux_dn,
                variance_px2: fit.width_px * fit.width_px,
            };
            fit_forced(frame, &places, &sky).into_iter().map(|fit| fit.map(measured)).collect()
        };
        let of = |plate: &StarLayout| -> Option<Vec<(usize, [f64; 2])>> {
            let design = [plate.iter().map(|(_, probe)| *probe).collect::<Vec<TestStar>>()];
            let found = told(signature(&less, &more, 1.0, &design, measure))?;
            Some(plate.iter().zip(found).filter_map(|((index, _), found)| found.map(|found| (*index, [found.x_px, found.y_px]))).collect())
        };
        let parts: Vec<Vec<(usize, [f64; 2])>> = parallel::map(plates, of).into_iter().collect::<Option<_>>()?;
        Some(parts.into_iter().flatten().collect())
    }
}

/// By how much more the stars of the second move than those of the first.
fn change(first: &Moved, second: &Moved) -> Moved {
    second.iter().filter_map(|(k, shift)| first.get(k).map(|own| (*k, [shift[0] - own[0], shift[1] - own[1]]))).collect()
}
