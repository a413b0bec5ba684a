//! How large residuals are expected to be, and which of them belong to wrong identifications.
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

/// A frame is taken for worse than the others if its own χ² has less than this probability.
const FRAME_PROBABILITY: f64 = 1e-4;
/// The median of r²/σ² for a normal residual in two dimensions, 2·ln 2.
const MEDIAN_SQUARE: f64 = 2.0 * std::f64::consts::LN_2;
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
        Whitened { inverse, square, weight: right / sum, cost: (l_xx * l_yy).ln() - sum.ln() }
    }
}

/// One star image's part in finding the noise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Which exposure.
    pub(super) exposure: usize,
    /// Stated variance per axis (mean of the two), the catalogue's error included, px².
    pub(super) stated_px2: f64,
    /// x² + y², px².
    pub(super) square_px2: f64,
    /// Probability of being right.
    pub(super) weight: f64,
}

impl Noise {
    /// Finds the noise anew from residuals and weights. `lost` is the number of parameters that the residuals have been fitted with.
    /// With `robust` the scale comes from the median: it is not led astray by wrong images that still have weight.
    pub(super) fn update(&mut self, samples: &[Sample], lost: usize, frames_lost: &[usize], robust: bool) {
        let right: f64 = samples.iter().map(|sample| sample.weight).sum();
        if samples.is_empty() || right < 1.0 {
            return;
        }
        let count = samples.len() as f64;
        let (right_in_all, images) = (right + self.before.weight(), count + self.before.images);
        self.wrong_share = (1.0 - right_in_all / images).clamp(SMALLEST_WRONG.max(0.5 / images).min(0.1), LARGEST_WRONG);
        // Residuals are smaller than errors by what the fit has taken.
        let freedom = ((2.0 * right_in_all - lost as f64 - self.before.lost) / (2.0 * right_in_all)).clamp(0.05, 1.0);
        self.floor_px2 = if robust {
            self.floor_from_median(samples, freedom).min(self.floor_by_likelihood(samples, freedom))
        } else {
            self.floor_by_likelihood(samples, freedom)
        };
        self.update_frames(samples, frames_lost);
        let mut wrong: Vec<f64> = samples.iter().filter(|sample| sample.weight < 0.5).map(|sample| sample.square_px2.sqrt()).collect();
        if wrong.len() >= 5 {
            wrong.sort_by(f64::total_cmp);
            self.wrong_radius_px = 1.5 * wrong[wrong.len() / 2];
        }
        let typical = samples.iter().map(|sample| sample.stated_px2).sum::<f64>() / count + self.floor_px2;
        self.wrong_radius_px = self.wrong_radius_px.max(20.0 * typical.sqrt());
    }

    /// τ² so that the median of r²/(σ² + τ²) is that of a normal residual.
    fn floor_from_median(&self, samples: &[Sample], freedom: f64) -> f64 {
        let excess = |floor: f64| {
            let mut ratios: Vec<f64> = samples
                .iter()
                .filter(|sample| sample.weight > 0.5)
                .map(|sample| sample.square_px2 / freedom / (self.frame_factors[sample.exposure] * (sample.stated_px2 + floor)))
                .collect();
            if ratios.is_empty() {
                return 0.0;
            }
            let middle = ratios.len() / 2;
            let (_, median, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
            *median / MEDIAN_SQUARE - 1.0
        };
        root(excess, samples, self.before.largest_square_px2())
    }

    /// τ² of greatest likelihood: Σ w·(r²/v − 2)/v = 0 with v = σ² + τ².
    fn floor_by_likelihood(&self, samples: &[Sample], freedom: f64) -> f64 {
        let score = |floor: f64| {
            let of = |sample: &Sample| {
                let factor = self.frame_factors[sample.exposure];
                let variance = sample.stated_px2 + floor;
                sample.weight * (sample.square_px2 / (freedom * factor * variance) - 2.0) / variance
            };
            samples.iter().map(of).sum::<f64>() + self.before.score(floor, freedom)
        };
        root(score, samples, self.before.largest_square_px2())
    }

    /// κ: one, unless a frame's χ² says otherwise; then the ratio itself.
    fn update_frames(&mut self, samples: &[Sample], frames_lost: &[usize]) {
        let mut sums = vec![[0.0, 0.0]; self.frame_factors.len()];
        for sample in samples {
            let [square, weight] = &mut sums[sample.exposure];
            *square += sample.weight * sample.square_px2 / (sample.stated_px2 + self.floor_px2);
            *weight += sample.weight;
        }
        for (exposure, [square, weight]) in sums.into_iter().enumerate() {
            let degrees = 2.0 * weight - frames_lost[exposure] as f64;
            if degrees < 1.0 {
                continue;
            }
            let improbable = ChiSquared::new(degrees).is_ok_and(|chi| chi.sf(square) < FRAME_PROBABILITY);
            self.frame_factors[exposure] = if improbable { square / degrees } else { 1.0 };
        }
    }
}

/// Where a falling function of τ² becomes zero; zero if it begins below. `largest` is the largest mean square seen elsewhere.
fn root(score: impl Fn(f64) -> f64, samples: &[Sample], largest: f64) -> f64 {
    const HALVINGS: usize = 40;
    if score(0.0) <= 0.0 {
        return 0.0;
    }
    let mut high = samples.iter().map(|sample| sample.square_px2).fold(largest, f64::max).max(1e-12);
    let mut low = high * 1e-12;
    if score(high) > 0.0 {
        return high;
    }
    // In the logarithm: noise spans many decades between the first guess and the end.
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if score(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
        if high / low < 1.0 + 1e-4 {
            break;
        }
    }
    (low * high).sqrt()
}
