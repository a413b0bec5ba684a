//! Whole-frame operations on the GPU: binning before pixels are read back, and light behind colour filters.
//!
//! Both go band by band. A band holds whole joined rows, so no joined pixel lies in two buffers.

use bytemuck::{Pod, Zeroable};

use super::binning::Joining;
use super::compose::{Output, join_program, mosaic_program};
use super::on_gpu::{GpuImager, Kept, WORKGROUP, pixels_with_room, result_bytes};
use super::plan::{Lit, Plan};
use super::{FrameExposure, GpuError};
use crate::effects::pixel::lanes::QUAD_PX;
use crate::gpu::{Binding, Buffer, Dispatch, Gpu};

/// `Joining` of `shaders/join.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct JoiningUniforms {
    width: u32,
    pixels: u32,
    divisor: u32,
    full_well_e: f32,
    share: f32,
    unused: [u32; 3],
}

/// `Filter` of `shaders/mosaic.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct FilterUniforms {
    number: u32,
    goes_on: u32,
    unused: [u32; 2],
}

impl GpuImager {
    /// Makes the programs that join pixels, if they are not there yet.
    pub(super) fn compile_join(&self, factor: usize, output: Output, kept: &mut Kept) -> Result<(), GpuError> {
        let bindings = [Binding::Uniform, Binding::Read, Binding::ReadWrite];
        let (entry, kernel) = match output {
            Output::Electrons => ("join", &mut kept.join),
            Output::Counts => ("join_counts", &mut kept.join_counts),
        };
        if kernel.is_none() {
            *kernel = Some(self.gpu.kernel(entry, &join_program(factor), entry, &bindings)?);
        }
        Ok(())
    }

    /// Joins the pixels of a finished band and gives the number of joined ones; they are in `kept.joined`.
    pub(super) fn join(
        &self,
        Joining { binning, full_well_e }: Joining,
        output: Output,
        width_px: usize,
        pixels: usize,
        kept: &mut Kept,
    ) -> Result<usize, GpuError> {
        let joined = pixels / (binning.factor * binning.factor);
        self.gpu.reserve(&mut kept.joined, "joined pixels", result_bytes(output, joined))?;
        let (kernel, native, invocations) = match output {
            Output::Electrons => (&kept.join, &kept.electrons, joined),
            Output::Counts => (&kept.join_counts, &kept.counts, joined.div_ceil(2)),
        };
        let (Some(kernel), Some(native), Some(result)) = (kernel, native, &kept.joined) else { return Ok(joined) }; // all were made before
        let uniforms = JoiningUniforms {
            width: (width_px / binning.factor) as u32,
            pixels: joined as u32,
            divisor: binning.divisor(),
            full_well_e: full_well_e.min(f32::MAX),
            share: binning.share() as f32,
            unused: [0; 3],
        };
        let uniforms = self.gpu.uniform("joining", bytemuck::bytes_of(&uniforms))?;
        let workgroups = Gpu::workgroups_for((invocations as u64).div_ceil(WORKGROUP));
        self.gpu.submit(&[Dispatch { kernel, buffers: &[&uniforms, native, result], workgroups }])?;
        Ok(joined)
    }

    /// The light of each filter on the pixels behind it, upon that of the sky.
    pub(super) fn behind_filters(&self, plan: &Plan, lits: &[Lit<'_>], exposure: &FrameExposure<'_>) -> Result<Vec<f32>, GpuError> {
        let mut kept = self.kept();
        let kept = &mut *kept;
        if kept.mosaic.is_none() {
            let bindings = [Binding::Uniform, Binding::Uniform, Binding::Read, Binding::ReadWrite];
            kept.mosaic = Some(self.gpu.kernel("mosaic", &mosaic_program(), "mosaic", &bindings)?);
        }
        let mut whole = Vec::with_capacity(plan.width_px * plan.height_px);
        for band in self.bands_of(plan) {
            let frame = self.frame_uniforms(plan, exposure, band)?;
            let pixels = band.rows * plan.width_px;
            let bytes = (pixels * size_of::<f32>()) as u64;
            self.gpu.reserve(&mut kept.electrons, "electrons", pixels_with_room(band, plan.width_px) * size_of::<f32>() as u64)?;
            self.gpu.reserve(&mut kept.behind, "light behind filters", bytes)?;
            let sky = exposure.sky_e.get(band.first_row * plan.width_px..).and_then(|rest| rest.get(..pixels));
            if let (Some(sky), Some(behind)) = (sky, &kept.behind) {
                self.gpu.upload(behind, bytemuck::cast_slice(sky))?;
            }
            for (number, lit) in (0..).zip(lits) {
                self.collect_all(plan, lit, band, &frame, kept)?;
                let filter = FilterUniforms { number, goes_on: u32::from(number > 0 || sky.is_some()), unused: [0; 2] };
                let filter = self.gpu.uniform("filter", bytemuck::bytes_of(&filter))?;
                let (Some(kernel), Some(through), Some(behind)) = (&kept.mosaic, &kept.electrons, &kept.behind) else {
                    continue; // all were made above
                };
                let buffers: [&Buffer; 4] = [&frame, &filter, through, behind];
                let workgroups = Gpu::workgroups_for((pixels.div_ceil(QUAD_PX) as u64).div_ceil(WORKGROUP));
                self.gpu.submit(&[Dispatch { kernel, buffers: &buffers, workgroups }])?;
            }
            let Kept { behind: Some(behind), staging, .. } = &mut *kept else { continue }; // it was made above
            self.gpu.download(behind, bytes, staging, |bytes| whole.extend_from_slice(bytemuck::cast_slice(bytes)))?;
        }
        Ok(whole)
    }
}
