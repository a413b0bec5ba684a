//! Implausible identifications: frames with far more stars than the catalogue has for this camera, or with no more matches than chance gives.
//!
//! Where noise is detected as stars every catalogue star has a detection near it, however faint it is. A camera that sees stars of the sixth
//! magnitude in its other frames does not see those of the ninth in one.

use crate::catalog::Catalog;
use crate::coordinates::{Direction, Icrs};
use crate::detect::Detections;
use crate::identify::Solution;
use crate::statistics::median;

/// A frame brings too many stars if they are so many times those that the catalogue has for it.
const TOO_MANY: f64 = 10.0;
/// Stars so much fainter than the usual limit may still be seen in a clear night, magnitudes.
const FAINTER: f64 = 0.75;
/// Of the stars of a frame so many are brighter than its limit: the faintest ones are lucky.
const BRIGHTER: f64 = 0.9;
/// The matches of a frame must be so many times those that chance brings about within their radius.
const BEYOND_CHANCE: f64 = 2.0;
/// Half of the residuals of a frame are below so many times their 2-D rms; nearly all below twice that.
const NEARLY_ALL: f64 = 2.0;

/// A frame that was identified.
pub(super) struct Seen<'a> {
    pub(super) name: &'a str,
    pub(super) detections: &'a Detections,
    pub(super) solution: &'a Solution,
}

/// Why each of the frames is to be left out, if it is.
pub(super) fn left_out(frames: &[Seen<'_>], catalog: &Catalog) -> Vec<Option<String>> {
    let limits: Vec<f64> = frames.iter().filter_map(|frame| frame.limit(catalog)).collect();
    let usual = median(&limits);
    frames.iter().map(|frame| frame.no_better_than_chance(catalog).or_else(|| frame.too_many(usual?, catalog))).collect()
}

impl Seen<'_> {
    /// The magnitude to which its stars go.
    fn limit(&self, catalog: &Catalog) -> Option<f64> {
        let mut magnitudes: Vec<f64> = self.solution.matches.iter().map(|one| catalog.stars[one.star].magnitude).collect();
        magnitudes.sort_unstable_by(f64::total_cmp);
        magnitudes.get(((BRIGHTER * magnitudes.len() as f64) as usize).min(magnitudes.len().saturating_sub(1))).copied()
    }

    /// The catalogue's stars in the frame that are brighter than a limit.
    fn expected(&self, limit: f64, catalog: &Catalog) -> usize {
        let camera = &self.solution.camera;
        let model = self.solution.model();
        let context = model.reference_context();
        let half_diagonal_px = (camera.width_px as f64).hypot(camera.height_px as f64) / 2.0;
        let reach_rad = match self.solution.projection {
            crate::identify::Projection::Pinhole => (half_diagonal_px / camera.focal_length_px).atan(),
            _ => (half_diagonal_px / camera.focal_length_px).min(std::f64::consts::FRAC_PI_2 * 1.3),
        };
        let centre = Direction::<Icrs>::along(self.solution.centre().xyz);
        let near = catalog.stars_within(&centre, 1.1 * reach_rad, limit);
        let inside = |index: &usize| {
            let apparent = Direction::from_unit(catalog.stars[*index].direction.xyz);
            let pixel = model.pixel(&self.solution.attitude.camera_from_apparent(&apparent), &context);
            pixel.is_some_and(|pixel| model.contains(pixel))
        };
        near.iter().filter(|index| inside(index)).count()
    }

    fn too_many(&self, usual: f64, catalog: &Catalog) -> Option<String> {
        let (found, expected) = (self.solution.matches.len(), self.expected(usual + FAINTER, catalog));
        (found as f64 > TOO_MANY * expected.max(1) as f64).then(|| {
            format!(
                "{} is left out: {found} of its {} star images would be stars, where the catalogue has {expected} as bright as those of the other frames: they are noise that meets stars by chance",
                self.name,
                self.detections.stars.len()
            )
        })
    }

    fn no_better_than_chance(&self, catalog: &Catalog) -> Option<String> {
        let camera = &self.solution.camera;
        let area_px2 = camera.width_px as f64 * camera.height_px as f64;
        let found = self.solution.matches.len();
        let stars = self.expected(self.limit(catalog)? + 0.01, catalog) as f64;
        let within_px = NEARLY_ALL * self.solution.rms_px;
        let images = self.detections.stars.len() as f64;
        let met = -(-images * std::f64::consts::PI * within_px * within_px / area_px2).exp_m1();
        (BEYOND_CHANCE * stars * met > found as f64).then(|| {
            format!(
                "{} is left out: among its {images:.0} star images chance alone would bring {:.0} within {within_px:.1} px of a catalogue star, and it has {found}",
                self.name,
                stars * met
            )
        })
    }
}
