//! mrcal's `.cameramodel`: the text of a Python dictionary.

use serde::Deserialize;

use super::forward::{Forward, Kind, Room};
use super::opencv::{checked_focal, numbers};
use super::{ExchangeError, Foreign};

/// LENSMODEL_OPENCV4, 5, 8 and 12.
pub(super) const ROOM: Room = Room { kind: Kind::Plane, counts: &[5, 8, 12], two_focal_lengths: true };

#[derive(Deserialize)]
struct Model {
    #[serde(alias = "lens_model")]
    lensmodel: String,
    intrinsics: Vec<f64>,
    extrinsics: Option<[f64; 6]>,
    imagersize: [usize; 2],
}

/// The text of the file.
pub(super) fn write(forward: &Forward, size_px: [usize; 2], comments: &[String]) -> String {
    let mut text = String::new();
    for comment in comments {
        text += &format!("# {comment}\n");
    }
    let intrinsics: Vec<f64> = forward.focal_px.iter().chain(&forward.centre_px).chain(&forward.coefficients).copied().collect();
    text += &format!("{{\n    'lensmodel':  'LENSMODEL_OPENCV{}',\n\n", forward.coefficients.len());
    text += "    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n";
    text += &format!("    'intrinsics': [ {},],\n\n", numbers(&intrinsics));
    text += "    # extrinsics are rt_fromref\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n";
    text += &format!("    'imagersize': [ {}, {},],\n}}\n", size_px[0], size_px[1]);
    text
}

/// Reads the text of a file.
pub(super) fn read(file: &str, text: &str) -> Result<Foreign, ExchangeError> {
    let model: Model = serde_json::from_str(&json(text)).map_err(|error| {
        ExchangeError::at(file, error.line(), format!("this is no mrcal camera model as `mrcal.cameramodel.write` writes it: {error}"))
    })?;
    let name = model.lensmodel.as_str();
    let count = match name {
        "LENSMODEL_PINHOLE" => 0,
        "LENSMODEL_OPENCV4" => 4,
        "LENSMODEL_OPENCV5" => 5,
        "LENSMODEL_OPENCV8" => 8,
        "LENSMODEL_OPENCV12" => 12,
        _ => {
            let remedy = "convert it first: mrcal-convert-lensmodel LENSMODEL_OPENCV8";
            return Err(ExchangeError::of(file, format!("the lens model {name:?} is not read here; {remedy}")));
        }
    };
    let [fx, fy, cx, cy] = match model.intrinsics.get(..4) {
        Some(first) if model.intrinsics.len() == 4 + count => [first[0], first[1], first[2], first[3]],
        _ => {
            let problem = format!("{name} has {} intrinsics, but there are {}", 4 + count, model.intrinsics.len());
            return Err(ExchangeError::of(file, problem));
        }
    };
    checked_focal(file, 1, [fx, fy])?;
    let forward = Forward { kind: Kind::Plane, focal_px: [fx, fy], centre_px: [cx, cy], coefficients: model.intrinsics[4..].to_vec() };
    let mut foreign = Foreign::forward(forward, model.imagersize);
    if model.extrinsics.is_some_and(|extrinsics| extrinsics != [0.0; 6]) {
        foreign.notes.push("the file's extrinsics (where the camera stood) are not imported".to_owned());
    }
    Ok(foreign)
}

/// The dictionary as JSON, line by line the same: quotes doubled, comments and commas at the end of lists taken out.
fn json(text: &str) -> String {
    let mut out = String::new();
    let mut chars = text.chars().peekable();
    let mut quote = None;
    while let Some(c) = chars.next() {
        match (quote, c) {
            (None, '#') => while chars.next_if(|next| *next != '\n').is_some() {},
            (None, 'b') if matches!(chars.peek(), Some('\'' | '"')) => {} // bytes
            (None, '\'' | '"') => {
                quote = Some(c);
                out.push('"');
            }
            (Some(open), c) if c == open => {
                quote = None;
                out.push('"');
            }
            (Some(_), '"') => out.push_str("\\\""),
            (None, ']' | '}') => {
                let kept = out.trim_end().len();
                if out[..kept].ends_with(',') {
                    out.replace_range(kept - 1..kept, " ");
                }
                out.push(c);
            }
            _ => out.push(c),
        }
    }
    out
}
