//! # Photon noise
//!
//! ## What it does
//!
//! Light comes in quanta: a pixel that expects λ electrons collects a Poisson number of them.
//!
//! ## Equation
//!
//! P(k) = λᵏ e^(−λ) / k!, by inversion: k is the quantile of the Poisson law at Φ(w), w standard normal. Below λ = 12 it is found
//! from the survival P(K > 0) on, term by term, until that falls below 1 − Φ(w). From 12 on, m is the whole number nearest to the quantile's
//! expansion λ + √λ w + (2 + w²)/6 − w(2 + w²)/(72 √λ), and k = m where w ≥ −z, else m − 1; Φ(z) = P(K ≥ m), and with N = λ + m,
//! t = (λ − m)/N: z = √N t a(t) + c₁(t)/√N + c₂(t)/N^(3/2) + c₃(t)/N^(5/2). t a(t) = √(2t − 2(1 − t) artanh t) is the signed root of the
//! likelihood, c₁ = ln(√2/(a √(1 − t)))/(t a) its correction; c₂ and c₃ were fitted to z of the incomplete gamma function. The processor takes
//! the expansion to one order more, (3w⁴ + 7w² − 16)/(810 λ), and needs z only where that comes near a whole number; the numbers are the same.
//!
//! ## Parameters
//!
//! None; it is there or not.
//!
//! ## Signature
//!
//! Centroids that are too good: the noise of a bright star's place is σ/√(electrons).
//!
//! ## Confused with
//!
//! Another gain: the slope of variance against mean is 1/gain.
//!
//! ## Neglected
//!
//! Fano noise and pair production below 1 µm (one electron a photon). The law is kept exactly but for f32: computed, not drawn, the
//! total variation distance to it (half of the sum of all errors of probabilities) is below 1e-5 at every λ up to 1e5, and below 2e-6 up to 1000;
//! the mean is right to 1e-5 of σ, the variance to 2e-5 of itself, the skewness to 1e-4 (moments of what lies within 6.6 σ). The tails end at 6.7 σ, that of λ < 12 at a probability of 1e-7. Above 2²⁴ electrons the numbers
//! are rounded to f32.
//!
//! ## Source
//!
//! O. E. Barndorff-Nielsen, Biometrika 73, 307 (1986), for the corrected root; N. M. Temme, "Asymptotic inversion of incomplete gamma
//! functions", Math. Comp. 58, 755 (1992); M. B. Giles, "Algorithm 955", ACM TOMS 42, 7 (2016), for the quantile's expansion; L. Devroye,
//! Non-Uniform Random Variate Generation (1986), chapter X.3 (inversion).

use crate::effects::ParameterSpec;
use crate::effects::pixel::lanes::{BLOCK_PX, vectorised, with_normals};
use crate::effects::pixel::poisson::{EXPANSION_FROM_E, poisson_numbers};
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage};
use crate::rng::StageKey;

/// Photon noise.
#[derive(Clone, Copy, Debug)]
pub struct PhotonNoise;

vectorised! {
    /// The twin.
    fn photon_noise(key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        with_normals(key, first_pixel, pixels, |run, normals| {
            // Arrays of a fixed length: loops over them are vectorised. What stands beyond a short run is as bright as its end.
            let mut lambda = [run[run.len() - 1]; BLOCK_PX];
            let mut w = [0.0_f32; BLOCK_PX];
            lambda[..run.len()].copy_from_slice(run);
            w[..run.len()].copy_from_slice(normals);
            for lambda in &mut lambda {
                *lambda = if *lambda > 0.0 { *lambda } else { 0.0 };
            }
            run.copy_from_slice(&poisson_numbers(&lambda, &w)[..run.len()]);
        });
    }
}

impl PixelEffect for PhotonNoise {
    const ID: &'static str = "photon-noise";
    const STAGE: Stage = Stage::Charge;
    const ROLE: Role = Role::Noise;
    const PARAMETERS: &'static [ParameterSpec] = &[];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 1;
    const FAINT_BELOW_E: Option<f64> = Some(EXPANSION_FROM_E as f64);
    const WGSL: &'static str = include_str!("../../../shaders/photon_noise.wgsl");
    const SOURCE: &'static str = page_source!("photon_noise.rs");
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

    /// Vectors of whatever width the processor has, and single numbers compiled for any, are the same to the bit.
    #[test]
    fn wide_registers_change_no_bit() {
        let key = StageKey { seed: 4, frame: 5, stage: 6 };
        let lambda: Vec<f32> = (0..20_011_u16).map(|i| (f32::from(i) * 0.02).powi(2)).collect();
        let mut w = vec![0.0; lambda.len()];
        with_normals(key, 3, &mut w, |run, normals| run.copy_from_slice(normals));
        let mut pixels = lambda.clone();
        photon_noise(key, 3, &mut pixels);
        for ((pixel, lambda), w) in pixels.iter().zip(&lambda).zip(&w) {
            assert_eq!(*pixel, poisson_numbers(&[*lambda; BLOCK_PX], &[*w; BLOCK_PX])[0], "λ {lambda}, w {w}");
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
