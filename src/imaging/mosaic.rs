//! Light behind the filters of a colour mosaic: the light of each filter is collected as a frame of its own, and a pixel takes that of its filter.
//! On the GPU all of it stays there but the frame that comes out.

use rayon::prelude::*;

use super::plan::{Lit, Plan};
use super::{FrameExposure, Imager, ImagingError, NoiseFree, PlacedStar, PlaneLight, Runner, on_cpu};
use crate::effects::detector::colour_filters::filter_at;

/// What one filter lets through.
#[derive(Clone, Debug)]
pub struct FilterLight<'a> {
    /// Stars to be spread.
    pub stars: &'a [PlacedStar],
    /// Other light to be spread.
    pub planes: Vec<PlaneLight<'a>>,
}

impl Imager {
    /// The light behind red, green and blue filters, upon that of the sky, row by row, before any effect. The stars of `exposure` are left out.
    pub fn behind_filters(&self, exposure: &FrameExposure<'_>, lights: &[FilterLight<'_>; 3]) -> Result<Vec<f32>, ImagingError> {
        match &self.runner {
            Runner::Cpu => behind_filters(&self.plan, exposure, lights),
            Runner::Gpu(gpu) => {
                let lits = through(&self.plan, exposure, lights)?;
                Ok(gpu.behind_filters(&self.plan, &lits, exposure)?)
            }
        }
    }
}

impl NoiseFree<'_> {
    /// The light behind red, green and blue filters, see [`Imager::behind_filters`].
    pub fn behind_filters(&self, exposure: &FrameExposure<'_>, lights: &[FilterLight<'_>; 3]) -> Result<Vec<f32>, ImagingError> {
        behind_filters(&self.plan, exposure, lights)
    }
}

/// What comes through each filter, ready for the pixels.
fn through<'a>(plan: &Plan, exposure: &FrameExposure<'_>, lights: &'a [FilterLight<'a>; 3]) -> Result<Vec<Lit<'a>>, ImagingError> {
    plan.light(&FrameExposure { stars: &[], ..*exposure }, &[])?; // the sky is checked once
    lights.iter().map(|light| plan.light(&FrameExposure { stars: light.stars, sky_e: &[], ..*exposure }, &light.planes)).collect()
}

/// On the CPU.
fn behind_filters(plan: &Plan, exposure: &FrameExposure<'_>, lights: &[FilterLight<'_>; 3]) -> Result<Vec<f32>, ImagingError> {
    let lits = through(plan, exposure, lights)?;
    let mut behind = match exposure.sky_e {
        [] => vec![0.0; plan.width_px * plan.height_px],
        sky_e => sky_e.to_vec(),
    };
    for (number, lit) in lits.iter().enumerate() {
        let through = on_cpu::electrons(plan, None, lit, &FrameExposure { sky_e: &[], ..*exposure });
        mosaic(number, plan.width_px, &through, &mut behind);
    }
    Ok(behind)
}

/// The twin: adds what came through a filter to the pixels behind it.
fn mosaic(number: usize, width_px: usize, through: &[f32], behind: &mut [f32]) {
    behind.par_chunks_mut(width_px).zip(through.par_chunks(width_px)).enumerate().for_each(|(y, (row, through))| {
        for (x, (pixel, through)) in row.iter_mut().zip(through).enumerate() {
            if filter_at(x, y) == number {
                *pixel += *through;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pixel_takes_the_light_of_its_own_filter() {
        let mut behind = [0.5; 8];
        for (number, light) in [(0, 1.0), (1, 2.0), (2, 4.0)] {
            mosaic(number, 4, &[light; 8], &mut behind);
        }
        assert_eq!(behind, [1.5, 2.5, 1.5, 2.5, 2.5, 4.5, 2.5, 4.5]);
    }
}
