//! What was drawn, held against what was asked for: how many values fell into each of a few parts of a distribution.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use super::distribution::{Distribution, normal_probability};
use super::draws::Draw;
use super::scene_path::PlaceKind;

/// Parts of equal probability that numbers are counted in.
const PARTS: usize = 10;

/// Values of a draw, counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DrawnShares {
    /// The place in the scene.
    pub path: String,
    /// What was asked for, in words.
    pub asked: String,
    /// The share that is expected in each part; empty where none is known.
    pub expected: Vec<f64>,
    /// Values in each part.
    pub counts: Vec<u64>,
    /// Sum of the values; of a vector, of its lengths; 0 for words and directions.
    pub sum: f64,
    /// The smallest of them.
    pub smallest: f64,
    /// The largest of them.
    pub largest: f64,
}

impl DrawnShares {
    pub(super) fn new(draw: &Draw) -> Self {
        let expected = draw.distribution.expected(&draw.path.kind);
        let counts = vec![0; expected.len().max(1)];
        Self { path: draw.path.text.clone(), asked: draw.distribution.words(), expected, counts, ..Self::default() }
    }

    /// How many values there are.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Counts the value that a scene has.
    pub(super) fn add(&mut self, draw: &Draw, scene: &Table) {
        let value = draw.path.get(scene);
        if draw.is_switch() {
            self.counts[usize::from(value.is_none())] += 1;
            return;
        }
        let Some(value) = value else { return };
        let part = draw.distribution.part(value, &draw.path.kind).min(self.counts.len() - 1);
        // Of a direction no number says anything.
        let is_direction = matches!(draw.distribution, Distribution::Sky { .. });
        let number = scalar(value).or_else(|| length(value)).filter(|_| !is_direction);
        if let Some(number) = number {
            let is_first = self.count() == 0;
            self.smallest = if is_first { number } else { self.smallest.min(number) };
            self.largest = if is_first { number } else { self.largest.max(number) };
            self.sum += number;
        }
        self.counts[part] += 1;
    }

    /// Adds what another shard counted.
    pub(super) fn merge(&mut self, other: &Self) {
        if other.count() > 0 {
            let is_first = self.count() == 0;
            self.smallest = if is_first { other.smallest } else { self.smallest.min(other.smallest) };
            self.largest = if is_first { other.largest } else { self.largest.max(other.largest) };
            self.sum += other.sum;
        }
        for (own, more) in self.counts.iter_mut().zip(&other.counts) {
            *own += more;
        }
    }
}

fn scalar(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

fn vector(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(scalar).collect()
}

fn length(value: &Value) -> Option<f64> {
    vector(value).map(|components| components.iter().map(|component| component * component).sum::<f64>().sqrt())
}

impl Distribution {
    /// What it is, in words.
    fn words(&self) -> String {
        match self {
            Self::Uniform([low, high]) => format!("evenly from {low} to {high}"),
            Self::LogUniform(ends) => {
                let [low, high] = ends.map(|end| super::distribution::rounded(end.exp()));
                format!("evenly in the logarithm from {low:.6} to {high:.6}")
            }
            Self::Normal { mean, sigma, .. } => format!("normally, {mean} ± {sigma}"),
            Self::Choice(values) => {
                let values: Vec<String> = values.iter().map(|(value, _)| value.to_string()).collect();
                format!("one of {}", values.join(", "))
            }
            Self::Ball(radius) => format!("in a ball of radius {radius}"),
            Self::Shell(radius) => format!("in all directions, of length {radius}"),
            Self::Sky { lowest_altitude_deg: None } => "over the sky".to_owned(),
            Self::Sky { lowest_altitude_deg: Some(altitude) } => format!("over the sky above {altitude}°"),
            Self::Quantiles(_) => "by a table of quantiles".to_owned(),
            Self::Times([from, to]) => format!("from {} to {}", from.to_isoformat(), to.to_isoformat()),
            Self::Probability(probability) => format!("on with probability {probability}"),
        }
    }

    /// The share that is expected in each part.
    fn expected(&self, kind: &PlaceKind) -> Vec<f64> {
        match self {
            // Whole numbers do not fill parts evenly.
            Self::Uniform([low, high]) if *kind == PlaceKind::Integer => {
                let count = high - low + 1.0;
                let first = |part: usize| (part as f64 / PARTS as f64 * count).ceil();
                (0..PARTS).map(|part| (first(part + 1) - first(part)) / count).collect()
            }
            Self::Choice(values) => {
                let starts = std::iter::once(0.0).chain(values.iter().map(|(_, up_to)| *up_to));
                values.iter().zip(starts).map(|((_, up_to), from)| up_to - from).collect()
            }
            Self::Probability(probability) => vec![*probability, 1.0 - probability],
            // Whole numbers next to these do not fill the parts as the numbers themselves do.
            Self::LogUniform(_) | Self::Normal { .. } | Self::Quantiles(_) if *kind == PlaceKind::Integer => Vec::new(),
            // Splits have parts of the sky.
            Self::Sky { .. } => Vec::new(),
            _ => vec![1.0 / PARTS as f64; PARTS],
        }
    }

    /// The part that a value falls into.
    fn part(&self, value: &Value, kind: &PlaceKind) -> usize {
        let of = |probability: f64| ((probability * PARTS as f64) as usize).min(PARTS - 1);
        let number = scalar(value).unwrap_or_default();
        let at = |[low, high]: [f64; 2], number: f64| (number - low) / (high - low);
        match self {
            Self::Uniform([low, high]) if *kind == PlaceKind::Integer => of((number - low) / (high - low + 1.0)),
            Self::Uniform(ends) => of(at(*ends, number)),
            Self::LogUniform(ends) => of(at(*ends, number.ln())),
            Self::Normal { mean, sigma, within } => of(at(*within, normal_probability((number - mean) / sigma))),
            Self::Choice(values) => values.iter().position(|(own, _)| own == value).unwrap_or_default(),
            Self::Ball(radius) => of((length(value).unwrap_or_default() / radius).powi(3)),
            Self::Shell(radius) => {
                let height = vector(value).and_then(|components| components.get(2).copied()).unwrap_or_default();
                of(0.5 * (1.0 + height / radius))
            }
            Self::Quantiles(quantiles) => {
                let next = quantiles.partition_point(|[_, value]| *value <= number).clamp(1, quantiles.len() - 1);
                let ([p0, v0], [p1, v1]) = (quantiles[next - 1], quantiles[next]);
                of(p0 + (p1 - p0) * at([v0, v1], number).clamp(0.0, 1.0))
            }
            Self::Times([from, to]) => {
                let time = value.as_str().and_then(|text| text.parse::<hifitime::Epoch>().ok());
                of(time.map_or(0.0, |time| (time - *from).to_seconds() / (*to - *from).to_seconds()))
            }
            Self::Sky { .. } | Self::Probability(_) => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::chance::AddressedChance;

    #[test]
    fn values_fall_into_the_parts_that_are_expected() {
        let chance = AddressedChance::new(9, 0, "test");
        let times = ["2026-01-01T00:00:00Z", "2026-01-02T00:00:00Z"].map(|text| text.parse().unwrap());
        for (distribution, kind) in [
            (Distribution::Uniform([-2.0, 6.0]), PlaceKind::Number),
            (Distribution::Uniform([3.0, 15.0]), PlaceKind::Integer),
            (Distribution::LogUniform([0.01_f64.ln(), 100.0_f64.ln()]), PlaceKind::Number),
            (Distribution::Normal { mean: 1.0, sigma: 2.0, within: [0.1, 0.9] }, PlaceKind::Number),
            (Distribution::Choice(vec![(Value::from("a"), 0.2), (Value::from("b"), 1.0)]), PlaceKind::Text),
            (Distribution::Ball(2.0), PlaceKind::Numbers(Some(3))),
            (Distribution::Shell(3.0), PlaceKind::Numbers(Some(3))),
            (Distribution::Quantiles(vec![[0.0, 1.0], [0.25, 2.0], [1.0, 10.0]]), PlaceKind::Number),
            (Distribution::Times(times), PlaceKind::Text),
        ] {
            let expected = distribution.expected(&kind);
            let mut counts = vec![0_u32; expected.len()];
            for index in 0..4000 {
                let value = distribution.value(&|number| chance.uniform(index, number), &kind);
                counts[distribution.part(&value, &kind)] += 1;
            }
            assert!((expected.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            for (count, share) in counts.iter().zip(&expected) {
                let wanted = 4000.0 * share;
                assert!((f64::from(*count) - wanted).abs() <= 4.0 * wanted.sqrt() + 1e-9, "{distribution:?}: {counts:?}");
            }
        }
    }
}
