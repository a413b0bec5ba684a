//! Noise model of star positions: scale, floor and weight of the tails, by maximum likelihood from the residuals.
//!
//! The covariance of a star image is taken to be s·κ_h·(Σ_i + φ), Σ_i what its measurement and the catalogue state, κ_h the factor of a
//! frame that is worse than the others, φ a floor, s one factor; its error has a two-dimensional t distribution of ν degrees of freedom
//! with that scatter. s, φ and ν are those of greatest likelihood. So declared errors may be wrong by any factor, and every test here is
//! one of shape against the noise found, never one against the noise declared.

use nalgebra::{DMatrix, DVector};

use super::linear_system::WhitenedSystem;
use super::star_images::StarImages;
use crate::calibrate::{BundleImage, Column};
use crate::statistics::significance::neg_ln_chi2_sf;

/// Degrees of freedom tried; the last means normal errors.
const TAILS: &[f64] = &[3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 30.0, f64::INFINITY];
/// Floors tried, in units of the median stated variance.
const FLOORS: &[f64] = &[0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0];
/// Tails must gain so much in log-likelihood over normal errors.
const TAIL_GAIN: f64 = 4.0;
/// And a floor so much.
const FLOOR_GAIN: f64 = 2.0;
/// An image whose residual is larger is left to identification to explain, standard errors.
const GROSS: f64 = 20.0;

/// A frame is worse than the others if chance makes it so with less than this probability.
const WORSE_P: f64 = 1e-4;

/// The noise of all star images.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NoiseModel {
    /// s.
    pub(super) factor: f64,
    /// s·φ, px² per axis.
    pub(super) floor_px2: f64,
    /// ν.
    pub(super) tail_degrees: f64,
    /// κ of each frame taking part.
    pub(super) frame_factors: Vec<f64>,
}

impl NoiseModel {
    /// Before anything is known: the stated errors.
    pub(super) fn stated(frame_factors: Vec<f64>) -> Self {
        Self { factor: 1.0, floor_px2: 0.0, tail_degrees: 10.0, frame_factors }
    }

    /// Scatter of an image: xx, xy, yy, px².
    pub(super) fn scatter_px2(&self, image: &BundleImage, place: usize) -> [f64; 3] {
        let worse = self.frame_factors[place];
        let [xx, xy, yy] = image.stated_px2;
        let of = |variance: f64| (worse * (self.factor * variance + self.floor_px2)).max(1e-12);
        [of(xx), worse * self.factor * xy, of(yy)]
    }

    /// Standard error per axis (of the core of the distribution), px.
    pub(super) fn sigma_px(&self, image: &BundleImage, place: usize) -> f64 {
        let [xx, _, yy] = self.scatter_px2(image, place);
        f64::midpoint(xx, yy).sqrt()
    }

    /// L⁻¹ with L·Lᵀ the scatter: xx, yx, yy.
    pub(super) fn whitener(&self, image: &BundleImage, place: usize) -> [f64; 3] {
        let [xx, xy, yy] = self.scatter_px2(image, place);
        let l_xx = xx.sqrt();
        let l_yx = xy / l_xx;
        let l_yy = (yy - l_yx * l_yx).max(1e-6 * yy).sqrt();
        [1.0 / l_xx, -l_yx / (l_xx * l_yy), 1.0 / l_yy]
    }

    /// The noise of greatest likelihood. `residual_px` x, y, x, y, … of the images; `freedom` = degrees of freedom over numbers, by which the
    /// fit has made residuals smaller than errors.
    pub(super) fn find(
        images: &[BundleImage],
        place: &[usize],
        residual_px: &[f64],
        take: &[bool],
        freedom: f64,
        frame_factors: &[f64],
    ) -> Self {
        let taken: Vec<usize> = (0..images.len()).filter(|k| take[*k]).collect();
        let mut variances: Vec<f64> =
            taken.iter().map(|k| frame_factors[place[*k]] * f64::midpoint(images[*k].stated_px2[0], images[*k].stated_px2[2])).collect();
        let unit = crate::statistics::median_in_place(&mut variances).unwrap_or(1.0).max(1e-12);
        let mut best: Option<(f64, Self)> = None;
        for &relative in FLOORS {
            let floor = relative * unit;
            // Squares and log-determinants for s = 1.
            let model = Self { factor: 1.0, floor_px2: floor, tail_degrees: 1.0, frame_factors: frame_factors.to_vec() };
            let terms =
                taken.iter().map(|k| square_and_log(&model, &images[*k], place[*k], [residual_px[2 * k], residual_px[2 * k + 1]], freedom));
            let squares = Squares::new(&terms.collect::<Vec<_>>());
            for &tail_degrees in TAILS {
                let (scale, likelihood) = squares.scale(tail_degrees);
                let penalty = if tail_degrees.is_finite() { TAIL_GAIN } else { 0.0 } + if relative > 0.0 { FLOOR_GAIN } else { 0.0 };
                let value = likelihood - penalty;
                if best.as_ref().is_none_or(|(most, _)| value > *most) {
                    let model = Self { factor: scale, floor_px2: scale * floor, tail_degrees, frame_factors: frame_factors.to_vec() };
                    best = Some((value, model));
                }
            }
        }
        best.map_or_else(|| Self::stated(frame_factors.to_vec()), |(_, model)| model)
    }

    /// Which images take part: all but those that are no images of their stars.
    pub(super) fn plausible(&self, images: &[BundleImage], place: &[usize], residual_px: &[f64]) -> Vec<bool> {
        let of = |k: usize| {
            let white = apply(self.whitener(&images[k], place[k]), [residual_px[2 * k], residual_px[2 * k + 1]]);
            let q = white[0] * white[0] + white[1] * white[1];
            q.is_finite() && q < GROSS * GROSS
        };
        (0..images.len()).map(of).collect()
    }

    /// What whitens each image.
    pub(super) fn whiteners(&self, images: &[BundleImage], place: &[usize]) -> Vec<[f64; 3]> {
        images.iter().zip(place).map(|(image, place)| self.whitener(image, *place)).collect()
    }

    /// Whitened numbers back in px.
    pub(super) fn unwhiten(&self, images: &[BundleImage], place: &[usize], white: &[f64]) -> Vec<f64> {
        let mut out = Vec::with_capacity(white.len());
        for k in 0..images.len() {
            let [a, b, c] = self.whitener(&images[k], place[k]);
            let x = white[2 * k] / a;
            out.extend([x, (white[2 * k + 1] - b * x) / c]);
        }
        out
    }
}

/// A column whitened.
pub(super) fn whitened(whiteners: &[[f64; 3]], column: &Column) -> Vec<f64> {
    let mut white = vec![0.0; 2 * column.len()];
    for ((white, whitener), value) in white.chunks_exact_mut(2).zip(whiteners).zip(column) {
        white.copy_from_slice(&apply(*whitener, *value));
    }
    white
}

fn apply(whitener: [f64; 3], [x, y]: [f64; 2]) -> [f64; 2] {
    [whitener[0] * x, whitener[1] * x + whitener[2] * y]
}

fn square_and_log(model: &NoiseModel, image: &BundleImage, place: usize, residual: [f64; 2], freedom: f64) -> [f64; 2] {
    let [xx, xy, yy] = model.scatter_px2(image, place);
    let [x, y] = apply(model.whitener(image, place), residual);
    [(x * x + y * y) / freedom, (xx * yy - xy * xy).max(1e-30).ln()]
}

/// Squares of residuals under s = 1, without gross errors.
struct Squares {
    start: f64,
    used: Vec<f64>,
    logs: f64,
}

impl Squares {
    fn new(terms: &[[f64; 2]]) -> Self {
        let mut squares: Vec<f64> = terms.iter().map(|[q, _]| *q).collect();
        let median = crate::statistics::median_in_place(&mut squares).unwrap_or(1.0);
        let start = (median / (2.0 * std::f64::consts::LN_2)).max(1e-12);
        let cut = GROSS * GROSS * start;
        let kept = || terms.iter().filter(|[q, _]| *q < cut);
        Self { start, used: kept().map(|[q, _]| *q).collect(), logs: kept().map(|[_, log]| log).sum() }
    }

    /// s of greatest likelihood and its log-likelihood.
    fn scale(&self, tail_degrees: f64) -> (f64, f64) {
        let count = self.used.len().max(1) as f64;
        let mut scale = self.start;
        for _ in 0..12 {
            let sum = sum_of(&self.used, |q| crate::statistics::student_t::weight(tail_degrees, q / scale) * q);
            let next = (sum / (2.0 * count)).max(1e-12);
            let settled = (next / scale - 1.0).abs() < 1e-4;
            scale = next;
            if settled {
                break;
            }
        }
        let body = if tail_degrees.is_finite() {
            // A logarithm of a product for many numbers: none is above 1 + GROSS²·start/(s·ν), so that sixteen stay far from overflow.
            let logs = self.used.chunks(16).map(|part| part.iter().map(|q| 1.0 + q / (scale * tail_degrees)).product::<f64>().ln());
            0.5 * (tail_degrees + 2.0) * logs.sum::<f64>()
        } else {
            0.5 * self.used.iter().sum::<f64>() / scale
        };
        (scale, -0.5 * self.logs - self.used.len() as f64 * scale.ln() - body)
    }
}

/// A sum in four parts, which the processor adds at once.
fn sum_of(values: &[f64], of: impl Fn(f64) -> f64) -> f64 {
    let mut sums = [0.0; 4];
    let parts = values.chunks_exact(4);
    let rest: f64 = parts.remainder().iter().map(|value| of(*value)).sum();
    for part in parts {
        for (sum, value) in sums.iter_mut().zip(part) {
            *sum += of(*value);
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// Degrees of freedom over numbers.
pub(super) fn freedom(system: &WhitenedSystem, take: &[bool], shared: usize) -> f64 {
    let taken = take.iter().filter(|take| **take).count() as f64;
    let mut seen = vec![false; system.frames];
    for (frame, _) in system.frame.iter().zip(take).filter(|(_, take)| **take) {
        seen[*frame] = true;
    }
    let own = (system.own.len() * seen.iter().filter(|seen| **seen).count()) as f64;
    ((2.0 * taken - own - shared as f64) / (2.0 * taken).max(1.0)).clamp(0.05, 1.0)
}

/// Variance factors of frames that the joint solution found to be worse than the others: how large they are once a smooth field of the
/// frame's own is taken out. What is worse in a frame by a displacement is a mismatch, and only what scatters is noise.
pub(super) fn frame_factors(stars: &StarImages, solved: &[f64], floor_px2: f64) -> Vec<f64> {
    let places: Vec<[f64; 2]> = stars.predicted_px(super::star_images::REACH_PX).collect();
    let largest = places.iter().flatten().fold(1.0_f64, |most, value| most.max(value.abs()));
    let scatter = |frame: usize| -> Option<[f64; 2]> {
        let own: Vec<usize> = (0..places.len()).filter(|k| stars.place[*k] == frame).collect();
        let fields = 12 + stars.own.len();
        (2 * own.len() > fields + 8).then_some(())?;
        let mut matrix = DMatrix::zeros(2 * own.len(), fields);
        let mut right = DVector::zeros(2 * own.len());
        for (row, k) in own.iter().enumerate() {
            let [xx, _, yy] = stars.images[*k].stated_px2;
            let root = 1.0 / (f64::midpoint(xx, yy) + floor_px2).max(1e-12).sqrt();
            let [x, y] = places[*k].map(|value| 2.0 * value / largest - 1.0);
            for axis in 0..2 {
                for (column, value) in [1.0, x, y, x * x, x * y, y * y].into_iter().enumerate() {
                    matrix[(2 * row + axis, 6 * axis + column)] = root * value;
                }
                for (column, own) in stars.own.iter().enumerate() {
                    let scale = 1.0 / own.iter().flatten().fold(1e-300_f64, |most, value| most.max(value.abs()));
                    matrix[(2 * row + axis, 12 + column)] = root * own[*k][axis] * scale;
                }
                right[2 * row + axis] = root * stars.residual_px[2 * k + axis];
            }
        }
        let factors = matrix.col_piv_qr();
        let (q, r) = (factors.q(), factors.r());
        let kept = (0..r.nrows()).take_while(|k| r[(*k, *k)].abs() > 1e-9 * r[(0, 0)].abs()).count();
        let mut rest = right;
        for column in 0..kept {
            let along = q.column(column).dot(&rest);
            rest -= q.column(column) * along;
        }
        // By the median: wrong stars are no reason to call a frame noisy.
        let mut squares: Vec<f64> = rest.as_slice().chunks_exact(2).map(|pair| pair[0] * pair[0] + pair[1] * pair[1]).collect();
        let freedom = (2 * own.len() - kept) as f64 / (2 * own.len()) as f64;
        let median = crate::statistics::median_in_place(&mut squares)?;
        Some([median / (2.0 * std::f64::consts::LN_2 * freedom), (2 * own.len() - kept) as f64])
    };
    if solved.iter().all(|factor| *factor <= 1.0) {
        return solved.to_vec();
    }
    let all: Vec<Option<[f64; 2]>> = (0..stars.frames.len()).map(scatter).collect();
    let mut levels: Vec<f64> = all.iter().flatten().map(|[level, _]| *level).collect();
    let Some(usual) = crate::statistics::median_in_place(&mut levels).filter(|usual| *usual > 0.0) else {
        return solved.to_vec();
    };
    let of = |(frame, found): (usize, &Option<[f64; 2]>)| match (solved[frame], found) {
        (factor, _) if factor <= 1.0 => 1.0,
        (factor, None) => factor,
        (_, Some([level, degrees])) => {
            let ratio = level / usual;
            // A median knows as much as half as many numbers.
            let surprise = neg_ln_chi2_sf(0.5 * degrees, 0.5 * degrees * ratio);
            if (-surprise).exp() < WORSE_P { ratio } else { 1.0 }
        }
    };
    all.iter().enumerate().map(of).collect()
}
