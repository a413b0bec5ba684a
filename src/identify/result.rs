//! What `boresight identify` says: the result, as it stands in files.

use schemars::JsonSchema;
use serde::Serialize;

use crate::camera::Camera;
use crate::provenance::Provenance;
use crate::recording::SkippedFrame;

/// The name of the file format.
pub const FORMAT: &str = "boresight-identify/1";

/// Which stars are in the frames of a recording.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct IdentifyResult<'a> {
    /// [`FORMAT`].
    pub format: &'static str,
    /// The frames that were measured.
    pub frames: Vec<FrameAnswer>,
    /// Ids of the effects that the star directions contain, in every frame.
    pub physics: Vec<&'static str>,
    /// Frames that could not be read.
    pub skipped: &'a [SkippedFrame],
    /// What to mind of the input, one sentence each.
    pub notes: Vec<&'a str>,
    /// Matches that were given a wrong star on purpose.
    pub misidentified_on_purpose: Vec<MisnamedMatch>,
    /// Where the stars are from, for people.
    pub catalog: &'a str,
    /// How the file came about.
    pub provenance: Provenance,
}

/// Whether a frame is identified, as files have it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FrameStatus {
    /// Its stars have names.
    Identified,
    /// They have none; the reason stands beside it.
    NotIdentified,
}

impl FrameStatus {
    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Identified => "identified",
            Self::NotIdentified => "not-identified",
        }
    }
}

/// One frame of the result. What is absent is not known of a frame that is not identified.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct FrameAnswer {
    /// The frame's file, or its number.
    pub file: String,
    /// Whether it is identified.
    pub status: FrameStatus,
    /// Why it is not.
    pub reason: Option<String>,
    /// Direction of the middle of the frame: right ascension and declination, ICRS.
    pub centre_radec_deg: Option<[f64; 2]>,
    /// The date at which the stars were taken, Julian year: that of the frame, 2000.0 where its time is not known, or that of the catalogue
    /// where proper motion is left out.
    pub centre_epoch_yr: Option<f64>,
    /// Whether the frame's time is known.
    pub time_known: bool,
    /// Position angle, north through east, of the frame's upward direction at the middle.
    pub roll_deg: Option<f64>,
    /// Principal distance.
    pub focal_length_px: Option<f64>,
    /// Angle between the middles of the left and the right edge.
    pub width_deg: Option<f64>,
    /// Angle between the middles of the upper and the lower edge.
    pub height_deg: Option<f64>,
    /// Star images found.
    pub stars_detected: usize,
    /// Those of them that have a name.
    pub stars_matched: usize,
    /// 2-D rms of the matches.
    pub rms_px: Option<f64>,
    /// Probability that a match as good as this one is of a wrong part of the sky.
    pub false_match_probability: Option<f64>,
    /// Quaternion, scalar last: components in ICRS axes to components in camera axes.
    pub camera_from_icrs: Option<[f64; 4]>,
    /// −1 if the image is mirrored, else +1.
    pub parity: Option<i8>,
    /// The law of the lens: `pinhole`, or that of a fisheye.
    pub projection: Option<&'static str>,
    /// The camera as found, in columns of the image as stored.
    pub camera: Option<Camera>,
    /// The stars.
    pub matches: Vec<NamedStar>,
    /// Time the identification took, s.
    pub seconds: f64,
}

/// A star image and its star.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct NamedStar {
    /// Number of the star image in the frame's detections, brightest first, from 0.
    pub detection: usize,
    /// Catalogue number.
    pub hip: u32,
    /// The star's name, if it has one.
    pub name: Option<&'static str>,
    /// Measured column.
    pub x_px: f64,
    /// Measured row.
    pub y_px: f64,
    /// Measured minus predicted position.
    pub residual_px: [f64; 2],
    /// V magnitude of the catalogue.
    pub magnitude: f64,
    /// Counts of the star.
    pub flux_dn: f64,
}

/// A match that was given a wrong star on purpose.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct MisnamedMatch {
    /// The frame's file, or its number.
    pub file: String,
    /// Measured column.
    pub x_px: f64,
    /// Measured row.
    pub y_px: f64,
    /// Catalogue number of the star that it is.
    pub true_hip: u32,
    /// Catalogue number of the star that it was given; absent where that is a direction without a star.
    pub given_hip: Option<u32>,
    /// Angle between the two.
    pub error_arcsec: f64,
}
