//! Detections → ControlPoints: which catalogue star is which detection, lost in space.

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::coordinates::{Apparent, Attitude, Direction};

/// A detection with its catalogue star.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Index into [`crate::detect::Detections::stars`].
    pub detection: usize,
    /// Index into [`crate::catalog::Catalog::stars`].
    pub star: usize,
    /// Measured minus predicted position, px (in the image as identified, that is after un-mirroring).
    pub residual_px: [f64; 2],
}

/// The answer for one frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Identification {
    /// The stars are identified.
    Identified(Solution),
    /// They are not, and why.
    NotIdentified {
        /// One sentence.
        reason: String,
    },
}

/// An identified frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// How the camera is turned.
    pub attitude: Attitude,
    /// The camera as far as this one frame tells it: focal length and k1 fitted, principal point in the middle.
    pub camera: Camera,
    /// −1 if the image is mirrored (x was replaced by width − 1 − x before everything else), else +1.
    pub parity: i8,
    /// The identified stars, brightest detection first.
    pub matches: Vec<Match>,
    /// 2-D rms of the matches' residuals.
    pub rms_px: f64,
    /// Probability that an image without these stars would have been matched as well as this one, over all that was tried.
    pub false_match_probability: f64,
}

/// A measured star image with the direction of the star it is held to be: all that the calibrator sees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ControlPoint {
    /// Index of the frame in its recording.
    pub frame: usize,
    /// Catalogue number.
    pub hip: u32,
    /// Direction of the star as its light arrives (as far as the physics in use models it), ICRS axes.
    #[serde(with = "direction_as_array")]
    pub direction: Direction<Apparent>,
    /// Measured column.
    pub x_px: f64,
    /// Measured row.
    pub y_px: f64,
    /// Covariance of the measured position: xx, xy, yy.
    pub covariance_px2: [f64; 3],
    /// Standard error of the catalogue direction at the time of the frame, rad per axis.
    pub catalog_sigma_rad: f64,
    /// Whether the catalogue knows the star's proper motion.
    pub has_proper_motion: bool,
    /// V magnitude.
    pub magnitude: f64,
    /// B − V where known.
    pub colour: Option<f64>,
}

/// The control points of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ControlPoints {
    /// The camera before calibration: ground values, or what identification found.
    pub nominal: Camera,
    /// Starting attitude of each frame; `None` where the frame was not identified.
    pub attitudes: Vec<Option<Attitude>>,
    /// The points, in order of frame.
    pub points: Vec<ControlPoint>,
}

mod direction_as_array {
    //! A direction in files: its three components.
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::coordinates::{Apparent, Direction};

    pub(super) fn serialize<S: Serializer>(direction: &Direction<Apparent>, serializer: S) -> Result<S::Ok, S::Error> {
        direction.xyz.serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Direction<Apparent>, D::Error> {
        Ok(Direction::along(<[f64; 3]>::deserialize(deserializer)?))
    }
}
