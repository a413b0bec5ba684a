//! The noise of the rows of a kind, from their residuals: a factor or a floor of the stated variances, and what the rows of a group share.

use super::rows::{Kind, KindNoise, Row, Shared};
use crate::statistics::median_in_place;

/// Degrees of freedom of the t distribution of the errors.
pub(super) const TAIL_DEGREES: f64 = 6.0;
/// Median of χ² of one degree of freedom.
const MEDIAN_CHI2: f64 = 0.454_936;
/// Mean of a squared residual times its weight, where residuals are standard normal.
const MEAN_WEIGHTED_CHI2: f64 = 0.825_077;
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

/// Factor and floor of the variance of rows. The floor f is the most likely one under the t distribution: with v = σ² + f, square z = r²/v and the weight
/// w = (ν + 1)/(ν + z) of ν degrees of freedom, Σ (w·z/⟨w·z⟩ − 1)/v = 0, ⟨w·z⟩ the mean for normal errors. Rows of bright stars have the small σ and decide. A floor
/// that gives the median of all rows is that of the faint stars, which are the most; its error is as large as the variance of the bright ones.
fn within(pairs: &[(f64, &Row)], dof: f64) -> KindNoise {
    let due = MEDIAN_CHI2 * dof;
    let score = |floor: f64| -> f64 {
        let of = |(rest, row): &(f64, &Row)| {
            let variance = row.sigma * row.sigma + floor;
            let square = rest * rest / (variance * dof);
            ((TAIL_DEGREES + 1.0) * square / ((TAIL_DEGREES + square) * MEAN_WEIGHTED_CHI2) - 1.0) / variance
        };
        pairs.iter().map(of).sum()
    };
    let at_nothing = score(0.0);
    if at_nothing > 0.0 {
        // With so much more every square is below a half.
        let high = 2.0 * pairs.iter().map(|(rest, _)| rest * rest / dof).fold(0.0, f64::max);
        return KindNoise { floor: root_between([0.0, high], [at_nothing, score(high)], score), ..KindNoise::STATED };
    }
    let mut ratios: Vec<f64> = pairs.iter().map(|(rest, row)| rest * rest / (row.sigma * row.sigma)).collect();
    let stated = median_in_place(&mut ratios).map_or(1.0, |median| median / due);
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
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Rows of stars from bright to faint, whose errors are as stated but for a floor.
    fn scattered(seed: u64, floor: f64) -> Vec<(f64, Row)> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let of = |k: i32| {
            let row = Row { value: 0.0, sigma: 0.02 * 1.02_f64.powi(k % 100), frame: 0, star: 0, point: None };
            let draw: f64 = StandardNormal.sample(&mut rng);
            (draw * row.sigma.hypot(floor), row)
        };
        (0..400).map(of).collect()
    }

    /// The floor that gives the median of χ².
    fn by_median(all: &[(f64, Row)]) -> f64 {
        let mut asked: Vec<f64> = all.iter().map(|(rest, row)| rest * rest / MEDIAN_CHI2 - row.sigma * row.sigma).collect();
        median_in_place(&mut asked).unwrap_or(0.0).max(0.0)
    }

    fn most_likely(all: &[(f64, Row)]) -> f64 {
        within(&all.iter().map(|(rest, row)| (*rest, row)).collect::<Vec<_>>(), 1.0).floor
    }

    /// A floor is found without bias. Where there is none the rows keep nearly all of what they tell, and with a floor from the median they do not.
    #[test]
    fn the_floor_is_found_and_no_other() {
        const SEEDS: u64 = 200;
        /// Mean of the floor, and of the share of the information that the rows keep.
        fn mean(floor: f64, found: fn(&[(f64, Row)]) -> f64) -> [f64; 2] {
            let (mut sum, mut kept) = (0.0, 0.0);
            for seed in 0..SEEDS {
                let all = scattered(seed, floor);
                let own = found(&all);
                sum += own;
                let told = |floor: f64| all.iter().map(|(_, row)| (row.sigma.powi(2) + floor).recip()).sum::<f64>();
                kept += told(own) / told(0.0);
            }
            [sum / SEEDS as f64, kept / SEEDS as f64]
        }
        let ([_, kept], [_, by_median]) = (mean(0.0, most_likely), mean(0.0, by_median));
        let [found, _] = mean(0.02, most_likely);
        println!("kept where there is no floor: {kept:.3}, by the median {by_median:.3}; floor {found:.2e} for 4e-4");
        assert!(kept > 0.95 && by_median < 0.9, "{kept}, {by_median}");
        assert!((found / 4e-4 - 1.0).abs() < 0.05, "{found:.2e}");
    }

    /// One bright row in twenty that is far off does not take the weight of all bright ones.
    #[test]
    fn few_rows_far_off_make_a_small_floor() {
        let mut all = scattered(1, 0.0);
        for (rest, row) in all.iter_mut().step_by(20) {
            *rest = 10.0 * row.sigma;
        }
        let floor = most_likely(&all);
        assert!(floor < 1e-3, "{floor:.2e}: a variance of 4e-4 is that of the brightest");
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
