//! Answers of a system under test, and the files that hold them.

mod astrometry_wcs;
mod csv_file;
mod json;
mod lost;
mod sidecars;
mod tetra3;

pub(in crate::suite) use sidecars::{camera_of, centroids_of};

use super::conventions::{Conventions, SignedAxes, WrittenAttitude};
use super::suite_file::AnswerForm;

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

    fn solved(attitude: WrittenAttitude) -> Self {
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
    fn fault(text: String) -> Self {
        Self { answers: Vec::new(), faults: vec![text] }
    }

    /// The answer of a file for one frame; a frame that it does not name is meant if it is the only one.
    #[must_use]
    pub fn of_frame(self, frame: usize) -> TrackerAnswer {
        let count = self.answers.len();
        let own = self.answers.into_iter().find(|(number, _)| number.is_none_or(|number| number == frame) || count == 1 && *number == Some(0));
        match (own, self.faults.first()) {
            (_, Some(fault)) => TrackerAnswer::without(AnswerStatus::Unreadable, Some(fault.clone())),
            (Some((_, answer)), None) => answer,
            (None, None) => TrackerAnswer::without(AnswerStatus::Unreadable, Some(format!("holds no answer for the frame {frame}"))),
        }
    }
}

/// Reads answers of a form; `size_px` is that of the frames, which world coordinates need.
#[must_use]
pub fn read_answers(form: AnswerForm, bytes: &[u8], size_px: [usize; 2]) -> AnswerFile {
    if form == AnswerForm::AstrometryWcs {
        return astrometry_wcs::read(bytes, size_px);
    }
    match std::str::from_utf8(bytes) {
        Err(error) => AnswerFile::fault(format!("is no text: byte {} is no UTF-8", error.valid_up_to())),
        Ok(text) => match form {
            AnswerForm::Csv => csv_file::read(text),
            AnswerForm::Json => json::read(text),
            AnswerForm::Lost => lost::read(text),
            AnswerForm::Tetra3 => tetra3::read(text),
            AnswerForm::AstrometryWcs => AnswerFile::default(),
        },
    }
}

/// One line of a stream.
#[must_use]
pub fn read_stream_line(line: &str) -> AnswerFile {
    json::read(line)
}

/// The conventions of programs that have their own.
#[must_use]
pub fn usual_conventions(form: AnswerForm) -> Conventions {
    let usual = Conventions::default();
    match form {
        // Source: UWCubeSat/lost, src/camera.cpp (x is the direction of depth, columns are −y, rows −z), src/attitude-utils.cpp.
        AnswerForm::Lost => Conventions { axes: SignedAxes([(2, 1), (0, -1), (1, -1)]), ..usual },
        _ => usual,
    }
}

#[cfg(test)]
mod tests;
