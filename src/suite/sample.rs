//! What was measured over frames, by the kind of its statistics, and the bounds of its true value.

use std::collections::{BTreeMap, BTreeSet};

use super::components::{Stratum, component};
use super::intervals::{Bounded, Risk, fisher_f, interpolated, mean_square, quantile, share, skewed_mean, student_t};

/// Sums of one independent unit, mostly a frame: stars of one frame share its attitude and its clouds. Frames of one field or of one sequence share a part
/// of their errors: there these are the units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// Sum of what is measured: hits, squares.
    pub sum: f64,
    /// Over how many: trials, numbers that were squared.
    pub count: f64,
}

/// A measured quantity.
#[derive(Clone, Debug, PartialEq)]
pub enum MetricSample {
    /// A share of frames: each is a hit or none.
    Share {
        /// Frames that are a hit.
        hits: u64,
        /// Frames.
        trials: u64,
    },
    /// A share of stars, or of frames that share a part of their errors; those of one unit hang together.
    ClusteredShare(Vec<Unit>),
    /// A quantile of a quantity, one value a frame.
    Quantile {
        /// Of each value the number of its unit.
        units: Vec<usize>,
        /// The values, in any order.
        values: Vec<f64>,
        /// From 0 to 1.
        share: f64,
    },
    /// The mean, one value a unit.
    Mean(Vec<f64>),
    /// The length of the mean vector: one list of values an axis. With one axis, the size of the mean.
    Bias(Vec<Vec<f64>>),
    /// The root of the mean square, or of its product with the factor.
    RootMeanSquare {
        /// Sums of squares and how many numbers were squared.
        units: Vec<Unit>,
        /// By what the mean square is multiplied (2 where it is of one axis and both together are asked for).
        factor: f64,
    },
    /// A component of variance, worked out with its bounds by `components`: the bounds at a risk.
    Component {
        /// Mean squares and degrees of freedom, from the innermost level on.
        strata: Vec<Stratum>,
        /// Which level.
        level: usize,
    },
    /// The largest value: a statement of the frames that were run, and of no others.
    Largest(Vec<f64>),
}

impl MetricSample {
    /// How many independent units there are.
    #[must_use]
    pub fn units(&self) -> usize {
        match self {
            Self::Share { trials, .. } => *trials as usize,
            Self::ClusteredShare(units) | Self::RootMeanSquare { units, .. } => units.iter().filter(|unit| unit.count > 0.0).count(),
            Self::Quantile { units, .. } => distinct(units),
            Self::Mean(values) | Self::Largest(values) => values.len(),
            Self::Bias(axes) => axes.first().map_or(0, Vec::len),
            Self::Component { strata, .. } => strata.iter().map(|stratum| stratum.freedom as usize).sum::<usize>() + 1,
        }
    }

    /// The value with its bounds; `None` where nothing was measured.
    #[must_use]
    pub fn bounds(&self, risk: Risk) -> Option<Bounded> {
        if self.units() == 0 {
            return None;
        }
        Some(match self {
            Self::Share { hits, trials } => share(*hits as f64, *trials as f64, risk),
            Self::ClusteredShare(units) => clustered_share(units, risk),
            Self::Quantile { units, values, share } => {
                let mut sorted = values.clone();
                sorted.sort_by(f64::total_cmp);
                quantile(&sorted, worth(units, values, *share), *share, risk)
            }
            Self::Mean(values) => {
                let (middle, _) = mean_of(values);
                skewed_mean(middle, &values.iter().map(|value| value - middle).collect::<Vec<_>>(), risk)
            }
            Self::Bias(axes) => bias(axes, risk),
            Self::RootMeanSquare { units, factor } => rooted(scaled(mean_square_of(units, risk), *factor)),
            Self::Component { strata, level } => rooted(component(strata, *level, risk)),
            Self::Largest(values) => {
                let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                Bounded { value: largest, lower: largest, upper: largest }
            }
        })
    }
}

fn scaled(bounded: Bounded, factor: f64) -> Bounded {
    Bounded { value: bounded.value * factor, lower: bounded.lower * factor, upper: bounded.upper * factor }
}

fn rooted(square: Bounded) -> Bounded {
    Bounded { value: square.value.max(0.0).sqrt(), lower: square.lower.max(0.0).sqrt(), upper: square.upper.max(0.0).sqrt() }
}

/// Mean and its standard error.
fn mean_of(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let middle = values.iter().sum::<f64>() / count;
    let square = values.iter().map(|value| (value - middle).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    (middle, (square / count).sqrt())
}

/// The length of a mean vector. Its upper bound is that of the component along it, which is never longer than the whole; the lower bound allows for any
/// direction (Hotelling, Ann. Math. Statist. 2, 360, 1931, with the variance along the mean vector).
fn bias(axes: &[Vec<f64>], risk: Risk) -> Bounded {
    let (count, parts) = (axes.first().map_or(0, Vec::len), axes.len() as f64);
    let middle: Vec<f64> = axes.iter().map(|values| mean_of(values).0).collect();
    let length = middle.iter().map(|own| own * own).sum::<f64>().sqrt();
    let along = |index: usize| -> f64 {
        let product: f64 = axes.iter().zip(&middle).map(|(values, own)| values[index] * own).sum();
        if length > 0.0 { product / length } else { axes[0][index] }
    };
    let (_, error) = mean_of(&(0..count).map(along).collect::<Vec<_>>());
    let freedom = count as f64 - parts;
    if freedom < 1.0 {
        return Bounded { value: length, lower: 0.0, upper: f64::INFINITY };
    }
    let any_direction = (parts * fisher_f(1.0 - risk.lower, parts, freedom)).sqrt();
    Bounded {
        value: length,
        lower: (length - any_direction * error).max(0.0),
        upper: length + student_t(1.0 - risk.upper, freedom) * error,
    }
}

/// The mean square of all. Its degrees of freedom are as many as numbers if they are normal and independent, fewer where the sums of the units scatter
/// more than those of such numbers would (heavy tails, numbers that hang together): Satterthwaite, Biometrics Bulletin 2, 110 (1946). That scatter is
/// itself found from the units, and small where the mean square is: no bound is nearer than that of a skewed mean over the units.
fn mean_square_of(units: &[Unit], risk: Risk) -> Bounded {
    let full: Vec<&Unit> = units.iter().filter(|unit| unit.count > 0.0).collect();
    let numbers: f64 = full.iter().map(|unit| unit.count).sum();
    let square = full.iter().map(|unit| unit.sum).sum::<f64>() / numbers;
    let variance = ratio_variance(units, square, numbers);
    let freedom = if variance > 0.0 { (2.0 * square * square / variance).min(numbers) } else { numbers };
    let by_numbers = mean_square(square, freedom, risk);
    let each = numbers / full.len() as f64;
    let deviations: Vec<f64> = full.iter().map(|unit| (unit.sum - square * unit.count) / each).collect();
    let by_units = skewed_mean(square, &deviations, risk);
    Bounded { value: square, lower: by_numbers.lower.min(by_units.lower), upper: by_numbers.upper.max(by_units.upper) }
}

/// The variance of Σ sum / Σ count over independent units.
fn ratio_variance(units: &[Unit], ratio: f64, numbers: f64) -> f64 {
    let full: Vec<&Unit> = units.iter().filter(|unit| unit.count > 0.0).collect();
    let count = full.len() as f64;
    if count < 2.0 {
        return f64::NAN;
    }
    let squares: f64 = full.iter().map(|unit| (unit.sum - ratio * unit.count).powi(2)).sum();
    squares / (numbers * numbers) * count / (count - 1.0)
}

/// Trials of one unit are worth fewer where they are hit or missed together: they are divided by the ratio of the variance over units to the binomial one
/// (the design effect: Kish, *Survey Sampling*, 1965). Without a hit, or without a miss, nothing tells that ratio, and a unit is one trial.
fn clustered_share(units: &[Unit], risk: Risk) -> Bounded {
    let trials: f64 = units.iter().map(|unit| unit.count).sum();
    let ratio = units.iter().map(|unit| unit.sum).sum::<f64>() / trials;
    let worth = worth_of(units, ratio, trials);
    share(ratio * worth, worth, risk)
}

/// How many independent trials the trials of these units are worth.
fn worth_of(units: &[Unit], ratio: f64, trials: f64) -> f64 {
    let count = units.iter().filter(|unit| unit.count > 0.0).count() as f64;
    let binomial = ratio * (1.0 - ratio) / trials;
    let effect = if binomial > 0.0 { (ratio_variance(units, ratio, trials) / binomial).max(1.0) } else { f64::INFINITY };
    if effect.is_finite() { (trials / effect).max(count.min(trials) * 0.5) } else { count }
}

/// The same of values beside a quantile of them.
pub(super) fn worth(units: &[usize], values: &[f64], share: f64) -> usize {
    if distinct(units) == values.len() {
        return values.len();
    }
    let cut = {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        interpolated(&sorted, share)
    };
    let mut sums: BTreeMap<usize, Unit> = BTreeMap::new();
    for (unit, value) in units.iter().zip(values) {
        let sum = sums.entry(*unit).or_insert(Unit { sum: 0.0, count: 0.0 });
        (sum.sum, sum.count) = (sum.sum + f64::from(u8::from(*value <= cut)), sum.count + 1.0);
    }
    let (sums, trials): (Vec<Unit>, f64) = (sums.into_values().collect(), values.len() as f64);
    let ratio = sums.iter().map(|unit| unit.sum).sum::<f64>() / trials;
    (worth_of(&sums, ratio, trials) as usize).max(1)
}

fn distinct(units: &[usize]) -> usize {
    units.iter().collect::<BTreeSet<_>>().len()
}
