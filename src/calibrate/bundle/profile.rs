//! Profile likelihood: standard errors of parameter combinations that the star images hardly determine.
//!
//! The linearised standard error of such a combination says how the cost bends at the solution. Where it bends differently a few of these
//! errors away (a detector's tilt is separated from the centre by the square of the tilt alone, so not at all near zero), that is no measure of
//! how far the truth may be. So the parameter that has most of the combination is moved by some of its errors and held, everything else
//! is adjusted anew, and the rise of the cost says how many standard errors that was (profile likelihood). Where the cost depends on the
//! square of a parameter there is a second solution with the other sign: it is looked for too.
//! Source: Venzon and Moolgavkar, Appl. Statist. 37, 87 (1988).

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::problem::Prior;
use super::{Problem, Run, Solved};

/// How far the parameter is moved, in its linearised standard errors.
const DISTANCES: [f64; 6] = [2.0, -2.0, 4.0, -4.0, 8.0, -8.0];
/// Below this factor the linearised standard error stands.
const NOTABLE: f64 = 1.25;

/// By how much the standard error along a parameter's own ridge is larger than the linearised one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wider {
    /// Index among the free parameters.
    pub(super) free: usize,
    /// The factor, above one.
    pub(super) factor: f64,
}

/// The parameters among these whose standard error is wider than the linearised one. `covariance` is that of the free parameters in their
/// own units, `unit` the residuals' variance in units of the stated one.
pub(super) fn wider(solved: &Solved, covariance: &DMatrix<f64>, unit: f64, weak: &[usize]) -> Vec<Wider> {
    // What earlier solutions know is of all parameters together: none of them can be held there.
    if weak.is_empty() || solved.problem.carried.is_some() {
        return Vec::new();
    }
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let here = Run { epsilon_px: 1e-4, max_turns: 0, from_afar: false, hold_noise: true };
    let least = problem.adjust(adjusted.state.clone(), adjusted.noise.clone(), &adjusted.scale, &here, Some(&adjusted.weights)).cost;
    let twin = twin(solved, covariance, weak);
    let of = |free: &usize| {
        let factor = DISTANCES
            .par_iter()
            .map(|distance| {
                let rise = cost_at(solved, covariance, *free, *distance).map_or(0.0, |cost| (cost - least) / unit);
                // Within one standard error of the best nothing is known of how far it goes on.
                distance.abs() / rise.max(1.0).sqrt()
            })
            .reduce(|| 1.0, f64::max);
        let twin = twin.as_ref().map_or(0.0, |(values, cost)| {
            let off = values[problem.free[*free]] - adjusted.state.values[problem.free[*free]];
            off.abs() / covariance[(*free, *free)].sqrt() / ((cost - least) / unit).max(1.0).sqrt()
        });
        Wider { free: *free, factor: factor.max(twin) }
    };
    weak.iter().map(of).filter(|wider| wider.factor > NOTABLE).collect()
}

/// The covariance widened along the ridges of these parameters: as one moves, the others follow it.
pub(super) fn widened(covariance: &DMatrix<f64>, wider: &[Wider]) -> DMatrix<f64> {
    let mut sum = covariance.clone();
    for Wider { free, factor } in wider {
        let ridge = covariance.column(*free) / covariance[(*free, *free)].sqrt();
        sum += (factor * factor - 1.0) * &ridge * ridge.transpose();
    }
    sum
}

/// The solution that is reached from the other signs of these parameters together (several may go into one square): its values and cost.
fn twin(solved: &Solved, covariance: &DMatrix<f64>, weak: &[usize]) -> Option<(Vec<f64>, f64)> {
    const TURNS: usize = 20;
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let size = |k: usize| covariance[(k, k)].sqrt();
    let own = DMatrix::from_fn(weak.len(), weak.len(), |i, j| covariance[(weak[i], weak[j])] / (size(weak[i]) * size(weak[j])));
    let turned = DVector::from_fn(weak.len(), |i, _| -2.0 * adjusted.state.values[problem.free[weak[i]]] / size(weak[i]));
    let gain = own.cholesky()?.solve(&turned);
    let mut state = adjusted.state.clone();
    for (k, index) in problem.free.iter().enumerate() {
        // The others are moved to where they are expected with these.
        state.values[*index] += weak.iter().zip(gain.iter()).map(|(free, gain)| covariance[(k, *free)] / size(*free) * gain).sum::<f64>();
    }
    let run = Run { epsilon_px: 1e-3, max_turns: TURNS, from_afar: false, hold_noise: true };
    // First with these held, so that what goes with them finds its place.
    let others: Vec<usize> = (0..problem.free.len()).filter(|k| !weak.contains(k)).collect();
    let state = if others.is_empty() {
        state
    } else {
        let without = holding(problem, &others);
        let scale: Vec<f64> = others.iter().map(|k| adjusted.scale[*k]).collect();
        without.adjust(state, adjusted.noise.clone(), &scale, &run, Some(&adjusted.weights)).state
    };
    let reached = problem.adjust(state, adjusted.noise.clone(), &adjusted.scale, &run, Some(&adjusted.weights));
    let is_finite = reached.cost.is_finite() && reached.state.values.iter().all(|value| value.is_finite());
    is_finite.then_some((reached.state.values, reached.cost))
}

/// The cost with one parameter held some standard errors from the solution and everything else adjusted.
fn cost_at(solved: &Solved, covariance: &DMatrix<f64>, held: usize, distance: f64) -> Option<f64> {
    const TURNS: usize = 12;
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let mut state = adjusted.state.clone();
    // Along the ridge: the others are moved to where they are expected.
    let ridge = covariance.column(held) / covariance[(held, held)].sqrt();
    for (k, index) in problem.free.iter().enumerate() {
        state.values[*index] += distance * ridge[k];
    }
    let others: Vec<usize> = (0..problem.free.len()).filter(|k| *k != held).collect();
    let without = holding(problem, &others);
    let scale: Vec<f64> = others.iter().map(|k| adjusted.scale[*k]).collect();
    let run = Run { epsilon_px: 1e-3, max_turns: TURNS, from_afar: false, hold_noise: true };
    let own = problem.priors.iter().filter(|prior| prior.free == held).map(|prior| {
        let off = (state.values[problem.free[held]] - prior.value) / prior.sigma;
        adjusted.noise.unit_variance * off * off
    });
    let own: f64 = own.sum();
    let cost = without.adjust(state, adjusted.noise.clone(), &scale, &run, Some(&adjusted.weights)).cost;
    (cost + own).is_finite().then_some(cost + own)
}

/// The problem with only these of its free parameters free; what is known of the others beforehand is left out.
fn holding(problem: &Problem, others: &[usize]) -> Problem {
    let place = |prior: &Prior| Some(Prior { free: others.iter().position(|k| *k == prior.free)?, ..*prior });
    let priors = problem.priors.iter().filter_map(place).collect();
    Problem { free: others.iter().map(|k| problem.free[*k]).collect(), priors, ..problem.clone() }
}
