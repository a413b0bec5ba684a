//! Options, report and errors of a sequential update.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::calibrate::CalibrateError;

/// What is done with frames of a camera that has changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnChange {
    /// They are not taken; the calibration stays as it was.
    #[default]
    Refuse,
    /// They are taken like all others.
    Average,
    /// They are taken, and what was known before is forgotten (its standard errors become a hundred times as large).
    Restart,
}

/// A parameter that drifts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// The parameter.
    pub name: String,
    /// Standard deviation of its random walk over one frame, in its own unit; over n frames √n times as much.
    pub sigma_per_frame: f64,
}

/// How an update is done. By default nothing is forgotten, nothing drifts, and frames of a changed camera are refused.
#[derive(Clone, Debug, PartialEq)]
pub struct UpdateOptions {
    /// Old frames count 1/e after this many new ones.
    pub forget_frames: Option<f64>,
    /// Parameters that drift.
    pub drift: Vec<Drift>,
    /// What is done with frames of a camera that has changed.
    pub on_change: OnChange,
    /// A camera has changed if an unchanged one would give such new frames with less than this probability.
    pub change_probability: f64,
}

impl Default for UpdateOptions {
    fn default() -> Self {
        Self { forget_frames: None, drift: Vec::new(), on_change: OnChange::Refuse, change_probability: 1e-6 }
    }
}

/// A parameter before and after an update.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ParameterChange {
    /// Its name.
    pub name: String,
    /// Value before.
    pub before: f64,
    /// Standard error before (after forgetting and drift).
    pub sigma_before: f64,
    /// Value after.
    pub after: f64,
    /// Standard error after.
    pub sigma_after: f64,
    /// By how many standard errors the new frames, taken at face value, move it: normal with variance one if the camera is the same.
    pub moved_sigma: f64,
    /// Unit of the values and standard errors.
    pub unit: String,
}

/// What an update has done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct UpdateReport {
    /// Whether the new frames were taken. They are not if the camera has changed ([`OnChange::Refuse`]), or the iteration did not end.
    pub taken: bool,
    /// Whether the iteration came to its end.
    pub converged: bool,
    /// Whether the camera has changed.
    pub changed: bool,
    /// χ² of the new frames' estimate against what was known.
    pub change_chi_squared: f64,
    /// Combinations of parameters in it.
    pub change_degrees: usize,
    /// Probability of such a χ², or a larger one, of an unchanged camera (F distribution, as the noise is found from the residuals).
    pub change_probability: f64,
    /// New frames that take part.
    pub frames: usize,
    /// New star images offered.
    pub stars_offered: usize,
    /// New star images used.
    pub stars: usize,
    /// 2-D rms of those used, px.
    pub rms_px: Option<f64>,
    /// The parameters.
    pub parameters: Vec<ParameterChange>,
    /// What to mind, one sentence each.
    pub warnings: Vec<String>,
}

/// Why a calibration cannot go on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SequentialError {
    /// The new frames cannot be solved.
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
    /// Pairs of stars leave no information matrix.
    #[error("a calibration by {method} cannot be updated: calibrate with --method bundle, which weighs single stars")]
    NotJoint {
        /// The method.
        method: &'static str,
    },
    /// The calibration is no result.
    #[error("the calibration did not converge and cannot be updated: calibrate again with more frames or fewer parameters")]
    NotConverged,
    /// Another size of frames.
    #[error("the new frames have {new:?} pixels, but the calibration is of frames of {known:?}: update with frames of the same camera")]
    OtherFrame {
        /// Width and height of the new frames.
        new: [usize; 2],
        /// Those of the calibration.
        known: [usize; 2],
    },
    /// An option that makes no sense.
    #[error("{name} = {value} cannot be used for an update: {allowed}")]
    BadOption {
        /// The option.
        name: &'static str,
        /// Its value.
        value: String,
        /// What can.
        allowed: String,
    },
    /// The state is none.
    #[error("the sequential state is not usable, {place} = {value}: {remedy}")]
    BadState {
        /// Where.
        place: String,
        /// What is there.
        value: String,
        /// What should be.
        remedy: &'static str,
    },
}
