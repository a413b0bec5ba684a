//! Identified star lists → control points, without an identification of our own.

use super::{ControlPoint, ControlPoints, FrameState, KnownAttitude};
use crate::camera::{Camera, ObserverError, Physics, PhysicsError, SkyChain, Term};
use crate::catalog::{Catalog, Star};
use crate::coordinates::Direction;
use crate::effects::{StarImage, StarState};
use crate::recording::{ListedStar, Mount, Recording};
use crate::units::{ARCSEC_RAD, DEG_RAD};

/// Error of a listed position (per axis) where the list gives none: what a plain centroid of a focused star reaches.
const DEFAULT_SIGMA_PX: f64 = 0.1;

/// Where no time is known stars are taken to stand where they stood at this epoch (Julian year), and results say so.
pub const ASSUMED_EPOCH_YR: f64 = 2000.0;

/// Why a star list cannot be taken as it is.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PreidentifiedError {
    /// The recording holds images.
    #[error("only a star list names its stars; this recording holds images")]
    NoList,
    /// No camera is described.
    #[error("the recording does not tell the focal length; add focal_length_px, or let the stars be identified anew")]
    NoCamera,
    /// A time cannot be used.
    #[error("frame {0}: {1}")]
    Observer(usize, ObserverError),
    /// An effect cannot be computed.
    #[error(transparent)]
    Physics(#[from] PhysicsError),
}

/// The covariance of a listed position, px²: xx, xy, yy.
#[must_use]
pub fn listed_covariance_px2(star: &ListedStar) -> [f64; 3] {
    star.covariance_px2.unwrap_or([DEFAULT_SIGMA_PX * DEFAULT_SIGMA_PX, 0.0, DEFAULT_SIGMA_PX * DEFAULT_SIGMA_PX])
}

/// Adds the control points that a frame's list names itself (`hip`, or `ra_deg` and `dec_deg`).
/// Returns the numbers that the catalogue does not hold.
pub fn add_listed_points(points: &mut ControlPoints, frame: usize, stars: &[ListedStar], catalog: &Catalog, sky: &SkyChain) -> Vec<u32> {
    let years = sky.observation().epoch_yr.map_or(0.0, |epoch| epoch - catalog.epoch_yr);
    let mut unknown = Vec::new();
    for listed in stars {
        let own = |[ra, dec]: [f64; 2]| Star {
            hip: 0,
            direction: Direction::from_radec_rad(ra * DEG_RAD, dec * DEG_RAD),
            proper_motion_rad_yr: None,
            parallax_rad: 0.0,
            magnitude: listed.magnitude.unwrap_or(f64::NAN),
            colour: None,
        };
        let (star, sigma) = match (listed.hip.and_then(|hip| catalog.by_hip(hip)), listed.radec_deg) {
            (Some(star), _) => (*star, catalog.position_sigma_rad(star, years)),
            (None, Some(radec)) => (own(radec), 0.0),
            (None, None) => {
                unknown.extend(listed.hip);
                continue;
            }
        };
        points.points.push(ControlPoint {
            frame,
            hip: star.hip,
            direction: sky.apparent(&star, catalog.epoch_yr),
            x_px: listed.x_px,
            y_px: listed.y_px,
            covariance_px2: listed_covariance_px2(listed),
            catalog_sigma_rad: sigma,
            // A direction that the list itself gives is that of its own time: nothing is missing.
            has_proper_motion: star.hip == 0 || star.proper_motion_rad_yr.is_some(),
            magnitude: if star.magnitude.is_finite() { star.magnitude } else { 99.0 },
            colour: star.colour,
            star: StarState::of(&star, catalog.epoch_yr),
            image: StarImage { flux_e: listed.flux_e, magnitude: listed.magnitude, ..StarImage::default() },
        });
    }
    unknown
}

/// −1 if star images lie on their frames as in a mirror, by the sense of rotation between catalogue and frame that most frames have; 1 else.
#[must_use]
pub fn handedness(points: &ControlPoints) -> i8 {
    let mut votes = 0_i64;
    for frame in 0..points.attitudes.len() {
        let own: Vec<&ControlPoint> = points.points.iter().filter(|point| point.frame == frame).collect();
        let count = own.len() as f64;
        if own.len() < 3 {
            continue;
        }
        let middle: [f64; 3] = std::array::from_fn(|axis| own.iter().map(|point| point.direction.xyz[axis]).sum::<f64>() / count);
        let [x, y] = [own.iter().map(|point| point.x_px).sum::<f64>() / count, own.iter().map(|point| point.y_px).sum::<f64>() / count];
        let z = nalgebra::Vector3::from(middle);
        let east = nalgebra::Vector3::new(-z.y, z.x, 0.0).try_normalize(1e-9).unwrap_or_else(nalgebra::Vector3::x);
        let north = z.cross(&east).normalize();
        // Σ of products of what is seen and what is catalogued: its determinant has the sign of the map from one to the other.
        let mut sums = [[0.0; 2]; 2];
        for point in own {
            let direction = nalgebra::Vector3::from(point.direction.xyz);
            let sky = [direction.dot(&east), direction.dot(&north)];
            for (row, seen) in sums.iter_mut().zip([point.x_px - x, point.y_px - y]) {
                row[0] += seen * sky[0];
                row[1] += seen * sky[1];
            }
        }
        // Columns to the right, rows downward, seen from within the sphere: a frame that is not mirrored turns as the sky does.
        votes += if sums[0][0] * sums[1][1] - sums[0][1] * sums[1][0] < 0.0 { -1 } else { 1 };
    }
    if votes < 0 { -1 } else { 1 }
}

/// The control points of a whole star list, its identifications taken as they are, for a model with this physics.
pub fn listed_control_points(recording: &Recording, catalog: &Catalog, physics: &Physics) -> Result<ControlPoints, PreidentifiedError> {
    let list = recording.stars.as_ref().ok_or(PreidentifiedError::NoList)?;
    let nominal: Camera = recording.nominal_camera().ok_or(PreidentifiedError::NoCamera)?;
    let observations = recording.observations().map_err(|(frame, error)| PreidentifiedError::Observer(frame, error))?;
    let mut points = ControlPoints::new(nominal, vec![None; recording.frames.len()], Vec::new());
    for (frame, (entry, mut observation)) in recording.frames.iter().zip(observations).enumerate() {
        observation.epoch_yr = observation.epoch_yr.or(Some(ASSUMED_EPOCH_YR));
        let sky = SkyChain::new(physics, observation)?;
        let stars = list.frames.get(frame).map_or(&[][..], Vec::as_slice);
        add_listed_points(&mut points, frame, stars, catalog, &sky);
        let known_attitude = entry.camera_from_icrs.zip(entry.attitude_sigma_arcsec);
        let known_attitude =
            known_attitude.map(|(camera_from_icrs, sigma)| KnownAttitude { camera_from_icrs, sigma_rad: sigma * ARCSEC_RAD });
        points.frames.push(FrameState { observation, known_attitude });
        for (id, parameters) in sky.effects() {
            if points.sky.iter().all(|term| term.effect != id) {
                points.sky.push(Term { effect: id.to_owned(), parameters: parameters.to_vec() });
            }
        }
    }
    points.fixed_mount = recording.mount == Some(Mount::Fixed);
    Ok(points)
}
