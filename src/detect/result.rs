//! What `boresight detect` says: the result, as it stands in files.

use schemars::JsonSchema;
use serde::Serialize;

use super::{Detections, PsfReport};
use crate::provenance::Provenance;
use crate::recording::SkippedFrame;

/// The name of the file format.
pub const FORMAT: &str = "boresight-detect/1";

/// The stars of a recording.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct DetectResult<'a> {
    /// [`FORMAT`].
    pub format: &'static str,
    /// The frames that were measured.
    pub frames: Vec<DetectedFrame<'a>>,
    /// Frames that could not be read.
    pub skipped: &'a [SkippedFrame],
    /// What to mind of the input, one sentence each.
    pub notes: &'a [String],
    /// Which image the stars are fitted with, where an empirical one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psf: Option<PsfReport>,
    /// How the file came about.
    pub provenance: Provenance,
}

/// The stars of one frame.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct DetectedFrame<'a> {
    /// The frame's file, or its number.
    pub file: &'a str,
    /// Its stars.
    #[serde(flatten)]
    pub detections: &'a Detections,
    /// Time the measurement took, s.
    pub seconds: f64,
}
