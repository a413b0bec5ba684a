//! The cameras of the plate solvers tetra3, cedar-solve and tetra3rs, as JSON.
//!
//! # tetra3 and cedar-solve
//! Two numbers, given to `solve_from_image` or `solve_from_centroids`: `fov_estimate` and `distortion`. The solver takes k away at the measured
//! point, about the middle of the frame (source: `tetra3.py`, `_undistort_centroids`):
//!
//! ```text
//! r_u = r·(1 − k·(2r/width)²)/(1 − k),  tan(angle) = r_u/F,  F = (width/2)/tan(fov/2)
//! ```
//! so with the principal point in the middle k1 = k·(2/width)² and f = F·(1 − k) without any loss. Where the principal point lies elsewhere, the
//! solver's attitude takes up the shift as a rotation, which is stated beside the residual that is left.
//!
//! # tetra3rs
//! `CameraModel` with `RadialDistortion` (source: tetra3rs 0.14, `camera_model.rs`, `distortion/radial.rs`): OpenCV's first five coefficients in
//! pixels instead of units of f, about `crpix`, which counts from the middle of the frame; `parity_flip` turns x after the distortion.
//! Its files (`CameraModel.load_from_file`) are the fields in that order in postcard's binary form, whose specification is fixed since 1.0: numbers as
//! eight bytes, the least significant first; whole numbers seven bits a byte; truth values and the kind of distortion a byte. Both this form and the
//! JSON of its own serde names are read; the first is written.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::fit::{self, FIT_SIDE, Residual};
use super::forward::{Forward, Kind, Room};
use super::opencv::checked_focal;
use super::reference::{fit_model, turned};
use super::{ExchangeError, Foreign};
use crate::camera::{Camera, Model};

/// tetra3rs has one focal length, and five coefficients.
pub(super) const ROOM: Room = Room { kind: Kind::Plane, counts: &[5], two_focal_lengths: false };

/// tetra3's camera.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tetra3 {
    comment: Option<Vec<String>>,
    image_width: usize,
    image_height: usize,
    /// `fov_estimate`, degrees over the width.
    fov_estimate: f64,
    /// `distortion`, negative for barrel.
    distortion: f64,
    /// Rotation vector, rad, that takes directions in this program's camera axes to those of tetra3's camera.
    rotation_rad: Option<[f64; 3]>,
}

/// Serde's form of tetra3rs' `CameraModel`.
#[derive(Clone, Debug, Deserialize)]
struct Tetra3rs {
    focal_length_px: f64,
    image_width: usize,
    image_height: usize,
    crpix: [f64; 2],
    parity_flip: bool,
    distortion: Value,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Radial {
    k1: f64,
    k2: f64,
    k3: f64,
    p1: f64,
    p2: f64,
    center: [f64; 2],
}

fn middle(size_px: [usize; 2]) -> [f64; 2] {
    size_px.map(|side| (side as f64 - 1.0) / 2.0)
}

/// tetra3's camera nearest to a model, the best rotation taken out, and that rotation in the result.
pub(super) fn tetra3_of(model: &Model) -> Result<(Tetra3, Residual), ExchangeError> {
    let camera = model.camera();
    let size_px = [camera.width_px, camera.height_px];
    let start = Model::new(Camera { principal_point_px: middle(size_px), p1: 0.0, p2: 0.0, ..*camera });
    // f and k1 alone are free.
    let (nearest, rotation_rad) = fit_model(&start, &[2, 3], &fit::pairs(model, FIT_SIDE)?, true)?;
    let own = fit::directions(model);
    let residual = fit::residual(size_px, |pixel| own(pixel).map(|xyz| turned(rotation_rad, xyz)), fit::pixels(&nearest));
    let half = camera.width_px as f64 / 2.0;
    let found = nearest.camera();
    let k = found.k1 * half * half;
    let solved = Tetra3 {
        comment: None,
        image_width: size_px[0],
        image_height: size_px[1],
        fov_estimate: 2.0 * (half * (1.0 - k) / found.focal_length_px).atan().to_degrees(),
        distortion: k,
        rotation_rad: Some(rotation_rad),
    };
    Ok((solved, residual))
}

fn json<T: Serialize>(value: &T) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}

/// The text of tetra3's file.
pub(super) fn write_tetra3(camera: &Tetra3, comments: &[String]) -> String {
    json(&Tetra3 { comment: Some(comments.to_vec()), ..camera.clone() })
}

/// tetra3rs' file.
pub(super) fn write_tetra3rs(forward: &Forward, size_px: [usize; 2], parity: i8) -> Vec<u8> {
    let f = forward.focal_px[1];
    let c = |index: usize| forward.coefficients.get(index).copied().unwrap_or(0.0);
    let (f2, f4) = (f * f, f * f * f * f);
    let middle = middle(size_px);
    let mut bytes = f.to_le_bytes().to_vec();
    for side in size_px {
        postcard_whole(&mut bytes, side);
    }
    for (centre_px, middle_px) in forward.centre_px.iter().zip(middle) {
        bytes.extend((centre_px - middle_px).to_le_bytes());
    }
    bytes.extend([u8::from(parity < 0), RADIAL]);
    for coefficient in [c(0) / f2, c(1) / f4, c(4) / (f2 * f4), c(2) / f, c(3) / f, 0.0, 0.0] {
        bytes.extend(f64::to_le_bytes(coefficient));
    }
    bytes
}

/// The places of tetra3rs' kinds of distortion in its list: None, Radial, Polynomial.
const NO_DISTORTION: u8 = 0;
const RADIAL: u8 = 1;
const POLYNOMIAL: u8 = 2;

/// A whole number in postcard: seven bits a byte, the lowest first, the eighth bit set on all but the last.
fn postcard_whole(bytes: &mut Vec<u8>, mut value: usize) {
    while value >= 0x80 {
        bytes.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

/// Reads postcard from the front of what is left.
struct Postcard<'a>(&'a [u8]);

impl Postcard<'_> {
    fn number(&mut self) -> Option<f64> {
        let (head, rest) = self.0.split_first_chunk::<8>()?;
        self.0 = rest;
        Some(f64::from_le_bytes(*head))
    }

    fn byte(&mut self) -> Option<u8> {
        let (head, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*head)
    }

    /// Of 32 bits.
    fn whole(&mut self) -> Option<usize> {
        let mut value: u64 = 0;
        for place in 0..5 {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << (7 * place);
            if byte < 0x80 {
                return usize::try_from(u32::try_from(value).ok()?).ok();
            }
        }
        None
    }
}

/// Whether bytes can only be tetra3rs' binary file: they are used up by its fields, and these make sense.
pub(super) fn is_tetra3rs_binary(bytes: &[u8]) -> bool {
    from_postcard(bytes).is_some()
}

fn from_postcard(bytes: &[u8]) -> Option<Tetra3rs> {
    let mut rest = Postcard(bytes);
    let focal_length_px = rest.number().filter(|f| (1.0..1e9).contains(f))?;
    let (image_width, image_height) = (rest.whole()?, rest.whole()?);
    let crpix = [rest.number()?, rest.number()?];
    let parity_flip = rest.byte().filter(|byte| *byte < 2)? == 1;
    let distortion = match rest.byte()? {
        NO_DISTORTION => Value::String("None".to_owned()),
        RADIAL => {
            let mut values = [0.0; 7];
            for value in &mut values {
                *value = rest.number()?;
            }
            let [k1, k2, k3, p1, p2, x, y] = values;
            serde_json::json!({ "Radial": { "k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2, "center": [x, y] } })
        }
        // Its terms are not read here, so where it ends is not known.
        POLYNOMIAL => {
            rest.0 = &[];
            serde_json::json!({ "Polynomial": {} })
        }
        _ => return None,
    };
    rest.0.is_empty().then_some(Tetra3rs { focal_length_px, image_width, image_height, crpix, parity_flip, distortion })
}

fn unreadable(file: &str, what: &str) -> impl Fn(serde_json::Error) -> ExchangeError {
    let (file, what) = (file.to_owned(), what.to_owned());
    move |error| ExchangeError::at(&file, error.line(), format!("this is no {what}: {error}"))
}

/// Reads tetra3's file.
pub(super) fn read_tetra3(file: &str, text: &str) -> Result<Foreign, ExchangeError> {
    let what = "camera of tetra3; it is JSON with image_width, image_height, fov_estimate (degrees) and distortion";
    let camera: Tetra3 = serde_json::from_str(text).map_err(unreadable(file, what))?;
    if !(camera.fov_estimate > 0.0 && camera.fov_estimate < 180.0) {
        return Err(ExchangeError::of(file, format!("fov_estimate = {} must be an angle between 0 and 180 degrees", camera.fov_estimate)));
    }
    let k = camera.distortion;
    if !(k.is_finite() && k < 1.0) {
        return Err(ExchangeError::of(file, format!("distortion = {k} must be a number below 1")));
    }
    let half = camera.image_width as f64 / 2.0;
    let focal_length_px = half / (camera.fov_estimate.to_radians() / 2.0).tan() * (1.0 - k);
    let ours = Camera { k1: k / (half * half), ..Camera::pinhole(camera.image_width, camera.image_height, focal_length_px) };
    let mut foreign = Foreign::ours(ours);
    if camera.rotation_rad.is_some_and(|rotation| rotation != [0.0; 3]) {
        foreign.notes.push("directions of this camera differ from those of the one it was made from by the file's rotation_rad".to_owned());
    }
    Ok(foreign)
}

/// Reads tetra3rs' file.
pub(super) fn read_tetra3rs(file: &str, bytes: &[u8]) -> Result<Foreign, ExchangeError> {
    let what = "CameraModel of tetra3rs, neither as its save_to_file writes it nor in JSON";
    let camera: Tetra3rs = match from_postcard(bytes) {
        Some(camera) => camera,
        None => serde_json::from_slice(bytes).map_err(unreadable(file, what))?,
    };
    let size_px = [camera.image_width, camera.image_height];
    let f = camera.focal_length_px;
    checked_focal(file, 1, [f; 2])?;
    let radial = match (&camera.distortion, camera.distortion.get("Radial")) {
        (Value::String(none), _) if none == "None" => Radial::default(),
        (_, Some(radial)) => serde_json::from_value(radial.clone()).map_err(unreadable(file, "RadialDistortion of tetra3rs"))?,
        _ => {
            let remedy = "calibrate there with the radial model";
            return Err(ExchangeError::of(
                file,
                format!("the distortion is neither None nor Radial, and others are not read here; {remedy}"),
            ));
        }
    };
    if radial.center != [0.0; 2] {
        let problem = format!("the distortion's center {:?} differs from crpix, which is not read here; put it into crpix", radial.center);
        return Err(ExchangeError::of(file, problem));
    }
    let middle = middle(size_px);
    let (f2, f4) = (f * f, f * f * f * f);
    let forward = Forward {
        kind: Kind::Plane,
        focal_px: [f; 2],
        centre_px: [camera.crpix[0] + middle[0], camera.crpix[1] + middle[1]],
        coefficients: vec![radial.k1 * f2, radial.k2 * f4, radial.p1 * f, radial.p2 * f, radial.k3 * f2 * f4],
    };
    let mut foreign = Foreign::forward(forward, size_px);
    foreign.parity = if camera.parity_flip { -1 } else { 1 };
    Ok(foreign)
}
