//! Which parameters the data support: from the focal length alone, one group after the other is let free as long as the Bayesian
//! information criterion falls; then each is tried to be taken out again. All that was tried is reported, with held-out frames beside it.
//!
//! Models are compared on the same star images with the same weights and the same noise, those of the fullest model: so the differences
//! are χ² differences of nested models, and a poor model cannot hide behind a large noise.
//! Source: Schwarz, Ann. Statist. 6, 461 (1978); Akaike, IEEE Trans. Autom. Control 19, 716 (1974).

use super::{Adjusted, Problem, Run, Solved, held_out, names, pose, scales, solve};
use crate::calibrate::calibration::{Candidate, ModelSelection};
use crate::calibrate::select::Selection;
use crate::calibrate::{CalibrateError, CalibrateOptions};
use crate::identify::ControlPoints;

/// What is let free together, in the order of preference where two are equally good.
const GROUPS: &[&[&str]] = &[&["k1"], &["x0", "y0"], &["p1", "p2"], &["k2"], &["k3"], &["aspect"], &["quadratic-rest"]];
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

/// Selects the parameters, and solves them.
pub(super) fn select(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
) -> Result<(Solved, ModelSelection), CalibrateError> {
    // What the caller asks for besides the camera (effects of the sky, temperature …) is in every set.
    let asked: Vec<String> = options.solve.iter().filter(|name| !super::is_reference(name)).cloned().collect();
    let with = |groups: &[&[&str]]| -> CalibrateOptions {
        let mut solve: Vec<String> = BEGIN.iter().map(|name| (*name).to_owned()).collect();
        solve.extend(groups.iter().copied().flatten().map(|name| (*name).to_owned()));
        solve.extend(asked.iter().cloned());
        // A prior counts in the sets that solve its parameter.
        let priors = options.priors.iter().filter(|prior| super::solve_for::names_it(&solve, &prior.name)).cloned().collect();
        CalibrateOptions { solve, priors, ..options.clone() }
    };
    let groups: Vec<&[&str]> = GROUPS.iter().copied().filter(|group| group.iter().all(|name| is_known(name))).collect();
    let full = solve(points, &with(&groups), selection)?;
    let fit = |chosen: &[&[&str]]| -> Result<Fitted, CalibrateError> {
        let (problem, _) = pose(points, &with(chosen), selection)?;
        Ok(fitted(problem, &full, options, points.nominal_is_found))
    };
    let count = full.adjusted.weight_sum * 2.0;
    let mut chosen: Vec<&[&str]> = Vec::new();
    let mut now = fit(&chosen)?;
    let mut report = ModelSelection { begun_with: names(&now.solved.problem), tried: Vec::new() };
    let bic = |from: &Fitted, to: &Fitted| to.chi_squared - from.chi_squared + count.ln() * (to.parameters as f64 - from.parameters as f64);
    loop {
        let mut best: Option<(f64, &[&str], Fitted)> = None;
        for group in groups.iter().copied().filter(|group| !chosen.contains(group)) {
            let mut set = chosen.clone();
            set.push(group);
            let tried = fit(&set)?;
            let delta = bic(&now, &tried);
            if best.as_ref().is_none_or(|(least, _, _)| delta < least - AS_GOOD) {
                best = Some((delta, group, tried));
            }
        }
        let Some((delta_bic, group, tried)) = best else { break };
        let taken = delta_bic < 0.0;
        report.tried.push(candidate(group, &now, &tried, delta_bic, taken));
        if !taken {
            break;
        }
        chosen.push(group);
        now = tried;
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
    // The last word on the noise is the chosen model's own.
    let Solved { problem, adjusted, .. } = now.solved;
    let run = Run { epsilon_px: options.epsilon_px, max_turns: options.max_iterations, from_afar: false, hold_noise: false };
    let scale = scales(&problem, &adjusted.state);
    let adjusted = problem.adjust(adjusted.state, full.adjusted.noise.clone(), &scale, &run, None);
    let mut problem = problem;
    problem.model.set_values(&adjusted.state.values);
    Ok((Solved { problem, adjusted, notes: full.notes }, report))
}

/// Whether this build has the effect.
fn is_known(name: &str) -> bool {
    super::is_reference(name) || super::solve_for::is_solvable(name)
}

/// A set fitted from the fullest model's attitudes, with its weights and noise.
///
/// A distortion that is not solved keeps its declared value; where identification found it from these star images, it is zero.
fn fitted(mut problem: Problem, full: &Solved, options: &CalibrateOptions, nominal_is_found: bool) -> Fitted {
    let mut state = full.adjusted.state.clone();
    // Values by name: the two models may hold different terms.
    let known = full.problem.model.parameters();
    let free = names(&problem);
    state.values = problem.model.values();
    if nominal_is_found {
        state.values[DISTORTION].fill(0.0);
    }
    for (k, parameter) in problem.model.parameters().iter().enumerate() {
        let place = known.iter().position(|other| other.name == parameter.name);
        if let Some(place) = place.filter(|_| free.contains(&parameter.name)) {
            state.values[k] = full.adjusted.state.values[place];
        }
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
    Fitted { solved: Solved { problem, adjusted, notes: Vec::new() }, chi_squared, parameters }
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
