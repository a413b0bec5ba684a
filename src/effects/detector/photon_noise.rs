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
//! likelihood, c₁ = ln(√2/(a √(1 − t)))/(t a) its correction; c₂ and c₃ were fitted to z of the incomplete gamma function.
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
use crate::effects::pixel::math::{floor_positive, normal_upper_tail, poly_exp, round};
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage};
use crate::rng::StageKey;

/// Photon noise.
#[derive(Clone, Copy, Debug)]
pub struct PhotonNoise;

/// Expected electrons from which on the expansion of z is used instead of sums of probabilities.
const EXPANSION_FROM_E: f32 = 12.0;

/// Bits from which half of those of a number are taken for the reciprocal of its root (Lomont 2003, Fast inverse square root).
const ROUGH_INVERSE_ROOT: u32 = 0x5f37_59df;

/// Pixels whose probabilities are summed together: several registers' worth, so that the loop runs on all of them at once.
const LANES: usize = 16;

/// a, c₁, c₂ and c₃ of the page as polynomials of t, the constant first.
#[allow(clippy::approx_constant, clippy::excessive_precision, clippy::unreadable_literal, reason = "as fitted")]
mod coefficients {
    pub(super) const A: [f32; 9] =
        [1.41421356, -0.235699955, 0.216110651, -0.105653824, 0.105470141, -0.0598661338, 0.0817357317, -0.108672987, 0.0872841137];
    pub(super) const C1: [f32; 9] =
        [0.471404521, 0.15714833, 0.108217197, 0.0755815762, 0.0436860547, 0.145396395, 0.174959931, -0.838543406, 0.920841109];
    pub(super) const C2: [f32; 5] = [0.0227193453, 0.0517626576, 0.0556984971, 0.0480907339, 0.207448841];
    pub(super) const C3: [f32; 3] = [-0.0217364629, -0.0350709349, -0.154754407];
}

#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn polynomial<const N: usize>(coefficients: [f32; N], t: f32) -> f32 {
    let mut sum = coefficients[N - 1];
    for i in 1..N {
        sum = sum * t + coefficients[N - 1 - i];
    }
    sum
}

/// The Poisson number of expectation `lambda` ≥ [`EXPANSION_FROM_E`] at the quantile of a standard normal number.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn poisson_quantile(lambda: f32, w: f32) -> f32 {
    let whole = floor_positive(lambda);
    let part = lambda - whole;
    let root = lambda.sqrt();
    let w2 = w * w + 2.0;
    // 1/√λ from the bits, to 4 %: m may be off by half, and a division is dear.
    let inverse_root = f32::from_bits(ROUGH_INVERSE_ROOT - (lambda.to_bits() >> 1));
    let near = whole + round(part + root * w + w2 * (1.0 / 6.0 - (1.0 / 72.0) * w * inverse_root));
    let m = if near > 1.0 { near } else { 1.0 };
    // Whole numbers first: their difference is exact.
    let difference = (whole - m) + part;
    let scale = 1.0 / (lambda + m).sqrt();
    let inverse = scale * scale;
    let t = difference * inverse;
    let c = polynomial(coefficients::C1, t) + inverse * (polynomial(coefficients::C2, t) + inverse * polynomial(coefficients::C3, t));
    let z = scale * (difference * polynomial(coefficients::A, t) + c);
    if w + z >= 0.0 { m } else { m - 1.0 }
}

/// The first survival P(K > 0) = 1 − e^(−λ); a series where the difference would lose digits. λ ≤ 12.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn first_survival(lambda: f32, zero: f32) -> f32 {
    let l = lambda;
    let series = l * (1.0 - l * 0.5 * (1.0 - l * (1.0 / 3.0) * (1.0 - l * 0.25 * (1.0 - l * 0.2))));
    if l < 0.1 { series } else { 1.0 - zero }
}

/// Poisson numbers of expectations below [`EXPANSION_FROM_E`] by inversion, for `LANES` pixels at once; where λ is larger the result means
/// nothing. `u` is uniform in (0, 1], and small where the number is to be large.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
#[allow(clippy::needless_bitwise_bool, reason = "a lazy `and` is a branch, and the loop would not vectorise")]
fn poisson_inversion(lambda: &[f32; LANES], u: &[f32; LANES]) -> [f32; LANES] {
    let mut probability = [0.0_f32; LANES];
    let mut survival = [0.0_f32; LANES];
    let mut last = [0.0_f32; LANES];
    let mut count = [0.0_f32; LANES];
    for i in 0..LANES {
        let l = if lambda[i] < EXPANSION_FROM_E { lambda[i] } else { 0.0 };
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

vectorised! {
    /// The twin.
    fn photon_noise(key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        with_normals(key, first_pixel, pixels, |run, normals| {
            let mut faint = 0_u32;
            let mut lambda = [0.0_f32; BLOCK_PX];
            for ((pixel, w), lambda) in run.iter_mut().zip(normals).zip(&mut lambda) {
                *lambda = if *pixel > 0.0 { *pixel } else { 0.0 };
                faint += u32::from(*lambda < EXPANSION_FROM_E);
                *pixel = poisson_quantile(if *lambda < EXPANSION_FROM_E { EXPANSION_FROM_E } else { *lambda }, *w);
            }
            if faint > 0 {
                sum_faint(&lambda, normals, run);
            }
        });
    }
}

/// Replaces the numbers of pixels of little light.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
fn sum_faint(lambda: &[f32; BLOCK_PX], normals: &[f32], pixels: &mut [f32]) {
    for ((pixels, normals), lambda) in pixels.chunks_mut(LANES).zip(normals.chunks(LANES)).zip(lambda.as_chunks::<LANES>().0) {
        if lambda.iter().all(|l| *l >= EXPANSION_FROM_E) {
            continue;
        }
        let mut u = [1.0_f32; LANES];
        for (u, w) in u.iter_mut().zip(normals) {
            let tail = normal_upper_tail(w.abs());
            *u = if *w < 0.0 { 1.0 - tail } else { tail };
        }
        for ((pixel, small), l) in pixels.iter_mut().zip(poisson_inversion(lambda, &u)).zip(lambda) {
            *pixel = if *l < EXPANSION_FROM_E { small } else { *pixel };
        }
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

    /// The number at a normal quantile, by the same lines as the twin's.
    fn at_quantile(lambda: f32, w: f32) -> f64 {
        let mut pixel = [poisson_quantile(lambda.max(EXPANSION_FROM_E), w)];
        if lambda < EXPANSION_FROM_E {
            sum_faint(&[lambda; BLOCK_PX], &[w], &mut pixel);
        }
        f64::from(pixel[0])
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
            assert_eq!(f64::from(*pixel), at_quantile(*lambda, *w), "λ {lambda}, w {w}");
        }
    }

    /// The law itself, not draws of it: where along w each number begins, found by bisection, and what lies between has the right probability.
    #[test]
    fn the_law_is_exact() {
        use statrs::function::{erf::erfc, gamma::ln_gamma};
        for lambda in [0.003_f32, 0.1, 0.7, 1.0, 3.3, 8.0, 11.9, 12.0, 12.6, 14.0, 17.3, 20.0, 31.0, 50.0, 100.0, 1000.0, 12_345.6, 1e5] {
            let l = f64::from(lambda);
            let survival = |k: f64| {
                let (mut low, mut high) = (-6.6_f32, 6.6_f32);
                if at_quantile(lambda, low) >= k {
                    return 1.0;
                }
                for _ in 0..45 {
                    let middle = 0.5 * (low + high);
                    if at_quantile(lambda, middle) >= k { high = middle } else { low = middle }
                }
                0.5 * erfc(f64::from(high) * std::f64::consts::FRAC_1_SQRT_2)
            };
            let (first, last) = ((l - 7.0 * l.sqrt()).floor().max(0.0), (l + 7.0 * l.sqrt() + 10.0).ceil());
            let (mut distance, mut moments) = (0.0, [0.0; 3]);
            let mut above = survival(first);
            for k in first as u32..last as u32 {
                let k = f64::from(k);
                let next = survival(k + 1.0);
                let error = (above - next) - (k * l.ln() - l - ln_gamma(k + 1.0)).exp();
                above = next;
                distance += 0.5 * error.abs();
                for (power, moment) in (1..).zip(&mut moments) {
                    *moment += error * (k - l).powi(power);
                }
            }
            // Central moments of the law: λ, λ, and λ again.
            let errors = [moments[0] / l.sqrt(), moments[1] / l, (moments[2] - 3.0 * l * moments[0]) / l.powf(1.5)];
            println!(
                "λ {lambda}: distance {distance:.1e}; mean {:.1e} σ, variance {:.1e}, skewness {:.1e}",
                errors[0], errors[1], errors[2]
            );
            assert!(errors.iter().all(|error| error.abs() < 2e-4), "λ {lambda}: {errors:.1?}");
            assert!(distance < 1e-5, "λ {lambda}: total variation distance {distance:.1e}");
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
