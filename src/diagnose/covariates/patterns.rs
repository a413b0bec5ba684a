//! The patterns over the field by which residuals are held against a covariate: bins, products and maps.

use super::covariate::{Carrier, Fields, bins};
use crate::calibrate::Column;

/// Shifts, and fields linear in x and y.
pub(super) const LINEAR: [Carrier; 6] =
    [|_| [1.0, 0.0], |_| [0.0, 1.0], |[x, _]| [x, 0.0], |[_, y]| [y, 0.0], |[x, _]| [0.0, x], |[_, y]| [0.0, y]];

/// Each carrier in each of `count` bins of equal numbers.
pub(super) fn binned(values: &[f64], count: usize, fields: &Fields, carriers: &[Carrier]) -> Vec<Column> {
    let own = bins(values, count);
    let highest = own.iter().flatten().max().copied().unwrap_or(0);
    let mut columns = Vec::new();
    for bin in 0..=highest {
        for carrier in carriers {
            columns.push(fields.each(|k, place| if own[k] == Some(bin) { carrier(place) } else { [0.0; 2] }));
        }
    }
    columns
}

/// Each carrier times the value above its mean.
pub(super) fn times(values: &[f64], fields: &Fields, carriers: &[Carrier]) -> Vec<Column> {
    let known: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let of = |carrier: &Carrier| {
        fields.each(|k, place| if values[k].is_finite() { carrier(place).map(|c| c * (values[k] - mean)) } else { [0.0; 2] })
    };
    carriers.iter().map(of).collect()
}

/// Vector fields of products of Legendre polynomials up to a degree.
pub(super) fn legendre(fields: &Fields, degree: usize, factor: impl Fn(usize, f64) -> f64) -> Vec<Column> {
    let polynomials = |t: f64| {
        let mut p = vec![1.0, t];
        for n in 2..=degree {
            let m = n as f64;
            p.push(((2.0 * m - 1.0) * t * p[n - 1] - (m - 1.0) * p[n - 2]) / m);
        }
        p
    };
    let values: Vec<(Vec<f64>, Vec<f64>)> = fields.place.iter().map(|[x, y]| (polynomials(*x), polynomials(*y))).collect();
    let mut columns = Vec::new();
    for i in 0..=degree {
        for j in 0..=degree - i {
            let scalar = |k: usize| factor(k, values[k].0[i] * values[k].1[j]);
            columns.push((0..values.len()).map(|k| [scalar(k), 0.0]).collect());
            columns.push((0..values.len()).map(|k| [0.0, scalar(k)]).collect());
        }
    }
    columns
}
