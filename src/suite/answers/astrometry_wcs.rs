//! The header that `solve-field` writes (`.wcs`): world coordinates of the frame, from which the attitude follows.

use super::types::{AnswerFile, AnswerStatus, TrackerAnswer};
use crate::exchange::{Format, import};
use crate::suite::conventions::WrittenAttitude;

/// Reads a header; an empty file means that nothing was found.
pub(super) fn read(bytes: &[u8], size_px: [usize; 2]) -> AnswerFile {
    if bytes.is_empty() {
        return AnswerFile { answers: vec![(None, TrackerAnswer::without(AnswerStatus::None, None))], faults: Vec::new() };
    }
    let imported = match import("the answer", bytes, Some(Format::Sip), Some(size_px)) {
        Ok(imported) => imported,
        Err(error) => return AnswerFile::fault(error.to_string()),
    };
    if imported.parity < 0 {
        return AnswerFile::fault("places the frame mirrored on the sky".to_owned());
    }
    let Some(attitude) = imported.camera_from_icrs else { return AnswerFile::fault("does not place the frame on the sky".to_owned()) };
    let rows = attitude.rows();
    AnswerFile { answers: vec![(None, TrackerAnswer::solved(WrittenAttitude::Matrix(rows)))], faults: Vec::new() }
}
