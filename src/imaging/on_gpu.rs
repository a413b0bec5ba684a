//! The pixel effects on a GPU: programs made for the plan, buffers kept from frame to frame, work split where a limit asks for it.

use std::sync::{Arc, Mutex, PoisonError};

use bytemuck::{Pod, Zeroable};

use super::compose::{Output, UNIFORM_ALIGNMENT, chain_program, collect_plane_program, collect_program};
use super::plan::{Lit, Plan};
use super::plane::PlaneBatch;
use super::tiles::{Entry, Grid, TILE_PX, bin};
use super::{Exposure, GpuError, SplitLimits};
use crate::effects::pixel::{AnyPixelEffect, PlaneStar, Stage, Star};
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
const WORKGROUP: u64 = 64;

/// The bindings of `shaders/lib/collect.wgsl`.
const COLLECT_BINDINGS: [Binding; 7] =
    [Binding::Uniform, Binding::Uniform, Binding::Read, Binding::Read, Binding::Read, Binding::ReadWrite, Binding::ReadWrite];

/// The bindings of `shaders/lib/collect_plane.wgsl`.
const PLANE_BINDINGS: [Binding; 7] =
    [Binding::Uniform, Binding::Uniform, Binding::Read, Binding::Read, Binding::Read, Binding::Read, Binding::ReadWrite];

/// Bytes of an entry's profiles: along the columns and along the rows of its tile.
const PROFILE_BYTES: usize = 2 * TILE_PX * size_of::<f32>();

/// What is kept between frames.
#[derive(Debug, Default)]
struct Kept {
    profiles: Option<Kernel>,
    collect: Option<Kernel>,
    /// Programs of plane spreads, by their ids.
    planes: Vec<(&'static str, Kernel)>,
    atlas: Option<KeptAtlas>,
    /// Programs that finish a frame, by what they do.
    finish: Vec<(Option<Stage>, Output, Kernel)>,
    stars: Option<Buffer>,
    starts: Option<Buffer>,
    entries: Option<Buffer>,
    profile: Option<Buffer>,
    electrons: Option<Buffer>,
    counts: Option<Buffer>,
    staging: Option<Buffer>,
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
    gpu: Gpu,
    limits: SplitLimits,
    /// Rows of a band: a whole number of tiles.
    band_rows: usize,
    kept: Mutex<Kept>,
}

/// A band of rows.
#[derive(Clone, Copy, Debug)]
struct Band {
    first_row: usize,
    rows: usize,
}

impl GpuImager {
    pub(super) fn new(gpu: Gpu, plan: &Plan, limits: SplitLimits) -> Self {
        let row_of_tiles_bytes = (plan.width_px * TILE_PX * size_of::<f32>()) as u64;
        let band_rows = (limits.buffer_bytes / row_of_tiles_bytes).max(1) as usize * TILE_PX;
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
    ) -> Result<Vec<f32>, GpuError> {
        let mut frame = Vec::with_capacity(plan.width_px * plan.height_px);
        self.bands(plan, lit, exposure, stage, Output::Electrons, |_, bytes| {
            frame.extend_from_slice(bytemuck::cast_slice(bytes));
        })?;
        Ok(frame)
    }

    /// Counts at the end of the chain.
    pub(super) fn counts(&self, plan: &Plan, lit: &Lit<'_>, exposure: &Exposure<'_>) -> Result<Vec<u16>, GpuError> {
        let mut frame = Vec::with_capacity(plan.width_px * plan.height_px);
        self.bands(plan, lit, exposure, Some(Stage::Digital), Output::Counts, |pixels, bytes| {
            frame.extend_from_slice(&bytemuck::cast_slice(bytes)[..pixels]);
        })?;
        Ok(frame)
    }

    /// Makes the frame band by band and hands each band's bytes to `take`, with its number of pixels.
    fn bands(
        &self,
        plan: &Plan,
        lit: &Lit<'_>,
        exposure: &Exposure<'_>,
        stage: Option<Stage>,
        output: Output,
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<(), GpuError> {
        // A poisoned lock means that another frame's thread died; what is kept is replaced or overwritten before use.
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let enabled = plan.effects_up_to(stage);
        let effects: Vec<_> = enabled.iter().map(|enabled| enabled.effect).collect();
        self.compile(plan, &effects, stage, output, &mut kept)?;
        let mut effect_bytes = Vec::new();
        for one in enabled {
            effect_bytes.extend(one.uniforms(exposure));
            effect_bytes.resize(effect_bytes.len().next_multiple_of(UNIFORM_ALIGNMENT), 0);
        }
        let effect_uniforms = self.gpu.uniform("effects", &effect_bytes)?;
        for first_row in (0..plan.height_px).step_by(self.band_rows) {
            let band = Band { first_row, rows: self.band_rows.min(plan.height_px - first_row) };
            let pixels = band.rows * plan.width_px;
            let frame_uniforms = self.frame_uniforms(plan, exposure, band)?;
            self.gpu.reserve(&mut kept.electrons, "electrons", (pixels * size_of::<f32>()) as u64)?;
            self.collect(plan, &lit.stars, band, &frame_uniforms, &mut kept)?;
            for batch in &lit.planes {
                self.collect_plane(plan, batch, band, &frame_uniforms, &mut kept)?;
            }
            let bytes = match output {
                Output::Electrons => pixels as u64 * 4,
                Output::Counts => pixels.div_ceil(2) as u64 * 4,
            };
            if output == Output::Counts {
                self.gpu.reserve(&mut kept.counts, "counts", bytes)?;
            }
            let Kept { finish, electrons, counts, staging, .. } = &mut *kept;
            let (Some(electrons), Some((_, _, kernel))) = (&*electrons, finish.iter().find(|(s, o, _)| (*s, *o) == (stage, output))) else {
                continue; // both were made above
            };
            let mut buffers = vec![&frame_uniforms, &effect_uniforms, electrons];
            buffers.extend(counts.as_ref().filter(|_| output == Output::Counts));
            if output == Output::Counts || !effects.is_empty() {
                let workgroups = Gpu::workgroups_for((bytes / 4).div_ceil(WORKGROUP));
                self.gpu.submit(&[Dispatch { kernel, buffers: &buffers, workgroups }])?;
            }
            let result = buffers.last().copied().unwrap_or(electrons);
            self.gpu.download(result, bytes, staging, |bytes| take(pixels, bytes))?;
        }
        Ok(())
    }

    /// Makes the programs that are not there yet.
    fn compile(
        &self,
        plan: &Plan,
        effects: &[&dyn AnyPixelEffect],
        stage: Option<Stage>,
        output: Output,
        kept: &mut Kept,
    ) -> Result<(), GpuError> {
        use Binding::{ReadWrite, Uniform};
        if kept.collect.is_none() {
            let program = collect_program(plan.spread);
            kept.profiles = Some(self.gpu.kernel("profiles", &program, "profiles", &COLLECT_BINDINGS)?);
            kept.collect = Some(self.gpu.kernel("collect", &program, "collect", &COLLECT_BINDINGS)?);
        }
        if !kept.finish.iter().any(|(s, o, _)| (*s, *o) == (stage, output)) {
            let bindings = [Uniform, Uniform, ReadWrite, ReadWrite];
            let bindings = if output == Output::Counts { &bindings[..] } else { &bindings[..3] };
            let kernel = self.gpu.kernel("finish", &chain_program(effects, output), "finish", bindings)?;
            kept.finish.push((stage, output, kernel));
        }
        Ok(())
    }

    fn frame_uniforms(&self, plan: &Plan, exposure: &Exposure<'_>, band: Band) -> Result<Buffer, GpuError> {
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

    /// Fills the buffer of electrons with the stars' light, in as many dispatches as the loop budget and the size of buffers ask for.
    fn collect(&self, plan: &Plan, stars: &[Star], band: Band, frame: &Buffer, kept: &mut Kept) -> Result<(), GpuError> {
        let grid = Grid { width: plan.width_px, first_row: band.first_row, rows: band.rows, tile_width: TILE_PX };
        let most_stars = (self.limits.buffer_bytes as usize / size_of::<Star>()).max(1);
        let most_entries = (self.limits.buffer_bytes as usize / PROFILE_BYTES).max(1);
        let per_dispatch = self.limits.entries_per_dispatch.clamp(1, crate::gpu::LOOP_BUDGET);
        let mut goes_on = 0;
        for lists in bin(stars, &grid, most_stars, most_entries) {
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
                let numbers = u64::from(all_entries) * (PROFILE_BYTES / size_of::<f32>()) as u64;
                let work = [
                    Dispatch { kernel: profiles, buffers: &buffers, workgroups: Gpu::workgroups_for(numbers.div_ceil(WORKGROUP)) },
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
