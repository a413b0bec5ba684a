//! # Starlight of unseen stars
//!
//! ## What it does
//!
//! The light of all stars that are too faint to be rendered one by one: the Milky Way and what lies beside it.
//!
//! ## Equation
//!
//! ∫ 10^(−0.4·m) dN(m) from the scene's faintest magnitude on; N(m, l, b), the stars per square degree brighter than V = m in galactic
//! longitude and latitude, is the sum of a disc and a spheroid:
//!
//! ```text
//! 925·10^(0.035·d) / (1 + 10^(−0.132·d))³ · [sin b·(1 − µ·cot b·cos l)]^(5γ − 3)             d = m − 15.75
//! 1050·10^(0.087·e) / (1 + 10^(−0.180·e))^2.5 · (1 − cos b·cos l)^−σ                        e = m − 17.5
//! ```
//! µ goes from 0.03 (m ≤ 12) to 0.09 (m ≥ 20), γ from 0.36 to 0.04; σ = 1.45 − 0.20·cos b·cos l. From the ground it is weakened by the extinction.
//!
//! ## Parameters
//!
//! `relative`: the brightness over that of the model.
//!
//! ## Signature
//!
//! Nothing in the places of the stars; photon noise, and the Milky Way.
//!
//! ## Confused with
//!
//! Zodiacal light, which moves with the Sun.
//!
//! ## Neglected
//!
//! Dust clouds and all structure; starlight scattered by dust (a fifth more); faint stars that make the background
//! uneven. The law is fitted for |b| ≥ 20° (counts to 15 %). Nearer to the galactic equator the light at |b| = 12° stands in its place, which
//! is right to a factor of two. Stars brighter than V = 5 are never in it.
//!
//! ## Source
//!
//! J. N. Bahcall, R. M. Soneira, ApJS 44, 73 (1980), appendix B.

use super::glow::{Circumstances, Needs, RELATIVE, S10, SkyGlow};
use crate::dual::dot;
use crate::effects::ParameterSpec;
use crate::units::DEG_RAD;

/// The light of faint stars.
#[derive(Clone, Copy, Debug)]
pub struct Starlight;

/// The galactic axes in ICRS components: to the centre and to the north pole (The Hipparcos and Tycho Catalogues, ESA SP-1200, volume 1, 1.5.11).
const CENTRE: [f64; 3] = [-0.054_875_560_4, -0.873_437_090_2, -0.483_835_015_5];
const POLE: [f64; 3] = [-0.867_666_149_0, -0.198_076_373_4, 0.455_983_776_2];
/// Latitude below which the light does not rise any more.
const LOWEST_LATITUDE_DEG: f64 = 12.0;
/// Magnitudes between which the law holds, or beyond which there is no light.
const BRIGHTEST: f64 = 5.0;
const FAINTEST: f64 = 25.0;

/// Stars per square degree brighter than V = m; `sin_b` above 0, `toward_centre` = cos b · cos l.
fn counts(m: f64, sin_b: f64, toward_centre: f64) -> f64 {
    let along = ((m - 12.0) / 8.0).clamp(0.0, 1.0);
    let (mu, gamma) = (0.03 + 0.06 * along, 0.36 - 0.32 * along);
    let power = |exponent: f64| 10.0_f64.powf(exponent);
    let (d, e) = (m - 15.75, m - 17.5);
    let disc = 925.0 * power(0.035 * d) / (1.0 + power(-0.132 * d)).powi(3) * (sin_b - mu * toward_centre).powf(5.0 * gamma - 3.0);
    let sigma = 1.45 - 0.20 * toward_centre;
    let spheroid = 1050.0 * power(0.087 * e) / (1.0 + power(-0.180 * e)).powf(2.5) * (1.0 - toward_centre).powf(-sigma);
    disc + spheroid
}

/// Light of the stars fainter than a magnitude, S10. By parts: −N(m)·10^(−0.4·m) and 0.4·ln 10·∫ N·10^(−0.4·m) dm, with Simpson's rule.
fn light_s10(faintest: f64, sin_b: f64, toward_centre: f64) -> f64 {
    const STEP: f64 = 1.0;
    let from = faintest.max(BRIGHTEST);
    if from >= FAINTEST {
        return 0.0;
    }
    let steps = 2 * ((FAINTEST - from) / (2.0 * STEP)).ceil().max(1.0) as u32;
    let step = (FAINTEST - from) / f64::from(steps);
    let at = |index: u32| {
        let m = from + f64::from(index) * step;
        counts(m, sin_b, toward_centre) * 10.0_f64.powf(-0.4 * (m - 10.0))
    };
    let (first, last) = (at(0), at(steps));
    let between: f64 = (1..steps).map(|index| f64::from(2 + 2 * (index % 2)) * at(index)).sum();
    last - first + 0.4 * std::f64::consts::LN_10 * step / 3.0 * (first + between + last)
}

impl SkyGlow for Starlight {
    fn id(&self) -> &'static str {
        "starlight"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[RELATIVE]
    }
    fn needs(&self) -> Needs {
        Needs::Nothing
    }
    fn brightness(&self, parameters: &[f64], direction: [f64; 3], circumstances: &Circumstances) -> f64 {
        let (sin_lowest, cos_lowest) = (LOWEST_LATITUDE_DEG * DEG_RAD).sin_cos();
        let sin_b = dot(direction, POLE).abs();
        let mut toward_centre = dot(direction, CENTRE);
        if sin_b < sin_lowest {
            // The longitude stays.
            toward_centre *= cos_lowest / (1.0 - sin_b * sin_b).sqrt();
        }
        let light = light_s10(circumstances.faintest_magnitude, sin_b.clamp(sin_lowest, 1.0), toward_centre);
        parameters[0] * light * S10 * circumstances.transmission(direction)
    }
    fn source(&self) -> &'static str {
        page_source!("starlight.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(longitude_deg: f64, latitude_deg: f64) -> (f64, f64) {
        let (sin_b, cos_b) = (latitude_deg * DEG_RAD).sin_cos();
        (sin_b, cos_b * (longitude_deg * DEG_RAD).cos())
    }

    /// Counts and light of the published law, from another implementation of equation B1 (Python) and a sum over steps of 0.002 mag.
    #[test]
    fn agrees_with_another_implementation() {
        for (longitude, latitude, m, expected) in [
            (90.0, 90.0, 10.0, 1.988_065_8),
            (90.0, 20.0, 15.0, 545.410_41),
            (0.0, 50.0, 18.0, 1_743.599_4),
            (90.0, 30.0, 22.0, 8_820.762_7),
        ] {
            let (sin_b, toward_centre) = places(longitude, latitude);
            assert!((counts(m, sin_b, toward_centre) / expected - 1.0).abs() < 1e-6);
        }
        for (faintest, longitude, latitude, expected) in
            [(5.0, 90.0, 90.0, 17.059_98), (9.0, 30.0, 20.0, 69.946_77), (9.0, 180.0, 40.0, 14.669_40), (12.3, 60.0, 30.0, 15.498_23)]
        {
            let (sin_b, toward_centre) = places(longitude, latitude);
            let found = light_s10(faintest, sin_b, toward_centre);
            assert!((found / expected - 1.0).abs() < 2e-3, "{found} for {expected}");
        }
    }

    /// Counts of the Tycho-2 and UCAC4 catalogues over the whole sky (H. Kleijn, hnsky.com): 9.28 stars per square degree brighter than 10, of
    /// which the law, averaged over the sky with its lowest latitude, must have as many within a third.
    #[test]
    fn the_whole_sky_has_as_many_stars_as_catalogues_have() {
        let (mut sum, mut weight) = (0.0, 0.0);
        for longitude in (0..360).step_by(10) {
            for step in 0..90 {
                let latitude = (f64::from(step) + 0.5).max(LOWEST_LATITUDE_DEG);
                let area = ((f64::from(step) + 0.5) * DEG_RAD).cos();
                let (sin_b, toward_centre) = places(f64::from(longitude), latitude);
                sum += area * counts(10.0, sin_b, toward_centre);
                weight += area;
            }
        }
        assert!((sum / weight / 9.28 - 1.0).abs() < 0.35, "{}", sum / weight);
    }

    #[test]
    fn the_axes_are_the_galactic_ones() {
        for direction in [[0.36, -0.48, 0.8], [-0.6, 0.0, -0.8], [0.0, 1.0, 0.0]] {
            let (l, b) = sofars::coords::icrs2g(f64::atan2(direction[1], direction[0]), f64::asin(direction[2]));
            assert!((dot(direction, POLE) - b.sin()).abs() < 1e-9 && (dot(direction, CENTRE) - b.cos() * l.cos()).abs() < 1e-9);
        }
    }

    #[test]
    fn stars_that_are_rendered_are_left_out() {
        let light = |faintest_magnitude: f64| {
            let circumstances = Circumstances { faintest_magnitude, ..Circumstances::default() };
            Starlight.brightness(&[1.0], POLE, &circumstances) / S10
        };
        assert!(light(5.0) > light(9.0) && light(9.0) > light(14.0) && light(26.0) == 0.0);
        assert_eq!(light(2.0), light(5.0));
    }
}
