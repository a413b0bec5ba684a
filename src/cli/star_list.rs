//! Star lists in the place of images: what a flight unit measured, in the terms of the stages that follow.

use boresight::camera::SkyChain;
use boresight::catalog::{Catalog, Star};
use boresight::coordinates::Direction;
use boresight::detect::{Detection, Detections, Flags};
use boresight::effects::{StarImage, StarState};
use boresight::identify::{ControlPoint, ControlPoints};
use boresight::recording::{ListedStar, Recording};
use boresight::units::DEG_RAD;

/// Error of a listed position (per axis) where the list gives none: what a plain centroid of a focused star reaches.
const DEFAULT_SIGMA_PX: f64 = 0.1;

/// The listed stars of a frame as detections, brightest first where the list tells brightness.
pub(crate) fn detections(recording: &Recording, stars: &[ListedStar]) -> Detections {
    let mut stars: Vec<Detection> = stars.iter().map(|star| detection(recording, star)).collect();
    stars.sort_by(|a, b| b.flux_dn.total_cmp(&a.flux_dn));
    Detections { width_px: recording.camera.width_px, height_px: recording.camera.height_px, background_dn: 0.0, noise_dn: 0.0, stars }
}

/// Electrons per DN in which listed electrons are written as DN.
pub(crate) fn gain_e_per_dn(recording: &Recording) -> f64 {
    recording.camera.gain_e_per_dn.unwrap_or(1.0)
}

fn covariance(star: &ListedStar) -> [f64; 3] {
    star.covariance_px2.unwrap_or([DEFAULT_SIGMA_PX * DEFAULT_SIGMA_PX, 0.0, DEFAULT_SIGMA_PX * DEFAULT_SIGMA_PX])
}

fn detection(recording: &Recording, star: &ListedStar) -> Detection {
    let from_magnitude = |magnitude: f64| 10.0_f64.powf(-0.4 * (magnitude - 10.0));
    let flux = star.flux_e.or_else(|| star.magnitude.map(from_magnitude)).unwrap_or(1.0);
    let flux_dn = flux / gain_e_per_dn(recording);
    Detection {
        x_px: star.x_px,
        y_px: star.y_px,
        covariance_px2: covariance(star),
        flux_dn,
        // Nothing is said of it; a star on a list stands well above the noise.
        flux_sigma_dn: 0.05 * flux_dn,
        background_dn: 0.0,
        background_gradient_dn: [0.0; 2],
        width_px: 1.0,
        chi2_per_dof: 1.0,
        peak_dn: flux_dn,
        flags: Flags::default(),
    }
}

/// The control points that a list names itself (`hip`, or `ra_deg` and `dec_deg`), with no identification of ours.
/// Also returns the numbers that the catalogue does not hold.
pub(crate) fn listed_control_points(
    points: &mut ControlPoints,
    frame: usize,
    stars: &[ListedStar],
    catalog: &Catalog,
    sky: &SkyChain,
) -> Vec<u32> {
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
            covariance_px2: covariance(listed),
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
