//! Passes on the GPU: charge that moves over a frame which may lie in several buffers.
//!
//! A line pass goes from buffer to buffer with its carries and needs one of them at a time; a neighbour pass sees a band and the two beside
//! it. So no binding is larger than one band, however large the frame, and no invocation runs longer than the loop budget.

use bytemuck::{Pod, Zeroable};

use super::GpuError;
use super::compose::pass_programs;
use super::on_gpu::{Band, GpuImager, Kept, WORKGROUP, pixels_with_room};
use super::plan::{Enabled, Plan};
use crate::effects::pixel::pass::{Along, Carry, PassShape, Sweep};
use crate::effects::pixel::{ExposureContext, Work};
use crate::gpu::{Binding, Buffer, Dispatch, Gpu, Kernel, LOOP_BUDGET};

/// `Part` of `shaders/lib/walk.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct PartUniforms {
    first: u32,
    count: u32,
    begins: u32,
    unused: u32,
}

/// `Around` of `shaders/lib/neighbours.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct AroundUniforms {
    height: u32,
    rows_before: u32,
    unused: [u32; 2],
}

/// A sweep with everything that its dispatches share.
struct Walk<'a> {
    kernel: &'a Kernel,
    effect: &'a Buffer,
    carries: &'a Buffer,
    /// The most pixels of a line in one dispatch.
    longest: usize,
}

impl GpuImager {
    /// Makes the programs of a pass, if they are not there yet.
    pub(super) fn compile_pass(&self, pass: &Enabled, in_bands: bool, kept: &mut Kept) -> Result<(), GpuError> {
        use Binding::{Read, ReadWrite, Uniform};
        let (id, Work::Frame(shape, _)) = (pass.effect.id(), pass.effect.work()) else { return Ok(()) };
        if kept.passes.iter().any(|(other, _)| *other == id) {
            return Ok(());
        }
        let bindings = match shape {
            PassShape::Lines(_) => &[Uniform, Uniform, ReadWrite, ReadWrite, Uniform][..],
            PassShape::Neighbours { .. } if in_bands => &[Uniform, Uniform, Read, ReadWrite, Uniform, Read, Read][..],
            PassShape::Neighbours { .. } => &[Uniform, Uniform, Read, ReadWrite, Uniform][..],
        };
        let programs = pass_programs(pass.effect, shape, in_bands);
        let kernels = programs.iter().map(|program| self.gpu.kernel(id, &program.wgsl, program.entry, bindings));
        kept.passes.push((id, kernels.collect::<Result<_, _>>()?));
        Ok(())
    }

    /// Runs a pass over the frame that `kept` holds. `frames`: the uniforms of the bands.
    pub(super) fn pass(
        &self,
        plan: &Plan,
        pass: &Enabled,
        context: &ExposureContext,
        bands: &[Band],
        frames: &[Buffer],
        kept: &mut Kept,
    ) -> Result<(), GpuError> {
        let Work::Frame(shape, _) = pass.effect.work() else { return Ok(()) };
        let effect = self.effect_uniforms(std::slice::from_ref(pass), context)?;
        match shape {
            PassShape::Lines(sweeps) => {
                let longest_line = plan.width_px.max(bands.first().map_or(0, |band| band.rows));
                self.gpu.reserve(&mut kept.carries, "carries", (longest_line * size_of::<Carry>()) as u64)?;
                let Kept { passes, frame, carries: Some(carries), .. } = kept else { return Ok(()) }; // it was made above
                let Some((_, kernels)) = passes.iter().find(|(id, _)| *id == pass.effect.id()) else { return Ok(()) }; // as before
                for (sweep, kernel) in sweeps.iter().zip(kernels) {
                    let longest = self.limits.entries_per_dispatch.clamp(1, LOOP_BUDGET) as usize;
                    self.sweep(*sweep, &Walk { kernel, effect: &effect, carries, longest }, plan.width_px, bands, frames, frame)?;
                }
                Ok(())
            }
            PassShape::Neighbours { sweeps } => {
                (0..sweeps).try_for_each(|sweep| self.make_anew(plan, (pass.effect.id(), sweep), &effect, bands, frames, kept))
            }
        }
    }

    /// Walks all lines once.
    fn sweep(
        &self,
        sweep: Sweep,
        walk: &Walk<'_>,
        width_px: usize,
        bands: &[Band],
        frames: &[Buffer],
        electrons: &[Option<Buffer>],
    ) -> Result<(), GpuError> {
        let mut is_first = true;
        for turn in 0..bands.len() {
            let band = if sweep.backward { bands.len() - 1 - turn } else { turn };
            let Some(electrons) = &electrons[band] else { continue }; // it was made before
            let (lines, length) = match sweep.along {
                Along::Columns => (width_px, bands[band].rows),
                Along::Rows => (bands[band].rows, width_px),
            };
            is_first |= sweep.along == Along::Rows;
            let parts = length.div_ceil(walk.longest);
            for turn in 0..parts {
                let first = walk.longest * if sweep.backward { parts - 1 - turn } else { turn };
                let count = walk.longest.min(length - first);
                let part = PartUniforms { first: first as u32, count: count as u32, begins: u32::from(is_first), unused: 0 };
                let part = self.gpu.uniform("part", bytemuck::bytes_of(&part))?;
                let buffers = [&frames[band], walk.effect, electrons, walk.carries, &part];
                let workgroups = Gpu::workgroups_for((lines as u64).div_ceil(WORKGROUP));
                self.gpu.submit(&[Dispatch { kernel: walk.kernel, buffers: &buffers, workgroups }])?;
                is_first = false;
            }
        }
        Ok(())
    }

    /// Makes every pixel anew once.
    fn make_anew(
        &self,
        plan: &Plan,
        (id, sweep): (&'static str, usize),
        effect: &Buffer,
        bands: &[Band],
        frames: &[Buffer],
        kept: &mut Kept,
    ) -> Result<(), GpuError> {
        kept.made.resize_with(bands.len(), || None);
        let kernel = kept.passes.iter().find(|(other, _)| *other == id).and_then(|(_, kernels)| kernels.get(sweep));
        let Some(kernel) = kernel else { return Ok(()) }; // it was made before
        for (number, band) in bands.iter().enumerate() {
            let pixels = (band.rows * plan.width_px) as u64;
            let bytes = pixels_with_room(*band, plan.width_px) * size_of::<f32>() as u64;
            self.gpu.reserve(&mut kept.made[number], "electrons made anew", bytes)?;
            let rows_before = number.checked_sub(1).map_or(0, |before| bands[before].rows);
            let around = AroundUniforms { height: plan.height_px as u32, rows_before: rows_before as u32, unused: [0; 2] };
            let around = self.gpu.uniform("around", bytemuck::bytes_of(&around))?;
            let beside = |other: usize| kept.frame[other.min(bands.len() - 1)].as_ref();
            let (Some(before), Some(source), Some(after)) = (beside(number.saturating_sub(1)), beside(number), beside(number + 1)) else {
                continue; // all were made before
            };
            let Some(made) = &kept.made[number] else { continue }; // it was made above
            let buffers = [&frames[number], effect, source, made, &around, before, after];
            let buffers = if bands.len() > 1 { &buffers[..] } else { &buffers[..5] };
            let workgroups = Gpu::workgroups_for(pixels.div_ceil(WORKGROUP));
            self.gpu.submit(&[Dispatch { kernel, buffers, workgroups }])?;
        }
        std::mem::swap(&mut kept.frame, &mut kept.made);
        Ok(())
    }
}
