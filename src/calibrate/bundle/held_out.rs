//! Cross-validation over frames at the cost of one Newton step per fold, without a new solution.
//!
//! The normal equations of the solution are a sum over frames. Without the frames of a fold they are known too, and one Newton step from
//! the solution leads to the solution of the other frames, to second order in that step (which is a fraction of the parameters' own
//! errors). So k folds cost one more pass over the star images, not k solutions. The held-out frame's own attitude is fitted anew with the
//! camera of the others; the star images are judged that the full solution uses.

use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};

use super::noise::Whitened;
use super::normal::Reduced;
use super::problem::{Attitudes, Problem, Row, State};
use super::{Adjusted, Solved};
use crate::calibrate::held_out::folds;
use crate::parallel;

/// 2-D rms of the held-out star images, px; `None` with fewer than two frames, or where one part alone determines the camera.
pub(in crate::calibrate) fn rms_px(solved: &Solved) -> Option<f64> {
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let active: Vec<usize> = (0..problem.exposures.len()).filter(|k| adjusted.weights[*k].iter().any(|weight| *weight > 0.5)).collect();
    if active.len() < 2 {
        return None;
    }
    let folds = folds(active.len());
    let shared = problem.shared_count();
    let parts: Vec<Reduced> = parallel::map(&active, |exposure| {
        let mut own = Reduced::zero(shared);
        let held = |index: usize, _: &Row, _: &Whitened| adjusted.weights[*exposure][index];
        let sums = problem.frame_sums(
            &adjusted.state.values,
            problem.own(&adjusted.state, *exposure),
            &adjusted.noise,
            &adjusted.scale,
            *exposure,
            held,
        );
        sums.eliminate(0.0, &mut own);
        own
    });
    let mut total = Reduced::zero(shared);
    for part in &parts {
        total.matrix += &part.matrix;
        total.right += &part.right;
    }
    for prior in &problem.priors {
        let weight = adjusted.noise.unit_variance / (prior.sigma * adjusted.scale[prior.free]).powi(2);
        let off = (adjusted.state.values[problem.free[prior.free]] - prior.value) * adjusted.scale[prior.free];
        total.matrix[(prior.free, prior.free)] += weight;
        total.right[prior.free] -= weight * off;
    }
    let states: Vec<Option<State>> = (0..folds)
        .map(|fold| {
            let mut rest = total.clone();
            // Every k-th frame, so that a drift through the night is shared by all folds.
            for part in parts.iter().skip(fold).step_by(folds) {
                rest.matrix -= &part.matrix;
                rest.right -= &part.right;
            }
            moved(problem, adjusted, &rest)
        })
        .collect();
    let squares: Vec<Option<(f64, usize)>> =
        parallel::map_numbers(active.len(), |place| judged(problem, adjusted, states[place % folds].as_ref()?, active[place]));
    let (mut sum, mut count) = (0.0, 0_usize);
    for one in squares {
        let (square, images) = one?;
        sum += square;
        count += images;
    }
    (count > 0).then(|| (sum / count as f64).sqrt())
}

/// The state one Newton step away, on other frames' equations.
fn moved(problem: &Problem, adjusted: &Adjusted, rest: &Reduced) -> Option<State> {
    let n = rest.right.len();
    let root: Vec<f64> = (0..n).map(|k| rest.matrix[(k, k)].sqrt()).collect();
    if root.iter().any(|r| r.is_nan() || *r <= 0.0) {
        return None;
    }
    let matrix = DMatrix::from_fn(n, n, |i, j| rest.matrix[(i, j)] / (root[i] * root[j]));
    let right = DVector::from_fn(n, |i, _| rest.right[i] / root[i]);
    let step = matrix.cholesky()?.solve(&right);
    let mut state = adjusted.state.clone();
    for (k, index) in problem.free.iter().enumerate() {
        state.values[*index] += step[k] / root[k] / adjusted.scale[k];
    }
    if problem.attitudes == Attitudes::FixedToEarth {
        let at = problem.free.len();
        let turn = Vector3::new(step[at] / root[at], step[at + 1] / root[at + 1], step[at + 2] / root[at + 2]);
        state.mount = UnitQuaternion::from_scaled_axis(turn) * state.mount;
    }
    Some(state)
}

/// Sum of squares of a held-out frame's star images, its own attitude (and rates) fitted anew, and their number.
fn judged(problem: &Problem, adjusted: &Adjusted, state: &State, exposure: usize) -> Option<(f64, usize)> {
    const STEPS: usize = 3;
    const SMALL_STEP_PX: f64 = 0.01;
    let mut own = problem.own(state, exposure)?;
    if problem.attitudes != Attitudes::FixedToEarth {
        let held = |index: usize, _: &Row, _: &Whitened| adjusted.weights[exposure][index];
        let largest_rad = SMALL_STEP_PX / adjusted.state.values[2].abs();
        for _ in 0..STEPS {
            // The camera is held: none of its parameters takes part.
            let sums = problem.frame_sums(&state.values, Some(own), &adjusted.noise, &[], exposure, held);
            let step = sums.eliminate(0.0, &mut Reduced::zero(0))?.own_step(&DVector::zeros(0));
            own.step(step);
            // Steps grow smaller by the square: what is left after a small one is nothing.
            if step.iter().all(|step| step.abs() < largest_rad) {
                break;
            }
        }
    }
    let (mut sum, mut count) = (0.0, 0_usize);
    problem.linearise_at(&state.values, own, exposure, |index, row| {
        if adjusted.weights[exposure][index] > 0.5 {
            sum += row.residual[0].powi(2) + row.residual[1].powi(2);
            count += 1;
        }
    });
    Some((sum, count))
}
