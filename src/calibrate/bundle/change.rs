//! Test of whether new frames are of the same, unchanged camera. With Λ the information known and N that of the new frames, the step from the one
//! to both has the covariance Λ⁻¹ − (Λ + N)⁻¹ if they are.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::known::{Known, WIDE, lost, of_parameters};
use super::{Adjusted, Problem, Run};
use crate::calibrate::result::REJECTED_WEIGHT;

/// Directions in which the new frames add less than this share to what is known do not take part in the test.
const SEEN: f64 = 1e-6;

/// Whether the new frames are of the same camera.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Change {
    /// Square of the step in units of its covariance.
    pub(in crate::calibrate) chi_squared: f64,
    /// Combinations of parameters that the new frames see.
    pub(in crate::calibrate) degrees: usize,
    /// Probability of such a step, or a larger one, of a camera that has not changed.
    pub(in crate::calibrate) probability: f64,
    /// The step of each parameter in units of its standard error.
    pub(in crate::calibrate) steps_sigma: Vec<f64>,
}

/// Whether the step from what is known to the solution with the new frames is one that noise makes.
pub(super) fn test(problem: &mut Problem, known: &Known, alone: &Adjusted, held: &Adjusted, scale: &[f64]) -> Option<Change> {
    let carried = problem.carried.take()?;
    // No turn, only the sums: what the new frames know without anything else.
    let run = Run { epsilon_px: 1.0, max_turns: 0, from_afar: false, hold_noise: true };
    let sums = problem.adjust(held.state.clone(), held.noise.clone(), scale, &run, Some(&alone.weights));
    let n = problem.free.len();
    let new = of_parameters(&sums.information, n, scale)?;
    let root: Vec<f64> = (0..n).map(|k| carried.information[(k, k)].sqrt()).collect();
    let equilibrated = |matrix: &DMatrix<f64>| DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] / (root[i] * root[j]));
    let factor = equilibrated(&carried.information).cholesky()?.l();
    let half = factor.solve_lower_triangular(&equilibrated(&new))?;
    let ratio = factor.solve_lower_triangular(&half.transpose())?;
    let eigen = ((&ratio + ratio.transpose()) * 0.5).symmetric_eigen();
    let step = DVector::from_fn(n, |k, _| (held.state.values[problem.free[k]] - carried.values[k]) * root[k]);
    let along = eigen.eigenvectors.transpose() * (factor.transpose() * &step);
    let axes = factor.transpose().solve_upper_triangular(&eigen.eigenvectors)?;
    let (mut chi_squared, mut degrees, mut taken) = (0.0, 0, 0.0);
    for (ratio, step) in eigen.eigenvalues.iter().zip(along.iter()).filter(|(ratio, _)| **ratio > SEEN) {
        chi_squared += step * step * (1.0 + ratio) / ratio;
        degrees += 1;
        taken += ratio / (ratio + WIDE);
    }
    problem.carried = Some(carried);
    if degrees == 0 {
        return Some(Change { chi_squared: 0.0, degrees, probability: 1.0, steps_sigma: vec![0.0; n] });
    }
    // The variance of unit weight, from residuals that the step has no part in.
    let floor = alone.noise.floor_px2;
    let active = alone.weights.iter().filter(|weights| weights.iter().any(|weight| *weight > REJECTED_WEIGHT)).count();
    let freedom_before = (2.0 * known.memory.weight() - known.memory.lost - n as f64).max(0.0);
    let freedom = freedom_before + 2.0 * alone.weight_sum - lost(problem, active) - taken;
    let unit = (known.memory.chi_squared(floor) + alone.chi_squared) / freedom.max(1.0);
    let ratio = chi_squared / degrees as f64 / unit.max(f64::MIN_POSITIVE);
    let probability = FisherSnedecor::new(degrees as f64, freedom.max(1.0)).map_or(1.0, |f| f.sf(ratio));
    let variance = |k: usize| -> f64 {
        let share = |(axis, ratio): (&f64, &f64)| axis * axis * ratio.max(0.0) / (1.0 + ratio.max(0.0));
        axes.row(k).iter().zip(eigen.eigenvalues.iter()).map(share).sum()
    };
    let steps_sigma = (0..n).map(|k| step[k] / (unit * variance(k)).sqrt().max(f64::MIN_POSITIVE)).collect();
    Some(Change { chi_squared: chi_squared / unit, degrees, probability, steps_sigma })
}
