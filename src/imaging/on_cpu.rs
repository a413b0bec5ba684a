//! The twins on the CPU: bands of rows on all cores, each band small enough to stay in a core's cache through all effects.
//!
//! A band depends on nothing but its stars and its place, so the bytes do not depend on the number of threads.

use rayon::prelude::*;

use super::Exposure;
use super::plan::{Lit, Plan};
use super::tiles::{Grid, TILE_PX, TileLists, bin};
use crate::effects::pixel::{PlaneStar, Rows, Stage, Star};

/// The chain of effects with everything that a band needs.
struct Chain<'a> {
    plan: &'a Plan,
    exposure: &'a Exposure<'a>,
    lit: &'a Lit<'a>,
    lists: TileLists<Star>,
    plane_lists: Vec<TileLists<PlaneStar>>,
    stage: Option<Stage>,
    uniforms: Vec<Vec<u8>>,
}

impl<'a> Chain<'a> {
    fn new(plan: &'a Plan, stage: Option<Stage>, lit: &'a Lit<'a>, exposure: &'a Exposure<'a>) -> Self {
        // One tile spans the frame's width: a twin goes through whole rows.
        let grid = Grid { width: plan.width_px, first_row: 0, rows: plan.height_px, tile_width: plan.width_px };
        let lists = bin(&lit.stars, &grid, usize::MAX, usize::MAX).swap_remove(0);
        let plane_lists = lit.planes.iter().map(|batch| batch.lists(&grid)).collect();
        let uniforms = plan.effects_up_to(stage).iter().map(|enabled| enabled.uniforms(exposure)).collect();
        Self { plan, exposure, lit, lists, plane_lists, stage, uniforms }
    }

    /// Fills the `band`-th band of [`TILE_PX`] rows.
    fn fill(&self, band: usize, electrons: &mut [f32], scratch: &mut Vec<f32>) {
        electrons.fill(0.0);
        let (width, first_row) = (self.plan.width_px, band * TILE_PX);
        for entry in self.lists.of(band) {
            let mut rows = Rows { width, first_row, electrons: &mut *electrons, scratch: &mut *scratch };
            self.plan.spread.add(&self.lists.stars[entry.star as usize], &mut rows);
        }
        for (batch, lists) in self.lit.planes.iter().zip(&self.plane_lists) {
            batch.add(lists, lists.of(band), &mut Rows { width, first_row, electrons: &mut *electrons, scratch: &mut *scratch });
        }
        let first_pixel = (first_row * width) as u32;
        for (enabled, uniforms) in self.plan.effects_up_to(self.stage).iter().zip(&self.uniforms) {
            enabled.effect.apply(uniforms, self.plan.key(enabled.effect, self.exposure), first_pixel, electrons);
        }
    }
}

/// Electrons after a stage.
pub(super) fn electrons(plan: &Plan, stage: Option<Stage>, lit: &Lit<'_>, exposure: &Exposure<'_>) -> Vec<f32> {
    let chain = Chain::new(plan, stage, lit, exposure);
    let mut frame = vec![0.0_f32; plan.width_px * plan.height_px];
    frame
        .par_chunks_mut(plan.width_px * TILE_PX)
        .enumerate()
        .for_each_init(Vec::new, |scratch, (band, rows)| chain.fill(band, rows, scratch));
    frame
}

/// Counts at the end of the chain.
pub(super) fn counts(plan: &Plan, lit: &Lit<'_>, exposure: &Exposure<'_>) -> Vec<u16> {
    let chain = Chain::new(plan, Some(Stage::Digital), lit, exposure);
    let mut frame = vec![0_u16; plan.width_px * plan.height_px];
    frame.par_chunks_mut(plan.width_px * TILE_PX).enumerate().for_each_init(
        || (Vec::new(), Vec::new()),
        |(scratch, electrons), (band, counts)| {
            electrons.resize(counts.len(), 0.0);
            chain.fill(band, electrons, scratch);
            for (count, value) in counts.iter_mut().zip(electrons.iter()) {
                *count = *value as u16;
            }
        },
    );
    frame
}
