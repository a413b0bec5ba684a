//! The descent to the residuals of greatest likelihood under t errors.

use super::frame_nuisance::FrameNuisance;
use super::linear_system::{Whitened, WhitenedSystem, masked};
use crate::statistics::student_t::{cost, psi_of};

/// Residuals of the images taken with every shared parameter held: the nuisance parameters (attitudes) are refitted, robustly.
pub(super) fn refit_own(system: &WhitenedSystem, take: &[bool], residual: &[f64]) -> Whitened {
    let own = FrameNuisance::new(system, take);
    let project = |column: &mut Whitened| -> Vec<f64> {
        own.take_out(column);
        Vec::new()
    };
    descend(masked(residual, take), take, system.tail_degrees, 0, project).0
}

/// Residuals of least Σρ that differ from those given by what `project` takes out of a column (it returns the coefficients along some of
/// what it takes), and the sums of these coefficients.
///
/// From the residuals as given, or from those of least squares if their cost is lower: with parameters of other frames a whole frame may
/// stand tens of σ off, where ψ is all tail. The step Πψ/d is Newton's with a mean slope; where it does not lower the cost the step with
/// the largest slope there is does (Huber's bound), so the descent cannot run away.
pub(super) fn descend(
    start: Whitened,
    take: &[bool],
    tail_degrees: f64,
    along: usize,
    project: impl Fn(&mut Whitened) -> Vec<f64>,
) -> (Whitened, Vec<f64>) {
    const TURNS: usize = 60;
    let steepest = if tail_degrees.is_finite() { (tail_degrees + 2.0) / tail_degrees } else { 1.0 };
    let value = |residual: &Whitened| cost(residual, take, tail_degrees);
    // The residuals after a step along ψ with a slope, and the coefficients.
    let stepped = |residual: &Whitened, psi: &Whitened, slope: f64| {
        let mut left = psi.clone();
        let part = project(&mut left);
        let next: Whitened = residual.iter().zip(psi.iter().zip(&left)).map(|(r, (psi, left))| r - (psi - left) / slope).collect();
        (next, part.into_iter().map(|part| -part / slope).collect::<Vec<f64>>())
    };
    let (mut residual, mut moved) = (start, vec![0.0; along]);
    let mut least = value(&residual);
    let mut psi = residual.clone();
    let mut slope = 1.0;
    for turn in 0..TURNS {
        let (mut next, mut part) = stepped(&residual, &psi, slope);
        let mut reached = value(&next);
        if turn > 0 && reached > least {
            (next, part) = stepped(&residual, &psi, steepest);
            reached = value(&next);
        }
        if reached < least {
            for (moved, part) in moved.iter_mut().zip(part) {
                *moved += part;
            }
            let settled = least - reached < 1e-10 * least.abs().max(1.0);
            (residual, least) = (next, reached);
            if settled && turn > 0 {
                break;
            }
        } else if turn > 0 {
            break;
        }
        (psi, slope) = psi_of(&residual, take, tail_degrees);
    }
    (residual, moved)
}
