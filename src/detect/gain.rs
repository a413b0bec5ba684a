//! Photon noise without a declared gain: variance of the counts per count of light, from the residuals of the stars themselves.
//!
//! Where real images differ from the Gaussian by more than photons scatter, the value found stands for that misfit too: it is then
//! larger than 1 / gain, and the errors stated with it are honest for such images, not a measure of the detector.
//!
//! The fit takes up part of the noise (with a star one pixel wide, most of it), so residuals are compared with what the fit
//! leaves of a given noise: for weighted least squares with hat matrix H, E r_i² = Σ_j (δ_ij − H_ij)² v_j.

use super::fit::{Fit, Freedom};
use super::image_model::Model;
use super::stamp::Scene;
use crate::statistics::cholesky::inverse;
use crate::statistics::order::ascending;

/// Stars fainter than this tell nothing, brighter than that tell more of the Gaussian's misfit than of photons.
const SNR_RANGE: (f64, f64) = (8.0, 60.0);
const MIN_STARS: usize = 5;
const MAX_STARS: usize = 100;
/// Far out, since few residuals make up a star's and their squares are skewed.
const OUTLIER_SIGMA: f64 = 7.0;

/// What one star tells.
#[derive(Default)]
pub(super) struct GainStatistics {
    /// Σ r² m less what noise without photons leaves, and the same per unit of the sought value.
    excess: f64,
    per_unit: f64,
    /// Variance of the first as a polynomial in the sought value.
    variance: [f64; 3],
}

impl GainStatistics {
    /// A pixel of so much light: what is left of it, and the variance expected of that without photons, and with them per unit of the sought value.
    pub(super) fn add(&mut self, light: f64, rest: f64, quiet: f64, lit: f64) {
        self.excess += light * (rest * rest - quiet);
        self.per_unit += light * lit;
        for (term, add) in self.variance.iter_mut().zip([quiet * quiet, 2.0 * quiet * lit, lit * lit]) {
            *term += light * light * add;
        }
    }

    pub(super) fn is_telling(&self) -> bool {
        self.per_unit > 0.0
    }

    fn value(&self) -> f64 {
        self.excess / self.per_unit
    }

    fn sigma(&self, value: f64) -> f64 {
        let [a, b, c] = self.variance;
        (2.0 * (a + b * value + c * value * value)).sqrt() / self.per_unit
    }
}

/// One star to learn from: where to fit it, what is free, and the light of its neighbours.
pub(super) struct Sample {
    pub(super) start: Model,
    pub(super) snr: f64,
    pub(super) freedom: Freedom,
    pub(super) neighbours: Vec<Model>,
}

/// Estimates the variance per count; 0 where nothing tells. `until`: the part of the work on the frame by which it is to end.
pub(super) fn variance_per_dn(scene: &Scene<'_>, samples: &[Sample], until: f64) -> f64 {
    let mut chosen: Vec<&Sample> = samples.iter().filter(|s| s.snr > SNR_RANGE.0 && s.snr < SNR_RANGE.1).collect();
    if chosen.len() < MIN_STARS {
        chosen = samples.iter().filter(|s| s.snr > SNR_RANGE.0).collect();
        ascending(&mut chosen, |a| a.snr);
    }
    // spread over the list, not its first
    let step = chosen.len().div_ceil(MAX_STARS).max(1);
    let chosen: Vec<&Sample> = chosen.into_iter().step_by(step).collect();
    let mut value = 0.0;
    // the better the weights of the fits, the better their residuals tell
    for _ in 0..2 {
        let scene = Scene { variance_per_dn: value, ..*scene };
        let told = scene.work.each(&chosen, until, |s| {
            let fit = scene.fit(s.start, s.freedom, &s.neighbours).filter(|f| !f.edge && f.lone_pixel_excess > 0.0)?;
            scene.influence(&fit, s.freedom, &s.neighbours)
        });
        value = pooled(&told.into_iter().flatten().flatten().collect::<Vec<_>>(), value);
    }
    value
}

/// The value that all stars tell together, near `start`.
pub(super) fn pooled(told: &[GainStatistics], start: f64) -> f64 {
    let mut value = start;
    // weights need the value: a few rounds, leaving out stars (doubles, galaxies) whose residuals are beyond chance
    for round in 0..6 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for t in told {
            let sigma = t.sigma(value);
            if round > 1 && t.value() - value > OUTLIER_SIGMA * sigma {
                continue;
            }
            sum += t.value() / (sigma * sigma);
            weights += 1.0 / (sigma * sigma);
        }
        if weights <= 0.0 {
            return 0.0;
        }
        value = (sum / weights).max(0.0);
    }
    value
}

impl Scene<'_> {
    fn influence(&self, fit: &Fit, freedom: Freedom, neighbours: &[Model]) -> Option<GainStatistics> {
        /// What a pixel's part in the rest of another costs.
        const PAIR_NS: u64 = 8;
        let mut profile = self.profile();
        let stamp = self.stamp(Model { x: fit.model.x, y: fit.model.y, ..fit.model }, neighbours, &mut profile);
        let count = freedom.parameters();
        profile.draw(stamp.window, &fit.model, freedom == Freedom::Ellipse);
        let rows: Vec<[f64; 7]> = (0..stamp.data.len()).map(|i| profile.row(i, fit.model.flux_dn)).collect();
        let normal = self.photons().normal(&stamp, &profile, fit.model.flux_dn, fit.offset_dn, count);
        let covariance = inverse(&normal.matrix, count)?;
        let signal: Vec<f64> = profile.value.iter().map(|p| p * fit.model.flux_dn).collect();
        let least = 0.01 * signal.iter().copied().fold(0.0, f64::max);
        let lit = stamp.used.iter().zip(&signal).filter(|(used, signal)| **used && **signal > least).count();
        self.work.spend(PAIR_NS * (lit * stamp.data.len()) as u64);
        let mut told = GainStatistics::default();
        for i in (0..stamp.data.len()).filter(|&i| stamp.used[i] && signal[i] > least) {
            let lever: [f64; 7] =
                std::array::from_fn(|a| if a < count { (0..count).map(|b| covariance[a][b] * rows[i][b]).sum() } else { 0.0 });
            let (mut quiet, mut lit) = (0.0, 0.0);
            for j in (0..stamp.data.len()).filter(|&j| stamp.used[j]) {
                let weight = 1.0 / (stamp.variance[j] + signal[j].max(0.0) * self.variance_per_dn);
                let hat = (0..count).map(|a| lever[a] * rows[j][a]).sum::<f64>() * weight;
                let left = (if i == j { 1.0 - hat } else { -hat }).powi(2);
                quiet += left * stamp.variance[j];
                lit += left * signal[j];
            }
            let residual = stamp.data[i] - signal[i] - fit.offset_dn;
            told.add(signal[i], residual, quiet, lit);
        }
        told.is_telling().then_some(told)
    }
}
