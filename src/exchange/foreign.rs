//! Import: cameras of other programs, converted to our model.

use schemars::JsonSchema;
use serde::Serialize;

use super::forward::Forward;
use super::plane::stored_column;
use super::reference::{Freedom, nearest, turned};
use super::wcs::{Meaning, Wcs};
use super::{ExchangeError, Format, LIMIT_PX, Residual, fit, mrcal, opencv, ros, tetra3};
use crate::camera::{Camera, Model, PARAMETER_COUNT};
use crate::coordinates::Attitude;
use crate::effects::ids;
use crate::effects::{Segment, displacement};
use fit::{FIT_SIDE, Pair};

/// A foreign camera as its file has it.
pub(super) struct Foreign {
    kind: Kind,
    size_px: Option<[usize; 2]>,
    /// −1 if x is turned behind the camera: the images are mirrored.
    pub(super) parity: i8,
    /// What to mind.
    pub(super) notes: Vec<String>,
}

enum Kind {
    /// The distortion is added to the ideal point.
    Forward(Forward),
    /// A model of our own form.
    Ours(Camera),
    /// A frame on the sky.
    Sky(Wcs),
}

impl Foreign {
    /// A camera that adds its distortion to the ideal point.
    pub(super) fn forward(forward: Forward, size_px: [usize; 2]) -> Self {
        Self { kind: Kind::Forward(forward), size_px: Some(size_px), parity: 1, notes: Vec::new() }
    }

    /// A camera of our own form.
    pub(super) fn ours(camera: Camera) -> Self {
        Self { kind: Kind::Ours(camera), size_px: Some([camera.width_px, camera.height_px]), parity: 1, notes: Vec::new() }
    }
}

/// The name of the file format.
pub const IMPORT_FORMAT: &str = "boresight-import/2";

/// A foreign camera in our model.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[non_exhaustive]
pub struct Imported {
    /// [`IMPORT_FORMAT`].
    pub format: &'static str,
    /// The format that was read.
    pub from: Format,
    /// The camera, in columns of the images as stored.
    pub model: Model,
    /// −1 if the images are mirrored: the model's directions then have x turned, as calibration files have it.
    pub parity: i8,
    /// How far our model's points lie from the foreign camera's.
    pub residual: Residual,
    /// Whether the residual is within [`LIMIT_PX`].
    pub expressible: bool,
    /// The attitude of the un-mirrored camera, where the file places the frame on the sky.
    pub camera_from_icrs: Option<Attitude>,
    /// What to mind, one sentence each.
    pub notes: Vec<String>,
}

impl Imported {
    /// The `[camera]` table of a recording.toml or a scene.
    #[must_use]
    pub fn camera_toml(&self) -> String {
        let Residual { rms_px, max_px, .. } = self.residual;
        let camera = self.model.camera();
        let [x0, y0] = camera.principal_point_px;
        let mut text =
            format!("# from a file of {}; residual over the frame: rms {rms_px:.1e} px, at most {max_px:.1e} px\n", self.from.name());
        for (id, parameters) in self.model.terms() {
            text += &format!("# and {id} = {parameters:?}, which this table has no keys for\n");
        }
        if self.parity < 0 {
            text += "# the images are mirrored; this is in columns as stored\n";
        }
        text += &format!("[camera]\nwidth_px = {}\nheight_px = {}\n", camera.width_px, camera.height_px);
        text += &format!("focal_length_px = {:?}\nprincipal_point_px = [{x0:?}, {y0:?}]\n", camera.focal_length_px);
        text + &format!("k1 = {:?}\np1 = {:?}\np2 = {:?}\n", camera.k1, camera.p1, camera.p2)
    }
}

/// The same camera seen in a mirror: of images as stored, where they are mirrored. Its terms must not tell left from right.
pub(super) fn mirrored(model: &Model) -> Result<Model, ExchangeError> {
    let own = displacement(model.projection()).map_or(0, |projection| projection.parameters().len() - 3);
    let projected = &model.values()[PARAMETER_COUNT..PARAMETER_COUNT + own];
    let mut other = Model::new(model.camera().mirrored()).with_projection(model.projection(), projected)?;
    for (id, parameters) in model.terms() {
        let keeps = displacement(id).is_some_and(|effect| effect.segment() == Segment::Sky || effect.facts().is_even_in_mirror);
        if !keeps {
            let reason = format!("the images are mirrored, and {id} is not the same in a mirror");
            return Err(ExchangeError::NoRoom { format: "a camera of mirrored images", reason });
        }
        other.set(id, parameters)?;
    }
    Ok(other)
}

/// The format of a file by what stands in it.
#[must_use]
pub fn detect(bytes: &[u8]) -> Option<Format> {
    if tetra3::is_tetra3rs_binary(bytes) {
        return Some(Format::Tetra3rs);
    }
    let text = String::from_utf8_lossy(bytes);
    let has = |word: &str| text.contains(word);
    Some(if text.starts_with("SIMPLE  =") || has("CTYPE1  =") {
        if has("'RA---TPV") { Format::Tpv } else { Format::Sip }
    } else if has("LENSMODEL_") {
        Format::Mrcal
    } else if has("opencv-matrix") {
        Format::OpenCv
    } else if has("distortion_model:") {
        Format::Ros
    } else if has("\"fov_estimate\"") {
        Format::Tetra3
    } else if has("\"crpix\"") {
        Format::Tetra3rs
    } else {
        return None;
    })
}

/// Reads a foreign camera and finds ours nearest to it. `file` is the name it goes by; `size_px` (columns, rows) is for formats that do not say.
pub fn import(file: &str, bytes: &[u8], from: Option<Format>, size_px: Option<[usize; 2]>) -> Result<Imported, ExchangeError> {
    let names = Format::ALL.map(Format::name).join(", ");
    let from = from.or_else(|| detect(bytes)).ok_or_else(|| {
        ExchangeError::of(file, format!("this is no camera in a format that is known; --from says which of {names} it is"))
    })?;
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(_) if from.is_per_frame() || from == Format::Tetra3rs => "", // pixels may follow the header; its own form is binary
        Err(error) => return Err(ExchangeError::of(file, format!("is not UTF-8 text (byte {})", error.valid_up_to()))),
    };
    let mut foreign = match from {
        Format::OpenCv => opencv::read(file, text)?,
        Format::Ros => ros::read(file, text)?,
        Format::Mrcal => mrcal::read(file, text)?,
        Format::Tetra3 => tetra3::read_tetra3(file, text)?,
        Format::Tetra3rs => tetra3::read_tetra3rs(file, bytes)?,
        Format::Sip | Format::Tpv => {
            let wcs = Wcs::read(file, bytes)?;
            let mut notes = Vec::new();
            if Wcs::meaning(file, bytes) != Some(Meaning::Apparent) {
                notes.push("the header maps places of the catalogue, so aberration and refraction are in this camera's scale and shape; headers of the light as it arrives (--wcs apparent) give the camera alone".to_owned());
            }
            Foreign { size_px: wcs.size_px, parity: wcs.parity(), kind: Kind::Sky(wcs), notes }
        }
    };
    if let (Some(asked), Some(own)) = (size_px, foreign.size_px)
        && asked != own
    {
        let problem = format!("the file is of frames of {} × {} pixels, not {} × {}", own[0], own[1], asked[0], asked[1]);
        return Err(ExchangeError::of(file, problem));
    }
    let missing = || ExchangeError::of(file, "does not say how large the frame is; give --width and --height in pixels");
    let size = foreign.size_px.or(size_px).ok_or_else(missing)?;
    if size.iter().any(|side| !(2..=1 << 20).contains(side)) {
        return Err(ExchangeError::of(file, format!("frames of {} × {} pixels are not read", size[0], size[1])));
    }
    let (model, residual, camera_from_icrs) = ours(file, &foreign, size)?;
    if model.terms().next().is_some() {
        let ids = model.terms().map(|(id, _)| id).collect::<Vec<_>>().join(", ");
        foreign.notes.push(format!("the reference model alone does not reach it; it is joined by {ids}"));
    }
    Ok(Imported {
        format: IMPORT_FORMAT,
        from,
        model,
        parity: foreign.parity,
        residual,
        expressible: residual.max_px <= LIMIT_PX,
        camera_from_icrs,
        notes: foreign.notes,
    })
}

/// Our model nearest to a foreign camera, in stored columns, and the frame's attitude.
fn ours(file: &str, foreign: &Foreign, size: [usize; 2]) -> Result<(Model, Residual, Option<Attitude>), ExchangeError> {
    let start = |focal_px: f64, centre: [f64; 2]| Camera { principal_point_px: centre, ..Camera::pinhole(size[0], size[1], focal_px) };
    match &foreign.kind {
        Kind::Ours(camera) => {
            let model = Model::new(*camera);
            let residual = fit::residual(size, fit::directions(&model), fit::pixels(&model));
            Ok((model, residual, None))
        }
        Kind::Forward(forward) => {
            let [fx, fy] = forward.focal_px;
            let mut camera = start((fx * fy).sqrt(), forward.centre_px);
            let mut start = None;
            if forward.kind == super::forward::Kind::Plane {
                let c = |index: usize| forward.coefficients.get(index).copied().unwrap_or(0.0);
                (camera.k1, camera.p1, camera.p2) = (c(0) / (fx * fy), c(3) / fx, c(2) / fy);
            } else {
                start = Some(Model::new(camera).with_projection(ids::KANNALA_BRANDT, &forward.coefficients)?); // the same equation
            }
            let start = start.unwrap_or_else(|| Model::new(camera));
            let freedom = Freedom { hold_centre: true, aspect: (fx / fy - 1.0).abs() > 1e-9, rotation: false };
            let found = nearest(&start, &forward.pairs(size, &format!("{file}: the camera"))?, &freedom, |pixel| forward.direction(pixel))?;
            Ok((found.model, found.residual, None))
        }
        Kind::Sky(wcs) => {
            let parity = wcs.parity();
            let (attitude, focal_px) = wcs.attitude();
            let rotation = attitude.camera_from_icrs;
            let direction = |pixel: [f64; 2]| {
                let sky = wcs.direction([stored_column(pixel[0], size, parity), pixel[1]]);
                let own = rotation * nalgebra::Vector3::from(sky);
                [own.x, own.y, own.z]
            };
            let centre = [stored_column(wcs.crpix[0] - 1.0, size, parity), wcs.crpix[1] - 1.0];
            let pairs: Vec<Pair> = fit::frame_points(size, FIT_SIDE, 0.0)
                .into_iter()
                .map(|pixel_px| Pair { pixel_px, direction: direction(pixel_px) })
                .collect();
            let freedom = Freedom { hold_centre: true, aspect: (focal_px[0] / focal_px[1] - 1.0).abs() > 1e-9, rotation: true };
            let camera = start((focal_px[0] * focal_px[1]).sqrt(), centre);
            let found = nearest(&Model::new(camera), &pairs, &freedom, |pixel| Some(direction(pixel)))?;
            let turn = nalgebra::UnitQuaternion::from_scaled_axis(nalgebra::Vector3::from(found.rotation_rad));
            debug_assert!(turned(found.rotation_rad, [0.0, 0.0, 1.0])[2] > 0.0);
            let model = if parity < 0 { mirrored(&found.model)? } else { found.model };
            Ok((model, found.residual, Some(Attitude::new(turn * rotation))))
        }
    }
}
