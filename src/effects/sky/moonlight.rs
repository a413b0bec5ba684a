//! # Moonlight
//!
//! ## What it does
//!
//! Moonlight scattered by the air: of a clear night with a full Moon it makes one that is twenty to a hundred times as bright.
//!
//! ## Equation
//!
//! B = f(ρ)·I·10^(−0.4·k·X(Z_moon))·(1 − 10^(−0.4·k·X(Z))) nanolamberts, I = 10^(−0.4·(3.84 + 0.026·α + 4e-9·α⁴)), f(ρ) =
//! 10^5.36·(1.06 + cos²ρ) + 10^(6.15 − ρ/40°), near the Moon 6.2e7·ρ⁻² in the place of the last term. ρ is the angle from the Moon, α its phase
//! angle, both in degrees; Z are zenith distances, k the extinction, X = (1 − 0.96·sin²Z)^(−1/2).
//!
//! ## Parameters
//!
//! `relative`: the brightness over that of the model.
//!
//! ## Signature
//!
//! Nothing in the places of the stars; photon noise, and a gradient towards the Moon.
//!
//! ## Confused with
//!
//! Stray light of the Moon in the lens, which follows the angle from the camera's axis.
//!
//! ## Neglected
//!
//! The Moon's disc itself (within 0.5° of its middle the brightness is that at 0.5°), its distance, its light below the horizon, clouds,
//! the colour. The model is good to 8 … 23 % (the paper's section 4). The change between the laws of the small-angle term is made
//! where they meet, at 8.4°, in the place of the paper's 10°: there is no step.
//!
//! ## Source
//!
//! K. Krisciunas, B. E. Schaefer, "A model of the brightness of moonlight", PASP 103, 1033 (1991), equations 3, 15, 20 and 21.

use super::glow::{Circumstances, NANOLAMBERT, Needs, RELATIVE, SkyGlow, scattering_air_mass};
use crate::dual::dot;
use crate::effects::ParameterSpec;
use crate::units::DEG_RAD;

/// Moonlight in the air.
#[derive(Clone, Copy, Debug)]
pub struct Moonlight;

/// Radius round the Moon's middle within which the brightness does not rise any more.
const NEAREST_DEG: f64 = 0.5;
/// Where the two laws of the small-angle term meet.
const MEET_DEG: f64 = 8.449_7;

/// How much light is scattered by an angle.
fn scattering(angle_deg: f64) -> f64 {
    let angle_deg = angle_deg.max(NEAREST_DEG);
    let rayleigh = 10.0_f64.powf(5.36) * (1.06 + (angle_deg * DEG_RAD).cos().powi(2));
    let small_angle = if angle_deg < MEET_DEG { 6.2e7 / (angle_deg * angle_deg) } else { 10.0_f64.powf(6.15 - angle_deg / 40.0) };
    rayleigh + small_angle
}

impl SkyGlow for Moonlight {
    fn id(&self) -> &'static str {
        "moonlight"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[RELATIVE]
    }
    fn needs(&self) -> Needs {
        Needs::Site
    }
    fn brightness(&self, parameters: &[f64], direction: [f64; 3], circumstances: &Circumstances) -> f64 {
        let (Some(moon), Some(zenith), Some(cosine)) =
            (circumstances.moon, circumstances.zenith, circumstances.cos_zenith_distance(direction))
        else {
            return 0.0;
        };
        let cos_moon = dot(moon.direction, zenith);
        if cos_moon < 0.0 {
            return 0.0;
        }
        let phase_deg = moon.phase_angle_rad / DEG_RAD;
        let illuminance = 10.0_f64.powf(-0.4 * (3.84 + 0.026 * phase_deg + 4e-9 * phase_deg.powi(4)));
        let through = |cosine: f64| 10.0_f64.powf(-0.4 * circumstances.extinction_mag_per_airmass * scattering_air_mass(cosine));
        let angle_deg = dot(direction, moon.direction).clamp(-1.0, 1.0).acos() / DEG_RAD;
        parameters[0] * NANOLAMBERT * scattering(angle_deg) * illuminance * through(cos_moon) * (1.0 - through(cosine))
    }
    fn source(&self) -> &'static str {
        page_source!("moonlight.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::super::glow::Moon;
    use super::*;

    /// Values of the function `krisciunas_schaefer` of specsim 1.0.0 (another implementation of the paper's equations): zenith distances of the view
    /// and of the Moon, their angle, the phase angle (degrees), extinction and V magnitude per square arcsecond.
    #[test]
    fn agrees_with_another_implementation() {
        for [view_deg, moon_deg, apart_deg, phase_deg, extinction, magnitude] in [
            [20.0, 70.0, 50.0, 45.0, 0.15, 19.854_844],
            [30.0, 40.0, 60.0, 0.0, 0.172, 18.497_432],
            [60.0, 30.0, 45.0, 20.0, 0.172, 18.192_359],
            [75.0, 60.0, 90.0, 90.0, 0.25, 20.479_332],
            [45.0, 80.0, 120.0, 5.0, 0.12, 19.178_398],
            [50.0, 45.0, 12.0, 0.0, 0.172, 16.917_471],
        ] {
            let circumstances = circumstances(moon_deg, phase_deg, extinction);
            let direction = apart(view_deg, moon_deg, apart_deg);
            let brightness = -2.5 * Moonlight.brightness(&[1.0], direction, &circumstances).log10();
            assert!((brightness - magnitude).abs() < 1e-4, "{brightness} for {magnitude}");
        }
    }

    fn circumstances(moon_deg: f64, phase_deg: f64, extinction_mag_per_airmass: f64) -> Circumstances {
        let (sine, cosine) = (moon_deg * DEG_RAD).sin_cos();
        let moon = Moon { direction: [sine, 0.0, cosine], phase_angle_rad: phase_deg * DEG_RAD };
        Circumstances { moon: Some(moon), zenith: Some([0.0, 0.0, 1.0]), extinction_mag_per_airmass, ..Circumstances::default() }
    }

    /// A direction at a zenith distance and an angle from the Moon, which stands over the x axis.
    fn apart(view_deg: f64, moon_deg: f64, apart_deg: f64) -> [f64; 3] {
        let [(sin_z, cos_z), (sin_m, cos_m)] = [view_deg, moon_deg].map(|angle| (angle * DEG_RAD).sin_cos());
        let cos_azimuth = ((apart_deg * DEG_RAD).cos() - cos_z * cos_m) / (sin_z * sin_m);
        [sin_z * cos_azimuth, sin_z * (1.0 - cos_azimuth * cos_azimuth).sqrt(), cos_z]
    }

    #[test]
    fn the_law_has_no_step() {
        for angle_deg in [NEAREST_DEG, MEET_DEG] {
            assert!((scattering(angle_deg + 1e-6) / scattering(angle_deg - 1e-6) - 1.0).abs() < 1e-4, "at {angle_deg}°");
        }
    }

    #[test]
    fn a_moon_below_the_horizon_gives_no_light() {
        assert_eq!(Moonlight.brightness(&[1.0], [0.0, 0.0, 1.0], &circumstances(91.0, 0.0, 0.172)), 0.0);
        assert!(Moonlight.brightness(&[1.0], [0.0, 0.0, 1.0], &circumstances(89.0, 0.0, 0.172)) > 0.0);
    }
}
