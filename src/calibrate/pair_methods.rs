//! The methods on pairs of stars, by name.

use super::error::CalibrateError;
use super::geometry::Scaling;
use super::least_squares;
use super::options::{CalibrateOptions, Method};
use super::pairs::FrameStars;
use super::variable_weights::{self, Limits, PairSolution};
use crate::camera::Camera;

/// The solver of the method.
pub(super) fn solve_pairs(
    frames: &[FrameStars],
    nominal: &Camera,
    scaling: &Scaling,
    options: &CalibrateOptions,
) -> Result<PairSolution, CalibrateError> {
    let limits = Limits { f_threshold: Some(options.f_threshold), epsilon_px: options.epsilon_px, max_iterations: options.max_iterations };
    match options.method {
        Method::VariableWeights => variable_weights::solve(frames, nominal, scaling, &limits).or_else(|error| match error {
            CalibrateError::Diverged { .. } | CalibrateError::Singular { .. } => {
                variable_weights::solve_in_stages(frames, nominal, scaling, &limits).unwrap_or(Err(error))
            }
            _ => Err(error),
        }),
        Method::LeastSquares | Method::Bundle => least_squares::solve(frames, nominal, scaling, &limits),
    }
}
