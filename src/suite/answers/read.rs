//! Files of answers by their form.

use super::types::AnswerFile;
use super::{astrometry_wcs, csv_file, json, lost, tetra3};
use crate::suite::conventions::{Conventions, SignedAxes};
use crate::suite::suite_file::AnswerForm;

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
pub(in crate::suite) fn read_stream_line(line: &str) -> AnswerFile {
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
