//! The noise of the rows of a kind, from their residuals: a factor or a floor of the stated variances, and what the rows of a group share.

use super::rows::{Kind, KindNoise, Row, Shared};
use crate::statistics::median_in_place;

/// Degrees of freedom of the t distribution of the errors.
pub(super) const TAIL_DEGREES: f64 = 6.0;
/// Median of χ² of one degree of freedom.
const MEDIAN_CHI2: f64 = 0.454_936;
/// Squares of residuals count so much at most, in variances: 1.5 standard errors.
const CUT_CHI2: f64 = 2.25;
/// A share of a variance that is none.
const NO_FLOOR: f64 = 1e-3;
/// Mean of χ² of one degree of freedom that is cut there.
const MEAN_CUT_CHI2: f64 = 0.778_465;
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

/// Factor and floor of the variance of rows. With v = σ² + f and z² = r²/v the floor f solves Σ (min(z², c²)/k − 1)/v = 0, k the mean of min(z², c²) of a
/// normal deviate: the most likely floor, but that no row counts for more than one of c standard errors (Huber, *Robust Statistics* (1981), 5.2, proposal
/// 2). The rows that tell most tell it, those of the bright stars: the floor that gives the median of χ² follows the typical, faint ones, and is by chance
/// as large as the variance of bright ones where there is none.
fn within(pairs: &[(f64, &Row)], dof: f64) -> KindNoise {
    let score = |floor: f64| -> f64 {
        let of = |(rest, row): &(f64, &Row)| {
            let variance = row.sigma * row.sigma + floor;
            ((rest * rest / (variance * dof)).min(CUT_CHI2) / MEAN_CUT_CHI2 - 1.0) / variance
        };
        pairs.iter().map(of).sum()
    };
    // Floors differ by orders of magnitude: it is looked for in its logarithm, from where it would be nothing to the smallest variance.
    let least = NO_FLOOR * pairs.iter().map(|(_, row)| row.sigma * row.sigma).fold(f64::INFINITY, f64::min);
    let at_least = if pairs.is_empty() { 0.0 } else { score(least) };
    if at_least > 0.0 {
        // With so much more no square is above its mean.
        let high = pairs.iter().map(|(rest, _)| rest * rest / dof).fold(least, f64::max) / MEAN_CUT_CHI2;
        let floor = root_between([least.ln(), high.ln()], [at_least, score(high)], |logarithm| score(logarithm.exp())).exp();
        return KindNoise { floor, ..KindNoise::STATED };
    }
    let mut ratios: Vec<f64> = pairs.iter().map(|(rest, row)| rest * rest / (row.sigma * row.sigma)).collect();
    let stated = median_in_place(&mut ratios).map_or(1.0, |median| median / (MEDIAN_CHI2 * dof));
    KindNoise { factor: stated.clamp(0.25, 1.0), ..KindNoise::STATED }
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
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Rows of stars from bright to faint, more of these, whose errors are as stated but for a floor; one in twenty is off by ten.
    fn scattered(seed: u64, floor: f64, has_outliers: bool) -> Vec<(f64, Row)> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let of = |_| {
            let magnitude = (1.0 + 62.0 * rng.random::<f64>()).log10() / 0.45;
            let row = Row { value: 0.0, sigma: 0.01 * 2.0_f64.powf(magnitude), frame: 0, star: 0, point: None };
            let draw: f64 = StandardNormal.sample(&mut rng);
            let far = if has_outliers && rng.random::<f64>() < 0.05 { 10.0 } else { 1.0 };
            (draw.signum() * draw.abs().max(if far > 1.0 { 1.0 } else { 0.0 }) * far * row.sigma.hypot(floor), row)
        };
        (0..400).map(of).collect()
    }

    /// Half of the floors that are found are too small, and where there is none the rows keep nearly all of what they tell, whatever some of them do.
    #[test]
    fn the_floor_is_found_and_no_other() {
        const SEEDS: u64 = 200;
        let of = |floor: f64, has_outliers: bool| -> [f64; 2] {
            let (mut floors, mut kept) = (Vec::new(), 0.0);
            for seed in 0..SEEDS {
                let all = scattered(seed, floor, has_outliers);
                let noise = within(&all.iter().map(|(rest, row)| (*rest, row)).collect::<Vec<_>>(), 1.0);
                floors.push(noise.floor);
                let told = |more: f64| all.iter().map(|(_, row)| (row.sigma.powi(2) + more).recip()).sum::<f64>();
                kept += told(noise.floor) / told(0.0);
            }
            [crate::statistics::median(&floors).unwrap(), kept / SEEDS as f64]
        };
        let [_, kept] = of(0.0, false);
        let [_, kept_beside] = of(0.0, true);
        let [found, _] = of(0.01, false);
        println!("where there is no floor {kept:.3} are kept, {kept_beside:.3} beside outliers; {found:.2e} is found for 1e-4");
        // By the median: 0.89 and 0.69.
        assert!(kept > 0.92 && kept_beside > 0.8, "{kept}, {kept_beside}");
        assert!((found / 1e-4 - 1.0).abs() < 0.15, "{found:.2e}");
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
