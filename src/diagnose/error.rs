//! Why there is no diagnosis.

use crate::calibrate::CalibrateError;

/// Why there is no diagnosis.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DiagnoseError {
    /// The baseline cannot be fitted.
    #[error("the camera that the recording is held against cannot be fitted: {0}")]
    Baseline(#[from] CalibrateError),
    /// Too little to judge.
    #[error("{images} star images in {frames} frames are too few to judge anything beside attitudes and camera: give more frames")]
    TooFew {
        /// Star images.
        images: usize,
        /// Frames.
        frames: usize,
    },
}
