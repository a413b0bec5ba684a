//! Photon transfer: variance of sky pixels against their level gives the gain.
//!
//! V = m/g + c with c = σ_r² − b/g + q²/12: level m, gain g (electrons per count), read noise σ_r and bias b, in counts, step of the codes q. The
//! slope is the gain alone; the intercept is one number for two, so read noise and bias are told apart only where one of them is known
//! (J. R. Janesick, Photon Transfer, SPIE 2007, chapter 5).
//!
//! The q²/12 of rounding holds of noise that reaches over the steps. Of noise of σ = 0.4 q the variance of the counts swings with the place of the level
//! between two codes from 0.21 to 0.28 q², of 0.3 q from 0.10 to 0.25 q², and a line through such points has a slope of its own, with a small error. From
//! 0.6 q on it swings by 0.3 %. So points of less noise take no part.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sky_pixels::Block;
use super::star_transfer::StarTransfer;
use crate::statistics::median;
use crate::statistics::order::sort_by;

/// Groups of blocks of like level that are kept of a frame.
const GROUPS: usize = 12;
/// A group has at least so many blocks.
const MIN_BLOCKS: usize = 12;
/// Blocks whose variance lies farther from the group's median than this many of their standard errors hold stars that were not found.
const CLIP_SIGMAS: f64 = 3.5;
/// A block that lies so many standard errors above the surface of all levels may hold a star.
const MAX_ABOVE_SIGMAS: f64 = 1.5;
/// A gain is told where the slope is at least so many of its standard errors.
const MIN_SLOPE_SIGMAS: f64 = 5.0;
/// Noise in steps of the codes from which on rounding adds q²/12, whatever the level.
const MIN_SIGMA_STEPS: f64 = 0.6;
/// Groups that the line leaves farther than this many standard errors take no part.
const OUTLIER_SIGMAS: f64 = 4.0;

/// Level and variance of sky pixels of like level in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TransferPoint {
    /// Number of the frame in the recording.
    pub frame: usize,
    /// Level, DN.
    pub level_dn: f64,
    /// Variance of a pixel, DN².
    pub variance_dn2: f64,
    /// Its standard error.
    pub sigma_dn2: f64,
    /// Sky pixels.
    pub pixels: usize,
}

impl TransferPoint {
    /// Whether the noise is wide enough for its variance not to hang on the place of the level between two codes.
    pub(crate) fn is_wider_than_rounding(&self, step_dn: f64) -> bool {
        self.variance_dn2 > (MIN_SIGMA_STEPS * MIN_SIGMA_STEPS + 1.0 / 12.0) * step_dn * step_dn
    }
}

/// The points of a frame: its blocks in groups of like level. The level is that of a smooth surface through all blocks: a block with a star that
/// was not found has a higher level of its own and more variance, and would tilt the line. Such blocks are left out by their level, of which the
/// variance of normal noise is independent.
pub(super) fn points(frame: usize, blocks: &[Block], shape: [usize; 2]) -> Vec<TransferPoint> {
    let Some(surface) = smooth_levels(blocks, shape) else { return Vec::new() };
    let is_dark =
        |(block, level): &(&Block, f64)| block.level_dn - level < MAX_ABOVE_SIGMAS * (block.variance_dn2 / block.pixels as f64).sqrt();
    let mut sorted: Vec<(&Block, f64)> = blocks.iter().zip(surface).filter(is_dark).collect();
    sort_by(&mut sorted, |a, b| a.1.total_cmp(&b.1).then(a.0.place.cmp(&b.0.place)));
    let groups = (sorted.len() / MIN_BLOCKS).clamp(1, GROUPS);
    let size = sorted.len().div_ceil(groups).max(1);
    sorted.chunks(size).filter(|group| group.len() >= MIN_BLOCKS).filter_map(|group| point(frame, group)).collect()
}

/// The level of every block on a polynomial of the third degree through all of them, stars given little weight.
pub(super) fn smooth_levels(blocks: &[Block], shape: [usize; 2]) -> Option<Vec<f64>> {
    const TERMS: usize = 10;
    const TURNS: usize = 6;
    let rows: Vec<[f64; TERMS]> = blocks
        .iter()
        .map(|block| {
            let [u, v] = [0, 1].map(|axis| 2.0 * (block.place[axis] as f64 + 0.5) / shape[axis].max(1) as f64 - 1.0);
            [1.0, u, v, u * u, u * v, v * v, u * u * u, u * u * v, u * v * v, v * v * v]
        })
        .collect();
    if blocks.len() < 2 * TERMS {
        return None;
    }
    let offset = blocks[0].level_dn;
    let mut weights = vec![1.0; blocks.len()];
    let mut levels = Vec::new();
    for _ in 0..TURNS {
        let mut normal = nalgebra::SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = nalgebra::SVector::<f64, TERMS>::zeros();
        for ((row, block), weight) in rows.iter().zip(blocks).zip(&weights) {
            let row = nalgebra::SVector::<f64, TERMS>::from_column_slice(row);
            normal += row * row.transpose() * *weight;
            right += row * ((block.level_dn - offset) * weight);
        }
        // A hair of ridge: blocks may lie along a line.
        normal += nalgebra::SMatrix::identity() * (1e-9 * normal.trace());
        let solved = normal.cholesky()?.solve(&right);
        levels = rows.iter().map(|row| offset + row.iter().zip(solved.iter()).map(|(a, b)| a * b).sum::<f64>()).collect();
        let rest: Vec<f64> = blocks.iter().zip(&levels).map(|(block, level)| block.level_dn - level).collect();
        let scale = crate::statistics::mad_sigma(&rest)?.max(1e-9);
        weights = rest.iter().map(|rest| (1.0 + (rest / scale).powi(2)).recip()).collect();
    }
    Some(levels)
}

/// Mean variance of a group, blocks beyond chance left out.
fn point(frame: usize, group: &[(&Block, f64)]) -> Option<TransferPoint> {
    let relative = |block: &Block| (2.0 / block.pixels as f64).sqrt();
    let typical = median(&group.iter().map(|(block, _)| block.variance_dn2).collect::<Vec<_>>())?;
    // Clipping is about the median, on one side as on the other: what is left of chi-squared noise keeps its mean to a part in a thousand.
    let kept: Vec<&(&Block, f64)> =
        group.iter().filter(|(block, _)| (block.variance_dn2 - typical).abs() < CLIP_SIGMAS * relative(block) * typical).collect();
    let pixels: usize = kept.iter().map(|(block, _)| block.pixels).sum();
    if kept.len() * 2 < group.len() || typical <= 0.0 {
        return None;
    }
    let mean = |value: fn(&(&Block, f64)) -> f64| kept.iter().map(|own| value(own) * own.0.pixels as f64).sum::<f64>() / pixels as f64;
    let variance_dn2 = mean(|(block, _)| block.variance_dn2);
    Some(TransferPoint {
        frame,
        level_dn: mean(|(_, level)| *level),
        variance_dn2,
        sigma_dn2: variance_dn2 * (2.0 / pixels as f64).sqrt(),
        pixels,
    })
}

/// What the sky tells of gain, read noise and bias.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PhotonTransfer {
    /// Electrons per count; nothing where levels differ too little to tell.
    pub gain_e_per_dn: Option<f64>,
    /// Its standard error.
    pub gain_sigma: Option<f64>,
    /// Slope of variance against level, DN.
    pub slope_dn: f64,
    /// Its standard error.
    pub slope_sigma_dn: f64,
    /// Variance at the level zero of the counts, DN²: that of reading, less the photons of a level as high as the bias, and that of rounding.
    pub intercept_dn2: f64,
    /// Its standard error.
    pub intercept_sigma_dn2: f64,
    /// Covariance of slope and intercept, DN³.
    pub covariance_dn3: f64,
    /// Curvature: variance per squared count. Positive for pixels of unequal response, negative for charge that spreads.
    pub curvature: f64,
    /// Its standard error.
    pub curvature_sigma: f64,
    /// χ² of the line per degree of freedom; standard errors are larger by its root where it is above one.
    pub chi2_per_dof: f64,
    /// Step of the codes, DN.
    pub step_dn: f64,
    /// Lowest and highest level of the points, DN.
    pub levels_dn: [f64; 2],
    /// Points that take part.
    pub points: usize,
    /// What the stars tell, where no gain is declared and enough of them were kept.
    pub stars: Option<StarTransfer>,
}

impl PhotonTransfer {
    /// The line through the points of all frames; nothing with fewer than three.
    pub(super) fn fitted(points: &[TransferPoint], step_dn: f64) -> Option<Self> {
        let points: Vec<&TransferPoint> = points.iter().filter(|point| point.is_wider_than_rounding(step_dn)).collect();
        let mut used = points.clone();
        let mut line = Line::through(&used, 1)?;
        for _ in 0..8 {
            let scale = line.chi2_per_dof().max(1.0).sqrt();
            let kept: Vec<&TransferPoint> =
                points.iter().copied().filter(|point| line.rest(point).abs() < OUTLIER_SIGMAS * scale * line.sigma(point)).collect();
            // Weights follow the line, not the point's own variance: a point that is low by chance would else count for more.
            let again = Line::weighted(&kept, 1, Some(&line))?;
            let is_settled = kept.len() == used.len() && (again.value[1] - line.value[1]).abs() < 1e-9 * line.value[1].abs();
            (used, line) = (kept, again);
            if is_settled {
                break;
            }
        }
        let scale = line.chi2_per_dof().max(1.0);
        let square = Line::weighted(&used, 2, Some(&line)).filter(|_| used.len() > 3);
        let (slope, slope_sigma) = (line.value[1], (line.covariance[(1, 1)] * scale).sqrt());
        let is_told = slope > MIN_SLOPE_SIGMAS * slope_sigma;
        let [intercept, intercept_variance, covariance] = line.at_zero();
        let level = |pick: fn(f64, f64) -> f64, start: f64| used.iter().map(|point| point.level_dn).fold(start, pick);
        Some(Self {
            gain_e_per_dn: is_told.then(|| 1.0 / slope),
            gain_sigma: is_told.then(|| slope_sigma / (slope * slope)),
            slope_dn: slope,
            slope_sigma_dn: slope_sigma,
            intercept_dn2: intercept,
            intercept_sigma_dn2: (intercept_variance * scale).sqrt(),
            covariance_dn3: covariance * scale,
            curvature: square.as_ref().map_or(0.0, |square| square.value[2]),
            curvature_sigma: square.map_or(f64::INFINITY, |square| (square.covariance[(2, 2)] * square.chi2_per_dof().max(1.0)).sqrt()),
            chi2_per_dof: line.chi2_per_dof(),
            step_dn,
            levels_dn: [level(f64::min, f64::INFINITY), level(f64::max, f64::NEG_INFINITY)],
            points: used.len(),
            stars: None,
        })
    }

    /// The line without its gain, where the noise of the pixels is not as the light made it.
    pub(crate) fn without_gain(self) -> Self {
        Self { gain_e_per_dn: None, gain_sigma: None, ..self }
    }

    /// Read noise in electrons for a gain and a bias, with its standard error from the line; nothing where the line leaves less than none.
    #[must_use]
    pub fn read_noise_e(&self, bias_dn: f64) -> Option<(f64, f64)> {
        let gain = self.gain_e_per_dn?;
        let variance_dn2 = self.intercept_dn2 + self.slope_dn * bias_dn - self.step_dn * self.step_dn / 12.0;
        let variance_e2 = variance_dn2 * gain * gain;
        // σ_r² = g²c + g·b: its change with intercept and slope at once.
        let by_intercept = gain * gain;
        let by_slope = gain * gain * bias_dn - 2.0 * gain * variance_e2;
        let error2 = by_intercept.powi(2) * self.intercept_sigma_dn2.powi(2)
            + by_slope.powi(2) * self.slope_sigma_dn.powi(2)
            + 2.0 * by_intercept * by_slope * self.covariance_dn3;
        (variance_e2 > 0.0).then(|| (variance_e2.sqrt(), error2.max(0.0).sqrt() / (2.0 * variance_e2.sqrt())))
    }

    /// Bias in counts for a read noise in electrons, with its standard error from the line.
    #[must_use]
    pub fn bias_dn(&self, read_noise_e: f64) -> Option<(f64, f64)> {
        let gain = self.gain_e_per_dn?;
        let variance_dn2 = (read_noise_e / gain).powi(2) + self.step_dn * self.step_dn / 12.0;
        let bias_dn = (variance_dn2 - self.intercept_dn2) / self.slope_dn;
        let by_intercept = -1.0 / self.slope_dn;
        // (σ_r·s)² has the slope in it too.
        let by_slope = (2.0 * read_noise_e * read_noise_e * self.slope_dn - bias_dn) / self.slope_dn;
        let error2 = by_intercept.powi(2) * self.intercept_sigma_dn2.powi(2)
            + by_slope.powi(2) * self.slope_sigma_dn.powi(2)
            + 2.0 * by_intercept * by_slope * self.covariance_dn3;
        Some((bias_dn, error2.max(0.0).sqrt()))
    }
}

/// A weighted polynomial of variance in the level, about the mean level.
struct Line {
    middle_dn: f64,
    value: nalgebra::DVector<f64>,
    covariance: nalgebra::DMatrix<f64>,
    chi2: f64,
    dof: usize,
}

impl Line {
    fn through(points: &[&TransferPoint], degree: usize) -> Option<Self> {
        Self::weighted(points, degree, None)
    }

    fn weighted(points: &[&TransferPoint], degree: usize, about: Option<&Self>) -> Option<Self> {
        let count = degree + 1;
        if points.len() <= count {
            return None;
        }
        let pixels: f64 = points.iter().map(|point| point.pixels as f64).sum();
        let middle_dn = points.iter().map(|point| point.level_dn * point.pixels as f64).sum::<f64>() / pixels;
        let sigma = |point: &TransferPoint| about.map_or(point.sigma_dn2, |line| line.sigma(point));
        let mut normal = nalgebra::DMatrix::zeros(count, count);
        let mut right = nalgebra::DVector::zeros(count);
        let row = |point: &TransferPoint| {
            let off = point.level_dn - middle_dn;
            nalgebra::DVector::from_iterator(count, std::iter::successors(Some(1.0), |power| Some(power * off)).take(count))
        };
        for point in points {
            let weight = sigma(point).powi(-2);
            let row = row(point);
            normal += &row * row.transpose() * weight;
            right += row * (point.variance_dn2 * weight);
        }
        // Columns of like size: powers of a level differ by orders of magnitude.
        let scale: Vec<f64> = (0..count).map(|k| normal[(k, k)].sqrt()).collect();
        if scale.iter().any(|scale| !(*scale > 0.0 && scale.is_finite())) {
            return None;
        }
        let scaled = nalgebra::DMatrix::from_fn(count, count, |a, b| normal[(a, b)] / (scale[a] * scale[b]));
        let inverse = scaled.cholesky()?.inverse();
        let covariance = nalgebra::DMatrix::from_fn(count, count, |a, b| inverse[(a, b)] / (scale[a] * scale[b]));
        let value = &covariance * right;
        let rest = |point: &&TransferPoint| ((point.variance_dn2 - row(point).dot(&value)) / sigma(point)).powi(2);
        let chi2 = points.iter().map(rest).sum();
        Some(Self { middle_dn, value, covariance, chi2, dof: points.len() - count })
    }

    fn at(&self, level_dn: f64) -> f64 {
        self.value.iter().rev().fold(0.0, |sum, value| sum * (level_dn - self.middle_dn) + value)
    }

    fn rest(&self, point: &TransferPoint) -> f64 {
        point.variance_dn2 - self.at(point.level_dn)
    }

    /// Standard error of a point's variance if the line is right.
    fn sigma(&self, point: &TransferPoint) -> f64 {
        self.at(point.level_dn).max(0.1 * point.variance_dn2) * (2.0 / point.pixels as f64).sqrt()
    }

    fn chi2_per_dof(&self) -> f64 {
        self.chi2 / self.dof as f64
    }

    /// Value at the level zero, its variance, and its covariance with the slope.
    fn at_zero(&self) -> [f64; 3] {
        let (m, c) = (self.middle_dn, &self.covariance);
        let value = self.value[0] - self.value[1] * m;
        let variance = c[(0, 0)] - 2.0 * m * c[(0, 1)] + m * m * c[(1, 1)];
        [value, variance, c[(0, 1)] - m * c[(1, 1)]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::significance::normal_cdf;

    /// Level and variance of whole counts of normal noise.
    fn rounded(level_dn: f64, sigma_dn: f64) -> [f64; 2] {
        let share = |code: f64| normal_cdf((code + 0.5 - level_dn) / sigma_dn) - normal_cdf((code - 0.5 - level_dn) / sigma_dn);
        let codes: Vec<f64> = (90..=110).map(f64::from).collect();
        let mean = codes.iter().map(|code| code * share(*code)).sum::<f64>();
        [mean, codes.iter().map(|code| (code - mean).powi(2) * share(*code)).sum()]
    }

    fn line(sigma_dn: f64) -> Option<PhotonTransfer> {
        let point = |k: usize| {
            let ([level_dn, variance_dn2], pixels) = (rounded(100.0 + 0.05 * k as f64, sigma_dn), 40_000);
            TransferPoint { frame: k, level_dn, variance_dn2, sigma_dn2: variance_dn2 * (2.0 / pixels as f64).sqrt(), pixels }
        };
        PhotonTransfer::fitted(&(0..10).map(point).collect::<Vec<_>>(), 1.0)
    }

    /// Noise that does not change with the level tells no gain, however narrow it is.
    #[test]
    fn rounding_is_no_gain() {
        assert!(line(0.3).is_none() && line(0.4).is_none());
        for sigma_dn in [0.65, 1.2] {
            assert!(line(sigma_dn).is_some_and(|line| line.gain_e_per_dn.is_none()), "{sigma_dn}");
        }
    }
}
