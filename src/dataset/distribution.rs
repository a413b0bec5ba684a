//! How a value is drawn: from numbers that are even between 0 and 1 to a value of the scene.

use hifitime::{Epoch, Unit};
use statrs::function::erf::{erf, erf_inv};
use toml::Value;

use super::scene_path::PlaceKind;

/// A distribution, checked and ready.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Distribution {
    /// Between two numbers.
    Uniform([f64; 2]),
    /// The same in the logarithm; the logarithms of the ends.
    LogUniform([f64; 2]),
    /// Mean, standard deviation, and the probabilities between which it is drawn.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation.
        sigma: f64,
        /// Probabilities of the ends.
        within: [f64; 2],
    },
    /// Values, and the probability that one of those up to and with each is taken.
    Choice(Vec<(Value, f64)>),
    /// A vector within a ball of this radius.
    Ball(f64),
    /// A vector of this length.
    Shell(f64),
    /// A direction.
    Sky {
        /// The lowest altitude above the horizon of the site, if there is one.
        lowest_altitude_deg: Option<f64>,
    },
    /// Probabilities and values, both rising.
    Quantiles(Vec<[f64; 2]>),
    /// Between two times.
    Times([Epoch; 2]),
    /// On with this probability.
    Probability(f64),
}

/// Where a normal distribution without `within` is cut, in standard deviations.
pub(super) const MAX_SIGMAS: f64 = 5.0;

/// The probability that a normal number is below this many standard deviations.
pub(super) fn normal_probability(sigmas: f64) -> f64 {
    0.5 * (1.0 + erf(sigmas / std::f64::consts::SQRT_2))
}

/// To twelve digits: what is drawn stands in a scene file as it is used, and a last digit that depends on a machine's library of functions does not
/// count.
pub(super) fn rounded(number: f64) -> f64 {
    format!("{number:.11e}").parse().unwrap_or(number)
}

fn number(value: f64, kind: &PlaceKind) -> Value {
    match kind {
        PlaceKind::Integer => Value::Integer(value.round() as i64),
        _ => Value::Float(rounded(value)),
    }
}

fn numbers(values: &[f64]) -> Value {
    Value::Array(values.iter().map(|value| Value::Float(rounded(*value))).collect())
}

impl Distribution {
    /// The value at numbers from 0 to 1, one for each dimension.
    pub(super) fn value(&self, unit: &dyn Fn(u32) -> f64, kind: &PlaceKind) -> Value {
        let between = |[low, high]: [f64; 2], at: f64| low + at * (high - low);
        match self {
            Self::Uniform([low, high]) if *kind == PlaceKind::Integer => {
                // The last of the whole numbers as often as the others.
                number((low + unit(0) * (high - low + 1.0)).floor().min(*high), kind)
            }
            Self::Uniform(ends) => number(between(*ends, unit(0)), kind),
            Self::LogUniform(ends) => number(between(*ends, unit(0)).exp(), kind),
            Self::Normal { mean, sigma, within } => {
                let probability = between(*within, unit(0));
                number(mean + sigma * std::f64::consts::SQRT_2 * erf_inv(2.0 * probability - 1.0), kind)
            }
            Self::Choice(values) => {
                let at = unit(0);
                let place = values.partition_point(|(_, up_to)| *up_to <= at).min(values.len() - 1);
                values[place].0.clone()
            }
            Self::Ball(radius) => {
                let length = radius * unit(0).cbrt();
                numbers(&direction(unit(1), unit(2)).map(|component| length * component))
            }
            Self::Shell(radius) => numbers(&direction(unit(0), unit(1)).map(|component| radius * component)),
            Self::Sky { .. } => radec_deg(direction(unit(0), unit(1))),
            Self::Quantiles(quantiles) => {
                let at = unit(0);
                let next = quantiles.partition_point(|[probability, _]| *probability <= at).clamp(1, quantiles.len() - 1);
                let ([p0, v0], [p1, v1]) = (quantiles[next - 1], quantiles[next]);
                number(between([v0, v1], ((at - p0) / (p1 - p0)).clamp(0.0, 1.0)), kind)
            }
            Self::Times([from, to]) => {
                let milliseconds = (unit(0) * (*to - *from).to_unit(Unit::Millisecond)).round();
                Value::String((*from + milliseconds * Unit::Millisecond).to_isoformat() + "Z")
            }
            Self::Probability(probability) => Value::Boolean(unit(0) < *probability),
        }
    }
}

/// A direction, even over the sphere, from two numbers.
pub(super) fn direction(height: f64, turn: f64) -> [f64; 3] {
    let z = 2.0 * height - 1.0;
    let ring = (1.0 - z * z).max(0.0).sqrt();
    let (sine, cosine) = (std::f64::consts::TAU * turn).sin_cos();
    [ring * cosine, ring * sine, z]
}

/// Right ascension and declination as a scene has them.
pub(super) fn radec_deg([x, y, z]: [f64; 3]) -> Value {
    let (ra, dec) = (y.atan2(x).rem_euclid(std::f64::consts::TAU), z.atan2(x.hypot(y)));
    numbers(&[ra.to_degrees(), dec.to_degrees()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::chance::AddressedChance;

    /// Values of a distribution in rising order.
    fn drawn(distribution: &Distribution, count: u64) -> Vec<f64> {
        let chance = AddressedChance::new(5, 0, "test");
        let value = |index| distribution.value(&|number| chance.uniform(index, number), &PlaceKind::Number).as_float().unwrap();
        let mut values: Vec<f64> = (0..count).map(value).collect();
        values.sort_by(f64::total_cmp);
        values
    }

    /// Holds values against a distribution function: the largest distance is that of chance (Kolmogorov and Smirnov; 1.95/√n is passed once in 1000).
    fn follows(values: &[f64], below: impl Fn(f64) -> f64) -> bool {
        let count = values.len() as f64;
        let farthest = values.iter().enumerate().map(|(rank, value)| ((rank as f64 + 0.5) / count - below(*value)).abs());
        farthest.fold(0.0, f64::max) < 1.95 / count.sqrt()
    }

    #[test]
    fn values_follow_their_distributions() {
        let uniform = drawn(&Distribution::Uniform([-2.0, 6.0]), 4000);
        assert!(follows(&uniform, |x| (x + 2.0) / 8.0));
        assert!(!follows(&uniform, |x| (x + 2.2) / 8.0), "the test can fail");
        let log = drawn(&Distribution::LogUniform([0.01_f64.ln(), 100.0_f64.ln()]), 4000);
        assert!(follows(&log, |x| (x / 0.01).ln() / 1e4_f64.ln()));
        let within = [normal_probability(-1.0), normal_probability(2.0)];
        let normal = drawn(&Distribution::Normal { mean: 10.0, sigma: 3.0, within }, 4000);
        assert!(normal[0] >= 7.0 && normal[3999] <= 16.0);
        assert!(follows(&normal, |x| (normal_probability((x - 10.0) / 3.0) - within[0]) / (within[1] - within[0])));
        let quantiles = drawn(&Distribution::Quantiles(vec![[0.0, 1.0], [0.25, 2.0], [1.0, 10.0]]), 4000);
        assert!(follows(&quantiles, |x| if x < 2.0 { 0.25 * (x - 1.0) } else { 0.25 + 0.75 * (x - 2.0) / 8.0 }));
    }

    #[test]
    fn vectors_are_even_in_ball_and_sphere() {
        let chance = AddressedChance::new(6, 0, "test");
        let of = |distribution: &Distribution| -> Vec<Vec<f64>> {
            let vector = |index| distribution.value(&|number| chance.uniform(index, number), &PlaceKind::Numbers(Some(3)));
            let floats = |value: Value| value.as_array().unwrap().iter().map(|x| x.as_float().unwrap()).collect();
            (0..4000).map(|index| floats(vector(index))).collect()
        };
        let sorted = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values
        };
        let length = |v: &Vec<f64>| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let ball = of(&Distribution::Ball(2.0));
        assert!(follows(&sorted(ball.iter().map(length).collect()), |r| (r / 2.0).powi(3)));
        let shell = of(&Distribution::Shell(7.0));
        assert!(shell.iter().all(|v| (length(v) - 7.0).abs() < 1e-9));
        for axis in 0..3 {
            assert!(follows(&sorted(shell.iter().map(|v| v[axis]).collect()), |x| (x + 7.0) / 14.0), "axis {axis}");
        }
        let sky = of(&Distribution::Sky { lowest_altitude_deg: None });
        assert!(follows(&sorted(sky.iter().map(|v| v[0]).collect()), |ra| ra / 360.0));
        assert!(follows(&sorted(sky.iter().map(|v| v[1]).collect()), |dec| 0.5 * (1.0 + dec.to_radians().sin())));
    }

    #[test]
    fn choices_whole_numbers_times_and_switches_keep_their_shares() {
        let chance = AddressedChance::new(7, 0, "test");
        let share = |distribution: &Distribution, kind: &PlaceKind, wanted: &Value| {
            let is_wanted = |index: &u64| distribution.value(&|number| chance.uniform(*index, number), kind) == *wanted;
            (0..10_000).filter(is_wanted).count() as f64 / 1e4
        };
        let choice = Distribution::Choice(vec![(Value::from("a"), 0.2), (Value::from("b"), 1.0)]);
        assert!((share(&choice, &PlaceKind::Text, &Value::from("a")) - 0.2).abs() < 0.02);
        for whole in [3, 4, 5] {
            let found = share(&Distribution::Uniform([3.0, 5.0]), &PlaceKind::Integer, &Value::Integer(whole));
            assert!((found - 1.0 / 3.0).abs() < 0.025, "{whole}: {found}");
        }
        assert!((share(&Distribution::Probability(0.15), &PlaceKind::Effect, &Value::Boolean(true)) - 0.15).abs() < 0.018);
        let times = Distribution::Times(["2026-01-01T00:00:00Z", "2026-01-01T00:00:10Z"].map(|text| text.parse().unwrap()));
        assert_eq!(times.value(&|_| 0.25, &PlaceKind::Text), Value::from("2026-01-01T00:00:02.500000Z"));
    }
}
