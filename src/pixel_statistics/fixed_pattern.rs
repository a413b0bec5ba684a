//! Fixed pattern, hot and dead pixels, pixels that jump: what stays with the pixel while the sky moves on.
//!
//! Frames of different pointings are held against each other pixel by pixel, each in units of its own noise. For a pixel with the values z_f the
//! expectation of (Σz)² − Σz² is zero without a pattern, and n(n − 1) times the variance of the pattern with one. A pattern of sensitivity
//! (PRNU) grows with the light, one of dark current (DSNU) with the exposure.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lines::{Estimate, FrameLines};
use super::sky_pixels::{BLOCK_PX, SkyPixels};
use crate::parallel;

/// Values are kept in steps of 1/16 standard deviation, up to eight of them.
const STEPS: f32 = 16.0;
const NOT_KEPT: i8 = i8::MIN;
/// Fewer frames of different pointings tell nothing.
pub(super) const MIN_FRAMES: usize = 3;
/// Frames share a pointing where more than this share of their bright stars coincide, within this distance, px.
const SAME_SHARE: f64 = 0.3;
const SAME_PX: f32 = 2.0;
/// Bright stars that are compared.
pub(super) const BRIGHT_STARS: usize = 40;
/// A pixel whose mean is off by so many standard errors is hot, or dead.
const DEFECT_SIGMAS: f64 = 6.5;
/// Frames that tell of jumping pixels.
const MIN_JUMP_FRAMES: usize = 8;
/// A pixel jumps where its variance in time is above chance with this probability, its highest value left out.
const JUMP_P: f64 = 1e-9;
/// Of the variance of single pixels, plane and means of lines leave this share.
const KEPT_BY_PLANE: f64 = 1.0 - 5.0 / (BLOCK_PX * BLOCK_PX) as f64;

/// A frame in units of its own noise.
#[derive(Clone, Debug)]
pub(super) struct PatternFrame {
    pub(super) frame: usize,
    /// Level of the sky, DN.
    pub(super) level_dn: f64,
    /// Noise of a sky pixel, DN.
    pub(super) sigma_dn: f64,
    /// Means over the sky of 1/V, L/V and L²/V: variance of a pixel V, DN², level L, DN.
    over_variance: [f64; 3],
    /// Exposure, s, where known.
    pub(super) exposure_s: Option<f64>,
    width_px: usize,
    values: Vec<i8>,
    /// Places of the brightest stars.
    bright_px: Vec<[f32; 2]>,
}

impl PatternFrame {
    pub(super) fn new(
        frame: usize,
        sky: &SkyPixels,
        lines: &FrameLines,
        exposure_s: Option<f64>,
        bright_px: Vec<[f32; 2]>,
    ) -> Option<Self> {
        let sigma_dn = sky.sigma_dn().filter(|sigma| *sigma > 0.0)?;
        let levels: Vec<f64> = sky.blocks.iter().map(|block| block.level_dn).collect();
        let level_dn = crate::statistics::median(&levels)?;
        let mut values = vec![NOT_KEPT; sky.residual_dn.len()];
        let (mut over_variance, mut pixels) = ([0.0; 3], 0.0);
        for block in &sky.blocks {
            let own = block.pixels as f64;
            pixels += own;
            for (power, sum) in (0..).zip(&mut over_variance) {
                *sum += own * block.level_dn.powi(power) / block.variance_dn2.max(1e-12);
            }
            let by_sigma = STEPS / block.variance_dn2.sqrt().max(1e-6) as f32;
            for y in block.place[1] * BLOCK_PX..(block.place[1] + 1) * BLOCK_PX {
                for x in block.place[0] * BLOCK_PX..(block.place[0] + 1) * BLOCK_PX {
                    let index = y * sky.width_px + x;
                    let residual = sky.residual_dn[index];
                    if !residual.is_nan() {
                        let rest = residual - lines.of_pixel([x, y]);
                        let by_sigma = by_sigma / sky.cell_noise[x % 2 + 2 * (y % 2)] as f32;
                        values[index] = (rest * by_sigma).round().clamp(-127.0, 127.0) as i8;
                    }
                }
            }
        }
        let over_variance = over_variance.map(|sum| sum / pixels.max(1.0));
        Some(Self { frame, level_dn, sigma_dn, over_variance, exposure_s, width_px: sky.width_px, values, bright_px })
    }

    /// Root of the mean square, in units of the noise at each place, of a pattern that is as large as the level above the bias, and of one of 1 DN.
    fn of_patterns(&self, bias_dn: f64) -> [f64; 2] {
        let [one, level, square] = self.over_variance;
        [(square - 2.0 * bias_dn * level + bias_dn * bias_dn * one).max(0.0).sqrt(), one.sqrt()]
    }

    fn shares_pointing(&self, other: &Self) -> bool {
        let near = |star: &&[f32; 2]| other.bright_px.iter().any(|known| (known[0] - star[0]).hypot(known[1] - star[1]) < SAME_PX);
        let fewest = self.bright_px.len().min(other.bright_px.len());
        // Two frames without stars may be of one field or not: they are taken as one, which tells nothing.
        fewest == 0 || self.bright_px.iter().filter(near).count() as f64 > SAME_SHARE * fewest as f64
    }

    /// Value of a pixel in standard deviations.
    pub(super) fn value(&self, index: usize) -> Option<f64> {
        // Beside the last row there is nothing.
        self.values.get(index).filter(|value| **value != NOT_KEPT).map(|value| f64::from(f32::from(*value) / STEPS))
    }

    /// Value of a pixel in standard deviations, 0 where it is not known.
    pub(super) fn deviation(&self, index: usize) -> f64 {
        self.value(index).unwrap_or(0.0)
    }

    /// Of frames of one size, in their order, the places of those of which no two share a pointing.
    pub(super) fn places_of_different(frames: &[&Self]) -> Vec<usize> {
        let mut chosen: Vec<usize> = Vec::new();
        for (place, frame) in frames.iter().enumerate() {
            if !chosen.iter().any(|known| frames[*known].shares_pointing(frame)) {
                chosen.push(place);
            }
        }
        chosen
    }

    /// Columns and rows.
    pub(super) fn size_px(&self) -> [usize; 2] {
        [self.width_px, self.values.len() / self.width_px.max(1)]
    }
}

/// Two frames of different pointings held against each other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PatternPair {
    /// Numbers of the frames.
    pub frames: [usize; 2],
    /// Mean product of the pixels' deviations, each in units of its frame's noise.
    pub covariance: Estimate,
    /// What a pattern of light of unit relative variance would make of it, where a bias is known.
    pub by_light: Option<f64>,
    /// What a pattern of 1 DN per second (per frame, where no exposure is known) would make of it.
    pub by_exposure: f64,
}

/// What stays with the pixels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FixedPattern {
    /// Frames of different pointings that were compared.
    pub frames: usize,
    /// Pixels that at least three of them show.
    pub pixels: usize,
    /// Variance of the pattern over that of the noise of one frame, hot and dead pixels left out.
    pub share: Option<Estimate>,
    /// Standard deviation of the pattern, DN, at the mean level.
    pub sigma_dn: Option<f64>,
    /// Mean level of the sky, DN.
    pub level_dn: f64,
    /// Variance of a pattern that grows with the light: squared share of the level above the bias, where a bias is known. Free of what
    /// does not, if levels differ enough.
    pub by_light: Option<Estimate>,
    /// Variance of a pattern that grows with the exposure, DN² (per s² where exposures are known).
    pub by_exposure: Option<Estimate>,
    /// Cosine of the two: above 0.99 they are not told apart.
    pub light_exposure_cosine: Option<f64>,
    /// Pixels far above the others.
    pub hot: usize,
    /// Pixels far below the others.
    pub dead: usize,
    /// Pixels that jump from frame to frame (random telegraph noise); nothing with too few frames.
    pub jumping: Option<usize>,
    /// Frame against frame.
    pub pairs: Vec<PatternPair>,
}

/// Those of the frames, in their order, of which no two share a pointing.
fn different(frames: &[PatternFrame]) -> Vec<&PatternFrame> {
    let mut chosen: Vec<&PatternFrame> = Vec::new();
    for frame in frames {
        if frame.values.len() == frames[0].values.len() && !chosen.iter().any(|known| known.shares_pointing(frame)) {
            chosen.push(frame);
        }
    }
    chosen
}

/// Sums over the pixels.
#[derive(Clone, Copy, Default)]
struct Sums {
    pixels: usize,
    plain: [f64; 2],
    /// Of values weighted by light and by exposure: Σ[(Σwz)² − Σw²z²], and the same of each pattern of unit variance.
    weighted: [f64; 2],
    response: [[f64; 2]; 2],
    noise: [f64; 2],
    hot: usize,
    dead: usize,
    jumping: usize,
}

impl Sums {
    fn add(mut self, other: Self) -> Self {
        let add = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        self.pixels += other.pixels;
        self.plain = add(self.plain, other.plain);
        self.weighted = add(self.weighted, other.weighted);
        self.response = [add(self.response[0], other.response[0]), add(self.response[1], other.response[1])];
        self.noise = add(self.noise, other.noise);
        self.hot += other.hot;
        self.dead += other.dead;
        self.jumping += other.jumping;
        self
    }
}

impl FixedPattern {
    /// Of the frames kept. `bias_dn`: the count of no light, where known. `are_timed`: whether the exposures of all frames of the recording are known, those
    /// that are not kept among them. Seconds and frames are no one unit: where a single exposure is not known all count as frames.
    pub(super) fn of(frames: &[PatternFrame], bias_dn: Option<f64>, are_timed: bool) -> Self {
        let chosen = if frames.is_empty() { Vec::new() } else { different(frames) };
        if chosen.len() < MIN_FRAMES {
            return Self { frames: chosen.len(), ..Self::default() };
        }
        let count = chosen.len() as f64;
        let mean = |value: &dyn Fn(&PatternFrame) -> f64| chosen.iter().map(|frame| value(frame)).sum::<f64>() / count;
        let (level_dn, sigma_dn) = (mean(&|frame| frame.level_dn), mean(&|frame| frame.sigma_dn));
        let time = |frame: &PatternFrame| frame.exposure_s.filter(|_| are_timed).unwrap_or(1.0);
        // A pattern of light moves a pixel by share · (level − bias)/σ, one of exposure by DN · t/σ: sky and noise are another at the corners, and of halves
        // that differ in their gains.
        let weight = |frame: &&PatternFrame| {
            let [by_light, by_count] = frame.of_patterns(bias_dn.unwrap_or(0.0));
            [by_light, time(frame) * by_count]
        };
        let weights: Vec<[f64; 2]> = chosen.iter().map(weight).collect();
        let first = sums(&chosen, &weights, 0.0);
        let share = first.plain[0] / first.plain[1].max(1.0) / KEPT_BY_PLANE;
        // A pattern lets ordinary pixels lie farther out.
        let all = sums(&chosen, &weights, share.max(0.0));
        if all.plain[1] <= 0.0 {
            return Self { frames: chosen.len(), ..Self::default() };
        }
        let plain = Estimate { value: all.plain[0] / all.plain[1] / KEPT_BY_PLANE, sigma: (2.0 / all.plain[1]).sqrt() / KEPT_BY_PLANE };
        let [by_light, by_exposure, cosine] = split(&all);
        Self {
            frames: chosen.len(),
            pixels: all.pixels,
            share: Some(plain),
            sigma_dn: Some(plain.value.max(0.0).sqrt() * sigma_dn),
            level_dn,
            by_light: by_light.filter(|_| bias_dn.is_some()),
            by_exposure,
            light_exposure_cosine: cosine.map(|cosine| cosine.value),
            hot: all.hot,
            dead: all.dead,
            jumping: (chosen.len() >= MIN_JUMP_FRAMES).then_some(all.jumping),
            pairs: pairs(&chosen, &weights, share.max(0.0), bias_dn.is_some()),
        }
    }
}

/// Every frame against every other, defects left out.
fn pairs(chosen: &[&PatternFrame], weights: &[[f64; 2]], share: f64, is_bias_known: bool) -> Vec<PatternPair> {
    let pixels = chosen[0].values.len();
    let is_ordinary: Vec<bool> = (0..pixels).into_par_iter().map(|index| of_pixel(chosen, weights, share, index).plain[1] > 0.0).collect();
    let both: Vec<(usize, usize)> = (0..chosen.len()).flat_map(|a| (a + 1..chosen.len()).map(move |b| (a, b))).collect();
    let of = |(a, b): &(usize, usize)| -> Option<PatternPair> {
        let (mut sum, mut count) = (0_i64, 0_u32);
        for ((one, other), is_ordinary) in chosen[*a].values.iter().zip(&chosen[*b].values).zip(&is_ordinary) {
            if *is_ordinary && *one != NOT_KEPT && *other != NOT_KEPT {
                sum += i64::from(*one) * i64::from(*other);
                count += 1;
            }
        }
        let count = f64::from(count);
        (count > 0.0).then(|| PatternPair {
            frames: [chosen[*a].frame, chosen[*b].frame],
            covariance: Estimate {
                value: sum as f64 / (count * f64::from(STEPS * STEPS)) / KEPT_BY_PLANE,
                sigma: count.sqrt().recip() / KEPT_BY_PLANE,
            },
            by_light: is_bias_known.then(|| weights[*a][0] * weights[*b][0]),
            by_exposure: weights[*a][1] * weights[*b][1],
        })
    };
    parallel::map(&both, of).into_iter().flatten().collect()
}

/// Pixels in chunks: sums of floats in one order at any number of threads.
fn sums(chosen: &[&PatternFrame], weights: &[[f64; 2]], share: f64) -> Sums {
    const CHUNK: usize = 1 << 15;
    let pixels = chosen[0].values.len();
    let chunks: Vec<usize> = (0..pixels).step_by(CHUNK).collect();
    let of_chunk = |start: &usize| {
        (*start..(start + CHUNK).min(pixels)).fold(Sums::default(), |sums, index| sums.add(of_pixel(chosen, weights, share, index)))
    };
    parallel::map(&chunks, of_chunk).into_iter().fold(Sums::default(), Sums::add)
}

fn of_pixel(chosen: &[&PatternFrame], weights: &[[f64; 2]], share: f64, index: usize) -> Sums {
    let (mut n, mut sum, mut square, mut highest) = (0.0, 0.0, 0.0, f64::NEG_INFINITY);
    let mut weighted = [(0.0, 0.0); 2];
    let (mut w2, mut w4, mut cross) = ([0.0; 2], [0.0; 2], (0.0, 0.0));
    for (frame, weight) in chosen.iter().zip(weights) {
        let Some(z) = frame.value(index) else { continue };
        (n, sum, square, highest) = (n + 1.0, sum + z, square + z * z, z.max(highest));
        for k in 0..2 {
            let value = weight[k] * z;
            weighted[k] = (weighted[k].0 + value, weighted[k].1 + value * value);
            let own = weight[k] * weight[k];
            (w2[k], w4[k]) = (w2[k] + own, w4[k] + own * own);
        }
        let both = weight[0] * weight[1];
        cross = (cross.0 + both, cross.1 + both * both);
    }
    let mut sums = Sums::default();
    if n < MIN_FRAMES as f64 {
        return sums;
    }
    sums.pixels = 1;
    sums.jumping = usize::from(n >= MIN_JUMP_FRAMES as f64 && is_jumping(n, sum, square, highest));
    if sums.jumping > 0 {
        return sums;
    }
    let deviation = sum / (n * (1.0 + (n - 1.0) * share)).sqrt();
    if deviation.abs() > DEFECT_SIGMAS {
        sums.hot = usize::from(deviation > 0.0);
        sums.dead = usize::from(deviation < 0.0);
        return sums;
    }
    sums.plain = [sum * sum - square, n * (n - 1.0)];
    sums.weighted = weighted.map(|(sum, square)| sum * sum - square);
    let mixed = cross.0 * cross.0 - cross.1;
    sums.response = [[w2[0] * w2[0] - w4[0], mixed], [mixed, w2[1] * w2[1] - w4[1]]];
    sums.noise = [2.0 * sums.response[0][0], 2.0 * sums.response[1][1]];
    sums
}

/// Whether a pixel varies in time beyond chance, its highest value (a cosmic ray) left out.
fn is_jumping(n: f64, sum: f64, square: f64, highest: f64) -> bool {
    let (n, sum, square) = (n - 1.0, sum - highest, square - highest * highest);
    let chi2 = square - sum * sum / n;
    // Quick refusal: chi-squared beyond this is rarer than one in a billion for any number of frames kept.
    chi2 > 3.0 * n && crate::statistics::significance::neg_ln_chi2_sf(n - 1.0, chi2) > -JUMP_P.ln()
}

/// The variances of both patterns at once, with the cosine of the two.
fn split(sums: &Sums) -> [Option<Estimate>; 3] {
    let [[a, m], [_, b]] = sums.response;
    let cosine = m / (a * b).sqrt();
    if !cosine.is_finite() {
        return [None; 3];
    }
    let alone = |k: usize, response: f64| Estimate {
        value: sums.weighted[k] / response / KEPT_BY_PLANE,
        sigma: sums.noise[k].sqrt() / response / KEPT_BY_PLANE,
    };
    let cosine_told = Some(Estimate { value: cosine, sigma: 0.0 });
    if cosine > 0.99 {
        return [Some(alone(0, a)), Some(alone(1, b)), cosine_told];
    }
    let determinant = a * b - m * m;
    let value = [(b * sums.weighted[0] - m * sums.weighted[1]) / determinant, (a * sums.weighted[1] - m * sums.weighted[0]) / determinant];
    // The two sums share the same noise with the correlation of the patterns.
    let covariance = 2.0 * m;
    let error = |p: f64, q: f64, own: f64, other: f64| {
        ((p * p * own + q * q * other - 2.0 * p * q * covariance).max(0.0)).sqrt() / determinant.abs() / KEPT_BY_PLANE
    };
    [
        Some(Estimate { value: value[0] / KEPT_BY_PLANE, sigma: error(b, m, sums.noise[0], sums.noise[1]) }),
        Some(Estimate { value: value[1] / KEPT_BY_PLANE, sigma: error(a, m, sums.noise[1], sums.noise[0]) }),
        cosine_told,
    ]
}
