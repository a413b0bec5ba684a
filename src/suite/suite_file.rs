//! `SUITE.toml`: the tables as they stand in the file.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::Spanned;

use super::conventions::{QuaternionOrder, RotationWay};

/// The name of the file format.
pub const SUITE_FORMAT: &str = "boresight-suite/1";

/// A suite: cases with requirements, and the system that is tested.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SuiteFile {
    /// `boresight-suite/1`.
    pub format: String,
    /// Seed of attitudes and noise: the same frames every time.
    #[serde(default = "one")]
    pub seed: u64,
    /// How sure a PASS is to be, where a requirement does not say so itself.
    #[serde(default = "usual_confidence")]
    pub confidence: f64,
    /// The system under test; absent: boresight itself.
    pub system: Option<SystemTable>,
    /// How boresight measures, where it is the system.
    #[serde(default)]
    pub own: OwnTable,
    /// The cases.
    #[serde(default, rename = "case")]
    #[schemars(with = "Vec<CaseTable>")]
    pub cases: Vec<Spanned<CaseTable>>,
}

fn one() -> u64 {
    1
}

fn usual_confidence() -> f64 {
    0.95
}

/// `[own]`: how boresight measures where it is the system under test.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct OwnTable {
    /// The centroid: `windowed` (quick), `gaussian` or `empirical`.
    pub centroid: OwnCentroid,
    /// Whether the attitude of a frame comes from the whole camera that is calibrated from all frames of its night, not from the one frame alone.
    pub calibrate: bool,
    /// Whether nights are diagnosed.
    pub diagnose: bool,
}

impl Default for OwnTable {
    fn default() -> Self {
        Self { centroid: OwnCentroid::Windowed, calibrate: false, diagnose: false }
    }
}

/// A centroid estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OwnCentroid {
    /// Moments in a Gaussian window.
    Windowed,
    /// Maximum likelihood under a Gaussian integrated over the pixels.
    Gaussian,
    /// The same with the image that the stars themselves show.
    Empirical,
}

/// `[system]`: a program that is tested.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SystemTable {
    /// What results call it; absent: the command's first word.
    pub name: Option<String>,
    /// Program and arguments. `{image}`, `{answer}`, `{recording}`, `{frame}`, `{time_utc}`, `{exposure_s}` and `{truth}` are filled in.
    pub command: Vec<String>,
    /// How frames are handed over.
    #[serde(default)]
    pub mode: SystemMode,
    /// The images that it reads.
    #[serde(default)]
    pub image: SystemImage,
    /// How counts become the numbers of the image; absent: as they are, or to 8 bits by dropping the low bits.
    pub scaling: Option<ScalingTable>,
    /// How its answers are written.
    #[serde(default)]
    pub answer: AnswerForm,
    /// How long a frame may take; of a batch, each frame.
    #[serde(default = "five")]
    pub timeout_s: f64,
    /// Processes at a time in mode `frame`; more than one disturbs latencies.
    #[serde(default = "one_usize")]
    pub workers: usize,
    /// Frames that are handed over before any counts, so that tables are loaded and caches warm.
    #[serde(default)]
    pub warm_up: usize,
    /// Its conventions.
    #[serde(default)]
    pub conventions: ConventionsTable,
}

fn five() -> f64 {
    5.0
}

fn one_usize() -> usize {
    1
}

/// How frames are handed over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SystemMode {
    /// A process for each frame.
    #[default]
    Frame,
    /// One process for a folder of frames, one file of answers.
    Batch,
    /// One process that reads a line of JSON for each frame on stdin and answers with a line on stdout.
    Stream,
}

/// The images that a system reads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SystemImage {
    /// PNG, 8 bits.
    #[default]
    Png8,
    /// PNG, 16 bits.
    Png16,
    /// TIFF, 16 bits.
    Tiff16,
    /// FITS, 16 bits, with a header.
    Fits,
    /// Numbers of 16 bits alone, the low byte first, row by row; what they are stands beside them in JSON.
    Raw16,
}

/// A linear scaling: counts at `black_dn` become 0, those at `white_dn` the top of the image.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScalingTable {
    /// Counts that become 0.
    pub black_dn: f64,
    /// Counts that become the largest number.
    pub white_dn: f64,
    /// Exponent of the scaled number: 0.5 shows faint stars.
    #[serde(default = "unit")]
    pub gamma: f64,
}

fn unit() -> f64 {
    1.0
}

/// How answers are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AnswerForm {
    /// A table with the columns `frame,status,qi,qj,qk,qw` or `ra_deg,dec_deg,roll_deg`.
    #[default]
    Csv,
    /// An object, or one a line.
    Json,
    /// `attitude_known`, `attitude_i` and so on, a line each: LOST.
    Lost,
    /// The dictionary of tetra3, cedar-solve and their kin as JSON: `RA`, `Dec`, `Roll`.
    Tetra3,
    /// A FITS header with world coordinates: `solve-field`.
    AstrometryWcs,
}

/// `[system.conventions]`.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ConventionsTable {
    /// Which way the rotation goes.
    pub rotation: RotationWay,
    /// The order of the quaternion.
    pub quaternion: QuaternionOrder,
    /// Where the axes of the camera point on the frame: `x right, y down, z out` (right, left, down, up, out, in).
    pub axes: Option<String>,
    /// The coordinate of the first pixel's centre (0, 0.5, 1), or `middle` where pixels are counted from the middle of the frame.
    #[schemars(with = "Option<serde_json::Value>")]
    pub pixel_origin: Option<toml::Value>,
}

/// `[[case]]`: frames of a kind, and what is required of the answers to them.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CaseTable {
    /// Its name.
    pub name: String,
    /// A scene file, beside the suite.
    pub scene: Option<String>,
    /// A built-in scene (`boresight preset list`).
    pub preset: Option<String>,
    /// A recipe of a dataset, beside the suite: its frames of the split `test`.
    pub dataset: Option<String>,
    /// Values of the scene that are other in this case, by path.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, serde_json::Value>")]
    pub set: BTreeMap<String, toml::Value>,
    /// Frames of each value of the sweep; `"auto"`: until all is decided.
    pub frames: FrameCount,
    /// The most frames of `"auto"`.
    #[serde(default = "usual_most")]
    pub max_frames: usize,
    /// Where the camera points.
    #[serde(default)]
    pub attitudes: Attitudes,
    /// One value of the scene that is swept.
    pub sweep: Option<SweepTable>,
    /// An answer is right if its boresight is within this of the truth.
    #[serde(default = "usual_within")]
    pub within_arcsec: f64,
    /// And its roll within this; absent: twenty times `within_arcsec`.
    pub about_within_arcsec: Option<f64>,
    /// Frames of which one camera is calibrated and one night diagnosed.
    #[serde(default = "usual_night")]
    pub night_frames: usize,
    /// Effects that a diagnosis is to name, by id.
    #[serde(default)]
    pub hidden: Vec<String>,
    /// What is required.
    #[serde(default)]
    #[schemars(with = "Vec<RequirementTable>")]
    pub require: Vec<Spanned<RequirementTable>>,
}

fn usual_most() -> usize {
    3000
}

fn usual_within() -> f64 {
    60.0
}

fn usual_night() -> usize {
    10
}

/// How many frames.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "frames is a number or \"auto\"")]
pub enum FrameCount {
    /// So many.
    Exactly(usize),
    /// `"auto"`.
    Word(String),
}

/// Where the camera points: a word, or a table with more.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "attitudes is one of uniform, list, scan, dither, stare, nested, scene, or a table with one of them as its kind"
)]
pub enum Attitudes {
    /// A kind with its usual numbers.
    Kind(AttitudeKind),
    /// A kind with numbers.
    Table(AttitudeTable),
}

impl Default for Attitudes {
    fn default() -> Self {
        Self::Kind(AttitudeKind::Uniform)
    }
}

impl Attitudes {
    /// The whole table.
    #[must_use]
    pub fn table(&self) -> AttitudeTable {
        match self {
            Self::Kind(kind) => AttitudeTable { kind: *kind, ..AttitudeTable::default() },
            Self::Table(table) => table.clone(),
        }
    }
}

/// How attitudes are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AttitudeKind {
    /// By chance, evenly over the sphere and over all rolls.
    #[default]
    Uniform,
    /// From a file, in its order.
    List,
    /// A slow drift: sequences of frames, each a step further; every sequence begins elsewhere.
    Scan,
    /// Around one attitude: a grid within one pixel, each place several times.
    Dither,
    /// One attitude, again and again.
    Stare,
    /// Fields by chance, in each a grid within one pixel, each place several times: stare, dither and fields in one, which tells errors apart as ECSS does.
    Nested,
    /// As the scene has them.
    Scene,
}

/// `attitudes` with its numbers.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AttitudeTable {
    /// How they are chosen.
    pub kind: AttitudeKind,
    /// Of `list`: a CSV file beside the suite with `ra_deg,dec_deg,roll_deg`.
    pub file: Option<String>,
    /// Of `stare`, `dither` and the first sequence of `scan`: right ascension, declination and roll; absent: by chance.
    pub at_deg: Option<[f64; 3]>,
    /// Of `dither` and `nested`: places along a side of the grid within a pixel.
    pub grid: usize,
    /// Of `dither` and `nested`: exposures of each place.
    pub repeats: usize,
    /// Of `scan`: by how much the stars move from frame to frame.
    pub step_px: f64,
    /// Of `scan`: frames of a sequence.
    pub sequence: usize,
    /// With a site and a time: the lowest altitude of the boresight.
    pub lowest_altitude_deg: f64,
}

impl Default for AttitudeTable {
    fn default() -> Self {
        Self {
            kind: AttitudeKind::Uniform,
            file: None,
            at_deg: None,
            grid: 3,
            repeats: 3,
            step_px: 3.7,
            sequence: 50,
            lowest_altitude_deg: 20.0,
        }
    }
}

/// `sweep`.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepTable {
    /// A value of the scene by its path, as `frames.rate_deg_s[2]` or `effects.prnu.relative`; an effect itself is switched by true and false.
    pub path: String,
    /// Its values.
    #[schemars(with = "Vec<serde_json::Value>")]
    pub values: Vec<toml::Value>,
    /// What `when` and results call it; absent: the last word of the path.
    pub name: Option<String>,
}

/// `[[case.require]]`.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RequirementTable {
    /// The metric (`boresight test --metrics` lists them).
    pub metric: String,
    /// Its value is not to lie below this.
    pub at_least: Option<f64>,
    /// Its value is not to lie above this.
    pub at_most: Option<f64>,
    /// How sure a PASS is to be.
    pub confidence: Option<f64>,
    /// For which values of the sweep: `rate <= 1.0`, comparisons joined by `and`.
    pub when: Option<String>,
    /// What hangs on it.
    #[serde(default)]
    pub level: RequirementLevel,
}

/// What hangs on a requirement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RequirementLevel {
    /// The suite fails without it.
    #[default]
    Minimum,
    /// What the design aims at: told, without an effect on the exit code.
    Design,
    /// What would be welcome: told, without an effect on the exit code.
    Stretch,
}

impl RequirementLevel {
    /// As it stands in files.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Minimum => "minimum",
            Self::Design => "design",
            Self::Stretch => "stretch",
        }
    }
}
