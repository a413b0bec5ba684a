//! Exchange of calibrated cameras with other programs, in both directions.
//!
//! Our model takes the distortion away at the MEASURED point. SIP and TPV do the same and hold the reference model without loss. OpenCV, ROS, mrcal and
//! tetra3rs add it to the ideal point: there is no closed form between the two, so a conversion is a fit over the frame, and how near it comes is part of
//! every result ([`Residual`]) and of the file. Nothing is written that misses the camera by more than [`LIMIT_PX`] unless it is asked for.
//!
//! A format is a file of its own with the equations and the source; what else knows of it is listed in CONTRIBUTING.md.

mod error;
mod fit;
mod foreign;
mod forward;
mod mrcal;
mod opencv;
mod plane;
mod reference;
mod result;
mod ros;
mod sip;
mod tetra3;
mod tpv;
mod view;
mod wcs;
mod world;
mod yaml;

use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use error::ExchangeError;
pub use fit::Residual;
pub use foreign::{IMPORT_FORMAT, Imported, detect, import};
inner!(result::{ExportResult, ImportResult});

use crate::calibrate::{Calibration, FrameResult};
use crate::camera::{Model, SkyChain};
use crate::coordinates::Attitude;
use crate::effects::ids;
use foreign::Foreign;
use forward::{Room, forward_of};

/// A format holds a camera if the largest residual over the frame is not above this, px.
pub const LIMIT_PX: f64 = 0.01;

/// The formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Format {
    /// OpenCV's FileStorage in YAML.
    OpenCv,
    /// ROS camera_info in YAML.
    Ros,
    /// mrcal's .cameramodel.
    Mrcal,
    /// FITS headers, TAN with SIP.
    Sip,
    /// FITS headers, TPV.
    Tpv,
    /// fov_estimate and distortion of tetra3 and cedar-solve.
    Tetra3,
    /// CameraModel of tetra3rs, as its `load_from_file` reads it.
    Tetra3rs,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 7] = [Self::OpenCv, Self::Ros, Self::Mrcal, Self::Sip, Self::Tpv, Self::Tetra3, Self::Tetra3rs];

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenCv => "opencv",
            Self::Ros => "ros",
            Self::Mrcal => "mrcal",
            Self::Sip => "sip",
            Self::Tpv => "tpv",
            Self::Tetra3 => "tetra3",
            Self::Tetra3rs => "tetra3rs",
        }
    }

    /// Whether there is one file for each frame.
    #[must_use]
    pub fn is_per_frame(self) -> bool {
        matches!(self, Self::Sip | Self::Tpv)
    }

    /// The name of the one file.
    fn file_name(self) -> &'static str {
        match self {
            Self::OpenCv => "camera.yml",
            Self::Ros => "camera_info.yaml",
            Self::Mrcal => "camera.cameramodel",
            Self::Tetra3 => "tetra3.json",
            Self::Tetra3rs => "tetra3rs.camera",
            Self::Sip | Self::Tpv => "frame.wcs",
        }
    }
}

impl FromStr for Format {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = if text == "cedar" || text == "cedar-solve" { "tetra3" } else { text };
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|format| format.name() == text)
            .ok_or_else(|| format!("there is no format {text:?}; there are {}", names()))
    }
}

/// What is exported.
#[derive(Clone, Debug)]
pub struct Subject {
    /// The camera; of the un-mirrored image.
    pub model: Model,
    /// −1 if the images are mirrored.
    pub parity: i8,
    /// Ids of the effects that the star directions behind the attitudes contain.
    pub physics: Vec<String>,
    /// Every frame that has an attitude.
    pub frames: Vec<SubjectFrame>,
    /// What world coordinates map the pixels to.
    pub places: Places,
}

/// An exposure of the camera.
#[derive(Clone, Debug)]
pub struct SubjectFrame {
    /// Index in the recording.
    pub frame: usize,
    /// Its attitude.
    pub attitude: Attitude,
    /// What is done to the light on its way, where that is known.
    pub sky: Option<SkyChain>,
}

/// What world coordinates map the pixels of a frame to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Places {
    /// Places of the catalogue: ICRS, from the barycentre of the solar system, at the frame's epoch. Aberration, refraction and what else the model
    /// has on the way are part of the map.
    #[default]
    Catalog,
    /// Directions of the light as it arrives, in ICRS axes.
    Apparent,
}

impl FromStr for Places {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "catalog" | "catalogue" => Ok(Self::Catalog),
            "apparent" => Ok(Self::Apparent),
            _ => Err(format!("there are no world coordinates {text:?}; there are catalog and apparent")),
        }
    }
}

impl From<&Calibration> for Subject {
    /// Of a calibration in the columns of the un-mirrored image, as the program holds it.
    fn from(calibration: &Calibration) -> Self {
        let model = calibration.full_chain();
        let frame = |frame: &FrameResult| {
            let sky = calibration.sky_chain(&model, frame.frame);
            Some(SubjectFrame { frame: frame.frame, attitude: frame.camera_from_icrs?, sky })
        };
        let frames = calibration.per_frame.iter().filter_map(frame).collect();
        Self { model, parity: calibration.parity, physics: calibration.physics.clone(), frames, places: Places::default() }
    }
}

/// A file to be written.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct File {
    /// Its name in its folder.
    pub name: String,
    /// What it holds.
    pub bytes: Vec<u8>,
}

/// The name of the file format.
pub const EXPORT_FORMAT: &str = "boresight-export/1";

/// A camera in a foreign format.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[non_exhaustive]
pub struct Exported {
    /// [`EXPORT_FORMAT`].
    pub format: &'static str,
    /// The foreign format.
    pub to: Format,
    /// The foreign model and the number of its coefficients, in words.
    pub model: String,
    /// The number of the distortion's coefficients.
    pub coefficients: usize,
    /// How far the foreign model's points lie from the camera's.
    pub residual: Residual,
    /// Largest error over the frame of the way back from the sky to the pixel, where the format has polynomials of its own for it.
    pub inverse_max_px: Option<f64>,
    /// Whether the residual is within [`LIMIT_PX`].
    pub expressible: bool,
    /// What to mind, one sentence each; they stand in the file too.
    pub notes: Vec<String>,
    /// The files.
    #[serde(skip)]
    pub files: Vec<File>,
}

/// Writes a camera in a foreign format.
pub fn export(subject: &Subject, to: Format) -> Result<Exported, ExchangeError> {
    let model = &subject.model;
    let size = [model.camera().width_px, model.camera().height_px];
    let mirrored = subject.parity < 0;
    let mut exported = Exported {
        format: EXPORT_FORMAT,
        to,
        model: String::new(),
        coefficients: 0,
        residual: Residual { rms_px: 0.0, max_px: 0.0, beyond_max_px: None },
        inverse_max_px: None,
        expressible: true,
        notes: Vec::new(),
        files: Vec::new(),
    };
    if mirrored && !to.is_per_frame() && to != Format::Tetra3rs {
        let note = "the images are mirrored, and this is the camera of the un-mirrored ones: flip the images left to right before using it";
        exported.notes.push(note.to_owned());
    }
    let wide = model.projection() != ids::PINHOLE;
    let one_file = |bytes: Vec<u8>| vec![File { name: to.file_name().to_owned(), bytes }];
    match to {
        Format::OpenCv | Format::Ros | Format::Mrcal | Format::Tetra3rs => {
            let room: &Room = match (to, wide) {
                (Format::OpenCv, false) => &opencv::PLANE,
                (Format::OpenCv, true) => &opencv::ANGLE,
                (Format::Ros, false) => &ros::PLANE,
                (Format::Ros, true) => &ros::ANGLE,
                (Format::Mrcal, _) => &mrcal::ROOM,
                _ => &tetra3::ROOM,
            };
            let as_stored = if mirrored && to == Format::Tetra3rs { foreign::mirrored(model)? } else { model.clone() };
            let (found, residual) = forward_of(&as_stored, room)?;
            exported.coefficients = found.coefficients.len();
            exported.model = format!("{} with {} coefficients, added to the ideal point", words(to, wide), exported.coefficients);
            exported.judged(residual);
            let comments = exported.comments();
            exported.files = one_file(match to {
                Format::OpenCv => opencv::write(&found, size, &comments).into_bytes(),
                Format::Ros => ros::write(&found, size, &comments).into_bytes(),
                Format::Mrcal => mrcal::write(&found, size, &comments).into_bytes(),
                _ => tetra3::write_tetra3rs(&found, size, subject.parity),
            });
        }
        Format::Tetra3 => {
            let (found, residual) = tetra3::tetra3_of(model)?;
            exported.coefficients = 1;
            let words = "field of view and one radial coefficient about the middle of the frame, taken away at the measured point";
            words.clone_into(&mut exported.model);
            let note =
                "the residual is what is left after the rotation rotation_rad, by which the solver's attitudes differ from this camera's";
            exported.notes.push(note.to_owned());
            exported.judged(residual);
            exported.files = one_file(tetra3::write_tetra3(&found, &exported.comments()).into_bytes());
        }
        Format::Sip | Format::Tpv => world::headers(subject, &mut exported)?,
    }
    Ok(exported)
}

fn words(to: Format, wide: bool) -> &'static str {
    match (to, wide) {
        (Format::OpenCv, true) => "OpenCV fisheye",
        (Format::Ros, true) => "equidistant",
        (Format::Mrcal, _) => "LENSMODEL_OPENCV",
        (Format::Tetra3rs, _) => "RadialDistortion",
        _ => "Brown and Conrady's model",
    }
}

impl Exported {
    /// Takes the residual in and judges it.
    fn judged(&mut self, residual: Residual) {
        self.residual = residual;
        self.expressible = residual.max_px <= LIMIT_PX;
    }

    /// What stands in the file about its making; plain ASCII, as FITS wants it.
    fn comments(&self) -> Vec<String> {
        let Residual { rms_px, max_px, beyond_max_px } = self.residual;
        let beyond = beyond_max_px.map_or("no image of the same directions".to_owned(), |value| format!("at most {value:.1e} px"));
        let mut comments = vec![
            format!("written by boresight {}: {}", env!("CARGO_PKG_VERSION"), self.model),
            format!("residual against the calibrated camera: rms {rms_px:.1e} px, at most {max_px:.1e} px over the frame"),
            format!("within a tenth of the frame beyond its edges: {beyond}"),
        ];
        comments.extend(self.notes.iter().cloned());
        comments
    }
}
