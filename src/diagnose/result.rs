//! What `boresight diagnose` writes: the diagnosis, and what was done to its input.

use schemars::JsonSchema;
use serde::Serialize;

use super::{Diagnosis, Verdict};
use crate::provenance::Provenance;
use crate::recording::SkippedFrame;

/// What `boresight diagnose` writes.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum DiagnoseResult<'a> {
    /// An answer.
    Answered(AnsweredDiagnosis<'a>),
    /// The frames do not lead to a question.
    Unasked(UnaskedDiagnosis),
}

/// The diagnosis, and what was done to its input.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct AnsweredDiagnosis<'a> {
    /// The diagnosis.
    #[serde(flatten)]
    pub diagnosis: &'a Diagnosis,
    /// −1 if the images are mirrored. Columns are those of the images as stored; parameters are those of the un-mirrored image.
    pub parity: i8,
    /// Frames that could not be read.
    pub skipped: &'a [SkippedFrame],
    /// What to mind of the input, one sentence each.
    pub notes: &'a [String],
}

/// What is written where the frames do not lead to a question.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct UnaskedDiagnosis {
    /// [`super::FORMAT`].
    pub format: &'static str,
    /// Always `undecided`.
    pub verdict: Verdict,
    /// Why, in a sentence.
    pub reason: String,
    /// Always empty.
    pub findings: [(); 0],
    /// How the file came about.
    pub provenance: Provenance,
}
