//! Components of variance of a nested design: fields, places within a pixel, repeated exposures.
//!
//! value = bias + field + place + noise. The mean square of a level has the expectation of the mean square below it plus its own variance times
//! the number of values in each of its means. The noise has exact bounds by χ²; those of the levels above are of the modified large-sample
//! kind: Graybill & Wang, J. Am. Stat. Assoc. 75, 869 (1980); Burdick & Graybill, *Confidence Intervals on Variance Components* (1992), 3.3.

use super::intervals::{Bounded, Risk, chi_squared, fisher_f, mean_square};

/// A level of a nested design.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stratum {
    /// Mean square of the level.
    pub mean_square: f64,
    /// Its degrees of freedom.
    pub freedom: f64,
    /// How many values each mean of this level is of.
    pub values: f64,
}

/// The variance of a level with its bounds. `strata` go from the innermost level on.
#[must_use]
pub(super) fn component(strata: &[Stratum], level: usize, risk: Risk) -> Bounded {
    let own = strata[level];
    if level == 0 {
        return mean_square(own.mean_square, own.freedom, risk);
    }
    let below = strata[level - 1];
    let value = (own.mean_square - below.mean_square) / own.values;
    if own.freedom < 1.0 || below.freedom < 1.0 {
        return Bounded { value: value.max(0.0), lower: 0.0, upper: f64::INFINITY };
    }
    let (s1, s2) = (own.mean_square, below.mean_square);
    let (n1, n2) = (own.freedom, below.freedom);
    // The upper bound.
    let h1 = n1 / chi_squared(risk.upper, n1) - 1.0;
    let g2 = 1.0 - n2 / chi_squared(1.0 - risk.upper, n2);
    let f_low = fisher_f(risk.upper, n1, n2);
    let h12 = ((1.0 - f_low).powi(2) - h1 * h1 * f_low * f_low - g2 * g2) / f_low;
    let upper = s1 - s2 + (h1 * h1 * s1 * s1 + g2 * g2 * s2 * s2 + h12 * s1 * s2).max(0.0).sqrt();
    // The lower bound.
    let g1 = 1.0 - n1 / chi_squared(1.0 - risk.lower, n1);
    let h2 = n2 / chi_squared(risk.lower, n2) - 1.0;
    let f_high = fisher_f(1.0 - risk.lower, n1, n2);
    let g12 = ((f_high - 1.0).powi(2) - g1 * g1 * f_high * f_high - h2 * h2) / f_high;
    let lower = s1 - s2 - (g1 * g1 * s1 * s1 + h2 * h2 * s2 * s2 + g12 * s1 * s2).max(0.0).sqrt();
    Bounded { value: value.max(0.0), lower: (lower / own.values).max(0.0), upper: (upper / own.values).max(0.0) }
}

/// The strata of one axis of a balanced design: `values[field][place][repeat]`. Levels that have one member alone are left out of the design.
#[must_use]
pub fn strata(values: &[Vec<Vec<f64>>]) -> [Option<Stratum>; 3] {
    let fields = values.len();
    let places = values.iter().map(Vec::len).min().unwrap_or(0);
    let repeats = values.iter().flatten().map(Vec::len).min().unwrap_or(0);
    if fields == 0 || places == 0 || repeats == 0 {
        return [None; 3];
    }
    let of = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let place_mean = |field: usize, place: usize| of(&values[field][place][..repeats]);
    let field_mean = |field: usize| of(&(0..places).map(|place| place_mean(field, place)).collect::<Vec<_>>());
    let whole = of(&(0..fields).map(field_mean).collect::<Vec<_>>());
    let (mut noise, mut of_places, mut of_fields) = (0.0, 0.0, 0.0);
    for (field, own) in values.iter().enumerate() {
        of_fields += (field_mean(field) - whole).powi(2);
        for (place, exposures) in own.iter().enumerate().take(places) {
            of_places += (place_mean(field, place) - field_mean(field)).powi(2);
            noise += exposures[..repeats].iter().map(|value| (value - place_mean(field, place)).powi(2)).sum::<f64>();
        }
    }
    let [f, p, r] = [fields, places, repeats].map(|count| count as f64);
    let stratum = |squares: f64, freedom: f64, values: f64| {
        (freedom > 0.0).then(|| Stratum { mean_square: values * squares / freedom, freedom, values })
    };
    [stratum(noise, f * p * (r - 1.0), 1.0), stratum(of_places, f * (p - 1.0), r), stratum(of_fields, f - 1.0, p * r)]
}

/// Strata of two axes together, which are equal but for their means.
#[must_use]
pub fn pooled(first: Option<Stratum>, second: Option<Stratum>) -> Option<Stratum> {
    let (first, second) = first.zip(second)?;
    let freedom = first.freedom + second.freedom;
    let square = (first.mean_square * first.freedom + second.mean_square * second.freedom) / freedom;
    Some(Stratum { mean_square: square, freedom, values: first.values })
}
