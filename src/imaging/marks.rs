//! Pixel flags from single effects, by the twins on the CPU whatever the backend: detector defects, and charge overflow.

use super::on_cpu;
use super::plan::Plan;
use super::{FrameExposure, Imager, ImagingError, PlaneLight};
use crate::effects::pixel::{AnyPixelEffect, PIXEL_EFFECTS, Stage};

/// Where an effect stands in the order in which they act.
fn rank(effect: &dyn AnyPixelEffect) -> Option<usize> {
    PIXEL_EFFECTS.iter().position(|other| other.id() == effect.id())
}

impl Imager {
    /// What an effect alone makes of a frame whose pixels hold one electron each, row by row; `None` where it is not switched on.
    pub fn of_one_electron(&self, id: &str, exposure: &FrameExposure<'_>) -> Result<Option<Vec<f32>>, ImagingError> {
        if !self.plan.has(id) {
            return Ok(None);
        }
        let alone = self.plan.only(|effect| effect.id() == id);
        let ones = vec![1.0; alone.width_px * alone.height_px];
        let exposure = FrameExposure { stars: &[], sky_e: &ones, ..*exposure };
        let lit = alone.light(&exposure, &[])?;
        Ok(Some(on_cpu::electrons(&alone, Some(Stage::Digital), &lit, &exposure)))
    }

    /// The frame just before an effect and just after it, with all noise, row by row; `None` where it is not switched on.
    pub fn before_and_after(
        &self,
        id: &str,
        exposure: &FrameExposure<'_>,
        planes: &[PlaneLight<'_>],
    ) -> Result<Option<[Vec<f32>; 2]>, ImagingError> {
        let Some(last) = PIXEL_EFFECTS.iter().position(|effect| effect.id() == id).filter(|_| self.plan.has(id)) else { return Ok(None) };
        let context = self.plan.context(exposure, &self.plan.light(exposure, planes)?);
        let up_to = |plan: Plan| -> Result<Vec<f32>, ImagingError> {
            let lit = plan.light(exposure, planes)?;
            Ok(on_cpu::electrons_in(&plan, Some(Stage::Digital), (&lit, &[]), exposure, &context))
        };
        let before = up_to(self.plan.only(|effect| rank(effect) < Some(last)))?;
        let after = up_to(self.plan.only(|effect| rank(effect) <= Some(last)))?;
        Ok(Some([before, after]))
    }
}
