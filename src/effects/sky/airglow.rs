//! # Airglow
//!
//! ## What it does
//!
//! The dark sky over a site on the ground: the glow of the upper air, and what else its zenith has that is not modelled apart (lights of
//! towns, for want of their places).
//!
//! ## Equation
//!
//! B(Z) = B_zenith·X·10^(−0.4·k·(X − 1)), X = (1 − 0.96·sin²Z)^(−1/2), Z the zenith distance, k the extinction: a glowing shell is seen
//! at a slant towards the horizon (van Rhijn), through more air.
//!
//! ## Parameters
//!
//! `zenith_mag_arcsec2`: V magnitude of a square arcsecond at the zenith; about 22 under a dark sky, where zodiacal light and faint
//! stars give another third, 18 in a town.
//!
//! ## Signature
//!
//! Nothing in the places of the stars; photon noise, and in wide fields a background that rises towards the horizon.
//!
//! ## Confused with
//!
//! Zodiacal light and starlight, which turn with the sky; a flat field.
//!
//! ## Neglected
//!
//! Its waves and its changes with hours and with the activity of the Sun (a factor of two), the colour, the side on which a town lies.
//!
//! ## Source
//!
//! K. Krisciunas, B. E. Schaefer, PASP 103, 1033 (1991), equations 2 and 3; R. H. Garstang, PASP 101, 306 (1989).

use super::glow::{Circumstances, Needs, SkyGlow, scattering_air_mass};
use crate::effects::ParameterSpec;

/// The glow of the upper air.
#[derive(Clone, Copy, Debug)]
pub struct Airglow;

impl SkyGlow for Airglow {
    fn id(&self) -> &'static str {
        "airglow"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[ParameterSpec { name: "zenith_mag_arcsec2", unit: "mag/arcsec²", typical: 22.0, range: (0.0, 40.0) }]
    }
    fn needs(&self) -> Needs {
        Needs::Site
    }
    fn brightness(&self, parameters: &[f64], direction: [f64; 3], circumstances: &Circumstances) -> f64 {
        let Some(cosine) = circumstances.cos_zenith_distance(direction) else { return 0.0 };
        let slant = scattering_air_mass(cosine);
        10.0_f64.powf(-0.4 * (parameters[0] + circumstances.extinction_mag_per_airmass * (slant - 1.0))) * slant
    }
    fn source(&self) -> &'static str {
        page_source!("airglow.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::DEG_RAD;

    #[test]
    fn the_sky_is_brightest_between_zenith_and_horizon() {
        let circumstances = Circumstances { zenith: Some([0.0, 0.0, 1.0]), extinction_mag_per_airmass: 0.172, ..Circumstances::default() };
        let at = |zenith_deg: f64| {
            let (sine, cosine) = (zenith_deg * DEG_RAD).sin_cos();
            -2.5 * Airglow.brightness(&[21.587], [sine, 0.0, cosine], &circumstances).log10()
        };
        assert!((at(0.0) - 21.587).abs() < 1e-12);
        // By hand: X(60°) = 1/√0.28 = 1.889822, brighter by 2.5·lg X = 0.691052 and fainter by 0.172·0.889822 = 0.153049 mag.
        assert!((at(60.0) - (21.587 - 0.691_052 + 0.153_049)).abs() < 2e-6, "{}", at(60.0));
        assert!(at(60.0) < at(30.0));
    }
}
