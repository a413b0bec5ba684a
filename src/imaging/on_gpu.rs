//! The pixel effects on a GPU: programs made for the plan, buffers kept from frame to frame, work split where a limit asks for it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytemuck::{Pod, Zeroable};

use super::binning::Joining;
use super::compose::{Output, UNIFORM_ALIGNMENT, chain_program, collect_plane_program, collect_program};
use super::plan::{Enabled, Lit, Plan, Segment};
use super::plane::PlaneBatch;
use super::tiles::{Entry, Grid, TILE_PX, bin};
use super::{Exposure, GpuError, SplitLimits};
use crate::effects::pixel::lanes::QUAD_PX;
use crate::effects::pixel::{ExposureContext, PlaneStar, Stage, Star};
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

/// `Part` of `shaders/lib/collect.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct PartUniforms {
    first_entry: u32,
    entries: u32,
    goes_on: u32,
    all_entries: u32,
}

/// Invocations of a workgroup in the programs that do not go by tiles.
pub(super) const WORKGROUP: u64 = 64;

/// The bindings of `shaders/lib/collect.wgsl`.
const COLLECT_BINDINGS: [Binding; 7] =
    [Binding::Uniform, Binding::Uniform, Binding::Read, Binding::Read, Binding::Read, Binding::ReadWrite, Binding::ReadWrite];

/// The bindings of `shaders/lib/collect_plane.wgsl`.
const PLANE_BINDINGS: [Binding; 7] =
    [Binding::Uniform, Binding::Uniform, Binding::Read, Binding::Read, Binding::Read, Binding::Read, Binding::ReadWrite];

/// Bytes of an entry's profiles: along the columns and along the rows of its tile.
const PROFILE_BYTES: usize = 2 * TILE_PX * size_of::<f32>();

/// Which program of a frame: effects up to this stage, what they write, number of the segment.
type FinishKey = (Option<Stage>, Output, usize);

/// What is kept between frames.
#[derive(Debug, Default)]
pub(super) struct Kept {
    profiles: Option<Kernel>,
    collect: Option<Kernel>,
    /// Programs of plane spreads, by their ids.
    planes: Vec<(&'static str, Kernel)>,
    atlas: Option<KeptAtlas>,
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
    stars: Option<Buffer>,
    starts: Option<Buffer>,
    entries: Option<Buffer>,
    profile: Option<Buffer>,
    pub(super) electrons: Option<Buffer>,
    pub(super) counts: Option<Buffer>,
    pub(super) staging: Option<Buffer>,
}

/// Tables on the device, and where they lie in memory: that tells whether they are those wanted.
#[derive(Debug)]
struct KeptAtlas {
    values: Arc<[f32]>,
    buffer: Buffer,
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

impl GpuImager {
    /// Rows that are joined, `joined_rows` at a time, are in the same band.
    pub(super) fn new(gpu: Gpu, plan: &Plan, limits: SplitLimits, joined_rows: usize) -> Self {
        let least_rows = (1..=joined_rows).map(|count| count * TILE_PX).find(|rows| rows.is_multiple_of(joined_rows)).unwrap_or(TILE_PX);
        let least_bytes = (plan.width_px * least_rows * size_of::<f32>()) as u64;
        let band_rows = (limits.buffer_bytes / least_bytes).max(1) as usize * least_rows;
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
        exposure: &Exposure<'_>,
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
        exposure: &Exposure<'_>,
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
        exposure: &Exposure<'_>,
        wanted: Wanted,
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<(), GpuError> {
        let Wanted { stage, output, joining } = wanted;
        let mut kept = self.kept();
        let kept = &mut *kept;
        let segments = plan.segments(stage);
        let last = segments.len() - 1;
        let context = plan.context(exposure, lit);
        self.compile(plan, &segments, stage, output, kept)?;
        if joining.is_some() {
            self.compile_join(output, kept)?;
        }
        let uniforms =
            segments.iter().map(|segment| self.effect_uniforms(segment.pixels, &context)).collect::<Result<Vec<_>, GpuError>>()?;
        let bands = self.bands_of(plan);
        let frames = bands.iter().map(|band| self.frame_uniforms(plan, exposure, *band)).collect::<Result<Vec<_>, GpuError>>()?;
        let key = |number: usize| (stage, if number == last { output } else { Output::Electrons }, number);
        let finish = |number: usize, band: usize, kept: &mut Kept| {
            self.finish(
                key(number),
                segments[number].pixels.is_empty(),
                bands[band].rows * plan.width_px,
                [&frames[band], &uniforms[number]],
                kept,
            )
        };
        // Where charge moves over the frame, all of it is held, a buffer for each band; else one buffer serves band after band.
        kept.frame.resize_with(if last == 0 { 0 } else { bands.len() }, || None);
        for (number, band) in bands.iter().enumerate() {
            if let Some(held) = kept.frame.get_mut(number) {
                std::mem::swap(held, &mut kept.electrons);
            }
            self.gpu.reserve(&mut kept.electrons, "electrons", (band.rows * plan.width_px * size_of::<f32>()) as u64)?;
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
    fn finish(&self, key: FinishKey, is_empty: bool, pixels: usize, uniforms: [&Buffer; 2], kept: &mut Kept) -> Result<(), GpuError> {
        let output = key.1;
        if output == Output::Counts {
            self.gpu.reserve(&mut kept.counts, "counts", result_bytes(output, pixels))?;
        } else if is_empty {
            return Ok(());
        }
        let (Some(electrons), Some((_, kernel))) = (&kept.electrons, kept.finish.iter().find(|(other, _)| *other == key)) else {
            return Ok(()); // both were made before
        };
        let mut buffers = vec![uniforms[0], uniforms[1], electrons];
        buffers.extend(kept.counts.as_ref().filter(|_| output == Output::Counts));
        let workgroups = Gpu::workgroups_for((pixels.div_ceil(QUAD_PX) as u64).div_ceil(WORKGROUP));
        self.gpu.submit(&[Dispatch { kernel, buffers: &buffers, workgroups }])
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

    /// Makes the programs that are not there yet.
    pub(super) fn compile(
        &self,
        plan: &Plan,
        segments: &[Segment<'_>],
        stage: Option<Stage>,
        output: Output,
        kept: &mut Kept,
    ) -> Result<(), GpuError> {
        use Binding::{ReadWrite, Uniform};
        if kept.collect.is_none() {
            let program = collect_program(plan.spread, plan.width_px.is_multiple_of(QUAD_PX));
            kept.profiles = Some(self.gpu.kernel("profiles", &program, "profiles", &COLLECT_BINDINGS)?);
            kept.collect = Some(self.gpu.kernel("collect", &program, "collect", &COLLECT_BINDINGS)?);
        }
        for (number, segment) in segments.iter().enumerate() {
            let output = if number + 1 == segments.len() { output } else { Output::Electrons };
            if let Some(pass) = segment.pass {
                self.compile_pass(pass, plan.height_px > self.band_rows, kept)?;
            }
            let is_needed = output == Output::Counts || !segment.pixels.is_empty();
            if is_needed && !kept.finish.iter().any(|(key, _)| *key == (stage, output, number)) {
                let effects: Vec<_> = segment.pixels.iter().map(|enabled| enabled.effect).collect();
                let bindings = [Uniform, Uniform, ReadWrite, ReadWrite];
                let bindings = if output == Output::Counts { &bindings[..] } else { &bindings[..3] };
                let kernel = self.gpu.kernel("finish", &chain_program(&effects, output), "finish", bindings)?;
                kept.finish.push(((stage, output, number), kernel));
            }
        }
        Ok(())
    }

    pub(super) fn frame_uniforms(&self, plan: &Plan, exposure: &Exposure<'_>, band: Band) -> Result<Buffer, GpuError> {
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

    /// Fills the buffer of electrons with the stars' light, in as many dispatches as the loop budget and the size of buffers ask for.
    fn collect(&self, plan: &Plan, lit: &Lit<'_>, band: Band, frame: &Buffer, kept: &mut Kept) -> Result<(), GpuError> {
        let grid = Grid { width: plan.width_px, first_row: band.first_row, rows: band.rows, tile_width: TILE_PX };
        let most_stars = (self.limits.buffer_bytes as usize / size_of::<Star>()).max(1);
        let most_entries = (self.limits.buffer_bytes as usize / PROFILE_BYTES).max(1);
        let per_dispatch = self.limits.entries_per_dispatch.clamp(1, crate::gpu::LOOP_BUDGET);
        let first_pixel = band.first_row * plan.width_px;
        let sky = lit.sky_e.get(first_pixel..first_pixel + band.rows * plan.width_px);
        if let (Some(sky), Some(electrons)) = (sky, &kept.electrons) {
            self.gpu.upload(electrons, bytemuck::cast_slice(sky))?;
        }
        // The stars' light goes on from that of the sky, where there is any.
        let mut goes_on = u32::from(sky.is_some());
        for lists in bin(&lit.stars, &grid, most_stars, most_entries) {
            for (buffer, label, bytes) in [
                (&mut kept.stars, "stars", bytemuck::cast_slice::<_, u8>(&lists.stars)),
                (&mut kept.starts, "tile starts", bytemuck::cast_slice(&lists.starts)),
                (&mut kept.entries, "tile entries", bytemuck::cast_slice(&lists.entries)),
            ] {
                // Room to grow, so that not every frame with a few stars more makes new buffers.
                self.gpu.reserve(buffer, label, (bytes.len() as u64).next_power_of_two())?;
                if let Some(buffer) = buffer
                    && !bytes.is_empty()
                {
                    self.gpu.upload(buffer, bytes)?;
                }
            }
            self.gpu.reserve(&mut kept.profile, "profile", ((lists.entries.len() * PROFILE_BYTES) as u64).next_power_of_two())?;
            let Kept { profiles: Some(profiles), collect: Some(collect), .. } = &*kept else {
                continue; // both were made before
            };
            let Kept { stars: Some(stars), starts: Some(starts), entries: Some(entries), .. } = &*kept else {
                continue; // all were made above
            };
            let Kept { profile: Some(profile), electrons: Some(electrons), .. } = &*kept else {
                continue; // as above
            };
            let all_entries = lists.entries.len() as u32;
            let longest = lists.longest();
            let mut first_entry = 0;
            loop {
                let part = PartUniforms { first_entry, entries: per_dispatch, goes_on, all_entries };
                let part = self.gpu.uniform("part", bytemuck::bytes_of(&part))?;
                let buffers = [frame, &part, stars, starts, entries, profile, electrons];
                let invocations = 2 * u64::from(all_entries);
                let work = [
                    Dispatch { kernel: profiles, buffers: &buffers, workgroups: Gpu::workgroups_for(invocations.div_ceil(WORKGROUP)) },
                    Dispatch { kernel: collect, buffers: &buffers, workgroups: [grid.columns() as u32, grid.tile_rows() as u32] },
                ];
                // The profiles serve all parts of the lists, and an empty list has none.
                self.gpu.submit(&work[usize::from(first_entry > 0 || all_entries == 0)..])?;
                goes_on = 1;
                first_entry += per_dispatch;
                if first_entry >= longest {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Adds the light of a plane spread to the buffer of electrons.
    fn collect_plane(&self, plan: &Plan, batch: &PlaneBatch<'_>, band: Band, frame: &Buffer, kept: &mut Kept) -> Result<(), GpuError> {
        let spread = batch.spread;
        if !kept.planes.iter().any(|(id, _)| *id == spread.id()) {
            let kernel = self.gpu.kernel("collect_plane", &collect_plane_program(spread), "collect_plane", &PLANE_BINDINGS)?;
            kept.planes.push((spread.id(), kernel));
        }
        self.keep_atlas(&batch.atlas.values, kept)?;
        let grid = Grid { width: plan.width_px, first_row: band.first_row, rows: band.rows, tile_width: TILE_PX };
        let most_stars = (self.limits.buffer_bytes as usize / size_of::<PlaneStar>()).max(1);
        let most_entries = (self.limits.buffer_bytes as usize / size_of::<Entry>()).max(1);
        let budget = crate::gpu::LOOP_BUDGET / (spread.loop_iterations() + 1);
        let per_dispatch = self.limits.entries_per_dispatch.clamp(1, budget.max(1));
        for lists in bin(&batch.stars, &grid, most_stars, most_entries) {
            if lists.entries.is_empty() {
                continue;
            }
            for (buffer, label, bytes) in [
                (&mut kept.stars, "stars", bytemuck::cast_slice::<_, u8>(&lists.stars)),
                (&mut kept.starts, "tile starts", bytemuck::cast_slice(&lists.starts)),
                (&mut kept.entries, "tile entries", bytemuck::cast_slice(&lists.entries)),
            ] {
                self.gpu.reserve(buffer, label, (bytes.len() as u64).next_power_of_two())?;
                if let Some(buffer) = buffer {
                    self.gpu.upload(buffer, bytes)?;
                }
            }
            let Kept { stars: Some(stars), starts: Some(starts), entries: Some(entries), .. } = &*kept else {
                continue; // all were made above
            };
            let Kept { atlas: Some(atlas), electrons: Some(electrons), planes, .. } = &*kept else {
                continue; // as above
            };
            let Some((_, kernel)) = planes.iter().find(|(id, _)| *id == spread.id()) else {
                continue; // as above
            };
            for first_entry in (0..lists.longest()).step_by(per_dispatch as usize) {
                let part = PartUniforms { first_entry, entries: per_dispatch, goes_on: 1, all_entries: lists.entries.len() as u32 };
                let part = self.gpu.uniform("part", bytemuck::bytes_of(&part))?;
                let buffers = [frame, &part, stars, starts, entries, &atlas.buffer, electrons];
                let workgroups = [grid.columns() as u32, grid.tile_rows() as u32];
                self.gpu.submit(&[Dispatch { kernel, buffers: &buffers, workgroups }])?;
            }
        }
        Ok(())
    }

    /// Brings tables to the device, unless they are there.
    fn keep_atlas(&self, values: &Arc<[f32]>, kept: &mut Kept) -> Result<(), GpuError> {
        if kept.atlas.as_ref().is_some_and(|atlas| Arc::ptr_eq(&atlas.values, values)) {
            return Ok(());
        }
        let mut buffer = None;
        self.gpu.reserve(&mut buffer, "atlas", (size_of_val(&**values) as u64).max(16))?;
        let Some(buffer) = buffer else {
            return Ok(()); // it was made above
        };
        if !values.is_empty() {
            self.gpu.upload(&buffer, bytemuck::cast_slice(values))?;
        }
        kept.atlas = Some(KeptAtlas { values: Arc::clone(values), buffer });
        Ok(())
    }
}
