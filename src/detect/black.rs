//! Noise of a frame whose counts are clipped at black: σ from the censored distribution of the counts that are left.
//!
//! Most counts are then the lowest, and their scatter says nothing. Of a normal distribution that is cut at the lowest count and rounded, the
//! shares of pixels at the lowest count and above some other determine σ: at the edges between counts, e, the quantiles of the shares below are
//! (e − level)/σ. Starlight comes in clumps and noise does not: only pixels are used whose neighbours are no brighter than most.

use std::ops::Range;

use statrs::distribution::{ContinuousCDF, Normal};

use crate::frame::Frame;
use crate::statistics::median_in_place;

/// Side of a part of the frame that tells its own noise, px.
const PART_PX: usize = 128;
/// The share of the lowest count from which on black is cut off above the sky.
const MIN_SHARE: f64 = 0.5;
/// Fewer pixels above the lowest count tell nothing.
const MIN_COUNT_ABOVE: f64 = 40.0;
/// The other edge is where so much of what is above the lowest count is left.
const LEFT: f64 = 0.3;
/// Where less of all is above the lowest count than this, it is defects and stars.
const MIN_SHARE_ABOVE: f64 = 3e-4;

/// What holds for this share of the parts holds nearly everywhere.
const NEARLY: f64 = 0.9;

/// Noise before black was cut off, DN, by parts of the frame; 0 where it was not.
#[derive(Clone, Debug)]
pub(super) struct CutNoise {
    columns: usize,
    rows: usize,
    sigma_dn: Vec<f64>,
    /// Scatter of what is left of it.
    left_dn: Vec<f64>,
    /// The share of the parts in which most counts are the lowest.
    black: f64,
    lowest_dn: f32,
}

impl CutNoise {
    /// At a pixel.
    pub(super) fn at(&self, x: usize, y: usize) -> f64 {
        self.sigma_dn[self.part(x, y)]
    }

    /// Whether black is cut off nearly everywhere.
    pub(super) fn is_everywhere(&self) -> bool {
        self.sigma_dn.iter().filter(|sigma| **sigma > 0.0).count() as f64 >= NEARLY * self.sigma_dn.len() as f64
    }

    /// Whether most counts are the lowest nearly everywhere, and what is above comes in blocks.
    pub(super) fn is_in_blocks(&self, frame: &Frame) -> bool {
        self.black >= NEARLY && comes_in_blocks(frame, self.lowest_dn)
    }

    /// Scatter of what is left of it at a pixel.
    pub(super) fn left_at(&self, x: usize, y: usize) -> f64 {
        self.left_dn[self.part(x, y)]
    }

    fn part(&self, x: usize, y: usize) -> usize {
        (y / PART_PX).min(self.rows - 1) * self.columns + (x / PART_PX).min(self.columns - 1)
    }
}

/// Whether samples of a frame's parts are such that black may be cut off in one.
pub(super) fn may_be_cut(samples: &[Vec<f32>]) -> bool {
    /// Samples have fewer of the lowest count by chance.
    const MIN_BLACK_SHARE: f64 = 0.8 * MIN_SHARE;
    let Some(lowest) = samples.iter().flatten().copied().reduce(f32::min) else { return false };
    samples.iter().any(|part| part.iter().filter(|count| **count == lowest).count() as f64 > MIN_BLACK_SHARE * part.len() as f64)
}

/// The noise where black is cut off; `None` where it is not. `masked`: pixels that say nothing, empty if there are none.
pub(super) fn cut_noise(frame: &Frame, masked: &[bool], floor_dn: f64) -> Option<CutNoise> {
    let is_masked = |i: usize| masked.get(i).copied().unwrap_or(false);
    let lowest = (0..frame.pixels_dn.len()).filter(|i| !is_masked(*i)).map(|i| frame.pixels_dn[i]).reduce(f32::min)?;
    let parts = |length: usize| (length / PART_PX).max(1);
    let (columns, rows) = (parts(frame.width_px), parts(frame.height_px));
    let mut together: Vec<f32> = Vec::new();
    let mut scanty = vec![false; columns * rows];
    let mut sigma_dn = vec![0.0; columns * rows];
    let mut left_dn = sigma_dn.clone();
    let mut black = 0_usize;
    for part in 0..columns * rows {
        let span = |i: usize, n: usize, length: usize| (i * PART_PX)..(if i + 1 == n { length } else { (i + 1) * PART_PX });
        let (xs, ys) = (span(part % columns, columns, frame.width_px), span(part / columns, rows, frame.height_px));
        if !is_mostly(frame, is_masked, &xs, &ys, lowest) {
            continue;
        }
        black += 1;
        let counts = lone_counts(frame, is_masked, &xs, &ys);
        left_dn[part] = scatter(&counts);
        if let Some(sigma) = sigma(&counts, lowest) {
            sigma_dn[part] = sigma.max(floor_dn);
        } else {
            scanty[part] = true;
            together.extend(counts);
        }
    }
    if let Some(sigma) = sigma(&together, lowest) {
        for (own, _) in sigma_dn.iter_mut().zip(&scanty).filter(|(_, scanty)| **scanty) {
            *own = sigma.max(floor_dn);
        }
    }
    let share = black as f64 / (columns * rows) as f64;
    (black > 0).then_some(CutNoise { columns, rows, sigma_dn, left_dn, black: share, lowest_dn: lowest })
}

/// Whether what is above the lowest count begins and ends at the edges of the blocks that JPEG compresses pictures in, more often than between
/// them: stars, and noise of single pixels, know nothing of these.
fn comes_in_blocks(frame: &Frame, lowest_dn: f32) -> bool {
    const BLOCK: usize = 8;
    /// The edge has so many times as many as any other place, and so many standard deviations more.
    const TIMES: f64 = 1.15;
    const CLEARLY: f64 = 5.0;
    let width = frame.width_px;
    let is_above = |i: usize| frame.pixels_dn[i] > lowest_dn;
    let most_at_one = |edges: [usize; BLOCK]| {
        let mut edges = edges.map(|count| count as f64);
        edges.sort_unstable_by(f64::total_cmp);
        let (next, most) = (edges[BLOCK - 2], edges[BLOCK - 1]);
        most > TIMES * next + CLEARLY * (most + TIMES * TIMES * next).sqrt()
    };
    let (mut across, mut down) = ([0; BLOCK], [0; BLOCK]);
    for i in 0..frame.pixels_dn.len() {
        let (x, y) = (i % width, i / width);
        across[x % BLOCK] += usize::from(x + 1 < width && is_above(i) != is_above(i + 1));
        down[y % BLOCK] += usize::from(y + 1 < frame.height_px && is_above(i) != is_above(i + width));
    }
    most_at_one(across) && most_at_one(down)
}

/// Whether most pixels of a part are at the lowest count.
fn is_mostly(frame: &Frame, is_masked: impl Fn(usize) -> bool, xs: &Range<usize>, ys: &Range<usize>, lowest: f32) -> bool {
    let (mut at, mut all) = (0_usize, 0_usize);
    for y in ys.clone() {
        let row = y * frame.width_px;
        for i in row + xs.start..row + xs.end {
            all += usize::from(!is_masked(i));
            at += usize::from(!is_masked(i) && frame.pixels_dn[i] == lowest);
        }
    }
    all > 0 && at as f64 >= MIN_SHARE * all as f64
}

/// The counts of the pixels of a part whose eight neighbours together are no brighter than those of most.
fn lone_counts(frame: &Frame, is_masked: impl Fn(usize) -> bool, xs: &Range<usize>, ys: &Range<usize>) -> Vec<f32> {
    let mut all: Vec<(f32, f64)> = Vec::with_capacity(xs.len() * ys.len());
    for y in ys.start.max(1)..ys.end.min(frame.height_px - 1) {
        for x in xs.start.max(1)..xs.end.min(frame.width_px - 1) {
            if is_masked(y * frame.width_px + x) {
                continue;
            }
            let square: f32 = (y - 1..=y + 1).map(|y| (x - 1..=x + 1).map(|x| frame.at(x, y)).sum::<f32>()).sum();
            all.push((frame.at(x, y), f64::from(square - frame.at(x, y))));
        }
    }
    let mut around: Vec<f64> = all.iter().map(|(_, around)| *around).collect();
    let most = median_in_place(&mut around).unwrap_or(0.0);
    all.into_iter().filter(|(_, around)| *around <= most).map(|(count, _)| count).collect()
}

/// Standard deviation of counts as they are.
fn scatter(counts: &[f32]) -> f64 {
    let count = counts.len().max(1) as f64;
    let mean = counts.iter().map(|c| f64::from(*c)).sum::<f64>() / count;
    (counts.iter().map(|c| (f64::from(*c) - mean).powi(2)).sum::<f64>() / count).sqrt()
}

/// σ of the normal distribution of which counts are what is left above the lowest.
fn sigma(counts: &[f32], lowest: f32) -> Option<f64> {
    let all = counts.len() as f64;
    let mut above: Vec<f32> = counts.iter().copied().filter(|count| *count > lowest).collect();
    let share = above.len() as f64 / all;
    if (above.len() as f64) < MIN_COUNT_ABOVE || !(MIN_SHARE_ABOVE..=1.0 - MIN_SHARE).contains(&share) {
        return None;
    }
    above.sort_unstable_by(f32::total_cmp);
    let at = above[((1.0 - LEFT) * above.len() as f64) as usize];
    let beyond = above.len() - above.partition_point(|count| *count <= at);
    let quantile = |above: f64| -Normal::standard().inverse_cdf(above);
    let apart = quantile((beyond as f64).max(0.5) / all) - quantile(share);
    // Edges lie half a step above the counts, at either end.
    (apart > 0.0).then(|| f64::from(at - lowest) / apart)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::Distribution;

    const SIZE: (usize, usize) = (512, 384);

    fn frame(count: impl FnMut(usize) -> f32) -> Frame {
        let pixels_dn = (0..SIZE.0 * SIZE.1).map(count).collect();
        Frame { width_px: SIZE.0, height_px: SIZE.1, pixels_dn, saturation_dn: 255.0 }
    }

    fn noise_of(frame: &Frame) -> f64 {
        let cut = cut_noise(frame, &vec![false; frame.pixels_dn.len()], 0.3);
        let mut all = cut.map_or_else(Vec::new, |cut| cut.sigma_dn);
        median_in_place(&mut all).unwrap_or(0.0)
    }

    /// Whatever the noise is in steps of the counts, and wherever black is cut off.
    #[test]
    fn noise_is_what_it_was_before_it_was_cut() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(7);
        for (sigma, level) in [(10.0, -1.0), (10.0, -12.0), (10.0, -27.0), (1.5, -0.7), (1.5, -2.0), (0.4, 0.0), (0.7, -0.9), (3.0, -3.0)] {
            let noise = rand_distr::Normal::new(level, sigma).unwrap();
            let found = noise_of(&frame(|_| (noise.sample(&mut rng) as f32).round().max(0.0)));
            assert!((found / sigma - 1.0).abs() < 0.12, "{found} for {sigma} at {level}");
            // With a star in every 40 × 40 pixels too.
            let star =
                |i: usize| 300.0 * (-(((i % SIZE.0 % 40) as f64 - 20.0).powi(2) + ((i / SIZE.0 % 40) as f64 - 20.0).powi(2)) / 2.5).exp();
            let found = noise_of(&frame(|i| ((noise.sample(&mut rng) + star(i)) as f32).round().clamp(0.0, 255.0)));
            assert!((found / sigma - 1.0).abs() < 0.25, "{found} for {sigma} at {level}, with stars");
        }
    }

    #[test]
    fn blocks_are_seen_and_stars_and_lone_pixels_are_none() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(9);
        let noise = rand_distr::Normal::new(-2.0, 1.5).unwrap();
        let lone = frame(|_| (noise.sample(&mut rng) as f32).round().max(0.0));
        let star = |i: usize| 90.0 * (-(((i % SIZE.0 % 37) as f32 - 18.0).powi(2) + ((i / SIZE.0 % 41) as f32 - 20.0).powi(2)) / 2.5).exp();
        let stars = frame(|i| star(i).round());
        // One block in nine is brighter by two counts.
        let block = |i: usize| if (i % SIZE.0 / 8 * 7 + i / SIZE.0 / 8 * 5).is_multiple_of(9) { 2.0 } else { 0.0 };
        let blocks = frame(|i| block(i) + star(i).round());
        for (name, frame, expected) in [("lone", lone, false), ("stars", stars, false), ("blocks", blocks, true)] {
            let cut = cut_noise(&frame, &vec![false; frame.pixels_dn.len()], 0.3).unwrap();
            assert_eq!(cut.is_in_blocks(&frame), expected, "{name}");
        }
    }

    #[test]
    fn starlight_on_black_is_no_noise() {
        let star = |i: usize| 200.0 * (-(((i % SIZE.0 % 16) as f32 - 8.0).powi(2) + ((i / SIZE.0 % 16) as f32 - 8.0).powi(2)) / 2.5).exp();
        assert_eq!(noise_of(&frame(|i| star(i).round())), 0.0);
        // What is not cut off is not asked.
        assert!(cut_noise(&frame(|i| 20.0 + (i % 7) as f32), &vec![false; SIZE.0 * SIZE.1], 0.3).is_none());
    }
}
