//! # Photon noise
//!
//! **What it is.** Light comes in quanta: a pixel that expects λ electrons collects a Poisson number of them.
//!
//! **Equation.** P(k) = λᵏ e^(−λ) / k!. Below λ = 10 by inversion: from the survival P(K > 0) on, term by term, until it falls below a uniform
//! number. From 10 on by the quantile of the normal distribution turned into that of the Poisson, rounded down (M. B. Giles, algorithm 955):
//! k = ⌊λ + √λ w + (2 + w²)/6 − (w + w³/2)/(36 √λ) + (−8/405 + 7w²/810 + w⁴/270)/λ⌋, w standard normal.
//!
//! **Parameter.** None; it is there or not.
//!
//! **What it leaves when left out.** Centroids that are too good: the noise of a bright star's place is σ/√(electrons).
//!
//! **Confused with.** Another gain: the slope of variance against mean is 1/gain.
//!
//! **Neglected.** Fano noise and pair production below 1 µm (one electron a photon). Against the exact law (computed, not drawn): below 10 the
//! probabilities hold to 3e-7 (f32); from 10 on the total variation distance is at most 1.4e-4 and falls as λ^-2, the mean is right to
//! 3e-6 electrons, the variance too large by 2.7e-4 at λ = 10, 3e-5 at 30, 3e-6 at 100, the skewness within 5e-4 of 1/√λ. The tails end
//! at 6.7 σ. Above 2²⁴ electrons the numbers are rounded to f32.
//!
//! **Source.** M. B. Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function", ACM TOMS 42, 7 (2016);
//! L. Devroye, Non-Uniform Random Variate Generation (1986), chapter X.3 (inversion).

use crate::effects::ParameterSpec;
use crate::effects::pixel::math::{floor, floor_positive, poly_exp, standard_normal, unit_interval};
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage};
use crate::rng::StageKey;

/// Photon noise.
#[derive(Clone, Copy, Debug)]
pub struct PhotonNoise;

/// Expected electrons from which on the quantile is used instead of inversion.
const QUANTILE_FROM_E: f32 = 10.0;

/// Pixels treated together: several registers' worth, so that the loop of the inversion runs on all of them at once.
const LANES: usize = 16;

/// A Poisson number of expectation `lambda` ≥ [`QUANTILE_FROM_E`] from a standard normal number.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn poisson_quantile(lambda: f32, w: f32) -> f32 {
    let root = lambda.sqrt();
    let w2 = w * w;
    let whole = floor_positive(lambda);
    let order_0 = (lambda - whole) + root * w;
    let order_1 = (2.0 + w2) * (1.0 / 6.0);
    let order_2 = w * (1.0 + 0.5 * w2) / (36.0 * root);
    let order_3 = ((w2 * (1.0 / 270.0) + 7.0 / 810.0) * w2 - 8.0 / 405.0) / lambda;
    whole + floor(order_0 + (order_1 - order_2 + order_3))
}

/// The first survival P(K > 0) = 1 − e^(−λ); a series where the difference would lose digits. λ ≤ 10.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn first_survival(lambda: f32, zero: f32) -> f32 {
    let l = lambda;
    let series = l * (1.0 - l * 0.5 * (1.0 - l * (1.0 / 3.0) * (1.0 - l * 0.25 * (1.0 - l * 0.2))));
    if l < 0.1 { series } else { 1.0 - zero }
}

/// Poisson numbers of expectations below [`QUANTILE_FROM_E`] by inversion, for `LANES` pixels at once; where λ is larger the result means
/// nothing. `u` is uniform in (0, 1].
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
#[allow(clippy::needless_bitwise_bool, reason = "a lazy `and` is a branch, and the loop would not vectorise")]
fn poisson_inversion(lambda: &[f32; LANES], u: &[f32; LANES]) -> [f32; LANES] {
    let mut probability = [0.0_f32; LANES];
    let mut survival = [0.0_f32; LANES];
    let mut last = [0.0_f32; LANES];
    let mut count = [0.0_f32; LANES];
    for i in 0..LANES {
        let l = if lambda[i] < QUANTILE_FROM_E { lambda[i] } else { 0.0 };
        probability[i] = poly_exp(-l);
        survival[i] = first_survival(l, probability[i]);
        last[i] = 6.0 + l + 6.5 * l.sqrt();
    }
    let mut k = 0.0_f32;
    loop {
        let mut running = 0.0_f32;
        let reciprocal = 1.0 / (k + 1.0);
        for i in 0..LANES {
            let more = if (u[i] < survival[i]) & (k < last[i]) { 1.0 } else { 0.0 };
            count[i] += more;
            running += more;
            probability[i] *= lambda[i] * reciprocal;
            survival[i] -= probability[i];
        }
        if running == 0.0 {
            return count;
        }
        k += 1.0;
    }
}

/// The twin.
fn photon_noise(key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
    let mut pixel = first_pixel;
    for block in pixels.chunks_mut(LANES) {
        let mut lambda = [0.0_f32; LANES];
        let mut large = [0.0_f32; LANES];
        let mut u = [0.0_f32; LANES];
        for (l, value) in lambda.iter_mut().zip(block.iter()) {
            *l = if *value > 0.0 { *value } else { 0.0 };
        }
        for i in 0..LANES {
            let words = key.words(pixel.wrapping_add(i as u32), 0);
            let l = if lambda[i] < QUANTILE_FROM_E { QUANTILE_FROM_E } else { lambda[i] };
            large[i] = poisson_quantile(l, standard_normal(words[0], words[1]));
            u[i] = unit_interval(words[2]);
        }
        if lambda.iter().any(|l| *l < QUANTILE_FROM_E) {
            let small = poisson_inversion(&lambda, &u);
            for i in 0..LANES {
                large[i] = if lambda[i] < QUANTILE_FROM_E { small[i] } else { large[i] };
            }
        }
        let count = block.len();
        block.copy_from_slice(&large[..count]);
        pixel = pixel.wrapping_add(LANES as u32);
    }
}

impl PixelEffect for PhotonNoise {
    const ID: &'static str = "photon_noise";
    const STAGE: Stage = Stage::Charge;
    const PARAMETERS: &'static [ParameterSpec] = &[];
    const RNG_STAGE: u32 = 1;
    const WGSL: &'static str = include_str!("../../../shaders/photon_noise.wgsl");
    const SOURCE: &'static str = include_str!("photon_noise.rs");
    type Uniforms = ();
    const FIELDS: &'static [(&'static str, usize)] = &[];

    fn uniforms(_parameters: &[f64], _exposure: &ExposureContext) {}
    fn apply(_uniforms: &(), key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        photon_noise(key, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DRAWS: usize = 400_000;

    fn drawn(lambda: f32, frame: u32) -> Vec<f64> {
        let mut pixels = vec![lambda; DRAWS];
        photon_noise(StageKey { seed: 99, frame, stage: PhotonNoise::RNG_STAGE }, 0, &mut pixels);
        pixels.iter().map(|k| f64::from(*k)).collect()
    }

    /// Mean, variance and skewness of 400 000 draws lie within 4.5 of their own standard errors of the exact law's.
    #[test]
    fn moments_are_those_of_the_poisson_law() {
        for (frame, lambda) in [0.1_f32, 0.5, 2.0, 5.0, 9.99, 10.0, 10.5, 20.0, 50.0, 100.0, 1e3, 1e4, 1e5].into_iter().enumerate() {
            let (l, n) = (f64::from(lambda), DRAWS as f64);
            let draws = drawn(lambda, frame as u32);
            let mean = draws.iter().sum::<f64>() / n;
            let moment = |power: i32| draws.iter().map(|k| (k - l).powi(power)).sum::<f64>() / n;
            let (second, third) = (moment(2), moment(3));
            // Central moments of the Poisson law: μ2 = μ3 = λ, μ4 = λ + 3λ², μ6 = λ + 25λ² + 15λ³.
            let error = |variance: f64| 4.5 * (variance / n).sqrt();
            assert!((mean - l).abs() < error(l), "λ {lambda}: mean {mean}");
            assert!((second - l).abs() < error(l + 2.0 * l * l) + 3e-4 * l, "λ {lambda}: variance {second}");
            assert!((third - l).abs() < error(25.0 * l * l + 15.0 * l.powi(3)) + 5e-4 * l, "λ {lambda}: third moment {third}");
            assert!(draws.iter().all(|k| *k >= 0.0 && k.fract() == 0.0));
        }
    }

    /// The counts of each k have the exact law's probabilities (χ² test at 5 σ).
    #[test]
    fn counts_follow_the_law() {
        for (frame, lambda) in [0.02_f64, 0.3, 1.0, 4.0, 9.9, 10.1, 25.0].into_iter().enumerate() {
            let draws = drawn(lambda as f32, 100 + frame as u32);
            let mut seen = vec![0.0_f64; 100];
            for k in &draws {
                seen[*k as usize] += 1.0;
            }
            let mut expected = DRAWS as f64 * (-lambda).exp();
            let (mut chi2, mut classes, mut rest_seen, mut rest_expected) = (0.0, 0.0, DRAWS as f64, DRAWS as f64);
            for (k, count) in seen.iter().enumerate() {
                if expected >= 10.0 {
                    chi2 += (count - expected).powi(2) / expected;
                    classes += 1.0;
                    rest_seen -= count;
                    rest_expected -= expected;
                }
                expected *= lambda / (k as f64 + 1.0);
            }
            let rest = (rest_seen - rest_expected).powi(2) / rest_expected.max(1.0);
            let limit = classes + 5.0 * f64::sqrt(2.0 * classes);
            assert!(
                chi2 + rest.min(25.0) < limit + 12.0,
                "λ {lambda}: χ² {chi2:.1} of {classes} classes, rest {rest_seen} for {rest_expected:.1}"
            );
        }
    }

    /// Faint light keeps its mean: the uniform number is fine near the tail that decides.
    #[test]
    fn nothing_comes_from_nothing_and_little_from_little() {
        assert!(drawn(0.0, 7).iter().all(|k| *k == 0.0));
        let mut pixels = [-3.0, f32::NAN, 1e-30];
        photon_noise(StageKey { seed: 1, frame: 0, stage: 1 }, 0, &mut pixels);
        assert_eq!(pixels, [0.0; 3]);
        let sum: f64 = (0..20).map(|frame| drawn(1e-3, 50 + frame).iter().sum::<f64>()).sum();
        assert!((sum - 8000.0).abs() < 4.5 * 8000.0_f64.sqrt(), "{sum} electrons for 8000");
    }
}
