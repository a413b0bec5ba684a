//! Recordings: files ⇄ frames, star lists and telemetry, in the four forms that real cameras leave behind.
//!
//! | form | what it is |
//! |---|---|
//! | [`Form::Manifest`] | a folder with `recording.toml` and the frames it names |
//! | [`Form::FitsFolder`] | a folder of FITS files; their headers tell what is known |
//! | [`Form::Images`] | bare images, from the command line or a folder; nothing else is known |
//! | [`Form::StarList`] | a manifest with a star list (CSV) in the place of the frames' files |
//!
//! A simulated night is written in the first form ([`write_manifest`], [`write_fits_u16`]) and read by the same code.
//! Pixel (0, 0) is the centre of the first pixel of the first row stored; FITS files that say `ROWORDER` BOTTOM-UP are turned
//! over on reading, and [`Recording::notes`] says so. Times are UTC, the middle of the exposure.

mod circumstances;
mod error;
mod exif;
mod fits;
mod fits_tiles;
mod foreign;
mod image_file;
mod image_form;
mod manifest;
mod open;
mod output;
mod places;
mod pnm;
mod schema;
mod star_list;
mod tags;
mod tiff;
mod time;
mod told;
mod values;
mod write;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use hifitime::Epoch;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::coordinates::Attitude;
use crate::frame::{Frame, MaskedFrame};

pub(crate) use circumstances::Offsets;
pub use error::{FrameProblem, FrameSize, ManifestKey, RecordingError};
pub use image_file::load as load_image;
pub(crate) use image_file::{of_bytes as image_of_bytes, size_of as image_size};
pub(crate) use image_form::{fits_rice_u16, low_byte_first, png_u8, png_u16};
pub use manifest::FORMAT;
pub use output::{OutputError, write_file};
pub use schema::CameraInfo;
pub use star_list::{ListedStar, StarList};
pub use told::{GivenCircumstances, ToldError};
pub use write::{FitsHeaders, write_fits_u16, write_manifest, write_png_u16};
inner!(schema::{RecordingFrameTable, RecordingMountTable, RecordingFile, STAR_LIST_FORMAT, RecordingSiteTable, StarListRow});
inner!(image_form::{ImageFileForm, write_image});
inner!(output::{OutputDirectory, OutputFile, ResultFolder, abandon, check_file});
inner!(write::{manifest_text, write_fits_f32, star_list_text, write_fits_with, write_manifest_of, write_fits_u8});

/// What a real camera left behind, or the simulator in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// What is known of the camera.
    pub camera: CameraInfo,
    /// How it stands; `None` where nobody says.
    pub mount: Option<Mount>,
    /// Where on the ground it stands.
    pub site: Option<Site>,
    /// The frames, in order.
    pub frames: Vec<FrameEntry>,
    /// The stars of the frames, where the recording holds these and no pixels.
    pub stars: Option<StarList>,
    /// The folder that the frames' files are relative to.
    pub directory: PathBuf,
    /// The form it came in.
    pub form: Form,
    /// The manifest, where there is one.
    pub manifest: Option<PathBuf>,
    /// The star list's file, where there is one.
    pub star_file: Option<PathBuf>,
    /// Frames that were left out (only with [`OpenOptions::keep_going`]), each with its reason.
    pub skipped: Vec<SkippedFrame>,
    /// What was done or not used on reading, one sentence each.
    pub notes: Vec<String>,
    /// Whether bad frames are to be skipped.
    pub keep_going: bool,
    /// Which image of files that hold several is read.
    pub plane: Option<Plane>,
}

/// The form in which a recording came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Form {
    /// A folder with `recording.toml`.
    Manifest,
    /// A folder of FITS files.
    FitsFolder,
    /// Bare images.
    Images,
    /// A manifest with a star list.
    StarList,
}

/// How the rows are exposed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Shutter {
    /// All at once.
    Global,
    /// One after the other; the frame's time is that of the MIDDLE row.
    Rolling,
}

/// The row read first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FirstRow {
    /// Row 0.
    Top,
    /// The last row.
    Bottom,
}

/// How the camera stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mount {
    /// One attitude a frame.
    Free,
    /// One attitude to the ground; the Earth turns.
    Fixed,
}

/// Where on the ground the camera stands, and the air there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Site {
    /// Geodetic latitude.
    pub latitude_deg: f64,
    /// Longitude, east positive.
    pub longitude_deg: f64,
    /// Height above the ellipsoid; zero where nobody says.
    pub height_m: f64,
    /// Air pressure.
    pub pressure_hpa: Option<f64>,
    /// Air temperature.
    pub temperature_c: Option<f64>,
    /// Relative humidity, 0 to 1.
    pub relative_humidity: Option<f64>,
}

/// One frame and its telemetry.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameEntry {
    /// Its file, as given: relative to [`Recording::directory`]. `None` in a star list.
    pub file: Option<PathBuf>,
    /// Its number in the recording as stored, from 0 (frames that were skipped count).
    pub number: usize,
    /// Its size.
    pub size: Option<FrameSize>,
    /// Whether it is stored from the bottom up and turned over on reading.
    pub rows_flipped: bool,
    /// Middle of the exposure.
    pub time_utc: Option<Epoch>,
    /// Whether that time was given without its zone and is taken for UTC: it may be off by 14 hours.
    pub zone_unknown: bool,
    /// Length of the exposure.
    pub exposure_s: Option<f64>,
    /// Temperature of the optics or the focal plane.
    pub temperature_c: Option<f64>,
    /// Velocity of the camera, barycentric, ICRS axes.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Body rate in camera axes.
    pub rate_deg_s: Option<[f64; 3]>,
    /// An attitude from elsewhere.
    pub camera_from_icrs: Option<Attitude>,
    /// How far that attitude is trusted; without it the attitude is a hint only.
    pub attitude_sigma_arcsec: Option<f64>,
    /// Right ascension and declination of the boresight, a hint.
    pub boresight_radec_deg: Option<[f64; 2]>,
    /// Altitude and azimuth (from north through east) of the boresight, a hint.
    pub altitude_azimuth_deg: Option<[f64; 2]>,
    /// Any other number by its name.
    pub covariates: BTreeMap<String, f64>,
    /// Where the manifest speaks of the file, for messages.
    pub place: Option<ManifestKey>,
}

/// A frame that was left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct SkippedFrame {
    /// Its file, or its number.
    pub file: String,
    /// Its number in the recording as stored, from 0.
    pub number: usize,
    /// Why it was left out.
    pub reason: String,
}

/// How a recording is opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OpenOptions {
    /// Bad frames are skipped and listed in [`Recording::skipped`] instead of being an error.
    pub keep_going: bool,
    /// Which image of files that hold several is read.
    pub plane: Option<Plane>,
}

/// Which image of a file that holds several: planes of a FITS cube, pages of a TIFF file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plane {
    /// This one, from 0.
    Index(usize),
    /// The three planes of a cube are colours, and their luminance is meant.
    Colours,
}

impl Recording {
    /// A recording to be written: its frames' files are relative to the folder it will stand in.
    #[must_use]
    pub fn new(camera: CameraInfo) -> Self {
        Self {
            camera,
            mount: None,
            site: None,
            frames: Vec::new(),
            stars: None,
            directory: PathBuf::new(),
            form: Form::Manifest,
            manifest: None,
            star_file: None,
            skipped: Vec::new(),
            notes: Vec::new(),
            keep_going: false,
            plane: None,
        }
    }

    /// Opens a recording; a bad frame is an error. `paths` is one recording (a folder or a manifest) or one image or more.
    ///
    /// ```
    /// use boresight::recording::Recording;
    ///
    /// let missing = Recording::open(&["no-such-night.fits"]).unwrap_err();
    /// assert!(missing.to_string().contains("no-such-night.fits"));
    /// ```
    pub fn open<P: AsRef<Path>>(paths: &[P]) -> Result<Self, RecordingError> {
        Self::open_with(paths, OpenOptions::default())
    }

    /// Opens a recording. Headers and sizes are checked here; pixels are read by [`Self::load_frame`].
    pub fn open_with<P: AsRef<Path>>(paths: &[P], options: OpenOptions) -> Result<Self, RecordingError> {
        let paths: Vec<&Path> = paths.iter().map(AsRef::as_ref).collect();
        open::open(&paths, options)
    }

    /// Where a frame's file lies; `None` in a star list.
    #[must_use]
    pub fn frame_path(&self, frame: usize) -> Option<PathBuf> {
        self.frames.get(frame)?.file.as_ref().map(|file| self.directory.join(file))
    }

    /// A frame's file as given, or its number.
    #[must_use]
    pub fn frame_name(&self, frame: usize) -> String {
        self.frames.get(frame).map_or_else(|| format!("frame {frame}"), FrameEntry::name)
    }

    /// Reads the pixels of a frame: every one finite, in DN; full at the camera's `saturation_dn` or at the top of the
    /// file's number range, whichever is lower. Pixels without a value have the median of the others: see [`Self::load_masked`].
    pub fn load_frame(&self, frame: usize) -> Result<Frame, RecordingError> {
        self.load_masked(frame).map(|masked| masked.frame)
    }

    /// The same, with the pixels marked that have no value (NaN or BLANK).
    pub fn load_masked(&self, frame: usize) -> Result<MaskedFrame, RecordingError> {
        let no_such_frame = || RecordingError::NoSuchFrame { frame, frames: self.frames.len() };
        let entry = self.frames.get(frame).ok_or_else(no_such_frame)?;
        let path = self
            .frame_path(frame)
            .ok_or_else(|| RecordingError::NoPixels { path: self.manifest.clone().unwrap_or_else(|| self.directory.clone()), frame })?;
        let fault = |problem| RecordingError::Frame { file: path.clone(), problem: Box::new(problem), place: entry.place.clone() };
        let read = match entry.size.filter(|_| self.form == Form::Manifest && image_file::is_raw(&path)) {
            Some(size) => image_file::load_raw(&path, size),
            None => image_file::load_masked(&path, self.plane),
        };
        let mut masked = read.map_err(fault)?;
        let loaded = &mut masked.frame;
        let found = FrameSize { width_px: loaded.width_px, height_px: loaded.height_px };
        if let Some(expected) = entry.size.filter(|expected| *expected != found) {
            return Err(fault(FrameProblem::WrongSize { found, expected, expected_from: "the recording says".to_owned() }));
        }
        if let Some(saturation_dn) = self.camera.saturation_dn {
            loaded.saturation_dn = loaded.saturation_dn.min(saturation_dn as f32);
        }
        Ok(masked)
    }

    /// Reads the pixels of a frame, or says why it is to be left out if bad frames are skipped.
    pub fn load_frame_or_skip(&self, frame: usize) -> Result<Result<MaskedFrame, SkippedFrame>, RecordingError> {
        match self.load_masked(frame) {
            Ok(loaded) => Ok(Ok(loaded)),
            Err(error) if self.keep_going && frame < self.frames.len() => {
                Ok(Err(SkippedFrame { file: self.frame_name(frame), number: self.frames[frame].number, reason: error.to_string() }))
            }
            Err(error) => Err(error),
        }
    }

    /// The size that all frames share; an error where bare images of several sizes were given.
    pub fn common_size(&self) -> Result<FrameSize, RecordingError> {
        let expected = FrameSize { width_px: self.camera.width_px, height_px: self.camera.height_px };
        match self.frames.iter().position(|entry| entry.size.is_some_and(|size| size != expected)) {
            None => Ok(expected),
            Some(other) => Err(RecordingError::MixedSizes {
                first: PathBuf::from(self.frame_name(0)),
                expected,
                file: PathBuf::from(self.frame_name(other)),
                found: self.frames[other].size.unwrap_or(expected),
            }),
        }
    }

    /// The camera as the recording describes it; `None` where it tells no focal length.
    #[must_use]
    pub fn nominal_camera(&self) -> Option<Camera> {
        self.common_size().ok()?;
        self.camera.nominal()
    }

    /// Every file that the recording is made of, in order: the manifest, the star list, the frames.
    #[must_use]
    pub fn input_files(&self) -> Vec<PathBuf> {
        let frames = (0..self.frames.len()).filter_map(|frame| self.frame_path(frame));
        self.manifest.iter().chain(&self.star_file).cloned().chain(frames).collect()
    }
}

impl FrameEntry {
    /// The file as given, or the frame's number.
    #[must_use]
    pub fn name(&self) -> String {
        self.file.as_ref().map_or_else(|| format!("frame {}", self.number), |file| file.display().to_string())
    }
}

impl CameraInfo {
    /// The focal length in pixels: as given, or from millimetres and pitch (of non-square pixels the geometric mean).
    #[must_use]
    pub fn nominal_focal_length_px(&self) -> Option<f64> {
        let from_mm = || {
            let [x_um, y_um] = self.pixel_pitch_um?;
            Some(self.focal_length_mm? * 1000.0 / (x_um * y_um).sqrt())
        };
        self.focal_length_px.or_else(from_mm)
    }

    /// The camera of the reference model; what is absent is zero or the middle. `None` without a focal length.
    #[must_use]
    pub fn nominal(&self) -> Option<Camera> {
        let mut camera = Camera::pinhole(self.width_px, self.height_px, self.nominal_focal_length_px()?);
        if let Some(point) = self.principal_point_px {
            camera.principal_point_px = point;
        }
        camera.k1 = self.k1.unwrap_or(0.0);
        camera.p1 = self.p1.unwrap_or(0.0);
        camera.p2 = self.p2.unwrap_or(0.0);
        Some(camera)
    }
}
