//! What `boresight run` and `boresight demo` say: the result, as it stands in files.

use schemars::JsonSchema;
use serde::Serialize;

use super::run_limit::RunRequirement;
use crate::provenance::Provenance;

/// The name of the file format.
pub const RUN_FORMAT: &str = "boresight-run/1";

/// A simulated night, calibrated and held against its truth.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RunResult {
    /// [`RUN_FORMAT`].
    pub format: &'static str,
    /// The parameters of the camera by every method.
    pub parameters: Vec<ParameterRow>,
    /// The cameras found against the true one.
    pub cameras: Vec<CameraRow>,
    /// Frames rendered.
    pub frames: usize,
    /// Frames whose stars were named.
    pub frames_identified: usize,
    /// Identifications that are wrong, those on purpose not counted.
    pub wrong_identifications: usize,
    /// Star images that the calibration was offered.
    pub control_points: usize,
    /// Identifications that were made wrong on purpose.
    pub misidentified: usize,
    /// Share of them that was asked for.
    pub misidentify_share: f64,
    /// Seed of their choice.
    pub misidentify_seed: u64,
    /// Those of them that the joint method rejected.
    pub misidentified_rejected: usize,
    /// Those of them that did not enter, as those of stars without a known proper motion do not.
    pub misidentified_left_out: usize,
    /// What was left out, and whether fewer identifications were made wrong than asked for, one sentence each.
    pub notes: Vec<String>,
    /// The limits that were asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub requirements: Vec<RunRequirement>,
    /// How the file came about.
    pub provenance: Provenance,
}

/// A parameter of the camera by every method; absent where a method gave no camera.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ParameterRow {
    /// Its name.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// As the recording declares it.
    pub nominal: f64,
    /// As it is.
    pub truth: f64,
    /// By pairs of stars, all weights one.
    pub least_squares: Option<f64>,
    /// By pairs of stars with variable weights.
    pub variable_weights: Option<f64>,
    /// Standard error of that.
    pub variable_weights_sigma: Option<f64>,
    /// By the joint method.
    pub bundle: Option<f64>,
    /// Standard error of that.
    pub bundle_sigma: Option<f64>,
}

/// A camera against the truth.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct CameraRow {
    /// Which camera: `nominal`, or the method that found it.
    pub camera: &'static str,
    /// What came of the method, in words.
    pub status: String,
    /// 2-D rms difference of its map from the true one, the best rotation taken out.
    pub mapping_error_rms_px: Option<f64>,
    /// Largest difference.
    pub mapping_error_max_px: Option<f64>,
    /// 2-D rms of the star images used.
    pub residual_rms_px: Option<f64>,
    /// 2-D rms of held-out frames.
    pub held_out_rms_px: Option<f64>,
}
