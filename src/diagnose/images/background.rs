//! Rows of the sky between the stars, frame by frame, and what they tell: less light at the corners, glow, stray light, halves that differ.
//!
//! A simulation has an even sky in every frame unless it is told otherwise. What the camera adds or takes stays with the detector from field to field;
//! what differs from field to field is the sky's own ([`super::sky_noise`]) and has no name here but is told where it is beyond chance. Errors are then
//! known, so they are taken at their word. The rows are whitened cells: a row holds no single place, and columns are whitened with them.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use super::expected_stars::StarMeasurement;
use super::proposed::{ChannelState, Pixels};
use super::rows::{Kind, Parameter, Question, Row, Rows, Shared, Shown};
use super::sky_columns::{Asked, asked};
use super::sky_light::SkyLight;
use super::sky_noise::{SkyNoise, least_fields, polynomials};
use super::sky_view::{SkyView, glows};
use crate::diagnose::channels::Channel;

/// Name of the rows.
const NAME: &str = "level of the sky";
/// Degree of the polynomials that the sky is held against where nothing has a name.
const MAP_DEGREE: usize = 5;
/// Fields that differ are told of below this probability, as −ln: it is no name and needs none of the family's care, but a certainty.
const UNEVEN_SURPRISE: f64 = 6.9;

/// The sky as it was before its rows were whitened.
#[derive(Clone, Debug, Default)]
struct Plain {
    light: SkyLight,
    /// Of every question (by its place among all) and parameter that has one the column over the cells.
    columns: Vec<(usize, usize, Vec<f64>)>,
}

/// What the background adds beside its rows.
#[derive(Clone, Debug, Default)]
pub(in crate::diagnose) struct Background {
    /// Patterns without a name, over all rows.
    pub(super) patterns: Vec<Question>,
    /// Why effects are not asked.
    pub(super) unasked: Vec<(&'static str, String)>,
    /// Why the channel is not looked at; nothing where it is.
    pub(in crate::diagnose) why_not: Option<String>,
    /// −ln of the probability that even skies look as uneven, each field in its own way.
    uneven: f64,
    plain: Plain,
}

impl Background {
    fn not_looked_at(why_not: String) -> Self {
        Self { why_not: Some(why_not), ..Self::default() }
    }

    /// −ln of the probability that even skies look as uneven beside effects of some sizes, each field in its own way; `sizes` by question and
    /// parameter. Nothing where it is no certainty.
    fn uneven_beside(&self, sizes: &BTreeMap<(usize, usize), f64>) -> Option<f64> {
        let mut light = self.plain.light.clone();
        for (question, parameter, column) in &self.plain.columns {
            let Some(size) = sizes.get(&(*question, *parameter)) else { continue };
            light.cells.iter_mut().zip(column).for_each(|(cell, unit)| cell.value -= size * unit);
        }
        let surprise = SkyNoise::found(&light, &[])?.surprise;
        Some(surprise).filter(|surprise| *surprise > UNEVEN_SURPRISE)
    }

    /// What is said of the channel with what each field has of its own, before effects are found and beside those found: it is told where the sky is
    /// uneven from field to field, but that is the sky's own (faint stars, clouds, the Milky Way) and no mismatch of the camera.
    pub(super) fn with_uneven(&self, mut state: ChannelState, sizes: &BTreeMap<(usize, usize), f64>) -> ChannelState {
        let before = Some(self.uneven).filter(|surprise| *surprise > UNEVEN_SURPRISE);
        for (surprise, located_by) in [(before, &mut state.located_by), (self.uneven_beside(sizes), &mut state.left_located_by)] {
            located_by.extend(surprise.map(|_| "frame".to_owned()));
        }
        state
    }
}

/// Adds the rows to those of stars and noise. `matched`: all stars that are known, by which the fields are told apart.
pub(super) fn add_background(
    rows: &mut Rows,
    &Pixels { statistics: pixels, detector, places, views }: &Pixels<'_>,
    stars: &[StarMeasurement],
    matched: &[StarMeasurement],
) -> Background {
    let light = SkyLight::new(&pixels.sky, detector.bias_dn, places);
    if light.frames.is_empty() {
        return Background::not_looked_at("no frame has sky enough between its stars".to_owned());
    }
    let by_number: BTreeMap<usize, &SkyView> = views.iter().map(|view| (view.frame, view)).collect();
    let moved = |[one, two]: [usize; 2]| by_number.get(&one)?.moved(by_number.get(&two)?);
    let fields = light.fields(matched, &moved);
    let gain_e_per_dn = detector.gain_e_per_dn.or_else(|| pixels.photon_transfer.as_ref()?.gain_e_per_dn);
    let (mut questions, mut unasked) = asked(&light, gain_e_per_dn, detector.bias_dn.is_some());
    let (of_sky, why_not) = glows(&light, views, stars);
    let first_glow: usize = questions.iter().map(|own| own.columns.len()).sum();
    let models = first_glow..first_glow + of_sky.len();
    questions.extend(of_sky);
    unasked.extend(why_not);
    let patterns = patterns(&light);
    let columns: Vec<Vec<f64>> = questions
        .iter()
        .flat_map(|own| own.columns.iter().map(|(_, column)| column.clone()))
        .chain(patterns.iter().flat_map(|(_, columns)| columns.clone()))
        .collect();
    let (joined, plain_columns) = light.joined(&fields, &columns);
    let models = &plain_columns[models];
    let told = SkyNoise::found(&joined, models).and_then(|noise| Some((noise.whitened(&joined, &plain_columns)?, noise)));
    let Some(((values, columns), noise)) = told else {
        return Background::not_looked_at(format!(
            "{} fields are too few to tell the sky from the camera (at least {} that lie apart)",
            joined.frames.len(),
            least_fields(models)
        ));
    };
    // Before anything is found no model is in force.
    let uneven = SkyNoise::found(&joined, &[]).map_or(noise.surprise, |own| own.surprise);
    let before = rows.len();
    let mut star = rows.rows().map(|row| row.star + 1).max().unwrap_or(0);
    let row = |(value, cell): (&f64, &super::sky_light::Cell)| {
        star += 1;
        Row { value: *value, sigma: 1.0, frame: joined.frames[cell.frame].place, star, point: None }
    };
    let own_rows: Vec<Row> = values.iter().zip(&joined.cells).map(row).collect();
    let over_all = |column: Vec<f64>| -> Vec<f64> { vec![0.0; before].into_iter().chain(column).collect() };
    let mut columns = columns.into_iter();
    for question in rows.questions.iter_mut().flat_map(|question| &mut question.columns) {
        question.resize(before + own_rows.len(), 0.0);
    }
    let mut plain_columns = plain_columns.into_iter();
    let mut plain = Vec::new();
    for question in questions {
        let count = question.columns.len();
        let own: Vec<Vec<f64>> = columns.by_ref().take(count).map(over_all).collect();
        let places = add_question(rows, question, own);
        for (places, column) in places.into_iter().zip(plain_columns.by_ref()) {
            plain.extend(places.into_iter().map(|(at, k)| (at, k, column.clone())));
        }
    }
    let patterns = patterns
        .into_iter()
        .map(|(follows, own)| {
            let columns = columns.by_ref().take(own.len()).map(over_all).collect();
            Question { id: "", parameters: Vec::new(), follows, columns, rank: 0, sign: None, is_part: false, products_of: &[] }
        })
        .collect();
    rows.kinds.push(Kind {
        channel: Channel::Background,
        name: NAME,
        rows: own_rows,
        per_frame: Vec::new(),
        common: Vec::new(),
        shared: Shared::No,
        is_scaled: false,
    });
    Background { patterns, unasked, why_not: None, uneven, plain: Plain { light: joined, columns: plain } }
}

/// Joins the columns to an effect that stars ask for too and to its parts, parameter by parameter; else it is a question of its own. Gives the places of
/// each column: questions and parameters.
fn add_question(rows: &mut Rows, own: Asked, columns: Vec<Vec<f64>>) -> Vec<Vec<(usize, usize)>> {
    let mut known: Vec<usize> = (0..rows.questions.len()).filter(|at| own.is_shared && rows.questions[*at].id == own.id).collect();
    if known.is_empty() {
        rows.questions.push(Question {
            id: own.id,
            parameters: Vec::new(),
            follows: own.follows,
            columns: Vec::new(),
            rank: 1,
            sign: own.sign,
            is_part: false,
            products_of: &[],
        });
        known.push(rows.questions.len() - 1);
    }
    let mut places = vec![Vec::new(); columns.len()];
    for (places, ((parameter, _), column)) in places.iter_mut().zip(own.columns.into_iter().zip(columns)) {
        for &at in &known {
            let question = &mut rows.questions[at];
            if let Some(k) = question.parameters.iter().position(|known| known.name == parameter.name) {
                question.columns[k].iter_mut().zip(&column).for_each(|(sum, value)| *sum += value);
                places.push((at, k));
            } else if !question.is_part {
                places.push((at, question.columns.len()));
                question.parameters.push(parameter);
                question.columns.push(column.clone());
            }
        }
    }
    if let (Some(corner), [at]) = (own.corner, &known[..]) {
        rows.questions[*at].parameters.push(Parameter { name: "corner", unit: "", shown: Shown::Given(corner) });
    }
    places
}

/// Patterns that stay with the detector, and the covariates that they follow.
fn patterns(light: &SkyLight) -> Vec<(&'static str, Vec<Vec<f64>>)> {
    let radius2 = |at: [f64; 2]| at[0] * at[0] + at[1] * at[1];
    let half = |along: f64| if along > 0.0 { 0.5 } else { -0.5 };
    let width = light.frames.first().map_or(0, |frame| polynomials([0.0; 2], frame.edge, MAP_DEGREE).len());
    vec![
        ("x", vec![light.column(|_, cell| cell.at[0])]),
        ("y", vec![light.column(|_, cell| cell.at[1])]),
        ("field-radius", vec![light.column(|_, cell| radius2(cell.at)), light.column(|_, cell| radius2(cell.at).powi(2))]),
        (
            "field-azimuth",
            vec![light.column(|_, cell| cell.at[0].powi(2) - cell.at[1].powi(2)), light.column(|_, cell| 2.0 * cell.at[0] * cell.at[1])],
        ),
        ("column-half", vec![light.column(|_, cell| half(cell.at[0]))]),
        ("row", vec![light.column(|_, cell| half(cell.at[1]))]),
        ("field-map", (0..width).map(|m| light.column(|frame, cell| polynomials(cell.at, frame.edge, MAP_DEGREE)[m])).collect()),
    ]
}
