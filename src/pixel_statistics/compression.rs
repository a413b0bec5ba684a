//! Traces of JPEG (ITU-T T.81) in the counts: combs in the coefficients of 8×8 blocks, blocks of one value, steps at the borders of blocks.
//!
//! Every aligned block b is transformed, c = D·b·Dᵀ with the orthonormal cosine transform D. A decoded image has c_uv = k·q_uv with whole k
//! and the quantiser q_uv, blurred by the rounding of its counts: 1/√12 of the counts' step, in every coefficient.
//!
//! - **Comb**: C(q) = mean of cos(2π c/q) over the coefficients outside of the tooth nearest to their median. The phases of a smooth
//!   histogram spread over the circle there, and those of a falling one lie between the teeth (C ≤ 0; scanned for Gaussians of all widths
//!   and offsets). p ≤ exp(−N C²) for N uniform phases (Chernoff; I₀(t) ≤ exp(t²/4); the Rayleigh test with a known direction), times the
//!   number of coefficients and quantisers tried. The fundamental is the largest q near the best score. A comb keeps
//!   C = exp(−π²/6 · step²/q²): 0.19 at q = 1 step, 0.035 at 0.7, 0.001 at 0.5. So quantisers below about 0.7 steps cannot be seen.
//! - **Table**: the same with q_uv = s·K_uv of the standard's table K.1, all coefficients in one sum with weights C. It sees
//!   a fine quantisation by the coarse steps of the high frequencies, and a coarse one by the few coefficients that are not 0.
//! - **Blocks of one value**: where everything is quantised away. Their number is compared with that of the same blocks shifted by half a
//!   block in both directions (McNemar 1947, with Hoeffding's bound): black or saturated regions are constant in both. A straight border of
//!   such a region makes a whole line of blocks constant in one and not in the other, all at once: blocks at the frame's lowest or highest
//!   count do not vote.
//!
//! Of a colour mosaic every block is transformed less the means of its four colours: their contrast displaces the coefficients of odd
//! frequency, whose phases then do not spread.
//!
//! (0,0), (0,4), (4,0), (4,4) are left out, because they are rational combinations of whole counts and have combs of their own. (0,1) and
//! (1,0) are left out, because a gradient of the sky displaces them. Quantisers below 0.6 of the counts' step are not tried.
//!
//! Frames of a still scene repeat their stars and their fixed pattern, so all frames count as one: N is the mean number of a frame.

use super::compression_combs::{BINS_PER_DN, BLOCK, Coefficient, CoefficientComb, MIN_QUANTISER_DN, Scan, TABLE, TOLD, table};
use super::mosaic::is_mosaic;
use crate::parallel;
use serde::{Deserialize, Serialize};

const BINS: usize = 4096;
const BLOCKS_PER_FRAME: usize = 4096;
const DIFFERENCES: usize = 8192;

/// Histograms of the coefficients of 8×8 blocks over all frames. Its size does not grow.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockDct {
    /// The unit of everything here, DN.
    unit_dn: f32,
    /// 64 × 4096 bins of 1/8 unit; the outer two hold what lies beyond.
    histograms: Vec<u32>,
    blocks: u64,
    frames: u64,
    /// Blocks that are of one value between the ends, and not so when shifted by half a block.
    constant_aligned: u64,
    /// Blocks that are not of one value, and are of one between the ends when shifted.
    constant_shifted: u64,
    /// Blocks that are of one value wherever they lie.
    constant_both: u64,
    /// Blocks compared with their shifted selves.
    compared: u64,
    /// Absolute differences of horizontal neighbours in bins of 1/4 unit, inside of blocks and across their borders.
    differences: [Vec<u64>; 2],
}

/// Whether the counts went through a block transform with quantisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct CompressionStatistics {
    /// Frames that were added.
    pub frames: u64,
    /// Blocks that were transformed.
    pub blocks: u64,
    /// Side of the blocks, px, where one of the three tests names them (`p_value` below 0.001).
    pub block_px: Option<u32>,
    /// Probability of as much without compression; an upper bound, with all trials of the three tests.
    pub p_value: f64,
    /// That of the best comb of one coefficient, with its trials.
    pub comb_p_value: f64,
    /// That of the best scale of the standard's table, with its trials.
    pub table_p_value: f64,
    /// That of the blocks of one value.
    pub constant_p_value: f64,
    /// The smallest quantiser that was told, DN.
    pub quantiser_dn: Option<f64>,
    /// Scale s of the quantisers s·K in units of the standard's luminance table K.1 (1 is "quality 50" of 8 bits), DN.
    /// `None` where most blocks are of one value: then the rounding of the counts displaces the few teeth there are.
    pub table_scale_dn: Option<f64>,
    /// Its accuracy for the standard's table, measured on simulated frames, DN.
    pub table_scale_error_dn: Option<f64>,
    /// R.m.s. of ln(quantiser / (s·K)) over the told ones: large where the table is another one. `None` below two of them.
    pub table_scatter: Option<f64>,
    /// Coefficients whose quantiser is told.
    pub combs: Vec<CoefficientComb>,
    /// Share of blocks of one value, at the grid of the compression.
    pub constant_share: f64,
    /// The same with the grid shifted by half a block.
    pub constant_share_shifted: f64,
    /// Share of coefficients of high frequency (u + v ≥ 8) that are 0 to 1/16 unit.
    pub zero_share: f64,
    /// The share expected if they were as wide as those of low frequency.
    pub zero_share_expected: f64,
    /// Mean absolute difference of horizontal neighbours across the borders of blocks, over that inside. Fixed columns of period 8 count
    /// too, so it is no evidence alone. `None` where all blocks are of one value.
    pub border_ratio: Option<f64>,
    /// Its standard error for independent pixels.
    pub border_ratio_error: Option<f64>,
}

impl CompressionStatistics {
    /// Whether the frames were compressed: as rarely by chance as what is counted has to be.
    pub(crate) fn is_told(&self) -> bool {
        /// −ln of that probability.
        const SURPRISE: f64 = 12.0;
        -self.p_value.max(f64::MIN_POSITIVE).ln() > SURPRISE
    }
}

impl BlockDct {
    /// Nothing added yet. `unit_dn` sets the bins of the histograms, which reach to 256 units: the step of the counts as the first frame
    /// tells it, 1 where it is not known. Anything but a positive number counts as 1.
    #[must_use]
    pub fn new(unit_dn: f64) -> Self {
        let differences = [vec![0; DIFFERENCES], vec![0; DIFFERENCES]];
        let histograms = vec![0; BLOCK * BLOCK * BINS];
        let unit_dn = if unit_dn > 0.0 && unit_dn.is_finite() { unit_dn as f32 } else { 1.0 };
        let (constant_aligned, constant_shifted, constant_both) = (0, 0, 0);
        Self { unit_dn, histograms, blocks: 0, frames: 0, constant_aligned, constant_shifted, constant_both, compared: 0, differences }
    }

    /// Adds a frame: at most 4096 of its blocks, always the same ones, of which all pixels are usable. A frame of a wrong size is left out.
    pub fn add_frame(&mut self, pixels_dn: &[f32], width_px: usize, height_px: usize, usable: impl Fn(usize) -> bool) {
        if width_px.checked_mul(height_px) != Some(pixels_dn.len()) {
            return;
        }
        self.frames += 1;
        let (basis, unit_dn) = (basis(), self.unit_dn);
        let (columns, rows) = (width_px / BLOCK, height_px / BLOCK);
        let stride = (columns * rows).div_ceil(BLOCKS_PER_FRAME).max(1);
        let read = |left: usize, top: usize| {
            let mut block = [0.0_f64; BLOCK * BLOCK];
            for (index, value) in block.iter_mut().enumerate() {
                let place = (top + index / BLOCK) * width_px + left + index % BLOCK;
                *value = f64::from(pixels_dn[place] / unit_dn);
                if !usable(place) || !value.is_finite() {
                    return None;
                }
            }
            Some(block)
        };
        let ends = ends(pixels_dn, &usable).map(|end_dn| f64::from(end_dn / unit_dn));
        let is_mosaic = is_mosaic(pixels_dn, width_px, &usable);
        let constant = |block: &[f64; 64]| block.iter().all(|value| *value == block[0]);
        let votes = |block: &[f64; 64]| !ends.contains(&block[0]);
        for index in (0..columns * rows).step_by(stride) {
            let (left, top) = (index % columns * BLOCK, index / columns * BLOCK);
            let Some(block) = read(left, top) else { continue };
            self.add_block(&if is_mosaic { without_colours(&block) } else { block }, &basis);
            let half = BLOCK / 2;
            if left + half + BLOCK > width_px || top + half + BLOCK > height_px {
                continue;
            }
            if let Some(shifted) = read(left + half, top + half) {
                self.compared += 1;
                match (constant(&block), constant(&shifted)) {
                    (true, true) => self.constant_both += 1,
                    (true, false) if votes(&block) => self.constant_aligned += 1,
                    (false, true) if votes(&shifted) => self.constant_shifted += 1,
                    _ => {}
                }
            }
        }
        let per_bin = 4.0 / self.unit_dn;
        let mut before = None;
        for (index, &value) in pixels_dn.iter().enumerate() {
            let column = index % width_px;
            let value = (value.is_finite() && usable(index)).then_some(value);
            if let (Some(left), Some(right), 1..) = (before, value, column) {
                let bin = (f32::abs(right - left) * per_bin).round() as usize;
                self.differences[usize::from(column.is_multiple_of(BLOCK))][bin.min(DIFFERENCES - 1)] += 1;
            }
            before = value;
        }
    }

    fn add_block(&mut self, block: &[f64; 64], basis: &[[f64; BLOCK]; BLOCK]) {
        self.blocks += 1;
        let mut half = [[0.0; BLOCK]; BLOCK];
        for (line, out) in block.chunks_exact(BLOCK).zip(&mut half) {
            for (row, out) in basis.iter().zip(out) {
                *out = row.iter().zip(line).map(|(a, b)| a * b).sum();
            }
        }
        for (v, row) in basis.iter().enumerate() {
            for u in 0..BLOCK {
                let coefficient: f64 = row.iter().zip(&half).map(|(a, line)| a * line[u]).sum();
                let bin = (coefficient * BINS_PER_DN).round() + BINS as f64 / 2.0;
                let bin = bin.clamp(0.0, BINS as f64 - 1.0) as usize;
                let number = &mut self.histograms[(v * BLOCK + u) * BINS + bin];
                *number = number.saturating_add(1);
            }
        }
    }

    /// Adds what another one of the same unit has accumulated; one of another unit is left out.
    pub fn merge(&mut self, other: &Self) {
        if self.unit_dn != other.unit_dn {
            return;
        }
        for (mine, theirs) in self.histograms.iter_mut().zip(&other.histograms) {
            *mine = mine.saturating_add(*theirs);
        }
        self.blocks += other.blocks;
        self.frames += other.frames;
        self.constant_aligned += other.constant_aligned;
        self.constant_shifted += other.constant_shifted;
        self.constant_both += other.constant_both;
        self.compared += other.compared;
        for (mine, theirs) in self.differences.iter_mut().flatten().zip(other.differences.iter().flatten()) {
            *mine += theirs;
        }
    }

    /// What the coefficients say. `step_dn` is the step of the counts: 1 for whole counts, 16 for 12 bits × 16, 0 for counts not rounded.
    #[must_use]
    pub fn statistics(&self, step_dn: f64) -> CompressionStatistics {
        let unit_dn = f64::from(self.unit_dn);
        let mut result = self.in_units(step_dn / unit_dn);
        for value in [&mut result.quantiser_dn, &mut result.table_scale_dn, &mut result.table_scale_error_dn].into_iter().flatten() {
            *value *= unit_dn;
        }
        for comb in &mut result.combs {
            comb.quantiser_dn *= unit_dn;
            comb.quantiser_error_dn *= unit_dn;
        }
        result
    }

    /// The same with all counts in units instead of DN.
    fn in_units(&self, step_dn: f64) -> CompressionStatistics {
        let coefficients: Vec<Coefficient> = (0..BLOCK * BLOCK).filter_map(|index| self.coefficient(index)).collect();
        let smallest_dn = MIN_QUANTISER_DN.max(0.6 * step_dn);
        let scans: Vec<Scan> = parallel::map(&coefficients, |coefficient| coefficient.scan(smallest_dn, step_dn));
        let trials: f64 = scans.iter().map(|scan| scan.trials).sum();
        let combs: Vec<CoefficientComb> =
            coefficients.iter().zip(&scans).filter_map(|(coefficient, scan)| coefficient.comb(scan, trials, step_dn)).collect();
        let comb_p_value = scans.iter().map(|scan| trials * (-scan.score).exp()).fold(1.0, f64::min);
        let (scale, table_p_value) = table(&coefficients, smallest_dn, step_dn);
        let constant_p_value = self.constant_p_value();
        let p_value = (3.0 * comb_p_value.min(table_p_value).min(constant_p_value)).min(1.0);
        let mut ratios: Vec<f64> = combs.iter().map(|comb| comb.quantiser_dn / TABLE[comb.row * BLOCK + comb.column]).collect();
        ratios.sort_by(f64::total_cmp);
        let share = |number: u64| if self.compared > 0 { (number + self.constant_both) as f64 / self.compared as f64 } else { 0.0 };
        let constant_share = share(self.constant_aligned);
        let table_scale_dn = if table_p_value < TOLD { Some(scale) } else { ratios.get(ratios.len() / 2).copied() };
        let table_scale_dn = table_scale_dn.filter(|_| constant_share < 0.5);
        let scatter = |scale: f64| (ratios.iter().map(|ratio| (ratio / scale).ln().powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
        let told = combs.iter().map(|comb| comb.quantiser_dn).min_by(f64::total_cmp);
        let (zero_share, zero_share_expected) = zero_shares(&coefficients);
        let ratio = border_ratio(&self.differences);
        CompressionStatistics {
            frames: self.frames,
            blocks: self.blocks,
            block_px: (p_value < TOLD).then_some(BLOCK as u32),
            p_value,
            comb_p_value,
            table_p_value,
            constant_p_value,
            // The smallest entry of the table is 10.
            quantiser_dn: told.or(table_scale_dn.map(|scale| 10.0 * scale)),
            table_scale_dn,
            table_scale_error_dn: table_scale_dn.map(|scale| 0.01 * scale),
            table_scatter: table_scale_dn.filter(|_| ratios.len() > 1).map(scatter),
            combs,
            constant_share,
            constant_share_shifted: share(self.constant_shifted),
            zero_share,
            zero_share_expected,
            border_ratio: ratio.map(|(ratio, _)| ratio),
            border_ratio_error: ratio.map(|(_, error)| error),
        }
    }

    /// Hoeffding's bound for a fair choice between aligned and shifted. A still scene repeats its blocks, so the frames count as one.
    fn constant_p_value(&self) -> f64 {
        let (aligned, shifted) = (self.constant_aligned as f64, self.constant_shifted as f64);
        if aligned <= shifted { 1.0 } else { (-(aligned - shifted).powi(2) / (2.0 * (aligned + shifted)) / self.frames as f64).exp() }
    }

    fn coefficient(&self, index: usize) -> Option<Coefficient> {
        if [(0, 0), (0, 1), (1, 0), (0, 4), (4, 0), (4, 4)].contains(&(index / BLOCK, index % BLOCK)) {
            return None;
        }
        let histogram = &self.histograms[index * BINS..(index + 1) * BINS];
        let value_dn = |bin: usize| (bin as f64 - BINS as f64 / 2.0) / BINS_PER_DN;
        let values: Vec<(f64, f64)> =
            (1..BINS - 1).filter(|bin| histogram[*bin] > 0).map(|bin| (value_dn(bin), f64::from(histogram[bin]))).collect();
        let number: f64 = values.iter().map(|value| value.1).sum();
        let quantile = |share: f64| {
            let mut below = 0.0;
            let found = values.iter().find(|value| {
                below += value.1;
                below >= share * number
            });
            found.map(|value| value.0)
        };
        let (low, median_dn, high) = (quantile(0.1587)?, quantile(0.5)?, quantile(0.8413)?);
        Coefficient::new(index, values, [median_dn, (high - low) / 2.0], self.frames as f64)
    }
}

/// The lowest and the highest count of the usable pixels.
fn ends(pixels_dn: &[f32], usable: impl Fn(usize) -> bool) -> [f32; 2] {
    let all = pixels_dn.iter().enumerate().filter(|(index, value)| value.is_finite() && usable(*index));
    all.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], (_, value)| [low.min(*value), high.max(*value)])
}

/// A block less the means of the four places of its 2 × 2 cells.
fn without_colours(block: &[f64; 64]) -> [f64; 64] {
    let cell = |index: usize| index % 2 + 2 * (index / BLOCK % 2);
    let mut sums = [0.0; 4];
    for (index, value) in block.iter().enumerate() {
        sums[cell(index)] += value;
    }
    std::array::from_fn(|index| block[index] - sums[cell(index)] / 16.0)
}

/// Mean difference across borders over that inside, and its standard error. The largest hundredth, which is stars, is cut to one value.
fn border_ratio([inside, border]: &[Vec<u64>; 2]) -> Option<(f64, f64)> {
    let total: u64 = inside.iter().chain(border).sum();
    let mut below = 0;
    let cut = inside.iter().zip(border).position(|(a, b)| {
        below += a + b;
        below as f64 >= 0.99 * total as f64
    })?;
    let moments = |histogram: &[u64]| {
        let number = histogram.iter().sum::<u64>() as f64;
        let value = |bin: usize| bin.min(cut.max(1)) as f64;
        let mean = histogram.iter().enumerate().map(|(bin, times)| value(bin) * *times as f64).sum::<f64>() / number;
        let spread = histogram.iter().enumerate().map(|(bin, times)| (value(bin) - mean).powi(2) * *times as f64).sum::<f64>();
        (mean, spread / number / number)
    };
    let ((b, b_variance), (a, a_variance)) = (moments(inside), moments(border));
    let ratio = a / b;
    (ratio.is_finite()).then(|| (ratio, (a_variance + ratio * ratio * b_variance).sqrt() / b))
}

/// Share of coefficients of high frequency that are 0, and the share of zeros of low frequencies of the same density at 0 if Gaussian.
fn zero_shares(coefficients: &[Coefficient]) -> (f64, f64) {
    let high = |coefficient: &&Coefficient| coefficient.index / BLOCK + coefficient.index % BLOCK >= 8;
    let (mut zeros, mut number) = (0.0, 0.0);
    for coefficient in coefficients.iter().filter(high) {
        zeros += coefficient.values.iter().filter(|value| value.0 == 0.0).map(|value| value.1).sum::<f64>();
        number += coefficient.values.iter().map(|value| value.1).sum::<f64>();
    }
    let mut low: Vec<f64> = coefficients.iter().filter(|coefficient| !high(coefficient)).map(|coefficient| coefficient.core_dn).collect();
    low.sort_by(f64::total_cmp);
    let core_bins = low.get(low.len() / 2).map_or(0.0, |core_dn| core_dn * BINS_PER_DN);
    let expected = if core_bins > 0.5 { 1.0 / (core_bins * std::f64::consts::TAU.sqrt()) } else { 1.0 };
    (if number > 0.0 { zeros / number } else { 0.0 }, expected)
}

/// The orthonormal cosine transform: rows of frequency, columns of position.
fn basis() -> [[f64; BLOCK]; BLOCK] {
    let mut basis = [[0.0; BLOCK]; BLOCK];
    for (frequency, row) in basis.iter_mut().enumerate() {
        for (place, value) in row.iter_mut().enumerate() {
            let norm: f64 = if frequency == 0 { 0.125 } else { 0.25 };
            *value = norm.sqrt() * (std::f64::consts::PI * (2 * place + 1) as f64 * frequency as f64 / 16.0).cos();
        }
    }
    basis
}

#[cfg(test)]
#[path = "compression_tests.rs"]
mod tests;
