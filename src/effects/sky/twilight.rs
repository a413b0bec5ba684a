//! # Twilight
//!
//! ## What it does
//!
//! Sunlight scattered by the air: in twilight from a Sun below the horizon, brightest on its side of the sky, and by day.
//!
//! ## Equation
//!
//! The smaller of two: twilight, 10^(−0.4·(m_sun − m_0 + 32.5 − h − Z/(360°·k)))·(100°/ρ)·(1 − 10^(−0.4·k·X(Z))), and daylight,
//! 10^(−0.4·(m_sun − m_0 + 43.27))·(f(ρ)·c + 440000·(1 − c))·(1 − 10^(−0.4·k·X(Z))), c = 10^(−0.4·k·X(Z_sun)), f(ρ) = 6.2e7·ρ⁻² + 10^(6.15 − ρ/40°) +
//! 10^5.36·(1.06 + cos²ρ), both over 1.11e-15 in nanolamberts. h is the Sun's altitude, ρ the angle from it, in degrees; m_sun = −26.74,
//! m_0 = −11.05; Z the zenith distance, k the extinction, X = 1/(cos Z + 0.025·exp(−11·cos Z)), 40 below the horizon.
//!
//! ## Parameters
//!
//! `relative`: the brightness over that of the model.
//!
//! ## Signature
//!
//! Nothing in the places of the stars; photon noise, and a gradient towards the azimuth of the Sun.
//!
//! ## Confused with
//!
//! Stray light of the Earth's limb, moonlight (it does not fade within the hour).
//!
//! ## Neglected
//!
//! Colour, the Earth's shadow rising in the east, clouds, dust in the high air. Below −18° of the Sun's altitude it goes on to fall,
//! by a magnitude each degree, to nothing.
//!
//! ## Source
//!
//! B. E. Schaefer, "Astronomy and the limits of vision", Vistas in Astronomy 36, 311 (1993), and "To the visual limits", Sky & Telescope 95 (5),
//! 57 (1998), lines 2210 to 2350 of its programme.

use super::glow::{Circumstances, NANOLAMBERT, Needs, RELATIVE, SkyGlow};
use crate::dual::dot;
use crate::effects::ParameterSpec;
use crate::units::DEG_RAD;

/// Sunlight in the air.
#[derive(Clone, Copy, Debug)]
pub struct Twilight;

/// V magnitude of the Sun less the constant of the programme.
const SUN_MAGNITUDE: f64 = -26.74 + 11.05;
/// The programme's unit in nanolamberts.
const UNIT_NANOLAMBERTS: f64 = 1.0 / 1.11e-15;
/// Radius round the Sun's middle within which the brightness does not rise any more.
const NEAREST_DEG: f64 = 0.5;

fn air_mass(cos_zenith_distance: f64) -> f64 {
    if cos_zenith_distance < 0.0 { 40.0 } else { 1.0 / (cos_zenith_distance + 0.025 * (-11.0 * cos_zenith_distance).exp()) }
}

/// In the programme's unit.
fn sunlight(zenith_deg: f64, sun_altitude_deg: f64, apart_deg: f64, extinction: f64) -> f64 {
    let power = |magnitudes: f64| 10.0_f64.powf(-0.4 * magnitudes);
    let scattered = 1.0 - power(extinction * air_mass((zenith_deg * DEG_RAD).cos()));
    // An extinction of nothing scatters nothing; the quotient must not become infinite on the way.
    let slant = zenith_deg / (360.0 * extinction.max(0.05));
    let twilight = power(SUN_MAGNITUDE + 32.5 - sun_altitude_deg - slant) * 100.0 / apart_deg;
    let direct = power(extinction * air_mass((sun_altitude_deg * DEG_RAD).sin()));
    let rayleigh = 10.0_f64.powf(5.36) * (1.06 + (apart_deg * DEG_RAD).cos().powi(2));
    let forward = 6.2e7 / (apart_deg * apart_deg) + 10.0_f64.powf(6.15 - apart_deg / 40.0) + rayleigh;
    let day = power(SUN_MAGNITUDE + 43.27) * (forward * direct + 440_000.0 * (1.0 - direct));
    twilight.min(day) * scattered
}

impl SkyGlow for Twilight {
    fn id(&self) -> &'static str {
        "twilight"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[RELATIVE]
    }
    fn needs(&self) -> Needs {
        Needs::Site
    }
    fn brightness(&self, parameters: &[f64], direction: [f64; 3], circumstances: &Circumstances) -> f64 {
        let (Some(sun), Some(zenith), Some(cosine)) =
            (circumstances.sun, circumstances.zenith, circumstances.cos_zenith_distance(direction))
        else {
            return 0.0;
        };
        let altitude_deg = dot(sun, zenith).clamp(-1.0, 1.0).asin() / DEG_RAD;
        let apart_deg = dot(direction, sun).clamp(-1.0, 1.0).acos() / DEG_RAD;
        let light = sunlight(cosine.acos() / DEG_RAD, altitude_deg, apart_deg.max(NEAREST_DEG), circumstances.extinction_mag_per_airmass);
        parameters[0] * light * UNIT_NANOLAMBERTS * NANOLAMBERT
    }
    fn source(&self) -> &'static str {
        page_source!("twilight.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn magnitude(zenith_deg: f64, sun_altitude_deg: f64, apart_deg: f64, extinction: f64) -> f64 {
        -2.5 * (sunlight(zenith_deg, sun_altitude_deg, apart_deg, extinction) * UNIT_NANOLAMBERTS * NANOLAMBERT).log10()
    }

    /// Another implementation of the same programme, in radians and with its constants multiplied out (Stellarium's `Skybright`, evaluated in
    /// Python): zenith distance, the Sun's altitude, their angle, extinction and V magnitude per square arcsecond; the last but one by day.
    #[test]
    fn agrees_with_another_implementation() {
        for [zenith_deg, sun_altitude_deg, apart_deg, extinction, expected] in [
            [0.0, -6.0, 96.0, 0.2, 13.645_385],
            [0.0, -12.0, 102.0, 0.2, 19.711_168],
            [60.0, -9.0, 39.0, 0.2, 14.177_041],
            [60.0, -9.0, 159.0, 0.2, 15.702_863],
            [80.0, -15.0, 100.0, 0.15, 19.939_720],
            [30.0, 20.0, 60.0, 0.2, 4.328_611],
            [45.0, -18.0, 90.0, 0.172, 24.656_865],
        ] {
            let found = magnitude(zenith_deg, sun_altitude_deg, apart_deg, extinction);
            assert!((found - expected).abs() < 2e-3, "{found} for {expected}");
        }
    }

    #[test]
    fn it_is_brightest_on_the_side_of_the_sun() {
        let (sine, cosine) = (-9.0 * DEG_RAD).sin_cos();
        let circumstances = Circumstances {
            sun: Some([cosine, 0.0, sine]),
            zenith: Some([0.0, 0.0, 1.0]),
            extinction_mag_per_airmass: 0.172,
            ..Circumstances::default()
        };
        let at = |azimuth_deg: f64| {
            let (y, x) = (azimuth_deg * DEG_RAD).sin_cos();
            let (height, along) = (30.0 * DEG_RAD).sin_cos();
            Twilight.brightness(&[1.0], [along * x, along * y, height], &circumstances)
        };
        let ring: Vec<f64> = (0..=18).map(|step| at(10.0 * f64::from(step))).collect();
        assert!(ring.windows(2).all(|pair| pair[1] < pair[0]), "{ring:?}");
        assert!(at(0.0) > 3.0 * at(180.0));
    }
}
