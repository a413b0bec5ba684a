//! CPU backend: the twins on bands of rows on all cores, each band small enough to stay in a core's cache through all effects up to the first pass.
//!
//! A band depends on nothing but its stars and its place, and a pass on nothing but the frame, so the bytes do not depend on the number of
//! threads.

use rayon::prelude::*;

use super::FrameExposure;
use super::plan::{Enabled, Lit, Plan};
use super::tiles::{Grid, TILE_PX, TileLists, bin};
use crate::effects::ids;
use crate::effects::pixel::lanes::to_counts;
use crate::effects::pixel::pass::FrameBuffer;
use crate::effects::pixel::{ExposureContext, Psf2dStar, Rows, SeparableStar, Stage, Work};
use crate::rng::StageKey;

/// Effects that each see one pixel, ready for an exposure.
pub(super) struct Pixels<'a> {
    effects: Vec<(Apply, StageKey, Vec<u8>)>,
    /// Electrons of the whole frame that are added before the effect of this place.
    read_e: Option<(usize, &'a [f32])>,
}

/// A twin, see [`Work::Pixels`].
type Apply = fn(&[u8], StageKey, u32, &mut [f32]);

impl std::fmt::Debug for Pixels<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} effects", self.effects.len())
    }
}

impl<'a> Pixels<'a> {
    /// Passes among the effects are left out.
    pub(super) fn new(plan: &Plan, enabled: &[Enabled], exposure: &FrameExposure<'_>, context: &ExposureContext) -> Self {
        let ready = |one: &Enabled| match one.effect.work() {
            Work::Pixels(apply) => Some((apply, plan.key(one.effect, exposure), one.uniforms(context))),
            Work::Frame(..) => None,
        };
        Self { effects: enabled.iter().filter_map(ready).collect(), read_e: None }
    }

    /// The same with what reading adds right before the converter, if that is among the effects; nothing if it is empty.
    fn with_read(mut self, enabled: &[Enabled], read_e: &'a [f32]) -> Self {
        let of_pixels = |one: &&Enabled| matches!(one.effect.work(), Work::Pixels(_));
        let converter = enabled.iter().filter(of_pixels).position(|one| one.effect.id() == ids::ADC);
        self.read_e = converter.map(|place| (place, read_e)).filter(|_| !read_e.is_empty());
        self
    }

    /// Changes a run of pixels, of which the first has this index in the frame.
    pub(super) fn apply(&self, first_pixel: usize, electrons: &mut [f32]) {
        for (place, (apply, key, uniforms)) in self.effects.iter().enumerate() {
            if let Some((_, read_e)) = self.read_e.filter(|(converter, _)| *converter == place) {
                electrons.iter_mut().zip(&read_e[first_pixel..]).for_each(|(electrons, read_e)| *electrons += read_e);
            }
            apply(uniforms, *key, first_pixel as u32, electrons);
        }
    }
}

/// The chain of effects up to the first pass, with everything that a band needs.
struct Chain<'a> {
    plan: &'a Plan,
    lit: &'a Lit<'a>,
    lists: TileLists<SeparableStar>,
    plane_lists: Vec<TileLists<Psf2dStar>>,
    pixels: Pixels<'a>,
}

impl<'a> Chain<'a> {
    fn new(plan: &'a Plan, lit: &'a Lit<'a>, pixels: Pixels<'a>) -> Self {
        // One tile spans the frame's width: a twin goes through whole rows.
        let grid = Grid { width: plan.width_px, first_row: 0, rows: plan.height_px, tile_width: plan.width_px };
        let lists = bin(&lit.stars, &grid, usize::MAX, usize::MAX).swap_remove(0);
        let plane_lists = lit.planes.iter().map(|batch| batch.lists(&grid)).collect();
        Self { plan, lit, lists, plane_lists, pixels }
    }

    /// Fills the `band`-th band of [`TILE_PX`] rows.
    fn fill(&self, band: usize, electrons: &mut [f32], scratch: &mut Vec<f32>) {
        let (width, first_row) = (self.plan.width_px, band * TILE_PX);
        match self.lit.sky_e.get(first_row * width..first_row * width + electrons.len()) {
            Some(sky) => electrons.copy_from_slice(sky),
            None => electrons.fill(0.0), // there is no light of the sky
        }
        for entry in self.lists.of(band) {
            let mut rows = Rows { width, first_row, electrons: &mut *electrons, scratch: &mut *scratch };
            self.plan.spread.add(&self.lists.stars[entry.star as usize], &mut rows);
        }
        for (batch, lists) in self.lit.planes.iter().zip(&self.plane_lists) {
            batch.add(lists, lists.of(band), &mut Rows { width, first_row, electrons: &mut *electrons, scratch: &mut *scratch });
        }
        self.pixels.apply(first_row * width, electrons);
    }
}

/// Electrons after a stage.
pub(super) fn electrons(plan: &Plan, stage: Option<Stage>, lit: &Lit<'_>, exposure: &FrameExposure<'_>) -> Vec<f32> {
    electrons_in(plan, stage, (lit, &[]), exposure, &plan.context(exposure, lit))
}

/// The same under circumstances that are not those of the light, and with what reading adds before the converter (empty: nothing).
pub(super) fn electrons_in(
    plan: &Plan,
    stage: Option<Stage>,
    (lit, read_e): (&Lit<'_>, &[f32]),
    exposure: &FrameExposure<'_>,
    context: &ExposureContext,
) -> Vec<f32> {
    let mut segments = plan.segments(stage).into_iter();
    let first = segments.next().map_or(&[][..], |segment| segment.pixels);
    let chain = Chain::new(plan, lit, Pixels::new(plan, first, exposure, context).with_read(first, read_e));
    let mut frame = vec![0.0_f32; plan.width_px * plan.height_px];
    let band_pixels = plan.width_px * TILE_PX;
    frame.par_chunks_mut(band_pixels).enumerate().for_each_init(Vec::new, |scratch, (band, rows)| chain.fill(band, rows, scratch));
    let mut scratch = Vec::new();
    for segment in segments {
        if let Some(pass) = segment.pass
            && let Work::Frame(_, move_charge) = pass.effect.work()
        {
            let mut buffer = FrameBuffer { width: plan.width_px, electrons: &mut frame, scratch: &mut scratch };
            move_charge(&pass.uniforms(context), &mut buffer);
        }
        let pixels = Pixels::new(plan, segment.pixels, exposure, context).with_read(segment.pixels, read_e);
        if !pixels.effects.is_empty() {
            frame.par_chunks_mut(band_pixels).enumerate().for_each(|(band, rows)| pixels.apply(band * band_pixels, rows));
        }
    }
    frame
}

/// Counts at the end of the chain, with what reading adds before the converter (empty: nothing).
pub(super) fn counts(plan: &Plan, lit: &Lit<'_>, read_e: &[f32], exposure: &FrameExposure<'_>) -> Vec<u16> {
    let stage = Some(Stage::Digital);
    let segments = plan.segments(stage);
    if segments.len() > 1 {
        let values = electrons_in(plan, stage, (lit, read_e), exposure, &plan.context(exposure, lit));
        let mut counts = vec![0; values.len()];
        to_counts(&values, &mut counts);
        return counts;
    }
    let pixels = Pixels::new(plan, segments[0].pixels, exposure, &plan.context(exposure, lit)).with_read(segments[0].pixels, read_e);
    let chain = Chain::new(plan, lit, pixels);
    let mut frame = vec![0_u16; plan.width_px * plan.height_px];
    frame.par_chunks_mut(plan.width_px * TILE_PX).enumerate().for_each_init(
        || (Vec::new(), Vec::new()),
        |(scratch, electrons), (band, counts)| {
            electrons.resize(counts.len(), 0.0);
            chain.fill(band, electrons, scratch);
            to_counts(electrons, counts);
        },
    );
    frame
}
