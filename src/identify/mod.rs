//! Detections → ControlPoints: which catalogue star is which detection, lost in space.
//!
//! [`identify`] needs no attitude, and a focal length only to be faster:
//! 1. Triangles of the brightest detections are looked up among the triangles of an [`Index`] by shape and size, for focal
//!    lengths around the nominal one or, without one (or if that fails), for all fields 3° to 90° wide, and for some amounts of
//!    radial distortion; then through the laws of fisheyes, around the middle of the frame. Either handedness is accepted: images may
//!    be mirrored. Where many detections look like no star (letters, edges, trails), those that do are searched first.
//! 2. Each pair of triangles is a hypothesis about attitude and focal length; the brightest catalogue stars around its triangle
//!    must be found among the detections, more of them than by chance.
//! 3. What survives is fitted to all detections (attitude, focal length, k1; of a fisheye the principal point) with a shrinking radius.
//! 4. A hypothesis is accepted if the probability that detections which have nothing to do with the stars would match as well
//!    is below a limit, everything that was tried included; else the frame is not identified, and a sentence says why.

mod association;
mod background_slope;
mod candidate;
mod candidate_block;
mod clutter;
mod control;
mod false_match;
mod fisheye;
mod fit;
mod frame_plane;
mod index;
mod index_scale;
mod laid_sky;
mod misidentify;
mod overlay;
mod point_map;
mod pose;
mod preidentified;
mod prior_attitude;
mod projection;
mod refine;
mod refusal;
mod result;
mod search;
mod search_plan;
mod sky;
mod solution;
mod spread;
mod stages;
mod wrong_camera;

use std::borrow::Cow;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::{Camera, Term};
use crate::catalog::Catalog;
use crate::coordinates::{Apparent, Attitude, Direction};
use crate::detect::Detections;
use crate::effects::{Observation, StarImage, StarState};
use crate::units::DEG_RAD;

pub use control::{FrameIdentification, control_points};
pub use index::{Index, IndexSize};
pub use misidentify::{Misidentification, MisidentificationKind};
pub use preidentified::PreidentifiedError;
pub use prior_attitude::AttitudePrior;
pub use projection::Projection;
pub use refusal::{NoMatch, Refusal};
inner!(result::{FORMAT, IdentifyFrameResult, FrameStatus, IdentifyResult, MisnamedMatch, NamedStar});
inner!(background_slope::BackgroundSlope);
inner!(control::{common_projection, image_state});
inner!(misidentify::misidentify);
inner!(preidentified::{ASSUMED_EPOCH_YR, add_listed_points, handedness, listed_control_points, listed_covariance_px2});
inner!(solution::catalog_directions);

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
        /// The cause; as text, one sentence.
        reason: Refusal,
        /// The hypotheses that were tried.
        hypotheses: u64,
    },
}

/// An identified frame.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Solution {
    /// How the camera is turned.
    pub attitude: Attitude,
    /// The camera as far as this one frame tells it: focal length and k1 fitted, principal point in the middle, but of fisheyes, where it is
    /// fitted too.
    pub camera: Camera,
    /// The law of the lens.
    pub projection: Projection,
    /// −1 if the image is mirrored (x was replaced by width − 1 − x before everything else), else +1.
    pub parity: i8,
    /// The identified stars, brightest detection first.
    pub matches: Vec<Match>,
    /// The distance from the principal point beyond which a fisheye's frame shows no star images: that of the outermost detection; infinite where the
    /// image fills the frame.
    pub lit_radius_px: f64,
    /// 2-D rms of the matches' residuals.
    pub rms_px: f64,
    /// Probability that an image without these stars would have been matched as well as this one, over all that was tried: as often as
    /// that happens on lists without stars, to a factor of about two.
    pub false_match_probability: f64,
}

/// How to identify.
#[derive(Clone, Debug, PartialEq)]
pub struct IdentifyOptions {
    /// Focal length in pixels as far as it is known; `None` searches all widths of field.
    pub nominal_focal_length_px: Option<f64>,
    /// The focal length is first searched within this factor (0.25: from nominal/1.25 to nominal·1.25).
    pub focal_length_tolerance: f64,
    /// Whether all widths of field are searched if the nominal focal length leads to nothing.
    pub search_beyond_tolerance: bool,
    /// The widths of field that are searched without a nominal focal length, radians: least and greatest.
    pub field_width_range_rad: [f64; 2],
    /// −1: the image is mirrored, +1: it is not; `None`: either.
    pub parity: Option<i8>,
    /// The law of the lens where it is known; `None`: the tangent plane and, if that leads to nothing, those of fisheyes.
    pub projection: Option<Projection>,
    /// Hypotheses about this frame that were tried before, in other searches: they count in [`Solution::false_match_probability`].
    pub hypotheses_before: u64,
    /// Where the camera is held to point: nothing is searched elsewhere, so that there is time for more.
    pub near: Option<AttitudePrior>,
    /// A match is accepted only if detections without these stars would match as well with less than this probability. A bound decides,
    /// mostly a hundred times what is stated in [`Solution::false_match_probability`].
    pub max_false_match_probability: f64,
    /// Give up after this time. Without a limit the answer is the same on every machine. Levels of the index that are needed
    /// for the first time are built on this time too: call [`Index::build`] before.
    pub time_limit: Option<Duration>,
    /// What of that time was taken before, by measuring the frame.
    pub time_spent: Duration,
}

impl Default for IdentifyOptions {
    fn default() -> Self {
        Self {
            nominal_focal_length_px: None,
            focal_length_tolerance: 0.25,
            search_beyond_tolerance: true,
            field_width_range_rad: [3.0 * DEG_RAD, 90.0 * DEG_RAD],
            parity: None,
            projection: None,
            hypotheses_before: 0,
            near: None,
            max_false_match_probability: 1e-6,
            time_limit: None,
            time_spent: Duration::ZERO,
        }
    }
}

/// The fewest star images of which a frame can be identified.
const MIN_DETECTIONS: usize = 4;
/// More detections than these, the brightest, are not looked at in the search.
const MAX_DETECTIONS: usize = 400;

/// Identifies the stars of one frame.
///
/// `directions` gives for every star of the catalogue the direction in which its light arrives in this frame; an empty slice
/// stands for the catalogue's own directions. `index` must have been made of the same catalogue.
#[must_use]
pub fn identify(
    detections: &Detections,
    catalog: &Catalog,
    index: &Index,
    directions: &[Direction<Apparent>],
    options: &IdentifyOptions,
) -> Identification {
    let begin = Instant::now();
    let (points, apparent) = match prepare(detections, catalog, index, directions, options) {
        Ok(prepared) => prepared,
        Err(reason) => return Identification::NotIdentified { reason, hypotheses: 0 },
    };
    let usable = points.all.centred_px.len();
    let failure = match search::search(&points, index, &apparent, options, begin) {
        Ok((found, points)) => return solution::solve(detections, points, index, &apparent, &found),
        Err(failure) => failure,
    };
    let hypotheses = failure.hypotheses;
    let reason = match failure.end {
        search::End::TimeLimit { limit } => Refusal::TimeLimit { limit_s: limit.as_secs_f64(), usable },
        search::End::Exhausted { least_bound, was_cut, .. } => Refusal::NoMatch(NoMatch {
            hypotheses,
            usable,
            within_rad: options.near.map(|near| near.within_rad),
            least_bound,
            asked: options.max_false_match_probability,
            was_cut,
        }),
    };
    Identification::NotIdentified { reason, hypotheses }
}

/// The least false-match probability that would be stated of any hypothesis about a frame, if none were ever accepted: to see, on frames
/// without these stars, how often chance does as well as is stated. `None` where there is nothing to search or the time limit came first.
#[must_use]
pub fn least_false_match_probability(
    detections: &Detections,
    catalog: &Catalog,
    index: &Index,
    directions: &[Direction<Apparent>],
    options: &IdentifyOptions,
) -> Option<f64> {
    let begin = Instant::now();
    let options = IdentifyOptions { max_false_match_probability: f64::MIN_POSITIVE, ..options.clone() };
    let (points, apparent) = prepare(detections, catalog, index, directions, &options).ok()?;
    match search::search(&points, index, &apparent, &options, begin) {
        Ok((found, _)) => Some(found.false_match_probability),
        Err(search::Failure { end: search::End::Exhausted { least_stated, .. }, .. }) => Some(least_stated),
        Err(search::Failure { end: search::End::TimeLimit { .. }, .. }) => None,
    }
}

/// The points of a frame, and the directions of the catalogue's stars in it.
type Searchable<'a> = (search_plan::FramePoints, Cow<'a, [Vector3<f64>]>);

/// What the search is made of, or why there is nothing to search.
fn prepare<'a>(
    detections: &Detections,
    catalog: &Catalog,
    index: &'a Index,
    directions: &[Direction<Apparent>],
    options: &IdentifyOptions,
) -> Result<Searchable<'a>, Refusal> {
    let in_catalog = catalog.stars.len();
    if index.star_count() != in_catalog {
        return Err(Refusal::OtherIndex { in_index: index.star_count(), in_catalog });
    }
    if !directions.is_empty() && directions.len() != in_catalog {
        return Err(Refusal::OtherDirections { directions: directions.len(), in_catalog });
    }
    if let Some(fault) = solution::fault_in(options, detections) {
        return Err(fault);
    }
    let points = solution::usable_points(detections);
    let usable = points.all.centred_px.len();
    if usable < MIN_DETECTIONS {
        return Err(Refusal::TooFewStars { usable, detected: detections.stars.len(), needed: MIN_DETECTIONS });
    }
    let apparent = if directions.is_empty() {
        Cow::Borrowed(&*index.vectors)
    } else {
        Cow::Owned(directions.iter().map(|direction| Vector3::from(direction.xyz)).collect())
    };
    Ok((points, apparent))
}

/// A measured star image with the direction of the star it is held to be: all that the calibrator sees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControlPoint {
    /// Index of the frame in its recording.
    pub frame: usize,
    /// Catalogue number.
    pub hip: u32,
    /// Direction of the star as its light arrives (as far as the physics in use models it), ICRS axes.
    #[serde(with = "direction_as_array")]
    #[schemars(with = "[f64; 3]")]
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
    /// The star as the catalogue has it, before any effect: what effects of the sky are solved from.
    #[serde(default)]
    pub star: StarState,
    /// What else is known of the image.
    #[serde(default, skip_serializing_if = "StarImage::is_unknown")]
    pub image: StarImage,
}

/// What is known of one frame besides its stars.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FrameState {
    /// Time, place, motion, telemetry.
    pub observation: Observation,
    /// An attitude from elsewhere (gyro, second head), if it is trusted.
    pub known_attitude: Option<KnownAttitude>,
}

/// An attitude from elsewhere and how far it is trusted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct KnownAttitude {
    /// The attitude.
    pub camera_from_icrs: Attitude,
    /// Its standard error about each axis, rad.
    pub sigma_rad: f64,
}

/// The control points of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControlPoints {
    /// The camera before calibration: ground values, or what identification found.
    pub nominal: Camera,
    /// The law of its lens, as identification found it.
    #[serde(default)]
    pub projection: Projection,
    /// Whether nobody declared that camera, and identification found it (its distortion then comes from these very star images).
    #[serde(default)]
    pub nominal_is_found: bool,
    /// Starting attitude of each frame; `None` where the frame was not identified.
    pub attitudes: Vec<Option<Attitude>>,
    /// The points, in order of frame.
    pub points: Vec<ControlPoint>,
    /// −1 if the images are mirrored. The points keep the coordinates of the file; see [`ControlPoints::unmirrored`].
    #[serde(default = "not_mirrored")]
    pub parity: i8,
    /// What is known of each frame; empty where nothing is.
    #[serde(default)]
    pub frames: Vec<FrameState>,
    /// The effects of the sky that the points' directions contain, with their parameters.
    #[serde(default)]
    pub sky: Vec<Term>,
    /// Whether the camera stands still on the ground while the Earth turns.
    #[serde(default)]
    pub fixed_mount: bool,
    /// What the frames are called, their files or their numbers; empty where they have no names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub frame_names: Vec<String>,
}

impl ControlPoints {
    /// Points of frames of which nothing else is known.
    #[must_use]
    pub fn new(nominal: Camera, attitudes: Vec<Option<Attitude>>, points: Vec<ControlPoint>) -> Self {
        Self {
            nominal,
            projection: Projection::Pinhole,
            nominal_is_found: false,
            attitudes,
            points,
            parity: 1,
            frames: Vec::new(),
            sky: Vec::new(),
            fixed_mount: false,
            frame_names: Vec::new(),
        }
    }

    /// What a frame is called in messages: its file, or its number.
    #[must_use]
    pub fn frame_name(&self, frame: usize) -> String {
        self.frame_names.get(frame).cloned().unwrap_or_else(|| format!("frame {frame}"))
    }

    /// What is known of a frame; the sensor's size always is.
    #[must_use]
    pub fn observation(&self, frame: usize) -> Observation {
        let sensor = Observation::of_sensor(self.nominal.width_px, self.nominal.height_px).sensor;
        let known = self.frames.get(frame).map_or_else(Observation::default, |frame| frame.observation);
        Observation { sensor: known.sensor.or(sensor), ..known }
    }
}

fn not_mirrored() -> i8 {
    1
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
