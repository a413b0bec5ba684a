//! Systematic errors of the focal length by effects of the sky that a calibration does not model.
//!
//! The angles between stars determine the focal length, and two effects change all of them alike, so that no residual shows it:
//!
//! **Refraction.** The air lifts stars by R₄₅·tan z. An angle is smaller in the light that arrives by R₄₅ along the horizon and by
//! R₄₅·sec² z along the vertical; the mean of the two goes into the scale (what they differ by is a stretch of the image, which no focal
//! length takes up). A camera that believes the catalogue's angles is found with
//!
//! ```text
//! Δf/f = −R₄₅·(1 + sec² z)/2        −2.8e-4 at the zenith, −6.9e-4 at z = 60°, at sea level
//! ```
//!
//! **Aberration.** The velocity v of the camera draws all stars towards its apex; around a boresight at the angle ψ from there
//! Δf/f = −(v/c)·cos ψ, at most 1.0e-4 either way for the Earth's own velocity.
//!
//! Where site and time are known both are modelled, and nothing of it is left.

use super::calibration::{Calibration, Systematic};
use crate::effects::displacement;
use crate::effects::ids;
use crate::units::{ARCSEC_RAD, DEG_RAD};

/// Refraction at 45° at sea level (1013.25 hPa, 15 °C, 0.55 µm), rad.
const REFRACTION_AT_45DEG_RAD: f64 = 57.08 * ARCSEC_RAD;
/// The largest zenith distance that a camera on the ground is held to look at with the middle of its frame, rad.
const LOWEST_RAD: f64 = 60.0 * DEG_RAD;
/// The Earth's mean velocity about the Sun over that of light.
const EARTH_OVER_LIGHT: f64 = 29.785 / 299_792.458;
/// What is below this share of a parameter's standard error is not said.
const NOTABLE_SIGMAS: f64 = 1.0;

/// Whether a camera looks through air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surroundings {
    /// It is in space: its recording tells its velocity and no site.
    Space,
    /// It stands on the ground, or may.
    MayBeGround,
}

impl Calibration {
    /// What effects of the sky that this calibration does not model may have done to it, where that is more than the errors stated.
    #[must_use]
    pub fn unmodelled(&self, surroundings: Surroundings) -> Vec<Systematic> {
        let Some(f) = self.parameters.iter().find(|parameter| parameter.name == "f") else { return Vec::new() };
        let in_force = |id: &str| {
            let solved = |name: &str| name.split('.').next() == Some(id);
            self.physics.iter().any(|own| own == id) || self.model.iter().any(|name| solved(name))
        };
        let frames = &self.control_points.frames;
        let could = |id: &str| {
            let known =
                |frame: &crate::identify::FrameState| displacement(id).is_some_and(|effect| effect.predicted(&frame.observation).is_some());
            !frames.is_empty() && frames.iter().all(known)
        };
        // Who leaves out what could be computed knows it.
        let is_open = |id: &str| !in_force(id) && !could(id);
        let mut found = Vec::new();
        if surroundings == Surroundings::MayBeGround && is_open(ids::REFRACTION) {
            let scale = |z_rad: f64| -0.5 * REFRACTION_AT_45DEG_RAD * (1.0 + 1.0 / z_rad.cos().powi(2));
            let range_px = [f.value * scale(LOWEST_RAD), f.value * scale(0.0)];
            found.push(Systematic {
                cause: ids::REFRACTION.to_owned(),
                parameter: "f".to_owned(),
                range_px,
                sentence: format!(
                    "if the camera stands on the ground, refraction that is not modelled makes f too small by {} px (at the zenith, at sea \
                     level) to {} px (30° above the horizon), {} to {} of its standard errors: tell the site and the times of the frames, \
                     or solve for refraction",
                    digits(-range_px[1]),
                    digits(-range_px[0]),
                    digits(-range_px[1] / f.sigma),
                    digits(-range_px[0] / f.sigma)
                ),
            });
        }
        if is_open(ids::STELLAR_ABERRATION) {
            let most = f.value * EARTH_OVER_LIGHT;
            found.push(Systematic {
                cause: ids::STELLAR_ABERRATION.to_owned(),
                parameter: "f".to_owned(),
                range_px: [-most, most],
                sentence: format!(
                    "aberration is not modelled, since the time or the camera's velocity is not known: by the Earth's motion f may be off by up \
                     to ± {} px ({} of its standard errors), by where the frames point",
                    digits(most),
                    digits(most / f.sigma)
                ),
            });
        }
        let largest = |systematic: &Systematic| systematic.range_px.iter().fold(0.0_f64, |most, px| most.max(px.abs()));
        found.retain(|systematic| largest(systematic) > NOTABLE_SIGMAS * f.sigma);
        found
    }
}

/// Two significant digits.
fn digits(value: f64) -> String {
    if value <= 0.0 || !value.is_finite() {
        return "0".to_owned();
    }
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.decimals$}")
}
