//! The widths of the converter's codes from the histogram of counts: missing codes and DNL.
//!
//! w_k = n_k / s_k, where s_k is what the other codes say about code k. Without converter faults the histogram is a
//! mixture of Gaussians no narrower than the noise σ, integrated over the codes. A mixture of Gaussians of 0.85 σ, fitted by expectation
//! maximisation (Richardson 1972, Lucy 1974), takes out the sharp structure (valleys between the levels of two frames, the rounding of a
//! narrow noise); a local quadratic of ln(n_k / mixture) with Poisson weights and without the code k itself takes out the rest. To first
//! order w_k − 1 = Σ_i a_i u_i, a_k = 1, with u_i the relative deviations of the counts, so that
//! v_k = φ Σ a_i²/s_i is its variance under Poisson counts with over-dispersion φ.
//!
//! D² = Σ ω_k ((w_k−1)² − v_k) / Σ ω_k κ_k. κ_k is the gain of the residual for a converter whose edges are displaced
//! independently (IEEE Std 1241: neighbouring widths share an edge, correlation −1/2): κ_k = Σ a_i² − Σ a_i a_{i+1}. For a converter with
//! independent widths D would be too small by 14 % at the narrowest window (half-width 4 codes). χ² = Σ (w_k−1)²/v_k has correlated terms; its
//! distribution is a scaled χ² of the same mean and variance (Satterthwaite 1946).

use crate::statistics::significance::{neg_ln_chi2_sf, normal_cdf};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Differential nonlinearity: the s.d. of the widths of the codes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct CodeWidths {
    /// S.d. of the code widths in units of the step of the codes; 0 where the widths vary less than chance alone would have it.
    pub dnl_steps: f64,
    /// Its standard error (of the upper side, where the value is small), steps.
    pub dnl_error_steps: f64,
    /// S.d. of the code widths, DN.
    pub dnl_dn: f64,
    /// Its standard error, DN.
    pub dnl_error_dn: f64,
    /// Σ (w−1)²/v over the tested codes; its mean is their number if all codes are equally wide.
    pub chi2: f64,
    /// Tested codes.
    pub codes: usize,
    /// Degrees of freedom of the scaled χ² that the p-value is taken from.
    pub effective_degrees: f64,
    /// Probability of as large a χ² with equally wide codes.
    pub p_value: f64,
}

/// Codes where more than 20 counts are expected and less than a twentieth of that is found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct MissingCodes {
    /// How many.
    pub number: usize,
    /// The first 16 of them, DN.
    pub codes_dn: Vec<i32>,
}

/// A code takes part in the test where more counts than this are expected.
const MIN_EXPECTED: f64 = 20.0;
const MIN_TESTED: usize = 9;
const EM_ITERATIONS: usize = 600;

/// The value at 0 of a quadratic of ln(count / rate).
pub(super) struct LocalFit {
    pub(super) ln_factor: f64,
    /// Variance of `ln_factor` under Poisson counts.
    pub(super) leverage: f64,
    /// ∂ ln_factor / ∂ (relative deviation of each point).
    gains: Vec<f64>,
}

/// Fits count = rate·exp(quadratic of x) to points (x, count, rate) with Poisson weights, by Newton's method.
pub(super) fn local_fit(points: &[(f64, f64, f64)]) -> Option<LocalFit> {
    let basis = |x: f64| Vector3::new(1.0, x, x * x);
    // Start: least squares of the logarithms, weighted by the counts.
    let (mut information, mut score) = (Matrix3::zeros(), Vector3::zeros());
    for &(x, count, rate) in points {
        let (row, count) = (basis(x), count.max(0.5));
        information += row * row.transpose() * count;
        score += row * count * (count / rate).ln();
    }
    let mut theta = information.cholesky()?.solve(&score);
    let mut inverse = Matrix3::zeros();
    for _ in 0..8 {
        let (mut information, mut score) = (Matrix3::zeros(), Vector3::zeros());
        for &(x, count, rate) in points {
            let row = basis(x);
            let expected = rate * row.dot(&theta).clamp(-30.0, 30.0).exp();
            information += row * row.transpose() * expected;
            score += row * (count - expected);
        }
        inverse = information.cholesky()?.inverse();
        let change = inverse * score;
        theta += change;
        if change.amax() < 1e-9 {
            break;
        }
    }
    let gains = points.iter().map(|&(x, _, rate)| (inverse * basis(x))[0] * rate * basis(x).dot(&theta).clamp(-30.0, 30.0).exp()).collect();
    Some(LocalFit { ln_factor: theta[0], leverage: inverse[(0, 0)], gains })
}

/// What the other codes say about one code.
pub(super) struct Width {
    place: usize,
    found: f64,
    expected: f64,
    /// First place of `row`.
    start: usize,
    /// a_i of the module's equation.
    row: Vec<f64>,
    /// a_i²/s_i, summed by [`covariance`]: 1/s of every place of the row.
    inverse_rates: Vec<f64>,
}

/// The widths of all codes with enough counts.
pub(super) fn widths(counts: &[f64], sigma: f64, over_dispersion: f64) -> Vec<Width> {
    let half = (sigma.round() as usize).clamp(4, 12);
    // The end codes may hold a pile; what lies beyond the last crowded neighbourhood is left out.
    let crowded = |place: &usize| {
        let near = &counts[place.saturating_sub(4).max(1)..(place + 5).min(counts.len() - 1)];
        near.iter().sum::<f64>() >= 5.0 * near.len() as f64 * over_dispersion
    };
    let inner = 1..counts.len().saturating_sub(1).max(1);
    let (Some(first), Some(last)) = (inner.clone().find(crowded), inner.clone().rev().find(crowded)) else { return Vec::new() };
    let rates = mixture(&counts[first..=last], 0.85 * sigma);
    let mut widths = Vec::new();
    for place in first + 1..last {
        let rate = rates[place - first];
        if rate < 0.5 * MIN_EXPECTED * over_dispersion {
            continue;
        }
        let (start, end) = (place.saturating_sub(half).max(first), (place + half).min(last));
        let x = |other: usize| (other as f64 - place as f64) / half as f64;
        let others = (start..=end).filter(|other| *other != place);
        let points: Vec<_> = others.map(|other| (x(other), counts[other], rates[other - first])).collect();
        let Some(fit) = local_fit(&points) else { continue };
        let expected = rate * fit.ln_factor.exp();
        if expected <= MIN_EXPECTED * over_dispersion {
            continue;
        }
        let mut row: Vec<f64> = fit.gains.iter().map(|gain| -gain).collect();
        row.insert(place - start, 1.0);
        let inverse_rates = (start..=end).map(|other| if other == place { 1.0 / expected } else { 1.0 / rates[other - first] }).collect();
        widths.push(Width { place, found: counts[place], expected, start, row, inverse_rates });
    }
    widths
}

/// Expected counts of the mixture of Gaussians of s.d. `sigma` steps, each integrated over the codes, that explains the counts best.
fn mixture(counts: &[f64], sigma: f64) -> Vec<f64> {
    let (spacing, reach) = (0.75 * sigma, 6.0 * sigma);
    let components = ((counts.len() as f64 + 6.0 * sigma) / spacing).ceil() as usize + 1;
    // Components beyond the range explain what a clip cuts off.
    let kernels: Vec<(usize, Vec<f64>)> = (0..components)
        .map(|component| {
            let centre = component as f64 * spacing - 3.0 * sigma;
            let low = (centre - reach).max(0.0).floor() as usize;
            let high = ((centre + reach).ceil().max(0.0) as usize).min(counts.len() - 1);
            let edge = |place: usize| normal_cdf((place as f64 - 0.5 - centre) / sigma);
            (low, (low..=high).map(|place| edge(place + 1) - edge(place)).collect())
        })
        .collect();
    let mut amounts = vec![counts.iter().sum::<f64>() / components as f64; components];
    let mut rates = vec![0.0; counts.len()];
    for iteration in 0..=EM_ITERATIONS {
        rates.fill(1e-12);
        for ((low, kernel), amount) in kernels.iter().zip(&amounts) {
            for (rate, weight) in rates[*low..].iter_mut().zip(kernel) {
                *rate += amount * weight;
            }
        }
        if iteration == EM_ITERATIONS {
            break;
        }
        let ratios: Vec<f64> = counts.iter().zip(&rates).map(|(count, rate)| count / rate).collect();
        for ((low, kernel), amount) in kernels.iter().zip(&mut amounts) {
            let (mut sum, mut norm) = (0.0, 0.0);
            for (ratio, weight) in ratios[*low..].iter().zip(kernel) {
                sum += ratio * weight;
                norm += weight;
            }
            *amount *= if norm > 0.0 { sum / norm } else { 0.0 };
        }
    }
    rates
}

pub(super) fn missing(widths: &[Width], dn: impl Fn(usize) -> i32) -> Option<MissingCodes> {
    let codes: Vec<i32> = widths.iter().filter(|width| width.found < 0.05 * width.expected).map(|width| dn(width.place)).collect();
    (widths.len() >= MIN_TESTED).then(|| MissingCodes { number: codes.len(), codes_dn: codes.iter().take(16).copied().collect() })
}

/// Covariances of the residuals w−1 of two codes: of Poisson counts, and of edges with widths of unit variance.
fn covariance(left: &Width, right: &Width) -> (f64, f64) {
    let at = |width: &Width, place: usize| place.checked_sub(width.start).and_then(|index| width.row.get(index)).copied().unwrap_or(0.0);
    let (mut poisson, mut edges) = (0.0, 0.0);
    for (index, (a, inverse_rate)) in left.row.iter().zip(&left.inverse_rates).enumerate() {
        let place = left.start + index;
        let b = at(right, place);
        poisson += a * b * inverse_rate;
        edges += a * (b - 0.5 * (at(right, place + 1) + if place > 0 { at(right, place - 1) } else { 0.0 }));
    }
    (poisson, edges)
}

pub(super) fn dnl(widths: &[Width], sigma: f64, over_dispersion: f64, step_dn: f64) -> Option<CodeWidths> {
    if widths.len() < MIN_TESTED {
        return None;
    }
    let codes = widths.len() as f64;
    let own: Vec<(f64, f64)> = widths.iter().map(|width| covariance(width, width)).collect();
    let squares: Vec<f64> = widths.iter().map(|width| (width.found / width.expected - 1.0).powi(2)).collect();
    let variances: Vec<f64> = own.iter().map(|(poisson, _)| poisson * over_dispersion).collect();
    let chi2: f64 = squares.iter().zip(&variances).map(|(square, variance)| square / variance).sum();
    let mut variance = 0.0_f64;
    let mut weights = vec![0.0; widths.len()];
    for _ in 0..8 {
        let (mut sum, mut norm) = (0.0, 0.0);
        for index in 0..widths.len() {
            let gain = own[index].1;
            weights[index] = gain / (variances[index] + variance * gain).powi(2);
            sum += weights[index] * (squares[index] - variances[index]);
            norm += weights[index] * gain;
        }
        variance = (sum / norm).max(0.0);
    }
    // Sums over pairs of residuals that share a count or an edge.
    let (mut correlation, mut spread) = (0.0, 0.0);
    for (index, left) in widths.iter().enumerate() {
        for (other, right) in widths.iter().enumerate().skip(index) {
            if right.start > left.start + left.row.len() {
                break;
            }
            let (poisson, edges) = covariance(left, right);
            let times = if index == other { 1.0 } else { 2.0 };
            let poisson = poisson * over_dispersion;
            correlation += times * poisson * poisson / (variances[index] * variances[other]);
            spread += 2.0 * times * weights[index] * weights[other] * (poisson + variance * edges).powi(2);
        }
    }
    let norm: f64 = weights.iter().zip(&own).map(|(weight, (_, gain))| weight * gain).sum();
    let dnl_steps = variance.sqrt();
    // √(D² + error of D²) − D: the usual error/(2 D) where D is large, and finite at 0.
    let by_chance = (variance + spread.sqrt() / norm).sqrt() - dnl_steps;
    // Measured: a mixture of Gaussians that are not wide compared with a code takes part of the widths for structure.
    let by_mixture = 0.4 * dnl_steps / (sigma * sigma);
    let dnl_error_steps = by_chance.hypot(by_mixture);
    let effective_degrees = codes * codes / correlation;
    let p_value = (-neg_ln_chi2_sf(effective_degrees, chi2 * codes / correlation)).exp();
    let (dnl_dn, dnl_error_dn) = (dnl_steps * step_dn, dnl_error_steps * step_dn);
    Some(CodeWidths { dnl_steps, dnl_error_steps, dnl_dn, dnl_error_dn, chi2, codes: widths.len(), effective_degrees, p_value })
}
