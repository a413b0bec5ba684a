//! Sums over the frames of a shard: what statistics of the whole dataset are made of, without a look into any archive.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::drawn_shares::DrawnShares;
use super::frame_key::FrameKey;
use super::plan::DatasetPlan;
use super::recipe::DrawLevel;
use super::sample::DatasetSample;
use super::sample_labels::STAR;

/// Counts of stars: 0, 1, 2 and 3, 4 to 7, and so on by powers of two.
const COUNTS: usize = 16;
/// Half magnitudes, and where they begin.
const MAGNITUDES: usize = 40;
pub(super) const FIRST_MAGNITUDE: f64 = -2.0;
/// Doublings of the signal-to-noise ratio, and where they begin.
const RATIOS: usize = 14;
pub(super) const FIRST_RATIO: f64 = 5.0;
/// Columns and rows that a frame is cut into.
pub(super) const PLACES: [usize; 2] = [16, 12];
/// Right ascensions and heights (sines of declination) that the sky is cut into: cells of equal area.
pub(super) const SKY: [usize; 2] = [48, 24];

/// Sums over frames. "Stars" are those of the catalogue that are visible.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ShardStatistics {
    /// Frames by their stars: 0, 1, 2 to 3, 4 to 7, and so on by powers of two.
    pub frames_by_stars: Vec<u64>,
    /// Stars by V magnitude, in steps of a half from −2 on.
    pub stars_by_magnitude: Vec<u64>,
    /// Stars by the ratio of electrons to their standard error: 5 to 10, 10 to 20, and so on.
    pub stars_by_snr: Vec<u64>,
    /// Stars by their place: 12 rows of 16 parts of a frame.
    pub stars_by_place: Vec<u64>,
    /// Frames by boresight: 24 bands of equal area from the south pole, each of 48 parts of right ascension.
    pub frames_by_boresight: Vec<u64>,
    /// Stars with a full pixel.
    pub saturated_stars: u64,
    /// Stars with another one near.
    pub blended_stars: u64,
    /// Stars whose light falls beside the frame in part.
    pub edge_stars: u64,
    /// Frames without stars on purpose.
    pub no_star_frames: u64,
    /// Frames with lights that look like stars and are none, on purpose.
    pub false_star_frames: u64,
    /// Frames that are one of a pair.
    pub paired_frames: u64,
    /// Frames in which each effect is on.
    pub frames_by_effect: BTreeMap<String, u64>,
    /// What was drawn.
    pub draws: Vec<DrawnShares>,
}

/// The part that a value falls into, from 0 to below `parts`.
fn part(value: f64, parts: usize) -> usize {
    (value.max(0.0) as usize).min(parts - 1)
}

/// The cell of the sky that a direction falls into.
pub(super) fn sky_cell([x, y, z]: [f64; 3]) -> usize {
    let turn = y.atan2(x).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
    part(0.5 * (1.0 + z) * SKY[1] as f64, SKY[1]) * SKY[0] + part(turn * SKY[0] as f64, SKY[0])
}

impl ShardStatistics {
    /// Without any frame.
    pub(super) fn new(plan: &DatasetPlan) -> Self {
        Self {
            frames_by_stars: vec![0; COUNTS],
            stars_by_magnitude: vec![0; MAGNITUDES],
            stars_by_snr: vec![0; RATIOS],
            stars_by_place: vec![0; PLACES[0] * PLACES[1]],
            frames_by_boresight: vec![0; SKY[0] * SKY[1]],
            draws: plan.draws.iter().map(DrawnShares::new).collect(),
            ..Self::default()
        }
    }

    /// Adds a frame.
    pub(super) fn add(&mut self, plan: &DatasetPlan, sample: &DatasetSample) {
        let (labels, frame) = (&sample.labels, &sample.frame);
        let lights = &labels.lights;
        let visible = lights.visible_stars();
        self.frames_by_stars[part(f64::from(usize::BITS - visible.leading_zeros()), COUNTS)] += 1;
        for index in (0..lights.hip.len()).filter(|index| lights.visible[*index] && lights.kind[*index] == STAR) {
            self.stars_by_magnitude[part(2.0 * (lights.magnitude[index] - FIRST_MAGNITUDE), MAGNITUDES)] += 1;
            self.stars_by_snr[part((lights.snr[index] / FIRST_RATIO).log2(), RATIOS)] += 1;
            let along = |at: f64, side: usize, parts: usize| part((at + 0.5) / side as f64 * parts as f64, parts);
            let column = along(lights.x_px[index], labels.size_px[0], PLACES[0]);
            let row = along(lights.y_px[index], labels.size_px[1], PLACES[1]);
            self.stars_by_place[row * PLACES[0] + column] += 1;
            self.saturated_stars += u64::from(lights.saturated[index]);
            self.blended_stars += u64::from(lights.blended[index]);
            self.edge_stars += u64::from(lights.edge[index]);
        }
        self.frames_by_boresight[sky_cell(labels.boresight())] += 1;
        self.no_star_frames += u64::from(frame.is_starless);
        self.false_star_frames += u64::from(frame.false_stars > 0);
        self.paired_frames += u64::from(frame.pair.is_some());
        for effect in &labels.effects {
            *self.frames_by_effect.entry(effect.clone()).or_default() += 1;
        }
        for (draw, shares) in plan.draws.iter().zip(&mut self.draws) {
            if plan.is_drawn_anew(draw.level, frame.key, frame.pair.is_some() && draw.is_of_exposure()) {
                shares.add(draw, &frame.scene);
            }
        }
    }

    /// Adds the frames of another shard.
    pub(super) fn merge(&mut self, other: &Self) {
        let add = |own: &mut Vec<u64>, more: &[u64]| {
            own.resize(own.len().max(more.len()), 0);
            own.iter_mut().zip(more).for_each(|(own, more)| *own += more);
        };
        add(&mut self.frames_by_stars, &other.frames_by_stars);
        add(&mut self.stars_by_magnitude, &other.stars_by_magnitude);
        add(&mut self.stars_by_snr, &other.stars_by_snr);
        add(&mut self.stars_by_place, &other.stars_by_place);
        add(&mut self.frames_by_boresight, &other.frames_by_boresight);
        self.saturated_stars += other.saturated_stars;
        self.blended_stars += other.blended_stars;
        self.edge_stars += other.edge_stars;
        self.no_star_frames += other.no_star_frames;
        self.false_star_frames += other.false_star_frames;
        self.paired_frames += other.paired_frames;
        for (effect, frames) in &other.frames_by_effect {
            *self.frames_by_effect.entry(effect.clone()).or_default() += frames;
        }
        if self.draws.is_empty() {
            self.draws.clone_from(&other.draws);
        } else {
            self.draws.iter_mut().zip(&other.draws).for_each(|(own, more)| own.merge(more));
        }
    }
}

impl DatasetPlan {
    /// Whether a frame is the first with its value of a draw; `follows`: it is one of a pair, and the draw is of the exposure.
    fn is_drawn_anew(&self, level: DrawLevel, key: FrameKey, follows: bool) -> bool {
        let (size, cameras) = (&self.recipe.size, &self.recipe.cameras);
        let begins_recording = key.index.is_multiple_of(size.frames_per_recording);
        let begins_camera = begins_recording && key.recording(size) < cameras.of(key.split);
        // The second of a pair has the exposure of the first.
        if follows && key.index % 2 == 1 {
            return false;
        }
        match level {
            DrawLevel::Dataset => key.index == 0 && self.is_first_split(key.split),
            // Splits that share cameras share their values.
            DrawLevel::Camera => begins_camera && (self.cameras_are_apart() || self.is_first_split(key.split)),
            DrawLevel::Recording => begins_recording,
            DrawLevel::Frame => true,
        }
    }
}
