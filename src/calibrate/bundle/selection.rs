//! Model selection of the camera's parameters by the Bayesian information criterion (BIC). One group after the other is freed as long as the
//! criterion falls; then each is tried to be taken out again. Where no group pays by itself the terms of the radial distortion that are left are
//! tried together: k2 and k3 of a wide lens nearly cancel over the frame, so that each alone is as poor as none. All that was tried is reported,
//! with held-out frames beside it. Either all of the camera is chosen so, from the focal length alone, or k2 and k3 beside parameters that are
//! solved in any case.
//!
//! Models are compared on the same star images with the same weights and the same noise, those of the fullest model: so the differences
//! are χ² differences of nested models, and a poor model cannot hide behind a large noise. The fullest model is the largest that the star
//! images determine: what they leave open (k3 of a narrow field, the corners of a fisheye) is left out and no reason to stop.
//!
//! **Errors after the choice.** A term of the radial distortion that is too small to be chosen may be there all the same, and the focal
//! length goes with it. So the errors stated are not those of the chosen model θ, but those that the next radial term leaves, about the
//! values stated: with θ₊, C₊ the solution with that term,
//!
//! ```text
//! C = C₊ + (θ₊ − θ)·(θ₊ − θ)ᵀ
//! ```
//! Whatever size the term has, the truth lies within two of these errors as often as it should (in 95 % of the nights or a little more); where
//! there is no such term at all they are too large, by a factor of two in a field of 20°.
//! Source: Schwarz, Ann. Statist. 6, 461 (1978); Akaike, IEEE Trans. Autom. Control 19, 716 (1974); on errors after a choice Leeb and
//! Pötscher, Econometric Theory 21, 21 (2005).

use nalgebra::DMatrix;

use super::determined::{check_coverage, check_solved, covariance};
use super::groups::{CENTRE, Group, all_groups, dropped, higher_radial, radial};
use super::solved::Alternative;
use super::start::settled;
use super::{Adjusted, Problem, Run, Solved, State, held_out, names, pose, scales, solve};
use crate::calibrate::calibration::{Candidate, ModelSelection};
use crate::calibrate::select::Selection;
use crate::calibrate::{CalibrateError, CalibrateOptions};
use crate::effects::ids;
use crate::identify::ControlPoints;

/// Places of k1, p1, p2 among the parameters.
const DISTORTION: std::ops::Range<usize> = 3..6;
/// With what it begins.
const BEGIN: &[&str] = &["f"];
/// Groups whose criteria differ by less are taken in the order of preference.
const AS_GOOD: f64 = 2.0;

/// A set of parameters, fitted.
struct Fitted {
    solved: Solved,
    chi_squared: f64,
    parameters: usize,
}

/// What there is to choose from.
struct Choice<'a> {
    points: &'a ControlPoints,
    options: &'a CalibrateOptions,
    selection: &'a Selection,
    /// What is in every set.
    begin: Vec<String>,
}

/// Selects the parameters, and solves them.
pub(super) fn select(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
) -> Result<(Solved, ModelSelection), CalibrateError> {
    let mut choice = Choice { points, options, selection, begin: options.solve.clone() };
    let (mut groups, full, base) = if options.select_model {
        // What the caller asks for besides the camera (effects of the sky, temperature …) is in every set.
        choice.begin = BEGIN.iter().map(|name| (*name).to_owned()).collect();
        // Of a fisheye identification found the principal point from these very star images: what they tell cannot be held as known.
        let found = points.nominal_is_found && options.projection != ids::PINHOLE;
        choice.begin.extend(CENTRE.iter().filter(|_| found).map(|name| (*name).to_owned()));
        choice.begin.extend(options.solve.iter().filter(|name| !super::is_reference(name)).cloned());
        let (groups, full) = choice.fullest()?;
        (groups, full, None)
    } else {
        let base = choice.solve(&[])?;
        let (groups, full) = choice.extended(&base)?;
        (groups, full, Some(base))
    };
    groups.retain(|group| group.iter().any(|name| !super::solve_for::names_it(&choice.begin, name)));
    let fit = |chosen: &[Group]| -> Result<Fitted, CalibrateError> {
        let (problem, _) = pose(points, &choice.with(chosen), selection)?;
        Ok(fitted(problem, &full, options, points.nominal_is_found))
    };
    let count = full.adjusted.weight_sum * 2.0;
    let mut chosen: Vec<Group> = Vec::new();
    let mut now = fit(&chosen)?;
    let mut report = ModelSelection { begun_with: names(&now.solved.problem), tried: Vec::new() };
    let bic = |from: &Fitted, to: &Fitted| to.chi_squared - from.chi_squared + count.ln() * (to.parameters as f64 - from.parameters as f64);
    while let Some((more, larger)) = next_step(&groups, &chosen, &now, &mut report, &fit, bic)? {
        chosen.extend(more);
        now = larger;
    }
    // What was taken early may have become superfluous.
    let mut k = 0;
    while k < chosen.len() {
        let mut set = chosen.clone();
        let group = set.remove(k);
        let without = fit(&set)?;
        let delta_bic = bic(&without, &now);
        if delta_bic > 0.0 {
            report.tried.push(candidate(group, &without, &now, delta_bic, false));
            chosen = set;
            now = without;
        } else {
            k += 1;
        }
    }
    let next = radial().find(|group| groups.contains(group) && !chosen.contains(group));
    let larger = next.map(|group| fit(&chosen.iter().copied().chain([group]).collect::<Vec<_>>())).transpose()?;
    let alternative = larger.and_then(|larger| alternative(&now, &larger, &full));
    if let Some(base) = base.filter(|_| chosen.is_empty()) {
        return Ok((Solved { alternative, ..base }, report));
    }
    // The last word on the noise is the chosen model's own.
    let Solved { problem, adjusted, .. } = now.solved;
    let run = Run { epsilon_px: options.epsilon_px, max_turns: options.max_iterations, from_afar: false, hold_noise: false };
    let scale = scales(&problem, &adjusted.state);
    let mut adjusted = problem.adjust(adjusted.state, full.adjusted.noise.clone(), &scale, &run, None);
    adjusted.turns.splice(0..0, full.adjusted.turns.iter().copied());
    let mut problem = problem;
    problem.model.set_values(&adjusted.state.values);
    Ok((Solved { problem, adjusted, notes: full.notes, alternative }, report))
}

impl Choice<'_> {
    /// The options that solve these groups beside what is in every set.
    fn with(&self, groups: &[Group]) -> CalibrateOptions {
        let mut solve = self.begin.clone();
        solve.extend(groups.iter().copied().flatten().map(|name| (*name).to_owned()));
        // A prior counts in the sets that solve its parameter.
        let priors = self.options.priors.iter().filter(|prior| super::solve_for::names_it(&solve, &prior.name)).cloned().collect();
        CalibrateOptions { solve, priors, ..self.options.clone() }
    }

    /// The solution with these groups, from the ground values.
    fn solve(&self, groups: &[Group]) -> Result<Solved, CalibrateError> {
        solve(self.points, &self.with(groups), self.selection)
    }

    /// The largest model of the camera that the star images determine, from the ground values: its groups and its solution.
    fn fullest(&self) -> Result<(Vec<Group>, Solved), CalibrateError> {
        let mut groups = all_groups();
        let mut dropped = dropped();
        loop {
            let error = match self.solve(&groups).and_then(|solved| check_solved(&solved).map(|()| solved)) {
                Ok(solved) => return Ok((groups, solved)),
                Err(error) if is_open(&error) => error,
                Err(error) => return Err(error),
            };
            let next = dropped.next().ok_or(error)?;
            groups.retain(|group| *group != next);
        }
    }

    /// k2 and k3 as far as the star images determine them, from the solution without.
    fn extended(&self, base: &Solved) -> Result<(Vec<Group>, Solved), CalibrateError> {
        let mut groups: Vec<Group> = higher_radial().collect();
        while !groups.is_empty() {
            match self.from(base, &groups) {
                Ok(solved) => return Ok((groups, solved)),
                Err(error) if is_open(&error) => groups.pop(),
                Err(error) => return Err(error),
            };
        }
        Ok((groups, base.clone()))
    }

    /// The solution with these groups, from one without them.
    fn from(&self, base: &Solved, groups: &[Group]) -> Result<Solved, CalibrateError> {
        let options = self.with(groups);
        let (mut problem, _) = pose(self.points, &options, self.selection)?;
        problem.attitudes = base.problem.attitudes;
        let state = carried_over(base, &problem);
        let scale = scales(&problem, &state);
        super::drop_without_effect(&mut problem, &scale);
        let scale = scales(&problem, &state);
        check_coverage(&problem, &state, &scale)?;
        let run = Run { epsilon_px: options.epsilon_px, max_turns: options.max_iterations, from_afar: false, hold_noise: false };
        let adjusted = problem.adjust(state, base.adjusted.noise.clone(), &scale, &run, None);
        let adjusted = settled(&problem, adjusted, &run);
        problem.model.set_values(&adjusted.state.values);
        let solved = Solved { problem, adjusted, notes: base.notes.clone(), alternative: None };
        check_solved(&solved)?;
        Ok(solved)
    }
}

/// The terms of the radial distortion that are left, in their order: the first two together, the first three.
fn radial_together(groups: &[Group], chosen: &[Group]) -> Vec<Vec<Group>> {
    let left: Vec<Group> = radial().filter(|group| groups.contains(group) && !chosen.contains(group)).collect();
    (2..=left.len()).map(|count| left[..count].to_vec()).collect()
}

/// The group that lowers the criterion most, with its solution, and where none does the first terms of the radial distortion that do so together;
/// `None` where nothing pays.
fn next_step(
    groups: &[Group],
    chosen: &[Group],
    now: &Fitted,
    report: &mut ModelSelection,
    fit: &impl Fn(&[Group]) -> Result<Fitted, CalibrateError>,
    bic: impl Fn(&Fitted, &Fitted) -> f64,
) -> Result<Option<(Vec<Group>, Fitted)>, CalibrateError> {
    let with = |more: &[Group]| fit(&chosen.iter().chain(more).copied().collect::<Vec<_>>());
    let mut best: Option<(f64, Group, Fitted)> = None;
    for group in groups.iter().copied().filter(|group| !chosen.contains(group)) {
        let tried = with(&[group])?;
        let delta = bic(now, &tried);
        if best.as_ref().is_none_or(|(least, _, _)| delta < least - AS_GOOD) {
            best = Some((delta, group, tried));
        }
    }
    let Some((delta_bic, group, tried)) = best else { return Ok(None) };
    let taken = delta_bic < 0.0;
    report.tried.push(candidate(group, now, &tried, delta_bic, taken));
    if taken {
        return Ok(Some((vec![group], tried)));
    }
    for several in radial_together(groups, chosen) {
        let tried = with(&several)?;
        let delta_bic = bic(now, &tried);
        let taken = delta_bic < 0.0;
        report.tried.push(candidate(&several.concat(), now, &tried, delta_bic, taken));
        if taken {
            return Ok(Some((several, tried)));
        }
    }
    Ok(None)
}

/// Whether an error means that the star images leave open what was to be solved.
fn is_open(error: &CalibrateError) -> bool {
    matches!(
        error,
        CalibrateError::Uncovered { .. }
            | CalibrateError::Singular { .. }
            | CalibrateError::Diverged { .. }
            | CalibrateError::NominalFolds
            | CalibrateError::NoDegreesOfFreedom { .. }
    )
}

/// The state of a solution in a problem whose model may hold other terms.
fn carried_over(from: &Solved, problem: &Problem) -> State {
    let known = from.problem.model.parameters();
    let mut state = from.adjusted.state.clone();
    state.values = problem.model.values();
    for (value, parameter) in state.values.iter_mut().zip(problem.model.parameters()) {
        if let Some(place) = known.iter().position(|other| other.name == parameter.name) {
            *value = from.adjusted.state.values[place];
        }
    }
    state
}

/// A set fitted from the fullest model's attitudes, with its weights and noise.
///
/// A distortion that is not solved keeps its declared value; where identification found it from these star images, it is zero.
fn fitted(mut problem: Problem, full: &Solved, options: &CalibrateOptions, nominal_is_found: bool) -> Fitted {
    let free = names(&problem);
    let mut state = carried_over(full, &problem);
    let declared = problem.model.values();
    for (k, parameter) in problem.model.parameters().iter().enumerate().filter(|(_, parameter)| !free.contains(&parameter.name)) {
        let found = nominal_is_found && DISTORTION.contains(&k) && super::is_reference(&parameter.name);
        state.values[k] = if found { 0.0 } else { declared[k] };
    }
    problem.attitudes = full.problem.attitudes;
    let scale = scales(&problem, &state);
    super::drop_without_effect(&mut problem, &scale);
    let scale = scales(&problem, &state);
    let run = Run { epsilon_px: 1e-4_f64.max(options.epsilon_px), max_turns: 30, from_afar: false, hold_noise: true };
    let weights = &full.adjusted.weights;
    let adjusted: Adjusted = problem.adjust(state, full.adjusted.noise.clone(), &scale, &run, Some(weights));
    problem.model.set_values(&adjusted.state.values);
    let (chi_squared, parameters) = (adjusted.chi_squared, problem.free.len());
    Fitted { solved: Solved { problem, adjusted, notes: Vec::new(), alternative: None }, chi_squared, parameters }
}

fn candidate(group: &[&str], before: &Fitted, after: &Fitted, delta_bic: f64, taken: bool) -> Candidate {
    let added = after.parameters as f64 - before.parameters as f64;
    let delta_chi2 = after.chi_squared - before.chi_squared;
    Candidate {
        added: group.iter().map(|name| (*name).to_owned()).collect(),
        delta_chi2,
        delta_bic,
        delta_aic: delta_chi2 + 2.0 * added,
        held_out_rms_px: held_out::rms_px(&after.solved),
        taken,
    }
}

/// A larger model beside the chosen one; `None` where the star images do not determine it at all.
fn alternative(chosen: &Fitted, larger: &Fitted, full: &Solved) -> Option<Alternative> {
    let Solved { problem, adjusted, .. } = &larger.solved;
    let names = names(problem);
    let cofactor = covariance(&adjusted.information, &names).ok()?;
    let (scale, unit) = (&adjusted.scale, full.adjusted.noise.unit_variance);
    let covariance = DMatrix::from_fn(names.len(), names.len(), |i, j| unit * cofactor[(i, j)] / (scale[i] * scale[j]));
    let own = carried_over(&chosen.solved, problem);
    let difference = problem.free.iter().map(|index| adjusted.state.values[*index] - own.values[*index]).collect();
    Some(Alternative { names, difference, covariance })
}
