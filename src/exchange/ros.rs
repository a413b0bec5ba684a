//! ROS `camera_info` in YAML, as camera_calibration_parsers and image_pipeline read it.

use super::forward::{Forward, Kind, Room};
use super::opencv::{intrinsics, numbers};
use super::yaml::Document;
use super::{ExchangeError, Foreign};

/// What the format knows: plumb_bob has five coefficients, rational_polynomial eight.
pub(super) const PLANE: Room = Room { kind: Kind::Plane, counts: &[5, 8], two_focal_lengths: true };
/// equidistant has four.
pub(super) const ANGLE: Room = Room { kind: Kind::Angle, counts: &[4], two_focal_lengths: true };

/// The models' names, their family and the numbers of coefficients they have.
const MODELS: &[(&str, Kind, usize)] =
    &[("plumb_bob", Kind::Plane, 5), ("rational_polynomial", Kind::Plane, 8), ("equidistant", Kind::Angle, 4)];

/// The text of the file.
pub(super) fn write(forward: &Forward, size_px: [usize; 2], comments: &[String]) -> String {
    let [fx, fy] = forward.focal_px;
    let [cx, cy] = forward.centre_px;
    let count = forward.coefficients.len();
    let name = MODELS.iter().find(|(_, kind, own)| (*kind, *own) == (forward.kind, count)).map_or("plumb_bob", |(name, ..)| name);
    let mut text = String::new();
    for comment in comments {
        text += &format!("# {comment}\n");
    }
    text += &format!("image_width: {}\nimage_height: {}\ncamera_name: boresight\n", size_px[0], size_px[1]);
    let matrix = |name: &str, rows: usize, cols: usize, data: &[f64]| {
        format!("{name}:\n  rows: {rows}\n  cols: {cols}\n  data: [{}]\n", numbers(data))
    };
    text += &matrix("camera_matrix", 3, 3, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    text += &format!("distortion_model: {name}\n");
    text += &matrix("distortion_coefficients", 1, count, &forward.coefficients);
    text += &matrix("rectification_matrix", 3, 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    text += &matrix("projection_matrix", 3, 4, &[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    text
}

/// Reads the text of a file.
pub(super) fn read(file: &str, text: &str) -> Result<Foreign, ExchangeError> {
    let document = Document::parse(file, text)?;
    let size_px = [document.side_px("image_width")?, document.side_px("image_height")?];
    let known = MODELS.iter().map(|(name, ..)| *name).collect::<Vec<_>>().join(", ");
    let name = document
        .text("distortion_model")?
        .ok_or_else(|| ExchangeError::of(file, format!("\"distortion_model\" is missing; it is one of {known}")))?;
    let &(_, kind, count) = MODELS
        .iter()
        .find(|(known, ..)| *known == name)
        .ok_or_else(|| ExchangeError::of(file, format!("the distortion_model {name:?} is not known; {known} are")))?;
    let (focal_px, centre_px) = intrinsics(file, &document)?;
    let (entry, mut coefficients) = document.matrix("distortion_coefficients", None)?;
    if coefficients.len() == 4 && count == 5 {
        coefficients.push(0.0); // older files leave k3 out
    }
    if coefficients.len() != count {
        return Err(document.fault(entry, &format!("must be {count} numbers for {name}, but is {}", coefficients.len())));
    }
    Ok(Foreign::forward(Forward { kind, focal_px, centre_px, coefficients }, size_px))
}
