//! What the verbs on calibrations say: the results, as they stand in files.

use schemars::JsonSchema;
use serde::Serialize;

use super::{Calibration, Comparison, Map, Method, Sequential, Status, UpdateReport};
use crate::detect::LearntImage;
use crate::provenance::Provenance;
use crate::recording::SkippedFrame;

/// What `boresight calibrate` writes.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum CalibrateResult<'a> {
    /// A camera.
    Solved(Box<SolvedCamera<'a>>),
    /// The stars lead to none.
    Unsolved(Box<UnsolvedCamera>),
}

/// The calibration, and what was done to its input.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SolvedCamera<'a> {
    /// The calibration, its columns those of the images as stored.
    #[serde(flatten)]
    pub calibration: Calibration,
    /// Frames that could not be read.
    pub skipped: &'a [SkippedFrame],
    /// What to mind of the input, one sentence each.
    pub notes: &'a [String],
    /// The image that the recording's stars show, whose bias was taken off the places; absent where none was learnt.
    pub image: Option<LearntImage>,
    /// What the noise of the stars tells of the detector; absent where a gain is declared, or nothing tells it.
    pub detector: Option<DetectorNumbers>,
    /// Identifications that were made wrong on purpose.
    pub misidentified_on_purpose: Vec<MisidentifiedPoint>,
}

/// Numbers of the detector that no file declares, as the noise of its stars and its sky tells them.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct DetectorNumbers {
    /// Gain, and read noise or bias where the other one is declared.
    pub parameters: Vec<DetectorNumber>,
    /// The same in words, with what cannot be told.
    pub reason: String,
}

/// A number with its standard error.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct DetectorNumber {
    /// Its name, which ends in its unit.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its standard error.
    pub sigma: f64,
}

/// An identification that was made wrong on purpose.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct MisidentifiedPoint {
    /// Index of the frame in its recording.
    pub frame: usize,
    /// Measured column.
    pub x_px: f64,
    /// Measured row.
    pub y_px: f64,
    /// Catalogue number of the star that it is.
    pub true_hip: u32,
    /// Catalogue number of the star that it was given; absent where that is a direction without a star.
    pub given_hip: Option<u32>,
    /// Angle between the two.
    pub error_arcsec: f64,
}

/// What is written where the stars lead to no camera.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct UnsolvedCamera {
    /// [`super::FORMAT`].
    pub format: &'static str,
    /// The method.
    pub method: Method,
    /// Always `not-converged`.
    pub status: Status,
    /// Why, in a sentence.
    pub reason: String,
    /// Ids of the effects that the star directions contain.
    pub physics: Vec<String>,
    /// Names of the parameters that were to be solved.
    pub model: Vec<String>,
    /// Always empty.
    pub parameters: [(); 0],
    /// Always null.
    #[schemars(with = "()")]
    pub camera: Option<()>,
    /// Star images used: none.
    pub stars: usize,
    /// Star images offered.
    pub stars_offered: usize,
    /// What to mind, one sentence each.
    pub warnings: Vec<String>,
    /// How the file came about.
    pub provenance: Provenance,
}

/// What `boresight calibrate --update` writes: the state to go on from, and what the new frames did to it.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct UpdateResult<'a> {
    /// The calibration after the new frames.
    #[serde(flatten)]
    pub state: &'a Sequential,
    /// Frames before them.
    pub frames_before: usize,
    /// What they did.
    pub update: UpdateReport,
    /// Frames that could not be read.
    pub skipped: &'a [SkippedFrame],
    /// What to mind of the input, one sentence each.
    pub notes: Vec<String>,
    /// How the file came about.
    pub provenance: Provenance,
}

/// What `boresight compare` writes.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct CompareResult {
    /// The two calibrations side by side.
    #[serde(flatten)]
    pub comparison: Comparison,
    /// The limit that was given, and whether the difference keeps it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<DifferenceLimit>,
    /// How the file came about.
    pub provenance: Provenance,
}

/// The largest difference that is none, and what came of it.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct DifferenceLimit {
    /// The limit.
    pub max_px: f64,
    /// Whether the difference is within it everywhere.
    pub is_kept: bool,
}

/// What `boresight map` writes.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct MapResult {
    /// The map.
    #[serde(flatten)]
    pub map: Map,
    /// How the file came about.
    pub provenance: Provenance,
}
