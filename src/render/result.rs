//! What `boresight simulate` and `boresight effects --signature` write: the results, as they stand in files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;

use super::MaskFlag;
use crate::camera::Camera;
use crate::coordinates::Attitude;
use crate::imaging::Binning;
use crate::provenance::{Provenance, word};
use crate::scene::{DetectorTable, PsfTable, SiteTable, SkyTable};

/// The name of the file format of `simulate.json`.
pub const SIMULATE_FORMAT: &str = "boresight-simulate/1";
/// The name of the file format of `truth/truth.json`.
pub const TRUTH_FORMAT: &str = "boresight-truth/2";
/// The name of the file format of a signature.
pub const SIGNATURE_FORMAT: &str = "boresight-signature/1";

/// What was rendered, and where it is.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SimulateResult {
    /// [`SIMULATE_FORMAT`].
    pub format: &'static str,
    /// The folder of the recording.
    #[serde(serialize_with = "as_word")]
    #[schemars(with = "String")]
    pub recording: PathBuf,
    /// The folder of its truth.
    #[serde(serialize_with = "as_word")]
    #[schemars(with = "String")]
    pub truth: PathBuf,
    /// The folder of the frames without noise, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clean: Option<String>,
    /// The folder of the masks, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub masks: Option<String>,
    /// Number in the scene of the first frame rendered.
    pub first_frame: usize,
    /// Frames rendered.
    pub frames: usize,
    /// Star images rendered.
    pub stars: usize,
    /// How it came about.
    pub provenance: Provenance,
}

/// A path need not be UTF-8: it is written as the command line's words are.
fn as_word<S: serde::Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&word(path.as_os_str()))
}

/// `truth/truth.json`: all that a simulated recording does not tell. The frames may come one after the other while they are written
/// (`Frames`), since they can be many.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SimulatedTruth<'a, Frames = Vec<TrueFrame>> {
    /// [`TRUTH_FORMAT`].
    pub format: &'static str,
    /// The camera.
    pub camera: &'a Camera,
    /// Id of the law of its lens.
    pub projection: &'static str,
    /// The parameters of that law, by name.
    pub projection_parameters: BTreeMap<String, f64>,
    /// The camera that the recording declares.
    pub nominal: &'a Camera,
    /// Of the detector's own pixels.
    pub detector: &'a DetectorTable,
    /// How pixels are joined, where they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub binning: Option<Binning>,
    /// The image of a star: as the scene has it, or the Gaussian of `[detector]`.
    pub psf: PsfTable,
    /// What works on pixels, in no order: what every camera has, and what the scene lists.
    pub pixel_effects: Vec<TruthEffect>,
    /// What lights the sky between the stars unevenly.
    pub sky_lights: Vec<TruthEffect>,
    /// The sky.
    pub sky: &'a SkyTable,
    /// The place on the ground, if it is there.
    pub site: Option<&'a SiteTable>,
    /// The frames.
    #[schemars(with = "Vec<TrueFrame>")]
    pub frames: Frames,
    /// What the values in masks mean, where masks were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask_flags: Option<[MaskFlag; MaskFlag::ALL.len()]>,
    /// How the file came about.
    pub provenance: &'a Provenance,
}

/// The truth of one frame.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct TrueFrame {
    /// Its number in the scene, as in stars.csv.
    pub frame: usize,
    /// Its image, within the folder of the recording.
    pub file: String,
    /// Its expected electrons, within the folder of the truth, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clean_file: Option<String>,
    /// Its mask, within the folder of the truth, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask_file: Option<String>,
    /// Middle of the exposure, UTC.
    pub time_utc: Option<String>,
    /// Length of the exposure.
    pub exposure_s: f64,
    /// The displacements in force.
    pub effects: Vec<TruthEffect>,
    /// Attitude when the exposure begins.
    pub camera_from_icrs_start: Attitude,
    /// Attitude in its middle.
    pub camera_from_icrs_mid: Attitude,
    /// Attitude when it ends.
    pub camera_from_icrs_end: Attitude,
    /// Barycentric velocity of the camera, ICRS axes.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Unit vector to the zenith, ICRS axes.
    pub zenith_icrs: Option<[f64; 3]>,
}

/// An effect in force.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct TruthEffect {
    /// Its id.
    pub id: String,
    /// Its parameters, by name.
    pub parameters: BTreeMap<String, f64>,
}

/// What a parameter of an effect on pixels does to measured stars.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SignatureResult {
    /// [`SIGNATURE_FORMAT`].
    pub format: &'static str,
    /// The effect.
    pub effect: String,
    /// The parameter.
    pub parameter: &'static str,
    /// Its unit; empty where it has none.
    pub unit: &'static str,
    /// Between which values of it the difference was taken; the others are typical.
    pub values: [f64; 2],
    /// The parameter of the page's formula, of which a unit is taken.
    pub formula: Option<String>,
    /// Over the stars of one brightness, then over all.
    pub summary: Vec<SignatureSummary>,
    /// Star by star.
    pub stars: Vec<SignatureStar>,
    /// How it came about.
    pub provenance: Provenance,
}

/// What a unit of the parameter does to a star.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SignatureStar {
    /// Column of the star.
    pub x_px: f64,
    /// Row of the star.
    pub y_px: f64,
    /// Electrons of the star.
    pub electrons: f64,
    /// Shift along the rows.
    pub dx_px: f64,
    /// Shift along the columns.
    pub dy_px: f64,
    /// Change of the flux over the flux.
    pub flux_relative: f64,
    /// The shift along the rows of a unit of the formula's parameter.
    pub formula_dx_px: Option<f64>,
    /// That along the columns.
    pub formula_dy_px: Option<f64>,
}

/// The same over stars.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SignatureSummary {
    /// Of which brightness; absent: all.
    pub electrons: Option<f64>,
    /// How many.
    pub stars: usize,
    /// Mean shift along the rows.
    pub mean_dx_px: f64,
    /// Mean shift along the columns.
    pub mean_dy_px: f64,
    /// √(mean(dx² + dy²)).
    pub rms_px: f64,
    /// Mean change of the flux over the flux.
    pub flux_relative: f64,
    /// Of the angle between the shifts and those of the formula; absent where either moves nothing.
    pub cosine: Option<f64>,
    /// Length of the shifts along those of the formula.
    pub ratio: Option<f64>,
}
