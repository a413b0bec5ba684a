//! Star lists in the place of images: the measurements of a flight unit, in the terms of the stages that follow.

use crate::detect::{Detection, Detections, Flags};
use crate::identify::listed_covariance_px2;
use crate::recording::{ListedStar, Recording};
use crate::statistics::order::descending;

/// The listed stars of a frame as detections, brightest first where the list tells brightness.
pub(super) fn detections(recording: &Recording, stars: &[ListedStar]) -> Detections {
    let mut stars: Vec<Detection> = stars.iter().map(|star| detection(recording, star)).collect();
    descending(&mut stars, |a| a.flux_dn);
    Detections { width_px: recording.camera.width_px, height_px: recording.camera.height_px, background_dn: 0.0, noise_dn: 0.0, stars }
}

/// Electrons per DN in which listed electrons are written as DN.
pub(super) fn gain_e_per_dn(recording: &Recording) -> f64 {
    recording.camera.gain_e_per_dn.unwrap_or(1.0)
}

fn detection(recording: &Recording, star: &ListedStar) -> Detection {
    let from_magnitude = |magnitude: f64| 10.0_f64.powf(-0.4 * (magnitude - 10.0));
    let flux = star.flux_e.or_else(|| star.magnitude.map(from_magnitude)).unwrap_or(1.0);
    let flux_dn = flux / gain_e_per_dn(recording);
    Detection {
        x_px: star.x_px,
        y_px: star.y_px,
        covariance_px2: listed_covariance_px2(star),
        flux_dn,
        // Nothing is said of it; a star on a list stands well above the noise.
        flux_sigma_dn: 0.05 * flux_dn,
        background_dn: 0.0,
        background_gradient_dn: [0.0; 2],
        width_px: 1.0,
        moments: None,
        chi2_per_dof: 1.0,
        peak_dn: flux_dn,
        flags: Flags::default(),
    }
}
