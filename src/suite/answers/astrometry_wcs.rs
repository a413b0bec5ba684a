//! The header that `solve-field` writes (`.wcs`): world coordinates of the frame, from which the attitude follows.

use nalgebra::Vector3;

use super::types::{AnswerFile, AnswerStatus, TrackerAnswer};
use crate::camera::Model;
use crate::coordinates::{Attitude, PixelPoint};
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
    let rows = imported.camera_from_icrs.and_then(|attitude| of_the_middle(&imported.model, &attitude, size_px));
    match rows {
        Some(rows) => AnswerFile { answers: vec![(None, TrackerAnswer::solved(WrittenAttitude::Matrix(rows)))], faults: Vec::new() },
        None => AnswerFile::fault("does not place the frame on the sky".to_owned()),
    }
}

/// The camera's axes in ICRS components as the middle of the frame has them: the principal point of a fitted distortion may lie anywhere.
fn of_the_middle(model: &Model, attitude: &Attitude, [width_px, height_px]: [usize; 2]) -> Option<[[f64; 3]; 3]> {
    let middle = PixelPoint { x_px: (width_px as f64 - 1.0) / 2.0, y_px: (height_px as f64 - 1.0) / 2.0 };
    let below = PixelPoint { y_px: middle.y_px + height_px as f64 / 4.0, ..middle };
    let context = model.reference_context();
    let sky = |point| Some(Vector3::from(attitude.apparent_from_camera(&model.direction(point, &context)?).xyz));
    let out = sky(middle)?;
    let below = sky(below)?;
    let down = (below - out * below.dot(&out)).normalize();
    let right = down.cross(&out);
    Some([right, down, out].map(|axis| [axis.x, axis.y, axis.z]))
}
