//! Noise model of the bundle adjustment: a mixture of right identifications with normal errors and wrong ones, solved by expectation–maximisation.
//!
//! A star image is right with probability 1 − π: then its residual is normal with the covariance that the measurement states, the
//! catalogue's own error, and a floor τ² that all images share (what centroids have beyond their photon noise), times a factor for
//! frames that are clearly worse than the others (trailed, out of focus). Or it is wrong: then its residual falls anywhere in a disc.
//!
//! ```text
//! p(r) = (1 − π)·N(r; 0, κ_h·(Σ_i + σ_cat² + τ²)) + π/(π_c·R²),   weight = probability that the image is right
//! ```
//! The weights are those of the expectation–maximisation algorithm; as a function of r they redescend to zero (a wrong star does not
//! pull at all) and are one within four standard errors (a right star loses nothing). π, τ, R and κ are found from the residuals
//! themselves. Source: Dempster, Laird and Rubin, J. R. Stat. Soc. B 39, 1 (1977); for mixtures in image matching: Hartley and
//! Zisserman, Multiple View Geometry (2004), section 4.7; MLESAC, Torr and Zisserman, CVIU 78, 138 (2000).

use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::memory::NoiseMemory;
use super::problem::Image;
use crate::parallel;

/// A frame is taken for worse than the others if its own χ² has less than this probability.
const FRAME_PROBABILITY: f64 = 1e-4;
/// Star images from which the median is taken, and the likelihood: more would tell the floor no better than it is needed.
const ENOUGH_FOR_MEDIAN: usize = 4096;
const ENOUGH_FOR_LIKELIHOOD: usize = 65_536;
/// The median of r²/σ² for a normal residual in two dimensions, 2·ln 2.
const MEDIAN_SQUARE: f64 = 2.0 * std::f64::consts::LN_2;
/// The floor is found to this relative precision.
const TOLERANCE: f64 = 1e-4;
/// The share of wrong identifications is never taken to be below this: a single one must be found among thousands.
const SMALLEST_WRONG: f64 = 1e-3;
/// Nor above this.
const LARGEST_WRONG: f64 = 0.9;

/// The noise of all star images.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Noise {
    /// τ², px² per axis.
    pub(in crate::calibrate) floor_px2: f64,
    /// π.
    pub(in crate::calibrate) wrong_share: f64,
    /// R, px.
    pub(in crate::calibrate) wrong_radius_px: f64,
    /// κ of each exposure.
    pub(in crate::calibrate) frame_factors: Vec<f64>,
    /// Focal length: what turns the catalogue's errors into pixels.
    pub(in crate::calibrate) focal_length_px: f64,
    /// Star images of earlier solutions, which have their say in what the noise is.
    pub(in crate::calibrate) before: NoiseMemory,
    /// χ² of the residuals per degree of freedom: by how much the variances are larger than those stated, and below one if the stated
    /// ones are too large (the floor cannot be negative). What is known beforehand in its own unit counts so much more against them.
    pub(in crate::calibrate) unit_variance: f64,
}

/// A residual whitened.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whitened {
    /// L⁻¹ with L·Lᵀ the covariance: xx, yx, yy.
    pub(super) inverse: [f64; 3],
    /// rᵀΣ⁻¹r.
    pub(super) square: f64,
    /// Probability that the identification is right.
    pub(super) weight: f64,
    /// −ln p(r) without constants.
    pub(super) cost: f64,
}

impl Noise {
    /// Covariance of a right image's residual, xx, xy, yy.
    pub(in crate::calibrate) fn covariance_px2(&self, exposure: usize, image: &Image) -> [f64; 3] {
        let factor = self.frame_factors[exposure];
        let [xx, xy, yy] = image.covariance_px2;
        let common = self.floor_px2 + (image.catalog_sigma_rad * self.focal_length_px).powi(2);
        [factor * (xx + common), factor * xy, factor * (yy + common)]
    }

    /// Whitens a residual and weighs it.
    pub(super) fn whiten(&self, exposure: usize, image: &Image, residual: [f64; 2]) -> Whitened {
        let [xx, xy, yy] = self.covariance_px2(exposure, image);
        let l_xx = xx.max(f64::MIN_POSITIVE).sqrt();
        let l_yx = xy / l_xx;
        let l_yy = (yy - l_yx * l_yx).max(f64::MIN_POSITIVE).sqrt();
        let inverse = [1.0 / l_xx, -l_yx / (l_xx * l_yy), 1.0 / l_yy];
        let (u, v) = (inverse[0] * residual[0], inverse[1] * residual[0] + inverse[2] * residual[1]);
        let square = u * u + v * v;
        // Relative to the density of a right image at its centre, so that the cost of a perfect image is that of its share alone.
        let right = (1.0 - self.wrong_share) * (-0.5 * square).exp();
        let wrong = self.wrong_share * 2.0 * l_xx * l_yy / (self.wrong_radius_px * self.wrong_radius_px);
        let sum = right + wrong;
        Whitened { inverse, square, weight: right / sum, cost: (l_xx * l_yy / sum).ln() }
    }
}

/// One star image's part in finding the noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Stated variance per axis (mean of the two), the catalogue's error included, px².
    pub(super) stated_px2: f64,
    /// x² + y², px².
    pub(super) square_px2: f64,
    /// Probability of being right.
    pub(super) weight: f64,
}

/// Sums over samples.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Totals {
    /// How many.
    pub(super) count: usize,
    /// How many are more probably right than wrong.
    pub(super) right: usize,
    /// Σ w.
    pub(super) weight: f64,
    /// Σ σ², px².
    pub(super) stated_px2: f64,
    /// Largest x² + y², px².
    pub(super) largest_square_px2: f64,
}

impl Totals {
    /// Adds a sample.
    pub(super) fn add(&mut self, sample: &Sample) {
        self.count += 1;
        self.right += usize::from(sample.weight > 0.5);
        self.weight += sample.weight;
        self.stated_px2 += sample.stated_px2;
        self.largest_square_px2 = self.largest_square_px2.max(sample.square_px2);
    }

    /// Adds the sums over other samples.
    pub(super) fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.right += other.right;
        self.weight += other.weight;
        self.stated_px2 += other.stated_px2;
        self.largest_square_px2 = self.largest_square_px2.max(other.largest_square_px2);
    }
}

impl Noise {
    /// Finds the noise anew from residuals and weights, by exposure, and their sums. `lost` is the number of parameters that the residuals
    /// have been fitted with. With `robust` the scale comes from the median: it is not led astray by wrong images that still have weight.
    pub(super) fn update(&mut self, samples: &[Vec<Sample>], totals: &Totals, lost: usize, frames_lost: &[usize], robust: bool) {
        let right = totals.weight;
        if totals.count == 0 || right < 1.0 {
            return;
        }
        let count = totals.count as f64;
        let (right_in_all, images) = (right + self.before.weight(), count + self.before.images);
        self.wrong_share = (1.0 - right_in_all / images).clamp(SMALLEST_WRONG.max(0.5 / images).min(0.1), LARGEST_WRONG);
        // Residuals are smaller than errors by what the fit has taken.
        let freedom = ((2.0 * right_in_all - lost as f64 - self.before.lost) / (2.0 * right_in_all)).clamp(0.05, 1.0);
        let largest = totals.largest_square_px2.max(self.before.largest_square_px2());
        let likely = self.floor_by_likelihood(&self.every(samples, totals, ENOUGH_FOR_LIKELIHOOD), freedom, largest);
        self.floor_px2 = if robust {
            likely.min(self.floor_from_median(&self.every(samples, totals, ENOUGH_FOR_MEDIAN), freedom, largest))
        } else {
            likely
        };
        self.update_frames(samples, frames_lost);
        if totals.count >= totals.right + 5 {
            let is_wrong = |sample: &&Sample| sample.weight <= 0.5;
            let mut wrong: Vec<f64> = samples.iter().flatten().filter(is_wrong).map(|sample| sample.square_px2).collect();
            let middle = wrong.len() / 2;
            self.wrong_radius_px = 1.5 * wrong.select_nth_unstable_by(middle, f64::total_cmp).1.sqrt();
        }
        let typical = totals.stated_px2 / count + self.floor_px2;
        self.wrong_radius_px = self.wrong_radius_px.max(20.0 * typical.sqrt());
    }

    /// Every k-th sample so that about `enough` are left, their squares for κ = 1, and k.
    fn every(&self, samples: &[Vec<Sample>], totals: &Totals, enough: usize) -> (Vec<Sample>, f64) {
        let every = totals.count.div_ceil(enough).max(1);
        let mut chosen = Vec::with_capacity(totals.count / every + 1);
        let mut skip = 0;
        for (own, factor) in samples.iter().zip(&self.frame_factors) {
            let like_others = |sample: &Sample| Sample { square_px2: sample.square_px2 / factor, ..*sample };
            chosen.extend(own.iter().skip(skip).step_by(every).map(like_others));
            // Counted through all frames.
            skip = if own.len() > skip { (every - (own.len() - skip) % every) % every } else { skip - own.len() };
        }
        (chosen, every as f64)
    }

    /// τ² so that the median of r²/(σ² + τ²) is that of a normal residual.
    fn floor_from_median(&self, (samples, _): &(Vec<Sample>, f64), freedom: f64, largest: f64) -> f64 {
        let right: Vec<&Sample> = samples.iter().filter(|sample| sample.weight > 0.5).collect();
        if right.is_empty() {
            return 0.0;
        }
        let mut ratios = vec![0.0; right.len()];
        let excess = |floor: f64| {
            for (ratio, sample) in ratios.iter_mut().zip(&right) {
                *ratio = sample.square_px2 / (freedom * (sample.stated_px2 + floor));
            }
            let (_, median, _) = ratios.select_nth_unstable_by(right.len() / 2, f64::total_cmp);
            *median / MEDIAN_SQUARE - 1.0
        };
        root(excess, self.floor_px2, largest)
    }

    /// τ² of greatest likelihood: Σ w·(r²/v − 2)/v = 0 with v = σ² + τ².
    fn floor_by_likelihood(&self, (samples, every): &(Vec<Sample>, f64), freedom: f64, largest: f64) -> f64 {
        let score = |floor: f64| {
            let of = |sample: &Sample| {
                let variance = sample.stated_px2 + floor;
                sample.weight * (sample.square_px2 / (freedom * variance) - 2.0) / variance
            };
            every * samples.iter().map(of).sum::<f64>() + self.before.score(floor, freedom)
        };
        root(score, self.floor_px2, largest)
    }

    /// κ: one, unless a frame's χ² says otherwise; then the ratio itself.
    fn update_frames(&mut self, samples: &[Vec<Sample>], frames_lost: &[usize]) {
        let floor = self.floor_px2;
        let factor = |(samples, lost): (&Vec<Sample>, &usize)| {
            let (mut square, mut weight) = (0.0, 0.0);
            for sample in samples {
                square += sample.weight * sample.square_px2 / (sample.stated_px2 + floor);
                weight += sample.weight;
            }
            let degrees = 2.0 * weight - *lost as f64;
            if degrees < 1.0 {
                return None;
            }
            // Nothing within three standard deviations is that improbable: the usual frame costs no special function.
            let far = square - degrees > 3.0 * (2.0 * degrees).sqrt();
            let improbable = far && ChiSquared::new(degrees).is_ok_and(|chi| chi.sf(square) < FRAME_PROBABILITY);
            Some(if improbable { square / degrees } else { 1.0 })
        };
        let found: Vec<Option<f64>> = parallel::map_numbers(samples.len(), |number| factor((&samples[number], &frames_lost[number])));
        for (factor, found) in self.frame_factors.iter_mut().zip(found) {
            *factor = found.unwrap_or(*factor);
        }
    }
}

/// Where a falling function of τ² becomes zero; zero if it begins below. `guess` is where it may be, `largest` the largest mean square seen.
fn root(mut score: impl FnMut(f64) -> f64, guess: f64, largest: f64) -> f64 {
    const STEPS: usize = 60;
    const WIDEST: f64 = 1e-12;
    if score(0.0) <= 0.0 {
        return 0.0;
    }
    let most = largest.max(1e-12);
    let least = most * WIDEST;
    // In the logarithm: noise spans many decades between the first guess and the end. The bracket is looked for about the guess.
    let begin = guess.clamp(least, most);
    let at_begin = score(begin);
    let (mut low, mut high) = ((begin, at_begin), (begin, at_begin));
    let mut factor = 1.5;
    while at_begin > 0.0 && high.1 > 0.0 {
        if high.0 >= most {
            return most;
        }
        low = high;
        let next = (high.0 * factor).min(most);
        high = (next, score(next));
        factor *= factor;
    }
    while at_begin <= 0.0 && low.1 <= 0.0 {
        if low.0 <= least {
            return least;
        }
        high = low;
        let next = (low.0 / factor).max(least);
        low = (next, score(next));
        factor *= factor;
    }
    // Regula falsi (Illinois), with a halving where it does not get on.
    let mut was_low = None;
    for step in 0..STEPS {
        let width = (high.0 / low.0).ln();
        if width < TOLERANCE {
            break;
        }
        let edge = 0.25 * TOLERANCE / width;
        let share = if step % 4 == 3 { 0.5 } else { (low.1 / (low.1 - high.1)).clamp(edge, 1.0 - edge) };
        let middle = low.0 * (share * width).exp();
        let value = score(middle);
        let is_low = value > 0.0;
        // An end that stays twice counts half, so that it is left behind.
        let stays = if was_low == Some(is_low) { 0.5 } else { 1.0 };
        if is_low {
            low = (middle, value);
            high.1 *= stays;
        } else {
            high = (middle, value);
            low.1 *= stays;
        }
        was_low = Some(is_low);
    }
    (low.0 * high.0).sqrt()
}
