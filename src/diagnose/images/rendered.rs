//! Columns of brightness and shape by rendering: what an effect on pixels does to the light and the moments of this recording's stars.
//!
//! Stars with the recording's own places, pixel phases, colours and expected electrons are rendered without noise with a little less and a little
//! more of an effect, and summed by the code that summed the recording's (`pixel_statistics/star_images.rs`). The change over the step is the column.
//! Where the effect's page has a formula for the images, that gives the unit alone; where the effect moves centres, the unit is that of
//! its displacement.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::expected_stars::ExpectedStar;
use crate::camera::Camera;
use crate::diagnose::options::ImageConditions;
use crate::diagnose::stamp_scenes::{StarLayout, gaussian, grid, layouts, room_px, scene, told, unit_shift, with_stage};
use crate::effects::detector::even_odd::EvenOdd;
use crate::effects::{
    AnyDisplacement, CentroidShift, DISPLACEMENTS, IMAGE_EFFECTS, ImageEffect, ImageResponse, REFERENCE_FLUX_E, Rendering, StarState, ids,
};
use crate::frame::Frame;
use crate::parallel;
use crate::pixel_statistics::{ImageFrame, StarDisc, SummedImage};
use crate::render::{PsfTables, StampRenderer, TestStar};
use crate::scene::Scene;

/// More star images take longer to render than their diagnosis is worth.
const MAX_IMAGES: usize = 30_000;
/// Fewer stars tell no column.
const MIN_STARS: usize = 20;
/// The light of a star reaches so far, in widths of its image.
const REACH_SIGMAS: f64 = 6.0;
/// A rendered column and a formula, or displacement, that are less alike than this have no common unit.
const MIN_COSINE: f64 = 0.3;
/// What is told by the pixels between the stars with columns of its own.
const BY_THE_SKY: &[&str] = &[<EvenOdd as CentroidShift>::ID, ids::BAYER];

/// What has to be known to render the stars of a recording.
#[derive(Clone, Copy, Debug)]
pub struct StampCamera {
    /// Its frames and their middle; as stored.
    pub camera: Camera,
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Typical image, sky and noise.
    pub looks: ImageConditions,
}

/// A column over the stars.
#[derive(Clone, Debug)]
pub(super) struct RenderedColumn {
    pub(super) id: &'static str,
    /// Name and unit.
    pub(super) parameter: (&'static str, &'static str),
    pub(super) follows: &'static str,
    /// What a unit does to each star, by its control point.
    pub(super) responses: BTreeMap<usize, ImageResponse>,
}

/// The columns of effects whose formula for the images is the unit alone.
pub(super) fn of_images(stars: &[ExpectedStar], stamps: &StampCamera) -> Vec<RenderedColumn> {
    let Some(bench) = Bench::new(stars, stamps) else { return Vec::new() };
    let column = |effect: &&'static dyn ImageEffect| bench.of_image(*effect, stars);
    parallel::map(IMAGE_EFFECTS, column).into_iter().flatten().collect()
}

/// The columns of effects that move centres.
pub(super) fn of_displacements(stars: &[ExpectedStar], stamps: &StampCamera) -> Vec<RenderedColumn> {
    let Some(bench) = Bench::new(stars, stamps) else { return Vec::new() };
    let asked = DISPLACEMENTS.par_iter().filter(|effect| !BY_THE_SKY.contains(&effect.id()));
    asked.filter_map(|effect| bench.of_displacement(*effect)).collect()
}

/// The stars on as few frames as have room for them.
struct Bench<'a> {
    stamps: &'a StampCamera,
    plates: Vec<StarLayout>,
    tables: PsfTables,
}

impl<'a> Bench<'a> {
    fn new(stars: &[ExpectedStar], stamps: &'a StampCamera) -> Option<Self> {
        if !(MIN_STARS..=MAX_IMAGES).contains(&stars.len()) {
            return None;
        }
        let camera = &stamps.camera;
        let half_px = 0.5 * (camera.width_px as f64).hypot(camera.height_px as f64);
        let place = |axis: usize, side: usize, at: [f64; 2]| at[axis] * half_px + 0.5 * (side as f64 - 1.0);
        let star = |own: &ExpectedStar| TestStar {
            x_px: place(0, camera.width_px, own.star.image.at),
            y_px: place(1, camera.height_px, own.star.image.at),
            electrons: own.flux_dn * stamps.gain_e_per_dn,
            colour: own.star.image.colour_offset.map(|offset| offset + StarState::REFERENCE_COLOUR),
        };
        let all = stars.iter().map(|own| (own.star.point, star(own))).filter(|(_, star)| star.electrons.is_finite());
        let plates = layouts(all, [camera.width_px, camera.height_px], room_px(&stamps.looks));
        Some(Self { stamps, plates, tables: PsfTables::default() })
    }

    /// In the unit of the formula, by the stars themselves.
    fn of_image(&self, effect: &'static dyn ImageEffect, stars: &[ExpectedStar]) -> Option<RenderedColumn> {
        let change = self.difference(&self.pair(&effect.rendering()?)?, &self.plates)?;
        let formula = |star: &ExpectedStar| Some((star.star.point, *effect.responses(&star.star.image)?.first()?));
        let formula: BTreeMap<usize, ImageResponse> = stars.iter().filter_map(formula).collect();
        // Magnitudes tell the unit where the effect has any, else the sizes of images.
        let size = |response: &ImageResponse| 0.5 * (response.second_px2[0] + response.second_px2[2]);
        let has_magnitude = formula.values().any(|response| response.magnitude != 0.0);
        let number = |response: &ImageResponse| if has_magnitude { response.magnitude } else { size(response) };
        let pairs = change.iter().filter_map(|(point, own)| Some([number(own), number(formula.get(point)?)]));
        let unit = unit(pairs)?;
        let parameter = *effect.parameters().first()?;
        Some(RenderedColumn { id: effect.id(), parameter, follows: effect.follows(), responses: per_unit(change, unit) })
    }

    /// In the unit of the displacement.
    fn of_displacement(&self, effect: &'static dyn AnyDisplacement) -> Option<RenderedColumn> {
        let rendering = effect.rendering(0).filter(|rendering| matches!(rendering, Rendering::Stage { by_colour: false, .. }))?;
        let Rendering::Stage { step, .. } = rendering else { return None };
        let pair = self.pair(&rendering)?;
        let unit = step.or_else(|| self.unit_by_shift(effect, &pair))?;
        let change = self.difference(&pair, &self.plates)?;
        let spec = effect.parameters().first()?;
        let follows = effect.facts().profile_covariate(spec.name).unwrap_or("flux");
        Some(RenderedColumn { id: effect.id(), parameter: (spec.name, spec.unit), follows, responses: per_unit(change, unit) })
    }

    /// The cameras with less and with more of it.
    fn pair(&self, rendering: &Rendering) -> Option<[Scene; 2]> {
        let Rendering::Stage { effect, parameters, .. } = rendering else { return None };
        let StampCamera { camera, looks, .. } = self.stamps;
        let of = |which: usize| {
            let plain = scene([camera.width_px, camera.height_px], &gaussian(looks, ""), looks.background_e)?;
            Some(with_stage(plain, effect, parameters, which))
        };
        Some([of(0)?, of(1)?])
    }

    /// The step in units of the displacement: by the shift of centres of stars that its page speaks of.
    fn unit_by_shift(&self, effect: &dyn AnyDisplacement, pair: &[Scene; 2]) -> Option<f64> {
        let StampCamera { camera, looks, .. } = self.stamps;
        let stars = grid(REFERENCE_FLUX_E, camera, looks);
        let [less, more] = self.summed(pair, &stars)?;
        let shifts = stars.iter().zip(less.iter().zip(more)).filter_map(|((_, star), (less, more))| {
            let (less, more) = (less.as_ref()?.centre_px, more?.centre_px);
            let formula = unit_shift(effect, 0, star, camera, looks);
            Some([0, 1].map(|axis| [more[axis] - less[axis], formula[axis]]))
        });
        unit(shifts.flatten())
    }

    /// What changes of every star from less to more, by its control point.
    fn difference(&self, pair: &[Scene; 2], plates: &[StarLayout]) -> Option<BTreeMap<usize, ImageResponse>> {
        let of = |plate: &StarLayout| -> Option<Vec<(usize, ImageResponse)>> {
            let [less, more] = self.summed(pair, plate)?;
            let changes = plate.iter().zip(less.into_iter().zip(more));
            Some(changes.filter_map(|((point, _), (less, more))| Some((*point, change(&less?, &more?)))).collect())
        };
        let found: BTreeMap<usize, ImageResponse> =
            parallel::map(plates, of).into_iter().collect::<Option<Vec<_>>>()?.into_iter().flatten().collect();
        (found.len() >= MIN_STARS).then_some(found)
    }

    /// A frame of stars by two cameras, summed.
    fn summed(&self, pair: &[Scene; 2], plate: &StarLayout) -> Option<[Vec<Option<SummedImage>>; 2]> {
        let stars: Vec<TestStar> = plate.iter().map(|(_, star)| *star).collect();
        let of = |scene: &Scene| -> Option<Vec<Option<SummedImage>>> {
            let frame = told(told(StampRenderer::with_tables(scene, &self.tables))?.frame(&stars))?;
            Some(sums(&frame, &stars, &self.stamps.looks))
        };
        Some([of(&pair[0])?, of(&pair[1])?])
    }
}

/// The images of a frame without noise, as those of a recording are summed.
fn sums(frame: &Frame, stars: &[TestStar], looks: &ImageConditions) -> Vec<Option<SummedImage>> {
    let radius_px = REACH_SIGMAS * looks.psf_sigma_px.hypot(0.3);
    let discs: Vec<StarDisc> = stars.iter().map(|star| StarDisc { x_px: star.x_px, y_px: star.y_px, radius_px }).collect();
    ImageFrame { frame, stars: &discs, flux_dn: &[], bad: None, sigma_px: looks.psf_sigma_px, noise_dn: 1.0 }.star_images()
}

fn change(less: &SummedImage, more: &SummedImage) -> ImageResponse {
    ImageResponse {
        magnitude: -2.5 * (more.flux_dn / less.flux_dn).log10(),
        second_px2: std::array::from_fn(|k| more.second_px2[k] - less.second_px2[k]),
        skewness: std::array::from_fn(|k| more.skewness[k] - less.skewness[k]),
    }
}

/// By how much rendered numbers exceed those of a unit: least squares; nothing where the two are not alike.
fn unit(pairs: impl Iterator<Item = [f64; 2]>) -> Option<f64> {
    let (own, along, square) = pairs.fold((0.0, 0.0, 0.0), |(own, along, square), [rendered, formula]| {
        (own + rendered * rendered, along + rendered * formula, square + formula * formula)
    });
    let cosine = along / f64::sqrt(own * square);
    (cosine.is_finite() && cosine.abs() > MIN_COSINE).then(|| along / square)
}

fn per_unit(change: BTreeMap<usize, ImageResponse>, unit: f64) -> BTreeMap<usize, ImageResponse> {
    change.into_iter().map(|(point, own)| (point, own.times(unit.recip()))).collect()
}

#[cfg(test)]
#[path = "rendered_tests.rs"]
mod tests;
