//! Plausibility of an estimated size: the nearest size within the natural range is tested against the estimate and its covariance.

use nalgebra::{DMatrix, DVector};

use super::final_fit::FinalFit;
use super::fit_state::AGREES;
use super::hypotheses::{Hypothesis, Variant};
use super::value_with_error::with_error;
use crate::effects::Natural;

/// What speaks against the size found of an accepted effect whose size nobody knows, if anything does.
pub(super) fn veto(solved: &FinalFit, k: usize, hypothesis: &Hypothesis, before: &Variant) -> Option<String> {
    let natural = hypothesis.effect.plausible_range().filter(|_| !hypothesis.in_force && hypothesis.known.is_none())?;
    let (values, covariance) = solved.sizes(k, before, natural.parameters)?;
    if distance(&values, &covariance, natural)? <= AGREES {
        return None;
    }
    let length = values.norm();
    let sigma = (values.dot(&(&covariance * &values)) / (length * length).max(f64::MIN_POSITIVE)).max(0.0).sqrt();
    let unit = hypothesis.effect.parameters()[*natural.parameters.first()?].unit;
    let size = with_error(if values.len() == 1 { values[0] } else { length }, sigma);
    let (least, most) = natural.range;
    Some(format!("its size, {} = {size} {unit}, is none that nature has ({least} to {most})", natural.what))
}

/// How many standard errors lie between an estimate and the nearest natural size.
fn distance(values: &DVector<f64>, covariance: &DMatrix<f64>, natural: Natural) -> Option<f64> {
    let (least, most) = natural.range;
    if let [value] = values.as_slice() {
        return Some((value - value.clamp(least, most)).abs() / covariance[(0, 0)].sqrt());
    }
    // The nearest vector v on the sphere: (C⁻¹ + λ·1)·v = C⁻¹·v̂ with the λ ≥ 0 for which it is as long as allowed. With eigenvalues cᵢ of C
    // and components v̂ᵢ: vᵢ = v̂ᵢ/(1 + λ·cᵢ), and the squared distance is Σ (v̂ᵢ − vᵢ)²/cᵢ. The length falls with λ.
    let eigen = covariance.clone().symmetric_eigen();
    let along = eigen.eigenvectors.tr_mul(values);
    let variance = eigen.eigenvalues.map(|value| value.max(f64::MIN_POSITIVE));
    let at = |lambda: f64| along.zip_map(&variance, |value, variance| value / (1.0 + lambda * variance));
    if values.norm() <= most {
        return Some(0.0);
    }
    let (mut low, mut high) = (0.0, 1.0 / variance.min());
    while at(high).norm() > most {
        high *= 4.0;
        if !high.is_finite() {
            return None;
        }
    }
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        *(if at(middle).norm() > most { &mut low } else { &mut high }) = middle;
    }
    let nearest = at(high);
    Some((0..along.len()).map(|i| (along[i] - nearest[i]).powi(2) / variance[i]).sum::<f64>().sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEED: Natural = Natural { what: "the velocity", parameters: &[1, 2, 3], range: (0.0, 42.0) };

    /// The nearest allowed vector is nearer than any other on the sphere, by search; within it the distance is nothing.
    #[test]
    fn the_nearest_natural_size_is_the_nearest() {
        let values = DVector::from_column_slice(&[60.0, -25.0, 8.0]);
        let covariance = DMatrix::from_row_slice(3, 3, &[9.0, 4.0, 1.0, 4.0, 25.0, -2.0, 1.0, -2.0, 100.0]);
        let found = distance(&values, &covariance, SPEED).unwrap();
        let inverse = covariance.clone().try_inverse().unwrap();
        let mut least = f64::INFINITY;
        for polar in 0..600 {
            for azimuth in 0..1200 {
                let (theta, phi) = (f64::from(polar) * std::f64::consts::PI / 600.0, f64::from(azimuth) * std::f64::consts::TAU / 1200.0);
                let (x, y, z) = (theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
                let off = DVector::from_column_slice(&[42.0 * x, 42.0 * y, 42.0 * z]) - &values;
                least = least.min(off.dot(&(&inverse * &off)));
            }
        }
        assert!((found / least.sqrt() - 1.0).abs() < 1e-3, "{found} {}", least.sqrt());
        assert_eq!(distance(&(values * 0.5), &covariance, SPEED), Some(0.0));
    }

    /// 300 km/s with an error of 20 are no aberration, 60 with as large an error may be; of a number either end of the range counts.
    #[test]
    fn what_nature_has_is_a_range() {
        let wide = DMatrix::from_diagonal_element(3, 3, 400.0);
        let speed = |x: f64| distance(&DVector::from_column_slice(&[x, 0.0, 0.0]), &wide, SPEED).unwrap();
        assert!((speed(300.0) - 258.0 / 20.0).abs() < 1e-6 && speed(300.0) > AGREES);
        assert!(speed(60.0) < AGREES);
        let air = Natural { what: "refraction", parameters: &[0], range: (27.0, 78.0) };
        let size = |value: f64| distance(&DVector::from_element(1, value), &DMatrix::from_element(1, 1, 25.0), air).unwrap();
        assert_eq!([size(12.0), size(50.0), size(88.0)], [3.0, 0.0, 2.0]);
    }
}
