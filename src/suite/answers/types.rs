//! An answer and its parts, whatever file it came from.

use crate::suite::conventions::WrittenAttitude;

/// What a system says of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AnswerStatus {
    /// It has an attitude.
    Solved,
    /// It has none, and says so.
    #[default]
    None,
    /// It says that something went wrong.
    Error,
    /// It ended by itself before it answered.
    Crashed,
    /// It did not answer in time.
    TimedOut,
    /// What it wrote is no answer.
    Unreadable,
}

/// The answer to one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrackerAnswer {
    /// What it says.
    pub status: AnswerStatus,
    /// The attitude as it was written.
    pub attitude: Option<WrittenAttitude>,
    /// How long it took, as it says itself, s.
    pub time_s: Option<f64>,
    /// Its words, where something went wrong.
    pub error: Option<String>,
    /// Its star images.
    pub centroids: Option<Vec<AnsweredStar>>,
    /// Its camera.
    pub camera: Option<AnsweredCamera>,
}

/// A star image of a system under test, in its own pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnsweredStar {
    /// Column.
    pub x: f64,
    /// Row.
    pub y: f64,
    /// Hipparcos number of the star that it is held to be.
    pub hip: Option<u32>,
}

/// A camera that a system under test recovered; absent keys are not judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AnsweredCamera {
    /// Focal length.
    pub focal_length_px: Option<f64>,
    /// Its standard error.
    pub focal_length_sigma_px: Option<f64>,
    /// Principal point.
    pub principal_point_px: Option<[f64; 2]>,
    /// Its standard errors.
    pub principal_point_sigma_px: Option<[f64; 2]>,
    /// Radial distortion (CONVENTIONS.md), px⁻².
    pub k1: Option<f64>,
    /// Its standard error.
    pub k1_sigma: Option<f64>,
}

impl TrackerAnswer {
    /// Without an attitude.
    #[must_use]
    pub fn without(status: AnswerStatus, error: Option<String>) -> Self {
        Self { status, error, ..Self::default() }
    }

    pub(super) fn solved(attitude: WrittenAttitude) -> Self {
        Self { status: AnswerStatus::Solved, attitude: Some(attitude), ..Self::default() }
    }
}

/// What a file of answers holds: answers by the number of their frame, and what is wrong with the file, one sentence each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AnswerFile {
    /// Answers; without a number where the form has none (one frame a file).
    pub answers: Vec<(Option<usize>, TrackerAnswer)>,
    /// Faults with their lines.
    pub faults: Vec<String>,
}

impl AnswerFile {
    pub(super) fn fault(text: String) -> Self {
        Self { answers: Vec::new(), faults: vec![text] }
    }

    /// The answer of a file for one frame; a frame that it does not name is meant if it is the only one.
    #[must_use]
    pub fn of_frame(self, frame: usize) -> TrackerAnswer {
        let count = self.answers.len();
        let own =
            self.answers.into_iter().find(|(number, _)| number.is_none_or(|number| number == frame) || count == 1 && *number == Some(0));
        match (own, self.faults.first()) {
            (_, Some(fault)) => TrackerAnswer::without(AnswerStatus::Unreadable, Some(fault.clone())),
            (Some((_, answer)), None) => answer,
            (None, None) => TrackerAnswer::without(AnswerStatus::Unreadable, Some(format!("holds no answer for the frame {frame}"))),
        }
    }
}
