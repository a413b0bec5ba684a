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
    /// What an effect of single pixels alone makes of pixels that hold one electron each, block by block: `see` gets the index of the first pixel
    /// of a block, row by row, and its electrons. It is not called where the effect is not switched on.
    pub fn on_single_electrons(
        &self,
        id: &str,
        exposure: &FrameExposure<'_>,
        mut see: impl FnMut(usize, &[f32]),
    ) -> Result<(), ImagingError> {
        const BLOCK_PX: usize = 4096; // stays in a core's cache
        if !self.plan.has(id) {
            return Ok(());
        }
        let alone = self.plan.only(|effect| effect.id() == id);
        let exposure = FrameExposure { stars: &[], sky_e: &[], ..*exposure };
        let context = alone.context(&exposure, &alone.light(&exposure, &[])?);
        let segments = alone.segments(Some(Stage::Digital));
        let pixels = on_cpu::Pixels::new(&alone, segments.first().map_or(&[], |segment| segment.pixels), &exposure, &context);
        let (mut block, count) = ([0.0; BLOCK_PX], alone.width_px * alone.height_px);
        for first in (0..count).step_by(BLOCK_PX) {
            let block = &mut block[..BLOCK_PX.min(count - first)];
            block.fill(1.0);
            pixels.apply(first, block);
            see(first, block);
        }
        Ok(())
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
