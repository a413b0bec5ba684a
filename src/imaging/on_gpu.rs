//! GPU backend: programs made for the plan, buffers kept from frame to frame, work split where a limit asks for it.

use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::{Pod, Zeroable};

use super::binning::Joining;
use super::collect_on_gpu::Collect;
use super::compose::{Output, UNIFORM_ALIGNMENT, chain_program};
use super::plan::{Enabled, Lit, Plan, Segment};
use super::tiles::TILE_PX;
use super::{FrameExposure, GpuError, SplitLimits};
use crate::effects::pixel::lanes::QUAD_PX;
use crate::effects::pixel::{ExposureContext, Stage};
use crate::gpu::{Binding, Buffer, Dispatch, Gpu, Kernel};

/// `Frame` of `shaders/lib/frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct FrameUniforms {
    width: u32,
    rows: u32,
    first_row: u32,
    tile_columns: u32,
    frame_index: u32,
    seed_low: u32,
    seed_high: u32,
    pixels: u32,
}

/// Invocations of a workgroup in the programs that do not go by tiles.
pub(super) const WORKGROUP: u64 = 64;

/// Which program of a frame: effects up to this stage, what they write, number of the segment, whether pixels may be faint.
type FinishKey = (Option<Stage>, Output, usize, bool);

/// What is kept between frames.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// What collects the stars' light.
    pub(super) collect: Collect,
    /// Programs of effects that each see one pixel.
    finish: Vec<(FinishKey, Kernel)>,
    /// The sweeps of passes, by id.
    pub(super) passes: Vec<(&'static str, Vec<Kernel>)>,
    /// The whole frame, a buffer for each band, where there are passes; and what a neighbour pass makes of it.
    pub(super) frame: Vec<Option<Buffer>>,
    pub(super) made: Vec<Option<Buffer>>,
    /// What goes along the lines of a line pass.
    pub(super) carries: Option<Buffer>,
    pub(super) join: Option<Kernel>,
    pub(super) join_counts: Option<Kernel>,
    pub(super) mosaic: Option<Kernel>,
    pub(super) joined: Option<Buffer>,
    /// Light that is behind filters.
    pub(super) behind: Option<Buffer>,
    pub(super) electrons: Option<Buffer>,
    pub(super) counts: Option<Buffer>,
    pub(super) staging: Option<Buffer>,
}

/// A GPU with the programs of a plan.
#[derive(Debug)]
pub(super) struct GpuImager {
    pub(super) gpu: Gpu,
    pub(super) limits: SplitLimits,
    /// Rows of a band: a whole number of tiles, and of joined pixels where there are any.
    band_rows: usize,
    kept: Mutex<Kept>,
}

/// A band of rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Band {
    pub(super) first_row: usize,
    pub(super) rows: usize,
}

/// What is made of a frame.
#[derive(Clone, Copy, Debug)]
struct Wanted {
    /// Effects up to this stage.
    stage: Option<Stage>,
    output: Output,
    /// How pixels are joined at the end.
    joining: Option<Joining>,
}

/// Bytes of a band's result.
pub(super) fn result_bytes(output: Output, pixels: usize) -> u64 {
    match output {
        Output::Electrons => pixels as u64 * 4,
        Output::Counts => pixels.div_ceil(2) as u64 * 4,
    }
}

/// By so much at most a buffer is larger than the pixels of its band ask for: workgroups are a rectangle, of at most three rows here.
const ROOM_BYTES: u64 = 4096;

/// Workgroups that send the pixels of a band through a chain.
fn workgroups_of_chain(pixels: usize) -> [u32; 2] {
    Gpu::workgroups_for((pixels.div_ceil(QUAD_PX) as u64).div_ceil(WORKGROUP))
}

/// Pixels for which the buffers of a band must have room: whole rows of tiles, and all that the last workgroup of a chain goes through.
pub(super) fn pixels_with_room(band: Band, width_px: usize) -> u64 {
    let workgroups = workgroups_of_chain(band.rows * width_px).map(u64::from);
    let of_chain = workgroups[0] * workgroups[1] * WORKGROUP * QUAD_PX as u64;
    of_chain.max((band.rows.next_multiple_of(TILE_PX) * width_px) as u64)
}

impl GpuImager {
    /// Rows that are joined, `joined_rows` at a time, are in the same band.
    pub(super) fn new(gpu: Gpu, plan: &Plan, limits: SplitLimits, joined_rows: usize) -> Self {
        let least_rows = (1..=joined_rows).map(|count| count * TILE_PX).find(|rows| rows.is_multiple_of(joined_rows)).unwrap_or(TILE_PX);
        let least_bytes = (plan.width_px * least_rows * size_of::<f32>()) as u64;
        let band_rows = (limits.buffer_bytes.saturating_sub(ROOM_BYTES) / least_bytes).max(1) as usize * least_rows;
        Self { gpu, limits, band_rows, kept: Mutex::default() }
    }

    pub(super) fn adapter(&self) -> String {
        self.gpu.adapter().to_string()
    }

    /// Electrons after a stage.
    pub(super) fn electrons(
        &self,
        plan: &Plan,
        stage: Option<Stage>,
        lit: &Lit<'_>,
        exposure: &FrameExposure<'_>,
        joining: Option<Joining>,
    ) -> Result<Vec<f32>, GpuError> {
        let mut frame = Vec::with_capacity(plan.width_px * plan.height_px);
        self.bands(plan, lit, exposure, Wanted { stage, output: Output::Electrons, joining }, |_, bytes| {
            frame.extend_from_slice(bytemuck::cast_slice(bytes));
        })?;
        Ok(frame)
    }

    /// Counts at the end of the chain.
    pub(super) fn counts(
        &self,
        plan: &Plan,
        lit: &Lit<'_>,
        exposure: &FrameExposure<'_>,
        joining: Option<Joining>,
    ) -> Result<Vec<u16>, GpuError> {
        let mut frame = Vec::with_capacity(plan.width_px * plan.height_px);
        self.bands(plan, lit, exposure, Wanted { stage: Some(Stage::Digital), output: Output::Counts, joining }, |pixels, bytes| {
            frame.extend_from_slice(&bytemuck::cast_slice(bytes)[..pixels]);
        })?;
        Ok(frame)
    }

    /// What is kept. A poisoned lock means that another frame's thread died; what is kept is replaced or overwritten before use.
    pub(super) fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The bands of a frame.
    pub(super) fn bands_of(&self, plan: &Plan) -> Vec<Band> {
        let band = |first_row| Band { first_row, rows: self.band_rows.min(plan.height_px - first_row) };
        (0..plan.height_px).step_by(self.band_rows).map(band).collect()
    }

    /// Makes the frame band by band and hands each band's bytes to `take`, with its number of pixels.
    fn bands(
        &self,
        plan: &Plan,
        lit: &Lit<'_>,
        exposure: &FrameExposure<'_>,
        wanted: Wanted,
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<(), GpuError> {
        let Wanted { stage, output, joining } = wanted;
        let mut kept = self.kept();
        let kept = &mut *kept;
        let segments = plan.segments(stage);
        let last = segments.len() - 1;
        let context = plan.context(exposure, lit);
        let may_be_faint = plan.may_be_faint(&context, lit);
        self.compile(plan, &segments, (stage, output, may_be_faint), kept)?;
        if let Some(Joining { binning, .. }) = joining {
            self.compile_join(binning.factor, output, kept)?;
        }
        let uniforms =
            segments.iter().map(|segment| self.effect_uniforms(segment.pixels, &context)).collect::<Result<Vec<_>, GpuError>>()?;
        let bands = self.bands_of(plan);
        let frames = bands.iter().map(|band| self.frame_uniforms(plan, exposure, *band)).collect::<Result<Vec<_>, GpuError>>()?;
        let key = |number: usize| (stage, if number == last { output } else { Output::Electrons }, number, may_be_faint);
        let finish = |number: usize, band: usize, kept: &mut Kept| {
            let is_empty = segments[number].pixels.is_empty();
            self.finish(key(number), is_empty, (bands[band], plan.width_px), [&frames[band], &uniforms[number]], kept)
        };
        // Where charge moves over the frame, all of it is held, a buffer for each band; else one buffer serves band after band.
        kept.frame.resize_with(if last == 0 { 0 } else { bands.len() }, || None);
        for (number, band) in bands.iter().enumerate() {
            if let Some(held) = kept.frame.get_mut(number) {
                std::mem::swap(held, &mut kept.electrons);
            }
            self.gpu.reserve(&mut kept.electrons, "electrons", pixels_with_room(*band, plan.width_px) * size_of::<f32>() as u64)?;
            self.collect_all(plan, lit, *band, &frames[number], kept)?;
            finish(0, number, kept)?;
            match kept.frame.get_mut(number) {
                Some(held) => std::mem::swap(held, &mut kept.electrons),
                None => self.hand_over(wanted, plan.width_px, band.rows, kept, &mut take)?,
            }
        }
        for (number, segment) in segments.iter().enumerate().skip(1) {
            if let Some(pass) = segment.pass {
                self.pass(plan, pass, &context, &bands, &frames, kept)?;
            }
            for (band, Band { rows, .. }) in bands.iter().enumerate() {
                std::mem::swap(&mut kept.frame[band], &mut kept.electrons);
                finish(number, band, kept)?;
                if number == last {
                    self.hand_over(wanted, plan.width_px, *rows, kept, &mut take)?;
                }
                std::mem::swap(&mut kept.frame[band], &mut kept.electrons);
            }
        }
        Ok(())
    }

    /// The uniforms of effects, one after the other.
    pub(super) fn effect_uniforms(&self, enabled: &[Enabled], context: &ExposureContext) -> Result<Buffer, GpuError> {
        let mut bytes = Vec::new();
        for one in enabled {
            bytes.extend(one.uniforms(context));
            bytes.resize(bytes.len().next_multiple_of(UNIFORM_ALIGNMENT), 0);
        }
        self.gpu.uniform("effects", &bytes)
    }

    /// Sends the pixels of a band through a segment's effects.
    fn finish(
        &self,
        key: FinishKey,
        is_empty: bool,
        (band, width_px): (Band, usize),
        uniforms: [&Buffer; 2],
        kept: &mut Kept,
    ) -> Result<(), GpuError> {
        let output = key.1;
        if output == Output::Counts {
            self.gpu.reserve(&mut kept.counts, "counts", pixels_with_room(band, width_px) * size_of::<u16>() as u64)?;
        } else if is_empty {
            return Ok(());
        }
        let (Some(electrons), Some((_, kernel))) = (&kept.electrons, kept.finish.iter().find(|(other, _)| *other == key)) else {
            return Ok(()); // both were made before
        };
        let mut buffers = vec![uniforms[0], uniforms[1], electrons];
        buffers.extend(kept.counts.as_ref().filter(|_| output == Output::Counts));
        self.gpu.submit(&[Dispatch { kernel, buffers: &buffers, workgroups: workgroups_of_chain(band.rows * width_px) }])
    }

    /// Hands the bytes of a finished band to `take`; where pixels are joined, those of the joined ones and no others.
    fn hand_over(
        &self,
        Wanted { output, joining, .. }: Wanted,
        width_px: usize,
        rows: usize,
        kept: &mut Kept,
        take: &mut impl FnMut(usize, &[u8]),
    ) -> Result<(), GpuError> {
        let mut pixels = width_px * rows;
        if let Some(joining) = joining {
            pixels = self.join(joining, output, width_px, pixels, kept)?;
        }
        let Kept { electrons, counts, joined, staging, .. } = kept;
        let result = match output {
            _ if joining.is_some() => joined,
            Output::Counts => counts,
            Output::Electrons => electrons,
        };
        let Some(result) = result else { return Ok(()) }; // it was made before
        self.gpu.download(result, result_bytes(output, pixels), staging, |bytes| take(pixels, bytes))
    }

    /// Makes the programs of the chain that are not there yet.
    fn compile(
        &self,
        plan: &Plan,
        segments: &[Segment<'_>],
        (stage, output, may_be_faint): (Option<Stage>, Output, bool),
        kept: &mut Kept,
    ) -> Result<(), GpuError> {
        use Binding::{ReadWrite, Uniform};
        for (number, segment) in segments.iter().enumerate() {
            let output = if number + 1 == segments.len() { output } else { Output::Electrons };
            if let Some(pass) = segment.pass {
                self.compile_pass(pass, plan.height_px > self.band_rows, kept)?;
            }
            let key = (stage, output, number, may_be_faint);
            let is_needed = output == Output::Counts || !segment.pixels.is_empty();
            if is_needed && !kept.finish.iter().any(|(other, _)| *other == key) {
                let effects: Vec<_> = segment.pixels.iter().map(|enabled| enabled.effect).collect();
                let bindings = [Uniform, Uniform, ReadWrite, ReadWrite];
                let bindings = if output == Output::Counts { &bindings[..] } else { &bindings[..3] };
                let kernel = self.gpu.kernel("finish", &chain_program(&effects, may_be_faint, output), "finish", bindings)?;
                kept.finish.push((key, kernel));
            }
        }
        Ok(())
    }

    pub(super) fn frame_uniforms(&self, plan: &Plan, exposure: &FrameExposure<'_>, band: Band) -> Result<Buffer, GpuError> {
        let [seed_low, seed_high] = plan.seed_words();
        let uniforms = FrameUniforms {
            width: plan.width_px as u32,
            rows: band.rows as u32,
            first_row: band.first_row as u32,
            tile_columns: plan.width_px.div_ceil(TILE_PX) as u32,
            frame_index: exposure.frame_index,
            seed_low,
            seed_high,
            pixels: (band.rows * plan.width_px) as u32,
        };
        self.gpu.uniform("frame", bytemuck::bytes_of(&uniforms))
    }

    /// Fills the buffer of electrons with all the light of a band.
    pub(super) fn collect_all(&self, plan: &Plan, lit: &Lit<'_>, band: Band, frame: &Buffer, kept: &mut Kept) -> Result<(), GpuError> {
        self.collect(plan, lit, band, frame, kept)?;
        lit.planes.iter().try_for_each(|batch| self.collect_plane(plan, batch, band, frame, kept))
    }
}
