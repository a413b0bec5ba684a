//! Unweighted least squares on pairs of stars, for comparison: P = I, iterated until the step is small (Gauss–Newton).
//!
//! A single wrong identification enters all pairs of its star with full weight, so this is what the robust methods are measured against.

use super::CalibrateError;
use super::geometry::Scaling;
use super::pairs::FrameStars;
use super::variable_weights::{self, Limits, PairSolution};
use crate::camera::Camera;

/// Solves with all weights one.
pub(super) fn solve(frames: &[FrameStars], start: &Camera, scaling: &Scaling, limits: &Limits) -> Result<PairSolution, CalibrateError> {
    variable_weights::solve(frames, start, scaling, &Limits { f_threshold: None, ..*limits })
}
