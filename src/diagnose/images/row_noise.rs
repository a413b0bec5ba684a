//! The noise of the rows of a kind, from their residuals: a factor or a floor of the stated variances, and what the rows of a group share.

use super::rows::{Kind, KindNoise, Row, Shared};
use crate::statistics::median_in_place;

/// Degrees of freedom of the t distribution of the errors.
pub(super) const TAIL_DEGREES: f64 = 6.0;
/// Median of χ² of one degree of freedom.
const MEDIAN_CHI2: f64 = 0.454_936;
/// Fewer groups do not tell what their rows share.
const MIN_GROUPS: usize = 4;

/// Weight of a residual under a t distribution.
pub(super) fn weight(residual: f64) -> f64 {
    (TAIL_DEGREES + 1.0) / (TAIL_DEGREES + residual * residual)
}

/// Its slope times the residual, differentiated: what a small change of the residual makes of ψ.
pub(super) fn slope(residual: f64) -> f64 {
    let w = weight(residual);
    w * (TAIL_DEGREES - residual * residual) / (TAIL_DEGREES + residual * residual)
}

/// The noise of a kind from its residuals.
pub(super) fn found(kind: &Kind, rest: &[f64], take: &[bool], parameters: usize) -> KindNoise {
    if !kind.is_scaled {
        return KindNoise::STATED;
    }
    let taken: Vec<usize> = (0..rest.len()).filter(|k| take[*k]).collect();
    let dof = 1.0 - (parameters as f64 / taken.len().max(1) as f64).min(0.5);
    let row = |k: &usize| &kind.rows[*k];
    let groups: Vec<Vec<usize>> = if kind.shared == Shared::No {
        Vec::new()
    } else {
        let is_taken = |group: Vec<usize>| group.into_iter().filter(|k| take[*k]).collect::<Vec<_>>();
        kind.groups().into_iter().map(is_taken).filter(|group| !group.is_empty()).collect()
    };
    let repeated = groups.iter().filter(|group| group.len() > 1).count();
    if repeated < MIN_GROUPS {
        let pairs: Vec<(f64, &Row)> = taken.iter().map(|k| (rest[*k], row(k))).collect();
        return within(&pairs, dof);
    }
    // Within groups first: what they share does not count there.
    let mut noise = KindNoise::STATED;
    for _ in 0..3 {
        let mut pairs = Vec::with_capacity(taken.len());
        let mut means = Vec::with_capacity(groups.len());
        for group in &groups {
            let weight = |k: &usize| noise.variance(row(k)).recip();
            let total: f64 = group.iter().map(weight).sum();
            let mean = group.iter().map(|k| rest[*k] * weight(k)).sum::<f64>() / total;
            means.push((mean, total.recip()));
            if group.len() > 1 {
                // A residual about its group's mean is smaller by what it gave to the mean.
                pairs.extend(group.iter().map(|k| ((rest[*k] - mean) / (1.0 - weight(k) / total).sqrt(), row(k))));
            }
        }
        noise = within(&pairs, 1.0);
        noise.shared = between(&means);
    }
    noise
}

/// Factor and floor of the variance of rows.
fn within(pairs: &[(f64, &Row)], dof: f64) -> KindNoise {
    let typical = |noise: &KindNoise| {
        let mut squares: Vec<f64> = pairs.iter().map(|(rest, row)| rest * rest / noise.variance(row)).collect();
        median_in_place(&mut squares).unwrap_or(MEDIAN_CHI2) / (MEDIAN_CHI2 * dof)
    };
    let stated = typical(&KindNoise::STATED);
    if stated <= 1.0 {
        return KindNoise { factor: stated.max(0.25), ..KindNoise::STATED };
    }
    let mut variances: Vec<f64> = pairs.iter().map(|(_, row)| row.sigma * row.sigma).collect();
    let scale = median_in_place(&mut variances).unwrap_or(1.0);
    let at = |floor: f64| KindNoise { floor, ..KindNoise::STATED };
    let (mut low, mut high) = (0.0, scale * stated * 4.0);
    while typical(&at(high)) > 1.0 && high < scale * 1e12 {
        high *= 4.0;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if typical(&at(middle)) > 1.0 { low = middle } else { high = middle }
    }
    at(0.5 * (low + high))
}

/// Variance of what groups share, from their means and the variances of these.
fn between(means: &[(f64, f64)]) -> f64 {
    // What all groups have in common the zero points take up, or leave: it is no scatter.
    let middle = crate::statistics::median(&means.iter().map(|(mean, _)| *mean).collect::<Vec<_>>()).unwrap_or(0.0);
    let means: Vec<(f64, f64)> = means.iter().map(|(mean, variance)| (mean - middle, *variance)).collect();
    let typical = |shared: f64| {
        let mut squares: Vec<f64> = means.iter().map(|(mean, variance)| mean * mean / (variance + shared)).collect();
        // Few means: their mean square, the largest cut, scatters less than their median.
        squares.sort_by(f64::total_cmp);
        let kept = &squares[..squares.len() - squares.len() / 20];
        let cut = if squares.len() >= 20 { 0.81 } else { 1.0 };
        kept.iter().sum::<f64>() / (kept.len() as f64 * cut) * (means.len() as f64 / (means.len() as f64 - 1.0))
    };
    if means.len() < MIN_GROUPS || typical(0.0) <= 1.0 {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, means.iter().map(|(mean, _)| mean * mean).fold(0.0, f64::max));
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if typical(middle) > 1.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}
