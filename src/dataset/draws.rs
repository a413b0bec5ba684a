//! Draws of a recipe, checked: each knows its place in the scene, its distribution and its random numbers.

use std::path::Path;

use hifitime::Epoch;
use serde_json::Value as Schema;
use toml::{Table, Value};

use super::chance::{AddressedChance, Stratum};
use super::distribution::{Distribution, MAX_SIGMAS, normal_probability};
use super::error::DatasetError;
use super::recipe::{DrawLevel, DrawSpread, DrawTable, QuantileTable};
use super::scene_path::{PlaceKind, ScenePath};
use crate::statistics::order::ascending;

/// The upper end of a draw, as a random number from 0 to 1.
pub(super) const UPPER: f64 = 1.0 - f64::EPSILON;

/// A draw, ready.
#[derive(Clone, Debug)]
pub(super) struct Draw {
    pub(super) level: DrawLevel,
    pub(super) path: ScenePath,
    pub(super) distribution: Distribution,
    is_even: bool,
    chance: AddressedChance,
}

/// For which dataset, camera, recording and frame something is drawn: an index of each level, and its place among those that are spread evenly.
#[derive(Clone, Copy, Debug)]
pub(super) struct DrawIndex {
    pub(super) index: u64,
    pub(super) stratum: Stratum,
}

impl Draw {
    /// Checks a table; `number` is its place in the recipe.
    pub(super) fn new(
        recipe: &str,
        folder: &Path,
        seed: u64,
        number: usize,
        table: &DrawTable,
        schema: &Schema,
    ) -> Result<Self, DatasetError> {
        let refuse = |key: &str, value: String, remedy: String| DatasetError::Value {
            path: recipe.to_owned(),
            key: format!("draw[{number}].{key}"),
            value,
            remedy,
        };
        let reserved = ["format", "seed", "first_frame", "series"];
        let first = table.path.split('.').next().unwrap_or_default();
        if reserved.contains(&first) {
            let remedy = "is set by the recipe itself and cannot be drawn; leave the draw out".to_owned();
            return Err(refuse("path", format!("{:?}", table.path), remedy));
        }
        let path = ScenePath::find(schema, &table.path)
            .map_err(|what| refuse("path", format!("{:?}", table.path), format!("is no place in a scene: {what}")))?;
        let (key, value, distribution) = distribution(folder, table, &refuse)?;
        if let Some(wanted) = mismatch(&distribution, &path.kind) {
            return Err(refuse(key, value, format!("gives {wanted}, but {} is {}", table.path, path.kind.words())));
        }
        if let Distribution::Uniform(ends) = distribution
            && path.kind == PlaceKind::Integer
            && ends.iter().any(|end| end.fract() != 0.0)
        {
            return Err(refuse(key, value, format!("must have whole ends, since {} is a whole number", table.path)));
        }
        let chance = AddressedChance::new(seed, table.per as u32, &path.text);
        Ok(Self { level: table.per, path, distribution, is_even: table.spread == DrawSpread::Even, chance })
    }

    /// A draw that the recipe does not name.
    pub(super) fn implied(seed: u64, path: &str, distribution: Distribution, schema: &Schema) -> Option<Self> {
        let path = ScenePath::find(schema, path).ok()?;
        let chance = AddressedChance::new(seed, DrawLevel::Frame as u32, &path.text);
        Some(Self { level: DrawLevel::Frame, path, distribution, is_even: false, chance })
    }

    /// Its random number in a dimension.
    pub(super) fn unit(&self, at: DrawIndex, number: u32) -> f64 {
        if self.is_even { self.chance.even(at.index, number, at.stratum) } else { self.chance.uniform(at.index, number) }
    }

    /// A random number of its own that is never spread evenly.
    pub(super) fn independent(&self, at: DrawIndex, number: u32) -> f64 {
        self.chance.uniform(at.index, number)
    }

    /// Whether it is of the exposure, which both frames of a pair share.
    pub(super) fn is_of_exposure(&self) -> bool {
        self.path.text.starts_with("frames.")
    }

    /// Whether it says that something is there or not.
    pub(super) fn is_switch(&self) -> bool {
        matches!(self.distribution, Distribution::Probability(_))
    }

    /// Its value at these numbers from 0 to 1.
    pub(super) fn value(&self, unit: &dyn Fn(u32) -> f64) -> Value {
        self.distribution.value(unit, &self.path.kind)
    }

    /// Puts a value into a scene.
    pub(super) fn apply(&self, scene: &mut Table, value: Value) -> Result<(), String> {
        match value {
            Value::Boolean(is_on) if self.is_switch() => self.path.switch(scene, is_on),
            value => self.path.set(scene, value),
        }
    }

    /// Random numbers at which the scene is tried before the first frame, with words for each: both ends, or every value of a choice.
    pub(super) fn ends(&self) -> Vec<(String, f64)> {
        match &self.distribution {
            Distribution::Choice(values) => {
                let starts = std::iter::once(0.0).chain(values.iter().map(|(_, up_to)| *up_to));
                let middle = |(from, (value, up_to)): (f64, &(Value, f64))| (format!("at its value {value}"), 0.5 * (from + up_to));
                starts.zip(values).map(middle).collect()
            }
            Distribution::Probability(_) => vec![("switched on".to_owned(), 0.0), ("switched off".to_owned(), 1.0)],
            _ => vec![("at its lower end".to_owned(), 0.0), ("at its upper end".to_owned(), UPPER)],
        }
    }

    /// The lower and the upper of them, of numbers alone.
    pub(super) fn outermost(&self) -> Option<[(String, f64); 2]> {
        let number = |value: &Value| value.as_float().or(value.as_integer().map(|whole| whole as f64));
        let value = |at: f64| number(&self.value(&|_| at));
        let mut ends: Vec<(f64, (String, f64))> = self.ends().into_iter().filter_map(|end| Some((value(end.1)?, end))).collect();
        ascending(&mut ends, |(value, _)| *value);
        let (low, high) = (ends.first()?.clone(), ends.last()?.clone());
        (low.0 < high.0).then_some([low.1, high.1])
    }
}

type Refuse<'a> = &'a dyn Fn(&str, String, String) -> DatasetError;

/// The way of drawing that a table gives, with its key and its value for messages.
fn distribution(folder: &Path, table: &DrawTable, refuse: Refuse<'_>) -> Result<(&'static str, String, Distribution), DatasetError> {
    let mut given: Vec<(&'static str, String, Result<Distribution, String>)> = Vec::new();
    if let Some(ends) = table.uniform {
        given.push(("uniform", format!("{ends:?}"), rising(ends).map(Distribution::Uniform)));
    }
    if let Some(ends) = table.log_uniform {
        let positive = if ends[0] > 0.0 { rising(ends) } else { Err("must be two numbers above 0".to_owned()) };
        given.push(("log_uniform", format!("{ends:?}"), positive.map(|ends| Distribution::LogUniform(ends.map(f64::ln)))));
    }
    if let Some(normal) = table.normal {
        let [low, high] = normal.within.unwrap_or([-1.0, 1.0].map(|side| normal.mean + side * MAX_SIGMAS * normal.sigma));
        let within = [low, high].map(|end| normal_probability((end - normal.mean) / normal.sigma));
        let is_possible = normal.mean.is_finite() && normal.sigma > 0.0 && normal.sigma.is_finite();
        let checked = if !is_possible {
            Err("must have a mean and a sigma above 0".to_owned())
        } else if low >= high || low.is_nan() || high.is_nan() {
            Err("must have `within` with the lower number first".to_owned())
        } else if within[1] - within[0] <= 1e-6 {
            Err("leaves nothing to draw: `within` lies where the distribution hardly reaches; widen it".to_owned())
        } else {
            Ok(Distribution::Normal { mean: normal.mean, sigma: normal.sigma, within })
        };
        given.push(("normal", format!("{{ mean = {}, sigma = {}, within = [{low}, {high}] }}", normal.mean, normal.sigma), checked));
    }
    if let Some(choice) = &table.choice {
        let count = choice.values.len();
        let weights = choice.weights.clone().unwrap_or_else(|| vec![1.0; count]);
        given.push(("choice", format!("{count} values"), weighted(&choice.values, &weights)));
    }
    if let Some(ball) = table.ball {
        let checked =
            if ball.radius.is_finite() && ball.radius > 0.0 { Ok(Distribution::Ball(ball.radius)) } else { Err(NO_RADIUS.to_owned()) };
        given.push(("ball", format!("{{ radius = {} }}", ball.radius), checked));
    }
    if let Some(sphere) = table.sphere {
        let checked = match sphere.radius {
            None if sphere.lowest_altitude_deg.is_some_and(|altitude| !(-90.0..=85.0).contains(&altitude)) => {
                Err("must have a lowest_altitude_deg between -90 and 85".to_owned())
            }
            None => Ok(Distribution::Sky { lowest_altitude_deg: sphere.lowest_altitude_deg }),
            Some(radius) if radius.is_finite() && radius > 0.0 => Ok(Distribution::Shell(radius)),
            Some(_) => Err(NO_RADIUS.to_owned()),
        };
        let told = match (sphere.radius, sphere.lowest_altitude_deg) {
            (Some(radius), _) => format!("{{ radius = {radius} }}"),
            (None, Some(altitude)) => format!("{{ lowest_altitude_deg = {altitude} }}"),
            (None, None) => "{}".to_owned(),
        };
        given.push(("sphere", told, checked));
    }
    if let Some(table) = &table.table {
        given.push(("table", format!("{:?}", table.file.display().to_string()), quantiles(folder, table).map(Distribution::Quantiles)));
    }
    if let Some(times) = &table.times {
        given.push(("times", format!("{times:?}"), period(times)));
    }
    if let Some(probability) = table.probability {
        let checked = (0.0..=1.0).contains(&probability).then_some(Distribution::Probability(probability));
        given.push(("probability", probability.to_string(), checked.ok_or_else(|| "must lie between 0 and 1".to_owned())));
    }
    let names: Vec<&str> = given.iter().map(|(name, ..)| *name).collect();
    let told = if names.is_empty() { "no distribution".to_owned() } else { names.join(" and ") };
    let mut given = given.into_iter();
    let (Some((key, value, checked)), None) = (given.next(), given.next()) else {
        let remedy =
            format!("has {told}; give one of uniform, log_uniform, normal, choice, ball, sphere, table, times, probability and no other");
        return Err(refuse("path", format!("{:?}", table.path), remedy));
    };
    checked.map(|distribution| (key, value.clone(), distribution)).map_err(|remedy| refuse(key, value, remedy))
}

const NO_RADIUS: &str = "must have a radius above 0";

fn rising(ends: [f64; 2]) -> Result<[f64; 2], String> {
    let is_rising = ends.iter().all(|end| end.is_finite()) && ends[0] < ends[1];
    if is_rising { Ok(ends) } else { Err("must be two numbers, the lower first".to_owned()) }
}

fn weighted(values: &[Value], weights: &[f64]) -> Result<Distribution, String> {
    let sum: f64 = weights.iter().sum();
    if values.is_empty() || values.len() != weights.len() {
        return Err(format!("must have one weight for each of one value or more; {} weights are given", weights.len()));
    }
    if !(weights.iter().all(|weight| *weight >= 0.0) && sum > 0.0 && sum.is_finite()) {
        return Err(format!("must have weights not below 0 and one above it; they are {weights:?}"));
    }
    let mut up_to = 0.0;
    let cumulated = weights.iter().map(|weight| {
        up_to += weight / sum;
        up_to
    });
    Ok(Distribution::Choice(values.iter().cloned().zip(cumulated).collect()))
}

fn period(times: &[String; 2]) -> Result<Distribution, String> {
    let of = |text: &String| text.parse::<Epoch>().map_err(|_| format!("{text:?} is no time; write it as 2026-03-01T22:15:07.250Z"));
    let [from, to] = [of(&times[0])?, of(&times[1])?];
    if from < to { Ok(Distribution::Times([from, to])) } else { Err("must be two times, the earlier first".to_owned()) }
}

/// Reads quantiles from a file.
fn quantiles(folder: &Path, table: &QuantileTable) -> Result<Vec<[f64; 2]>, String> {
    #[derive(serde::Deserialize)]
    struct Row {
        probability: f64,
        value: f64,
    }
    let mut reader = csv::Reader::from_path(folder.join(&table.file)).map_err(|error| format!("cannot be read: {error}"))?;
    let rows = reader.deserialize::<Row>().map(|row| row.map(|row| [row.probability, row.value]));
    let rows =
        rows.collect::<Result<Vec<_>, _>>().map_err(|error| format!("cannot be read: {error}; its columns are probability and value"))?;
    let is_rising = rows.windows(2).all(|pair| pair[0][0] < pair[1][0] && pair[0][1] <= pair[1][1]);
    let is_whole = rows.first().is_some_and(|row| row[0] == 0.0) && rows.last().is_some_and(|row| row[0] == 1.0);
    if is_rising && is_whole && rows.iter().all(|row| row[1].is_finite()) {
        Ok(rows)
    } else {
        Err("must have probabilities that rise from 0 to 1, and values that rise with them".to_owned())
    }
}

/// What a distribution gives, if it is not what stands at the place.
fn mismatch(distribution: &Distribution, kind: &PlaceKind) -> Option<&'static str> {
    let is_number = matches!(kind, PlaceKind::Number | PlaceKind::Integer);
    match distribution {
        Distribution::Uniform(_) | Distribution::LogUniform(_) | Distribution::Normal { .. } | Distribution::Quantiles(_) => {
            (!is_number).then_some("a number")
        }
        Distribution::Ball(_) | Distribution::Shell(_) => (*kind != PlaceKind::Numbers(Some(3))).then_some("three numbers"),
        Distribution::Sky { .. } => (*kind != PlaceKind::Numbers(Some(2))).then_some("right ascension and declination"),
        Distribution::Times(_) => (*kind != PlaceKind::Text).then_some("a time"),
        Distribution::Probability(_) => (!matches!(kind, PlaceKind::Effect | PlaceKind::Table)).then_some("whether something is there"),
        Distribution::Choice(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::schema;

    fn draw(text: &str) -> Result<Draw, String> {
        let table: DrawTable = toml::from_str(text).map_err(|error| error.to_string())?;
        Draw::new("r.toml", Path::new("."), 1, 2, &table, &schema()).map_err(|error| error.to_string())
    }

    #[test]
    fn bad_draws_are_refused_with_place_value_and_remedy() {
        for (text, told) in [
            (
                "path = \"camera.with_px\"\nuniform = [0, 1]",
                "r.toml: draw[2].path = \"camera.with_px\" is no place in a scene: camera has no key with_px; did you mean width_px?",
            ),
            ("path = \"camera.k1\"\nuniform = [1, 0]", "r.toml: draw[2].uniform = [1.0, 0.0] must be two numbers, the lower first"),
            ("path = \"camera.k1\"\nlog_uniform = [0, 1]", "r.toml: draw[2].log_uniform = [0.0, 1.0] must be two numbers above 0"),
            ("path = \"camera.k1\"", "r.toml: draw[2].path = \"camera.k1\" has no distribution; give one of uniform"),
            ("path = \"camera.k1\"\nuniform = [0, 1]\nprobability = 0.5", "has uniform and probability; give one of"),
            (
                "path = \"camera.k1\"\nball = { radius = 1 }",
                "r.toml: draw[2].ball = { radius = 1 } gives three numbers, but camera.k1 is a number",
            ),
            ("path = \"camera.width_px\"\nuniform = [99.5, 120.5]", "must have whole ends, since camera.width_px is a whole number"),
            (
                "path = \"frames.boresight_radec_deg\"\nsphere = { lowest_altitude_deg = 120 }",
                "draw[2].sphere = { lowest_altitude_deg = 120 } must have a lowest_altitude_deg between -90 and 85",
            ),
            ("path = \"frames.rate_deg_s\"\nball = { radius = 0 }", "r.toml: draw[2].ball = { radius = 0 } must have a radius above 0"),
            ("path = \"effects.moonlight\"\nprobability = 1.5", "r.toml: draw[2].probability = 1.5 must lie between 0 and 1"),
            ("path = \"camera.k1\"\nprobability = 0.5", "gives whether something is there, but camera.k1 is a number"),
            ("path = \"camera.k1\"\nnormal = { mean = 0, sigma = 1, within = [9, 10] }", "leaves nothing to draw"),
            ("path = \"camera.k1\"\nnormal = { mean = 0, sigma = -1 }", "must have a mean and a sigma above 0"),
            ("path = \"camera.k1\"\nchoice = { values = [] }", "draw[2].choice = 0 values must have one weight for each"),
            ("path = \"camera.k1\"\nchoice = { values = [1, 2], weights = [0, 0] }", "must have weights not below 0 and one above it"),
            ("path = \"camera.k1\"\ntable = { file = \"absent.csv\" }", "draw[2].table = \"absent.csv\" cannot be read"),
            ("path = \"frames.time_utc\"\ntimes = [\"now\", \"then\"]", "\"now\" is no time; write it as"),
            ("path = \"seed\"\nuniform = [0, 1]", "is set by the recipe itself"),
        ] {
            let fault = draw(&format!("per = \"frame\"\n{text}")).unwrap_err();
            assert!(fault.contains(told), "{fault}\ninstead of\n{told}");
        }
    }

    #[test]
    fn quantiles_are_read_and_checked() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("good.csv"), "probability,value\n0,1\n0.5,2\n1,10\n").unwrap();
        std::fs::write(folder.path().join("bad.csv"), "probability,value\n0.1,1\n1,10\n").unwrap();
        let read = |name: &str| quantiles(folder.path(), &QuantileTable { file: name.into() });
        assert_eq!(read("good.csv").unwrap(), [[0.0, 1.0], [0.5, 2.0], [1.0, 10.0]]);
        assert!(read("bad.csv").unwrap_err().contains("rise from 0 to 1"));
    }

    #[test]
    fn the_ends_of_a_choice_are_all_its_values() {
        let choice = draw("per = \"frame\"\npath = \"camera.k1\"\nchoice = { values = [1.0, 2.0, 3.0], weights = [1, 0.5, 8] }").unwrap();
        let values: Vec<f64> = choice.ends().iter().map(|(_, at)| choice.value(&|_| *at).as_float().unwrap()).collect();
        assert_eq!(values, [1.0, 2.0, 3.0]);
    }
}
