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

/// Factor and floor of the variance of rows. The floor f at which the median of r²/(σ² + f) is that of χ² is the median of what each row asks for alone,
/// r²/median − σ².
fn within(pairs: &[(f64, &Row)], dof: f64) -> KindNoise {
    let due = MEDIAN_CHI2 * dof;
    let mut ratios: Vec<f64> = pairs.iter().map(|(rest, row)| rest * rest / (row.sigma * row.sigma)).collect();
    let stated = median_in_place(&mut ratios).map_or(1.0 / dof, |median| median / due);
    if stated <= 1.0 {
        return KindNoise { factor: stated.max(0.25), ..KindNoise::STATED };
    }
    let mut floors: Vec<f64> = pairs.iter().map(|(rest, row)| rest * rest / due - row.sigma * row.sigma).collect();
    KindNoise { floor: median_in_place(&mut floors).unwrap_or(0.0).max(0.0), ..KindNoise::STATED }
}

/// Variance of what groups share, from their means and the variances of these.
fn between(means: &[(f64, f64)]) -> f64 {
    // What all groups have in common the zero points take up, or leave: it is no scatter.
    let middle = crate::statistics::median(&means.iter().map(|(mean, _)| *mean).collect::<Vec<_>>()).unwrap_or(0.0);
    let means: Vec<(f64, f64)> = means.iter().map(|(mean, variance)| (mean - middle, *variance)).collect();
    // Few means: their mean square, the largest cut, scatters less than their median.
    let kept = means.len() - means.len() / 20;
    let cut = if means.len() >= 20 { 0.81 } else { 1.0 };
    let factor = means.len() as f64 / (means.len() as f64 - 1.0) / (kept as f64 * cut);
    let mut squares = vec![0.0; means.len()];
    let mut above = |shared: f64| {
        squares.iter_mut().zip(&means).for_each(|(square, (mean, variance))| *square = mean * mean / (variance + shared));
        if kept < squares.len() {
            squares.select_nth_unstable_by(kept, f64::total_cmp);
        }
        squares[..kept].iter().sum::<f64>() * factor - 1.0
    };
    if means.len() < MIN_GROUPS {
        return 0.0;
    }
    let low = above(0.0);
    if low <= 0.0 {
        return 0.0;
    }
    // With so much shared no mean square is above one.
    let high = kept as f64 * factor * means.iter().map(|(mean, _)| mean * mean).fold(0.0, f64::max);
    root_between([0.0, high], [low, above(high)], above)
}

/// Where a falling function crosses zero, by false position with the Illinois rule. The far end is the answer if it does not cross.
fn root_between([mut low, mut high]: [f64; 2], [mut at_low, mut at_high]: [f64; 2], mut of: impl FnMut(f64) -> f64) -> f64 {
    const STEPS: usize = 60;
    if at_high > 0.0 {
        return high;
    }
    let width = 1e-12 * (high - low);
    let mut last_was_low = None;
    for _ in 0..STEPS {
        if high - low <= width || at_high == 0.0 {
            break;
        }
        let next = (low * at_high - high * at_low) / (at_high - at_low);
        // Rounding may put it on an end.
        let next = if next > low && next < high { next } else { 0.5 * (low + high) };
        let value = of(next);
        let is_low = value > 0.0;
        if is_low {
            (low, at_low) = (next, value);
            at_high *= if last_was_low == Some(true) { 0.5 } else { 1.0 };
        } else {
            (high, at_high) = (next, value);
            at_low *= if last_was_low == Some(false) { 0.5 } else { 1.0 };
        }
        if value.abs() < 1e-12 {
            return next;
        }
        last_was_low = Some(is_low);
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows whose scatter has a floor beside stated errors: the median of r²/(σ² + f) is that of χ².
    #[test]
    fn the_floor_gives_the_median_of_chi2() {
        let rows: Vec<Row> =
            (0..41).map(|k| Row { value: 0.0, sigma: 0.5 + 0.05 * f64::from(k % 7), frame: 0, star: 0, point: None }).collect();
        let pairs: Vec<(f64, &Row)> = rows.iter().enumerate().map(|(k, row)| (0.11 * (k as f64 - 19.5), row)).collect();
        let noise = within(&pairs, 1.0);
        assert!(noise.floor > 0.0 && noise.factor == 1.0, "{noise:?}");
        let mut squares: Vec<f64> = pairs.iter().map(|(rest, row)| rest * rest / noise.variance(row)).collect();
        let median = median_in_place(&mut squares).unwrap();
        assert!((median - MEDIAN_CHI2).abs() < 1e-9, "{median}");
    }

    /// Means whose squares are five times what their variances say: four fifths are shared.
    #[test]
    fn what_groups_share_is_found() {
        for count in [4_u32, 19, 45] {
            let means: Vec<(f64, f64)> = (0..count).map(|k| (if k % 2 == 0 { 5.0_f64.sqrt() } else { -5.0_f64.sqrt() }, 1.0)).collect();
            let middle = crate::statistics::median(&means.iter().map(|(mean, _)| *mean).collect::<Vec<_>>()).unwrap();
            let shared = between(&means);
            let kept = means.len() - means.len() / 20;
            let mut squares: Vec<f64> = means.iter().map(|(mean, variance)| (mean - middle).powi(2) / (variance + shared)).collect();
            squares.sort_by(f64::total_cmp);
            let cut = if count >= 20 { 0.81 } else { 1.0 };
            let mean = squares[..kept].iter().sum::<f64>() / (kept as f64 * cut) * f64::from(count) / f64::from(count - 1);
            assert!((mean - 1.0).abs() < 1e-9, "{count}: {mean}");
        }
        assert_eq!(between(&[(0.5, 1.0), (-0.5, 1.0), (0.2, 1.0), (-0.1, 1.0)]), 0.0);
    }
}
