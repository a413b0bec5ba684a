//! Hypotheses: the design columns of every displacement of the registry, at the current solution.
//!
//! A hypothesis is the columns of the effect's fitted parameters. What it needs and the recording lacks makes it not applicable. A
//! parameter that its columns depend on in a way that no tangent shows (the place of a seam, a length, an unknown zenith) is
//! searched over: one variant for each of its values; the p-value accounts for the search, since it is that of the largest statistic.

use super::options::DiagnoseOptions;
use super::rendered_columns::{Rendered, Shifts};
use super::star_images::StarImages;
use super::zenith::{supposed, unknown_zeniths, with_zenith};
use crate::calibrate::{BundleSolution, Column};
use crate::effects::{AnyDisplacement, Context, DISPLACEMENTS, Observation, Searched, StarState};
use crate::identify::ControlPoints;

/// One in so many frames may lack what an effect needs.
const FEW_OF: usize = 4;
/// One value of what is searched over.
#[derive(Clone, Debug)]
pub(super) struct Variant {
    /// All parameters of the effect, at which the columns are taken.
    pub(super) start: Vec<f64>,
    /// The zenith that it supposes: a direction in axes fixed to the Earth where the times are known, ICRS else.
    pub(super) zenith: Option<[f64; 3]>,
    /// By how much the zenith of each frame is turned about the pole from there, rad; none where it is the same for all.
    pub(super) turns_rad: Vec<f64>,
    /// Columns of the fitted parameters, px per unit.
    pub(super) columns: Vec<Column>,
    /// Standard error of what was searched over, where the search was made finer.
    pub(super) searched_sigma: Option<f64>,
    /// Whether the columns were rendered and measured; else they are the formula's.
    pub(super) rendered: bool,
}

/// An effect that may have been left out.
#[derive(Clone)]
pub(super) struct Hypothesis {
    /// The effect.
    pub(super) effect: &'static dyn AnyDisplacement,
    /// Indices of the parameters that are fitted.
    pub(super) fitted: Vec<usize>,
    /// Its variants; none where it is not applicable.
    pub(super) variants: Vec<Variant>,
    /// What the recording lacks.
    pub(super) missing: Option<String>,
    /// The first fitted parameter's value at the effect's known size, where the recording tells it.
    pub(super) known: Option<f64>,
    /// What is searched for, as long as the effect is not in the model at some size.
    pub(super) searched: Option<Searched>,
    /// Whether the model contains it.
    pub(super) in_force: bool,
    /// Shifts of the star images by rendering, where it could be rendered.
    pub(super) shifts: Option<Shifts>,
}

impl std::fmt::Debug for Hypothesis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({} variants)", self.id(), self.variants.len())
    }
}

impl Hypothesis {
    /// Its id.
    pub(super) fn id(&self) -> &'static str {
        self.effect.id()
    }

    /// Full name of a fitted parameter.
    pub(super) fn full_names(&self) -> Vec<String> {
        let name = |index: &usize| format!("{}.{}", self.id(), self.effect.parameters()[*index].name);
        fitted_once_found(&self.fitted, self.searched.as_ref()).iter().map(name).collect()
    }
}

/// All of them, in the registry's order.
pub(super) fn hypotheses(
    joint: &BundleSolution,
    stars: &StarImages,
    points: &ControlPoints,
    options: &DiagnoseOptions,
    rendered: &Rendered,
) -> Vec<Hypothesis> {
    DISPLACEMENTS
        .iter()
        .filter(|effect| effect.is_hypothesis())
        .map(|effect| hypothesis(*effect, joint, stars, points, options, rendered.of(effect.id()).cloned()))
        .collect()
}

fn hypothesis(
    effect: &'static dyn AnyDisplacement,
    joint: &BundleSolution,
    stars: &StarImages,
    points: &ControlPoints,
    options: &DiagnoseOptions,
    shifts: Option<Shifts>,
) -> Hypothesis {
    let first = stars.frames.first().map_or_else(Observation::default, |(_, observation)| *observation);
    let present = joint.model().terms().find(|(id, _)| *id == effect.id()).map(|(_, parameters)| parameters.to_vec());
    let known: Vec<Option<Vec<f64>>> = stars.frames.iter().map(|(_, observation)| effect.predicted(observation)).collect();
    let is_there = present.as_ref().is_some_and(|parameters| parameters.first().is_some_and(|size| *size != 0.0));
    let fitted = effect.default_free(&first);
    let searched = effect.searched(&first);
    let fitted = if is_there { fitted_once_found(&fitted, searched.as_ref()) } else { fitted };
    let whole = |parameters: &Vec<f64>| fitted.first().and_then(|index| parameters.get(*index)).copied();
    // A size that differs from frame to frame (pressure) is known as its mean: the columns are in proportion to it.
    let sizes: Vec<f64> = known.iter().flatten().filter_map(whole).collect();
    let known = (!sizes.is_empty() && sizes.len() == stars.frames.len()).then(|| sizes.iter().sum::<f64>() / sizes.len() as f64);
    let mut found = Hypothesis {
        effect,
        fitted,
        variants: Vec::new(),
        missing: None,
        known: known.filter(|known| *known != 0.0),
        searched,
        in_force: options.physics.iter().any(|id| id == effect.id()),
        shifts,
    };
    if effect.facts().searches_zenith && stars.frames.iter().any(|(_, observation)| observation.zenith.is_none()) {
        found.known = None;
        found.fitted = effect.default_free(&with_zenith(&first, [0.0, 0.0, 1.0]));
        match unknown_zeniths(stars, points) {
            Ok(zeniths) => {
                found.variants = zeniths.into_iter().filter_map(|zenith| free_zenith(joint, effect, &found.fitted, zenith)).collect();
            }
            Err(reason) => found.missing = Some(reason),
        }
        return found;
    }
    let lacks = stars.frames.iter().filter_map(|(_, observation)| effect.unmet_requirement(observation)).collect::<Vec<_>>();
    // Where a few frames do not tell what moves their stars, the effect leaves them alone and the others tell.
    let a_few = found.known.is_none() && FEW_OF * lacks.len() <= stars.frames.len();
    if let Some(reason) = lacks.first().filter(|_| !a_few) {
        let some = if lacks.len() < stars.frames.len() { "in some of the frames " } else { "" };
        found.missing = Some(format!("{some}{reason}"));
        return found;
    }
    let mut contexts = (0..stars.images.len()).map(|k| stars.context(k, points));
    if let Some(reason) = contexts.next().and_then(|context| effect.unmet_in_context(&context))
        && contexts.all(|context| effect.unmet_in_context(&context).is_some())
    {
        found.missing = Some(reason.to_owned());
        return found;
    }
    let star = stars.images.first().map_or_else(StarState::default, |image| points.points[image.point].star);
    let start = present.or_else(|| effect.identity(&Context::new(star, first))).unwrap_or_else(|| vec![0.0; effect.parameters().len()]);
    let starts = match found.searched.as_ref().filter(|_| !is_there) {
        Some(searched) => searched.values.iter().map(|value| with(&start, searched.parameter, *value)).collect(),
        None => vec![start],
    };
    if let Some(shifts) = found.shifts.as_ref().filter(|_| !is_there) {
        // Beside the formula, and before it: it was made with this recording's stars and this program's fit.
        let with_shifts = joint.with_signatures(shifts);
        let own = starts.iter().filter_map(|start| variant(&with_shifts, &found, start.clone()));
        found.variants = own.map(|own| Variant { rendered: true, ..own }).collect();
    }
    found.variants.extend(starts.into_iter().filter_map(|start| variant(joint, &found, start)).collect::<Vec<_>>());
    if found.variants.is_empty() {
        found.missing = Some("it cannot be computed for this camera".to_owned());
    }
    found
}

/// What is fitted of an effect that is there: what a search has come near to is a parameter like others, if it can be one.
fn fitted_once_found(fitted: &[usize], searched: Option<&Searched>) -> Vec<usize> {
    let more = searched.filter(|searched| searched.then_fitted && !fitted.contains(&searched.parameter));
    let mut all: Vec<usize> = fitted.iter().copied().chain(more.map(|searched| searched.parameter)).collect();
    all.sort_unstable();
    all
}

/// A finer search about a variant, for effects that have one: halfway to the values tried before, each `step` halving the way once more.
pub(super) fn finer(hypothesis: &Hypothesis, best: &Variant, joint: &BundleSolution, step: usize) -> Vec<Variant> {
    let Some(Searched { parameter, values, .. }) = &hypothesis.searched else { return Vec::new() };
    let here = best.start[*parameter];
    let share = 0.5_f64.powi(i32::try_from(step + 1).unwrap_or(i32::MAX));
    // The gaps are those of the first search, on either side; at its ends the one that there is.
    let at = values.partition_point(|value| *value < here).clamp(1, values.len().max(2) - 1);
    let Some(gap) = values.get(at).zip(values.get(at - 1)).map(|(high, low)| high - low) else { return Vec::new() };
    let range = hypothesis.effect.parameters()[*parameter].range;
    let tried = [-2.0, -1.0, 1.0, 2.0].map(|k| (here + k * share * gap).clamp(range.0, range.1));
    tried.into_iter().filter_map(|value| variant(joint, hypothesis, with(&best.start, *parameter, value))).collect()
}

/// The variant at a value of what is searched for.
pub(super) fn at_value(hypothesis: &Hypothesis, best: &Variant, joint: &BundleSolution, value: f64) -> Option<Variant> {
    variant(joint, hypothesis, with(&best.start, hypothesis.searched.as_ref()?.parameter, value))
}

fn with(start: &[f64], parameter: usize, value: f64) -> Vec<f64> {
    let mut own = start.to_vec();
    own[parameter] = value;
    own
}

fn variant(joint: &BundleSolution, hypothesis: &Hypothesis, start: Vec<f64>) -> Option<Variant> {
    let columns = joint.columns_of(hypothesis.id(), &start, &hypothesis.fitted)?;
    Some(Variant { start, zenith: None, turns_rad: Vec::new(), columns, searched_sigma: None, rendered: false })
}

fn free_zenith(joint: &BundleSolution, effect: &'static dyn AnyDisplacement, fitted: &[usize], zenith: [f64; 3]) -> Option<Variant> {
    let supposed = supposed(joint, zenith, &[]);
    let start = vec![0.0; effect.parameters().len()];
    // Where there is no refraction yet the zenith's own parameters have no columns: the search stands in their place.
    let columns = supposed.columns_of(effect.id(), &start, &fitted[..1])?;
    Some(Variant { start, zenith: Some(zenith), turns_rad: Vec::new(), columns, searched_sigma: None, rendered: false })
}
