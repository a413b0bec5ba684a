//! Cross-validation over frames: the camera from the other frames, the frame's own attitude free.
//!
//! The same star images are judged as in sample (those that the full solution uses), so the two rms values stand side by side.

use super::geometry::Scaling;
use super::pair_methods::solve_pairs;
use super::pairs::FrameStars;
use super::star_level::{ResidualSums, fit_attitude};
use super::{CalibrateError, CalibrateOptions};
use crate::camera::Camera;

/// Below this many frames every frame is a fold of its own.
const LEAVE_ONE_OUT_BELOW: usize = 16;
/// Folds above.
const FOLDS: usize = 10;

/// The parts into which so many frames are taken.
pub(super) fn folds(frames: usize) -> usize {
    if frames < LEAVE_ONE_OUT_BELOW { frames } else { FOLDS }
}

/// 2-D rms of the held-out star images, px; `None` with a single frame.
pub(super) fn rms_px(
    frames: &[FrameStars],
    used: &[Vec<bool>],
    nominal: &Camera,
    scaling: &Scaling,
    options: &CalibrateOptions,
) -> Result<Option<f64>, CalibrateError> {
    if frames.len() < 2 {
        return Ok(None);
    }
    let folds = folds(frames.len());
    let mut sums = ResidualSums::default();
    for fold in 0..folds {
        // Every k-th frame, so that a drift through the night is shared by all folds.
        let others: Vec<FrameStars> =
            frames.iter().enumerate().filter(|(i, _)| i % folds != fold).map(|(_, frame)| frame.clone()).collect();
        let camera = solve_pairs(&others, nominal, scaling, options)?.camera;
        for (frame, used) in frames.iter().zip(used).skip(fold).step_by(folds) {
            let part = ResidualSums::of(&[fit_attitude(&camera, &frame.stars, used)], std::slice::from_ref(used));
            sums.square_px2 += part.square_px2;
            sums.stars += part.stars;
        }
    }
    Ok(sums.rms_px())
}
