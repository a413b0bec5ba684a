//! OpenCV's `FileStorage` in YAML, as `cv::calibrateCamera`'s sample writes it and `cv::FileStorage` reads it.
//!
//! The fisheye model has the same keys and four coefficients of another meaning; `distortion_model: fisheye` tells the two apart.

use super::forward::{Forward, Kind, Room};
use super::yaml::Document;
use super::{ExchangeError, Foreign};

/// What the format knows: OpenCV's functions take 4, 5, 8 or 12 coefficients.
pub(super) const PLANE: Room = Room { kind: Kind::Plane, counts: &[5, 8, 12], two_focal_lengths: true };
/// The fisheye model.
pub(super) const ANGLE: Room = Room { kind: Kind::Angle, counts: &[4], two_focal_lengths: true };

/// A list of numbers that reads back to the same bits, each with a point as YAML's floats have it.
pub(super) fn numbers(values: &[f64]) -> String {
    values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(", ")
}

/// The text of the file.
pub(super) fn write(forward: &Forward, size_px: [usize; 2], comments: &[String]) -> String {
    let [fx, fy] = forward.focal_px;
    let [cx, cy] = forward.centre_px;
    let mut text = "%YAML:1.0\n---\n".to_owned();
    for comment in comments {
        text += &format!("# {comment}\n");
    }
    text += &format!("image_width: {}\nimage_height: {}\n", size_px[0], size_px[1]);
    if forward.kind == Kind::Angle {
        text += "distortion_model: fisheye\n";
    }
    let matrix = |name: &str, rows: usize, cols: usize, data: &[f64]| {
        format!("{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {} ]\n", numbers(data))
    };
    text += &matrix("camera_matrix", 3, 3, &[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    text += &matrix("distortion_coefficients", forward.coefficients.len(), 1, &forward.coefficients);
    text
}

/// Reads the text of a file.
pub(super) fn read(file: &str, text: &str) -> Result<Foreign, ExchangeError> {
    let document = Document::parse(file, text)?;
    let size_px = [document.side_px("image_width")?, document.side_px("image_height")?];
    let fisheye = match document.text("distortion_model")? {
        Some("fisheye") => true,
        None | Some("plumb_bob" | "rational_polynomial") => false,
        Some(other) => {
            return Err(ExchangeError::of(
                file,
                format!("the distortion_model {other:?} is not known; fisheye is, and so is a file without it"),
            ));
        }
    };
    let (focal_px, centre_px) = intrinsics(file, &document)?;
    let (entry, coefficients) = document.matrix("distortion_coefficients", None)?;
    let coefficients = match (fisheye, coefficients.len()) {
        (true, 4) | (false, 0 | 4 | 5 | 8 | 12) => coefficients,
        (false, 14) if coefficients[12..] == [0.0, 0.0] => coefficients[..12].to_vec(),
        (false, 14) => {
            return Err(document
                .fault(entry, "has a tilted sensor (its last two numbers), which is not read here; calibrate without CALIB_TILTED_MODEL"));
        }
        (true, count) => return Err(document.fault(entry, &format!("must be 4 numbers for fisheye, but is {count}"))),
        (false, count) => return Err(document.fault(entry, &format!("must be 4, 5, 8, 12 or 14 numbers, but is {count}"))),
    };
    let kind = if fisheye { Kind::Angle } else { Kind::Plane };
    Ok(Foreign::forward(Forward { kind, focal_px, centre_px, coefficients }, size_px))
}

/// fx, fy and cx, cy of a camera matrix.
pub(super) fn intrinsics(file: &str, document: &Document) -> Result<([f64; 2], [f64; 2]), ExchangeError> {
    let (entry, k) = document.matrix("camera_matrix", Some((3, 3)))?;
    if k[1] != 0.0 || k[3] != 0.0 || k[6..] != [0.0, 0.0, 1.0] {
        return Err(document.fault(entry, "must be [fx, 0, cx, 0, fy, cy, 0, 0, 1]; a skew is not read here"));
    }
    checked_focal(file, entry.line, [k[0], k[4]])?;
    Ok(([k[0], k[4]], [k[2], k[5]]))
}

/// Refuses focal lengths that are none.
pub(super) fn checked_focal(file: &str, line: usize, focal_px: [f64; 2]) -> Result<(), ExchangeError> {
    match focal_px.into_iter().find(|f| !(f.is_finite() && *f > 0.0)) {
        Some(f) => Err(ExchangeError::at(file, line, format!("the focal length {f} px must be greater than 0"))),
        None => Ok(()),
    }
}
