//! One-sided confidence bounds: Clopper–Pearson for shares, Student's t for means, χ² for mean squares, order statistics for quantiles.
//!
//! Bounds of shares and quantiles are exact or err to the safe side: an upper bound lies below the true value with a probability of at most `alpha`. Those of
//! means and mean squares are exact for normal quantities, and near for skewed ones.
//! Clopper & Pearson, Biometrika 26, 404 (1934); order statistics: David & Nagaraja, *Order Statistics* (2003), 7.1.

use statrs::function::beta::{beta_reg, inv_beta_reg};
use statrs::function::gamma::{gamma_lr, gamma_ur};

/// A value with a lower and an upper one-sided bound; without a bound on a side, infinite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounded {
    /// The estimate.
    pub value: f64,
    /// The true value lies below this with a probability of at most that of the lower side.
    pub lower: f64,
    /// The true value lies above this with a probability of at most that of the upper side.
    pub upper: f64,
}

/// The probability of an error on each side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Risk {
    /// That the true value lies below the lower bound.
    pub lower: f64,
    /// That it lies above the upper bound.
    pub upper: f64,
}

/// The share of hits among trials (Clopper–Pearson); both need not be whole numbers, where trials are worth less than one each.
#[must_use]
pub(super) fn share(hits: f64, trials: f64, risk: Risk) -> Bounded {
    let misses = trials - hits;
    let lower = if hits <= 0.0 { 0.0 } else { inv_beta_reg(hits, misses + 1.0, risk.lower) };
    let upper = if misses <= 0.0 { 1.0 } else { inv_beta_reg(hits + 1.0, misses, 1.0 - risk.upper) };
    Bounded { value: if trials > 0.0 { hits / trials } else { f64::NAN }, lower, upper }
}

/// The probability of at most `k` hits among `n` trials of probability `p`.
#[must_use]
pub(super) fn binomial_at_most(k: u64, n: u64, p: f64) -> f64 {
    if k >= n { 1.0 } else { beta_reg((n - k) as f64, k as f64 + 1.0, 1.0 - p) }
}

/// A quantile between order statistics; `values` are sorted, and worth `worth` independent ones. Without enough of them a side has no bound.
#[must_use]
pub(super) fn quantile(values: &[f64], worth: usize, share: f64, risk: Risk) -> Bounded {
    let count = worth as u64;
    // Ranks among the independent ones are shares of all.
    let of_all = |rank: u64| rank as f64 * values.len() as f64 / worth as f64;
    let least = |wanted: &dyn Fn(u64) -> bool| {
        let (mut low, mut high) = (1, count + 1);
        while low < high {
            let middle = u64::midpoint(low, high);
            if wanted(middle) {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        low
    };
    // The number of values below the quantile is binomial.
    let above = least(&|rank| binomial_at_most(rank - 1, count, share) >= 1.0 - risk.upper);
    let upper = if above > count { f64::INFINITY } else { values[(of_all(above).ceil() as usize).min(values.len()) - 1] };
    // The largest rank of which at least so many values lie below the quantile.
    let beyond = least(&|rank| 1.0 - binomial_at_most(rank - 1, count, share) < 1.0 - risk.lower);
    let lower = if beyond <= 1 { f64::NEG_INFINITY } else { values[(of_all(beyond - 1).floor() as usize).max(1) - 1] };
    Bounded { value: interpolated(values, share), lower, upper }
}

/// The quantile of sorted values, between neighbours in proportion.
pub(super) fn interpolated(values: &[f64], share: f64) -> f64 {
    let Some(last) = values.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    let below = (place.floor() as usize).min(last);
    let above = (below + 1).min(last);
    values[below] + (place - below as f64) * (values[above] - values[below])
}

/// The mean of a normal quantity with its standard error and degrees of freedom.
#[must_use]
pub(super) fn mean(value: f64, standard_error: f64, freedom: f64, risk: Risk) -> Bounded {
    if freedom < 1.0 {
        return Bounded { value, lower: f64::NEG_INFINITY, upper: f64::INFINITY };
    }
    Bounded {
        value,
        lower: value - student_t(1.0 - risk.lower, freedom) * standard_error,
        upper: value + student_t(1.0 - risk.upper, freedom) * standard_error,
    }
}

/// The mean of a quantity that may be skewed, from the deviations of its values, which sum to nothing: Student's t of what a cubic transformation has made
/// symmetrical (Hall, J. R. Statist. Soc. B 54, 221, 1992). Without it a mean that came out small has a small error too, and its upper bound is broken
/// too often.
#[must_use]
pub(super) fn skewed_mean(value: f64, deviations: &[f64], risk: Risk) -> Bounded {
    let count = deviations.len() as f64;
    let moment = |power: i32| deviations.iter().map(|own| own.powi(power)).sum::<f64>() / count;
    let square = moment(2);
    if count < 3.0 || square <= 0.0 {
        return mean(value, (square / (count - 1.0).max(1.0)).sqrt(), count - 1.0, risk);
    }
    let scatter = (square * count / (count - 1.0)).sqrt();
    let skewness = moment(3) / square.powf(1.5) * (count * (count - 1.0)).sqrt() / (count - 2.0);
    // Where the transformed difference of the mean from the truth, over the scatter, is x.
    let difference = |x: f64| {
        if skewness.abs() < 1e-6 { x } else { 3.0 / skewness * ((1.0 + skewness * (x - skewness / (6.0 * count))).cbrt() - 1.0) }
    };
    let [lower, upper] = [risk.lower, risk.upper].map(|risk| student_t(1.0 - risk, count - 1.0) / count.sqrt());
    Bounded { value, lower: value - scatter * difference(lower), upper: value - scatter * difference(-upper) }
}

/// A mean square with its degrees of freedom.
#[must_use]
pub(super) fn mean_square(value: f64, freedom: f64, risk: Risk) -> Bounded {
    if freedom < 1.0 {
        return Bounded { value, lower: 0.0, upper: f64::INFINITY };
    }
    Bounded {
        value,
        lower: value * freedom / chi_squared(1.0 - risk.lower, freedom),
        upper: value * freedom / chi_squared(risk.upper, freedom),
    }
}

/// The quantile of Student's t.
#[must_use]
pub(super) fn student_t(share: f64, freedom: f64) -> f64 {
    if share < 0.5 {
        return -student_t(1.0 - share, freedom);
    }
    let y = inv_beta_reg(0.5 * freedom, 0.5, 2.0 * (1.0 - share));
    // Near the middle y goes to 1, where nothing is left of 1 − y.
    if y < 1.0 { (freedom * (1.0 - y) / y).sqrt() } else { 0.0 }
}

/// The quantile of χ², by bisection.
#[must_use]
pub(super) fn chi_squared(share: f64, freedom: f64) -> f64 {
    let half = 0.5 * freedom;
    // The smaller tail has more digits.
    let is_below = |x: f64| if share < 0.5 { gamma_lr(half, 0.5 * x) < share } else { gamma_ur(half, 0.5 * x) > 1.0 - share };
    let spread = (2.0 * freedom).sqrt();
    crossing(0.0, freedom + 10.0 * spread + 60.0, is_below)
}

/// Where `is_below` turns from true to false between two numbers, by bisection to the last digits.
fn crossing(mut low: f64, mut high: f64, is_below: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        if middle <= low || middle >= high {
            break;
        }
        if is_below(middle) {
            low = middle;
        } else {
            high = middle;
        }
        if high - low < 1e-12 * high {
            break;
        }
    }
    f64::midpoint(low, high)
}

/// The quantile of Fisher's F, by bisection; `below` degrees of freedom in the denominator, infinite ones included.
#[must_use]
pub(super) fn fisher_f(share: f64, above: f64, below: f64) -> f64 {
    if below.is_infinite() {
        return chi_squared(share, above) / above;
    }
    let is_below = |x: f64| {
        let y = above * x / above.mul_add(x, below);
        beta_reg(0.5 * above, 0.5 * below, y) < share
    };
    let mut high = 1.0;
    while is_below(high) && high < 1e12 {
        high *= 2.0;
    }
    crossing(0.0, high, is_below)
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    const FIVE: Risk = Risk { lower: 0.05, upper: 0.05 };

    /// Values of R 4.2: qbeta, qt, qchisq, qf, pbinom.
    #[test]
    fn quantiles_are_those_of_r() {
        assert_relative_eq!(share(0.0, 299.0, FIVE).upper, 0.009_969_0, max_relative = 1e-4);
        assert_relative_eq!(share(3.0, 20.0, FIVE).lower, 0.042_169, max_relative = 1e-4);
        assert_relative_eq!(share(3.0, 20.0, FIVE).upper, 0.343_663, max_relative = 1e-4);
        assert_relative_eq!(student_t(0.95, 9.0), 1.833_113, max_relative = 1e-5);
        assert_relative_eq!(student_t(0.995, 1.0), 63.656_74, max_relative = 1e-5);
        assert_relative_eq!(student_t(0.5, 5.0), 0.0, epsilon = 1e-6);
        assert_relative_eq!(chi_squared(0.05, 10.0), 3.940_299, max_relative = 1e-6);
        assert_relative_eq!(chi_squared(0.95, 10.0), 18.307_04, max_relative = 1e-6);
        assert_relative_eq!(chi_squared(0.05, 20_000.0), 19_672.01, max_relative = 1e-5);
        assert_relative_eq!(fisher_f(0.95, 3.0, 10.0), 3.708_265, max_relative = 1e-5);
        assert_relative_eq!(fisher_f(0.05, 3.0, f64::INFINITY), 0.117_282, max_relative = 1e-4);
        assert_relative_eq!(binomial_at_most(2, 10, 0.3), 0.382_782_8, max_relative = 1e-6);
    }

    /// The numbers of frames without a failure that show a share, and those that bound a quantile at 95 %.
    #[test]
    fn the_numbers_of_frames_are_those_of_the_tables() {
        for (frames, wanted) in [(299.0, 0.99), (598.0, 0.995), (2995.0, 0.999)] {
            assert!(share(frames, frames, FIVE).lower >= wanted, "{frames}");
            assert!(share(frames - 1.0, frames - 1.0, FIVE).lower < wanted, "{frames}");
        }
        let sorted: Vec<f64> = (0..1109).map(f64::from).collect();
        assert!(quantile(&sorted, sorted.len(), 0.9973, FIVE).upper.is_finite());
        assert!(quantile(&sorted[1..], sorted.len() - 1, 0.9973, FIVE).upper.is_infinite());
    }

    #[test]
    fn bounds_of_quantiles_hold_the_value_between_them() {
        let sorted: Vec<f64> = (1..=100).map(f64::from).collect();
        let median = quantile(&sorted, 100, 0.5, FIVE);
        assert_eq!((median.value, median.lower, median.upper), (50.5, 42.0, 59.0));
        let none = quantile(&sorted[..1], 1, 0.5, FIVE);
        assert_eq!((none.lower, none.upper), (f64::NEG_INFINITY, f64::INFINITY));
    }
}
