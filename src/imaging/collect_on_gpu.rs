//! Star light on the GPU: lists of stars for the tiles that they light, and the programs that go through them.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::GpuError;
use super::compose::{collect_plane_program, collect_program};
use super::on_gpu::{Band, GpuImager, Kept, WORKGROUP};
use super::plan::{Lit, Plan};
use super::plane::PlaneBatch;
use super::tiles::{Entry, Grid, TILE_PX, TileList, TileLists, bin};
use crate::effects::pixel::{Psf2dStar, SeparableStar};
use crate::gpu::{Binding, Buffer, Dispatch, Gpu, Kernel, LOOP_BUDGET, WORKGROUPS_PER_AXIS};

/// `Part` of `shaders/lib/collect.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct PartUniforms {
    first_list: u32,
    all_entries: u32,
    unused: [u32; 2],
}

/// The bindings of `shaders/lib/collect.wgsl`.
const COLLECT_BINDINGS: [Binding; 7] =
    [Binding::Uniform, Binding::Uniform, Binding::Read, Binding::Read, Binding::Read, Binding::ReadWrite, Binding::ReadWrite];

/// The bindings of `shaders/lib/collect_plane.wgsl`.
const PLANE_BINDINGS: [Binding; 7] =
    [Binding::Uniform, Binding::Uniform, Binding::Read, Binding::Read, Binding::Read, Binding::Read, Binding::ReadWrite];

/// Bytes of an entry's profiles: along the columns and along the rows of its tile.
const PROFILE_BYTES: usize = 2 * TILE_PX * size_of::<f32>();

/// What is kept from frame to frame to collect light.
#[derive(Debug, Default)]
pub(super) struct Collect {
    profiles: Option<Kernel>,
    /// The programs `collect`: to pixels that hold nothing, and to those that hold light.
    sums: [Option<Kernel>; 2],
    /// Programs of plane spreads, by their ids.
    planes: Vec<(&'static str, Kernel)>,
    atlas: Option<KeptAtlas>,
    stars: Option<Buffer>,
    lists: Option<Buffer>,
    entries: Option<Buffer>,
    profile: Option<Buffer>,
}

/// Tables on the device, and where they lie in memory: that tells whether they are those wanted.
#[derive(Debug)]
struct KeptAtlas {
    values: Arc<[f32]>,
    buffer: Buffer,
}

/// A dispatch over tiles: the number of its part, the first list and how many of them.
struct Turn {
    part: usize,
    first_list: u32,
    count: u32,
}

impl Collect {
    /// Brings stars and lists to the device; what a part's lists are gone through in.
    fn bring<S: Pod>(&mut self, gpu: &Gpu, lists: &TileLists<S>, columns: usize, longest: u32) -> Result<Vec<Turn>, GpuError> {
        let parts = lists.parts(columns, longest);
        let all: Vec<TileList> = parts.concat();
        for (buffer, label, bytes) in [
            (&mut self.stars, "stars", bytemuck::cast_slice::<_, u8>(&lists.stars)),
            (&mut self.lists, "tile lists", bytemuck::cast_slice(&all)),
            (&mut self.entries, "tile entries", bytemuck::cast_slice(&lists.entries)),
        ] {
            // Room to grow, so that not every frame with a few stars more makes new buffers.
            gpu.reserve(buffer, label, (bytes.len() as u64).next_power_of_two())?;
            if let Some(buffer) = buffer {
                gpu.upload(buffer, bytes)?;
            }
        }
        let mut turns = Vec::new();
        let mut first_list = 0;
        for (part, lists) in parts.iter().enumerate() {
            for some in lists.chunks(WORKGROUPS_PER_AXIS as usize) {
                turns.push(Turn { part, first_list, count: some.len() as u32 });
                first_list += some.len() as u32;
            }
        }
        Ok(turns)
    }

    /// Brings tables to the device, unless they are there.
    fn keep_atlas(&mut self, gpu: &Gpu, values: &Arc<[f32]>) -> Result<(), GpuError> {
        if self.atlas.as_ref().is_some_and(|atlas| Arc::ptr_eq(&atlas.values, values)) {
            return Ok(());
        }
        let mut buffer = None;
        gpu.reserve(&mut buffer, "atlas", (size_of_val(&**values) as u64).max(16))?;
        let Some(buffer) = buffer else {
            return Ok(()); // it was made above
        };
        if !values.is_empty() {
            gpu.upload(&buffer, bytemuck::cast_slice(values))?;
        }
        self.atlas = Some(KeptAtlas { values: Arc::clone(values), buffer });
        Ok(())
    }
}

impl GpuImager {
    /// Fills the buffer of electrons with the light of sky and stars, in as many dispatches as the loop budget and the size of buffers ask for.
    pub(super) fn collect(&self, plan: &Plan, lit: &Lit<'_>, band: Band, frame: &Buffer, kept: &mut Kept) -> Result<(), GpuError> {
        let grid = Grid { width: plan.width_px, first_row: band.first_row, rows: band.rows, tile_width: TILE_PX };
        let most_stars = (self.limits.buffer_bytes as usize / size_of::<SeparableStar>()).max(1);
        let most_entries = (self.limits.buffer_bytes as usize / PROFILE_BYTES).max(1);
        let longest = self.limits.entries_per_dispatch.clamp(1, LOOP_BUDGET);
        let Kept { collect: own, electrons: Some(electrons), .. } = kept else { return Ok(()) }; // it was made before
        let (first_pixel, pixels) = (band.first_row * plan.width_px, band.rows * plan.width_px);
        let sky = lit.sky_e.get(first_pixel..first_pixel + pixels);
        match sky {
            Some(sky) => self.gpu.upload(electrons, bytemuck::cast_slice(sky))?,
            None => self.gpu.clear(electrons, (pixels * size_of::<f32>()) as u64)?,
        }
        // The stars' light is put on that of the sky, where there is any.
        let mut holds_light = sky.is_some();
        for lists in bin(&lit.stars, &grid, most_stars, most_entries).iter().filter(|lists| !lists.entries.is_empty()) {
            let turns = own.bring(&self.gpu, lists, grid.columns(), longest)?;
            self.gpu.reserve(&mut own.profile, "profile", ((lists.entries.len() * PROFILE_BYTES) as u64).next_power_of_two())?;
            for (number, Turn { part, first_list, count }) in turns.into_iter().enumerate() {
                let goes_on = holds_light || part > 0;
                self.compile_collect(plan, goes_on, own)?;
                let Collect { profiles: Some(profiles), sums, stars: Some(stars), lists: Some(tile_lists), .. } = &*own else {
                    continue;
                };
                let (Some(collect), Some(entries), Some(profile)) = (&sums[usize::from(goes_on)], &own.entries, &own.profile) else {
                    continue; // all were made above
                };
                let all_entries = lists.entries.len() as u32;
                let uniforms = PartUniforms { first_list, all_entries, unused: [0; 2] };
                let uniforms = self.gpu.uniform("part", bytemuck::bytes_of(&uniforms))?;
                let buffers = [frame, &uniforms, stars, tile_lists, entries, profile, electrons];
                let workgroups = Gpu::workgroups_for((2 * u64::from(all_entries)).div_ceil(WORKGROUP));
                let work = [
                    Dispatch { kernel: profiles, buffers: &buffers, workgroups },
                    Dispatch { kernel: collect, buffers: &buffers, workgroups: [count, 1] },
                ];
                // The profiles serve all parts of the lists.
                self.gpu.submit(&work[usize::from(number > 0)..])?;
            }
            holds_light = true;
        }
        Ok(())
    }

    /// Makes the programs that collect light, unless they are there.
    fn compile_collect(&self, plan: &Plan, goes_on: bool, own: &mut Collect) -> Result<(), GpuError> {
        let kernel = |label: &'static str| {
            let program = collect_program(plan.spread, plan.width_px, goes_on);
            self.gpu.kernel(label, &program, label, &COLLECT_BINDINGS)
        };
        if own.profiles.is_none() {
            own.profiles = Some(kernel("profiles")?);
        }
        let collect = &mut own.sums[usize::from(goes_on)];
        if collect.is_none() {
            *collect = Some(kernel("collect")?);
        }
        Ok(())
    }

    /// Adds the light of a plane spread to the buffer of electrons.
    pub(super) fn collect_plane(
        &self,
        plan: &Plan,
        batch: &PlaneBatch<'_>,
        band: Band,
        frame: &Buffer,
        kept: &mut Kept,
    ) -> Result<(), GpuError> {
        let Kept { collect: own, electrons: Some(electrons), .. } = kept else { return Ok(()) }; // it was made before
        let spread = batch.spread;
        if !own.planes.iter().any(|(id, _)| *id == spread.id()) {
            let kernel = self.gpu.kernel("collect_plane", &collect_plane_program(spread), "collect_plane", &PLANE_BINDINGS)?;
            own.planes.push((spread.id(), kernel));
        }
        own.keep_atlas(&self.gpu, &batch.atlas.values)?;
        let grid = Grid { width: plan.width_px, first_row: band.first_row, rows: band.rows, tile_width: TILE_PX };
        let most_stars = (self.limits.buffer_bytes as usize / size_of::<Psf2dStar>()).max(1);
        let most_entries = (self.limits.buffer_bytes as usize / size_of::<Entry>()).max(1);
        let budget = LOOP_BUDGET / (spread.loop_iterations() + 1);
        let longest = self.limits.entries_per_dispatch.clamp(1, budget.max(1));
        for lists in bin(&batch.stars, &grid, most_stars, most_entries).iter().filter(|lists| !lists.entries.is_empty()) {
            for Turn { first_list, count, .. } in own.bring(&self.gpu, lists, grid.columns(), longest)? {
                let Collect { planes, atlas: Some(atlas), stars: Some(stars), lists: Some(tile_lists), entries: Some(entries), .. } = &*own
                else {
                    continue; // all were made above
                };
                let Some((_, kernel)) = planes.iter().find(|(id, _)| *id == spread.id()) else {
                    continue; // as above
                };
                let part = PartUniforms { first_list, all_entries: lists.entries.len() as u32, unused: [0; 2] };
                let part = self.gpu.uniform("part", bytemuck::bytes_of(&part))?;
                let buffers = [frame, &part, stars, tile_lists, entries, &atlas.buffer, electrons];
                self.gpu.submit(&[Dispatch { kernel, buffers: &buffers, workgroups: [count, 1] }])?;
            }
        }
        Ok(())
    }
}
