//! What was measured over frames, by the kind of its statistics, and the bounds of its true value.

use super::components::{Stratum, component};
use super::intervals::{Bounded, Risk, fisher_f, mean, mean_square, quantile, share, student_t};

/// Sums of one independent unit, mostly a frame: stars of one frame share its attitude and its clouds.
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
    /// A share of stars; those of one unit hang together.
    ShareOfStars(Vec<Unit>),
    /// A quantile of a quantity, one value a frame.
    Quantile {
        /// The values, in any order.
        values: Vec<f64>,
        /// From 0 to 1.
        share: f64,
    },
    /// The mean, one value a frame.
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
            Self::ShareOfStars(units) | Self::RootMeanSquare { units, .. } => units.iter().filter(|unit| unit.count > 0.0).count(),
            Self::Quantile { values, .. } | Self::Mean(values) | Self::Largest(values) => values.len(),
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
            Self::ShareOfStars(units) => share_of_stars(units, risk),
            Self::Quantile { values, share } => {
                let mut sorted = values.clone();
                sorted.sort_by(f64::total_cmp);
                quantile(&sorted, *share, risk)
            }
            Self::Mean(values) => {
                let (middle, error) = mean_of(values);
                mean(middle, error, values.len() as f64 - 1.0, risk)
            }
            Self::Bias(axes) => bias(axes, risk),
            Self::RootMeanSquare { units, factor } => {
                let (square, freedom) = mean_square_of(units);
                rooted(scaled(mean_square(square, freedom, risk), *factor))
            }
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

/// The mean square of all, and its degrees of freedom: as many as numbers if they are normal and independent, fewer where the sums of the units
/// scatter more than those of such numbers would (heavy tails, numbers that hang together): Satterthwaite, Biometrics Bulletin 2, 110 (1946).
fn mean_square_of(units: &[Unit]) -> (f64, f64) {
    let numbers: f64 = units.iter().map(|unit| unit.count).sum();
    let square = units.iter().map(|unit| unit.sum).sum::<f64>() / numbers;
    let variance = ratio_variance(units, square, numbers);
    let freedom = if variance > 0.0 { (2.0 * square * square / variance).min(numbers) } else { numbers };
    (square, freedom)
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

/// Stars of one frame are worth fewer trials where they are hit or missed together: trials are divided by the ratio of the variance over frames to the
/// binomial one (the design effect: Kish, *Survey Sampling*, 1965). Without a hit, or without a miss, nothing tells that ratio, and a frame is one trial.
fn share_of_stars(units: &[Unit], risk: Risk) -> Bounded {
    let trials: f64 = units.iter().map(|unit| unit.count).sum();
    let hits: f64 = units.iter().map(|unit| unit.sum).sum();
    let frames = units.iter().filter(|unit| unit.count > 0.0).count() as f64;
    let ratio = hits / trials;
    let binomial = ratio * (1.0 - ratio) / trials;
    let effect = if binomial > 0.0 { (ratio_variance(units, ratio, trials) / binomial).max(1.0) } else { f64::INFINITY };
    let worth = if effect.is_finite() { (trials / effect).max(frames.min(trials) * 0.5) } else { frames };
    share(ratio * worth, worth, risk)
}
