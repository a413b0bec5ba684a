//! # Zodiacal light
//!
//! ## What it does
//!
//! Sunlight scattered by dust between the planets: brightest towards the Sun, along the ecliptic, with a weak counterglow opposite the Sun.
//!
//! ## Equation
//!
//! A table of the brightness at 0.5 µm over the difference of ecliptic longitude from the Sun's and the ecliptic latitude, 1e-8 W m⁻² sr⁻¹ µm⁻¹,
//! whose logarithm is interpolated evenly between its nodes; 1.28 of these are one star like the Sun of V = 10 per square degree. From the
//! ground it is weakened by the extinction of the air.
//!
//! ## Parameters
//!
//! `relative`: the brightness over that of the table.
//!
//! ## Signature
//!
//! Nothing in the places of the stars; photon noise, and a gradient under wide fields near the ecliptic.
//!
//! ## Confused with
//!
//! Airglow, whose brightness follows the zenith; the Milky Way, which stays with the stars.
//!
//! ## Neglected
//!
//! Its colour (redder than the Sun within 30° of it), the Earth's distance from the Sun (±4 %), the tilt of the dust's plane against the
//! ecliptic (10 % in the course of a year), light that the air scatters back into the view. Within 15° of the Sun, where the table ends, it holds
//! the value at the table's edge: there it is fainter than the truth.
//!
//! ## Source
//!
//! Ch. Leinert et al., "The 1997 reference of diffuse night sky brightness", A&AS 127, 1 (1998), table 17 and section 8.

use super::glow::{Circumstances, Needs, RELATIVE, S10, SkyGlow};
use crate::dual::dot;
use crate::effects::ParameterSpec;
use crate::units::DEG_RAD;

/// Sunlight scattered by dust.
#[derive(Clone, Copy, Debug)]
pub struct ZodiacalLight;

/// Differences of ecliptic longitude of the table's rows.
const LONGITUDES_DEG: [f64; 19] =
    [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0, 135.0, 150.0, 165.0, 180.0];
/// Ecliptic latitudes of its columns.
const LATITUDES_DEG: [f64; 11] = [0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 45.0, 60.0, 75.0, 90.0];
/// Brightness, 1e-8 W m⁻² sr⁻¹ µm⁻¹. The eight entries next to the Sun are blank in the paper; they repeat the first one that is not, to the right in
/// the row or downwards in the column.
const TABLE: [[f64; 11]; 19] = [
    [11500.0, 6780.0, 4740.0, 3140.0, 1610.0, 985.0, 640.0, 275.0, 150.0, 100.0, 77.0],
    [11500.0, 6780.0, 4740.0, 2940.0, 1540.0, 945.0, 625.0, 271.0, 150.0, 100.0, 77.0],
    [11500.0, 6780.0, 4740.0, 2470.0, 1370.0, 865.0, 590.0, 264.0, 148.0, 100.0, 77.0],
    [11500.0, 6780.0, 3440.0, 1860.0, 1110.0, 755.0, 525.0, 251.0, 146.0, 100.0, 77.0],
    [6400.0, 4480.0, 2410.0, 1410.0, 910.0, 635.0, 454.0, 237.0, 141.0, 99.0, 77.0],
    [3840.0, 2830.0, 1730.0, 1100.0, 749.0, 545.0, 410.0, 223.0, 136.0, 97.0, 77.0],
    [2480.0, 1870.0, 1220.0, 845.0, 615.0, 467.0, 365.0, 207.0, 131.0, 95.0, 77.0],
    [1650.0, 1270.0, 910.0, 680.0, 510.0, 397.0, 320.0, 193.0, 125.0, 93.0, 77.0],
    [1180.0, 940.0, 700.0, 530.0, 416.0, 338.0, 282.0, 179.0, 120.0, 92.0, 77.0],
    [910.0, 730.0, 555.0, 442.0, 356.0, 292.0, 250.0, 166.0, 116.0, 90.0, 77.0],
    [505.0, 442.0, 352.0, 292.0, 243.0, 209.0, 183.0, 134.0, 104.0, 86.0, 77.0],
    [338.0, 317.0, 269.0, 227.0, 196.0, 172.0, 151.0, 116.0, 93.0, 82.0, 77.0],
    [259.0, 251.0, 225.0, 193.0, 166.0, 147.0, 132.0, 104.0, 86.0, 79.0, 77.0],
    [212.0, 210.0, 197.0, 170.0, 150.0, 133.0, 119.0, 96.0, 82.0, 77.0, 77.0],
    [188.0, 186.0, 177.0, 154.0, 138.0, 125.0, 113.0, 90.0, 77.0, 74.0, 77.0],
    [179.0, 178.0, 166.0, 147.0, 134.0, 122.0, 110.0, 90.0, 77.0, 73.0, 77.0],
    [179.0, 178.0, 165.0, 148.0, 137.0, 127.0, 116.0, 96.0, 79.0, 72.0, 77.0],
    [196.0, 192.0, 179.0, 165.0, 151.0, 141.0, 131.0, 104.0, 82.0, 72.0, 77.0],
    [230.0, 212.0, 195.0, 178.0, 163.0, 148.0, 134.0, 105.0, 83.0, 72.0, 77.0],
];
/// Units of the table in a star like the Sun of the tenth magnitude per square degree.
const PER_S10: f64 = 1.28;
/// Obliquity of the ecliptic at J2000.0, arcseconds (IAU 2006).
const OBLIQUITY_ARCSEC: f64 = 84_381.406;

/// The table at a difference of longitude (0 … 180) and a latitude (0 … 90).
fn table_at(longitude_deg: f64, latitude_deg: f64) -> f64 {
    let (row, down) = place(&LONGITUDES_DEG, longitude_deg);
    let (column, right) = place(&LATITUDES_DEG, latitude_deg);
    let along = |row: usize| TABLE[row][column].ln() * (1.0 - right) + TABLE[row][column + 1].ln() * right;
    (along(row) * (1.0 - down) + along(row + 1) * down).exp()
}

/// Between which nodes a value lies, and how far on the way from the first to the second.
fn place(nodes: &[f64], value: f64) -> (usize, f64) {
    let first = nodes.iter().rposition(|node| *node <= value).unwrap_or(0).min(nodes.len() - 2);
    (first, ((value - nodes[first]) / (nodes[first + 1] - nodes[first])).clamp(0.0, 1.0))
}

/// Ecliptic longitude and latitude (J2000.0), rad.
fn ecliptic_rad(direction: [f64; 3]) -> [f64; 2] {
    let (sine, cosine) = (OBLIQUITY_ARCSEC / 3600.0 * DEG_RAD).sin_cos();
    let [x, y, z] = [direction[0], dot(direction, [0.0, cosine, sine]), dot(direction, [0.0, -sine, cosine])];
    [y.atan2(x), z.clamp(-1.0, 1.0).asin()]
}

impl SkyGlow for ZodiacalLight {
    fn id(&self) -> &'static str {
        "zodiacal-light"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[RELATIVE]
    }
    fn needs(&self) -> Needs {
        Needs::Time
    }
    fn brightness(&self, parameters: &[f64], direction: [f64; 3], circumstances: &Circumstances) -> f64 {
        let Some(sun) = circumstances.sun else { return 0.0 };
        let ([longitude, latitude], [sun_longitude, _]) = (ecliptic_rad(direction), ecliptic_rad(sun));
        let difference = (longitude - sun_longitude).cos().clamp(-1.0, 1.0).acos();
        let table = table_at(difference / DEG_RAD, latitude.abs() / DEG_RAD);
        parameters[0] * table / PER_S10 * S10 * circumstances.transmission(direction)
    }
    fn source(&self) -> &'static str {
        page_source!("zodiacal_light.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A direction by ecliptic longitude and latitude, degrees.
    fn ecliptic(longitude_deg: f64, latitude_deg: f64) -> [f64; 3] {
        let [(sin_l, cos_l), (sin_b, cos_b)] = [longitude_deg, latitude_deg].map(|angle| (angle * DEG_RAD).sin_cos());
        let (sine, cosine) = (OBLIQUITY_ARCSEC / 3600.0 * DEG_RAD).sin_cos();
        let [x, y, z] = [cos_l * cos_b, sin_l * cos_b, sin_b];
        [x, cosine * y - sine * z, sine * y + cosine * z]
    }

    /// Leinert et al. (1998), table 16: the same sky in S10 as the paper prints it there, rounded to three digits.
    #[test]
    fn agrees_with_the_other_table_of_the_paper() {
        let circumstances = Circumstances { sun: Some(ecliptic(200.0, 0.0)), ..Circumstances::default() };
        for (longitude_deg, latitude_deg, s10) in
            [(0.0, 90.0, 60.0), (180.0, 0.0, 180.0), (90.0, 0.0, 202.0), (60.0, 0.0, 395.0), (30.0, 0.0, 1940.0)]
        {
            for side in [-1.0, 1.0] {
                let direction = ecliptic(200.0 + side * longitude_deg, side * latitude_deg);
                let brightness = ZodiacalLight.brightness(&[1.0], direction, &circumstances) / S10;
                assert!((brightness / s10 - 1.0).abs() < 0.005, "{longitude_deg}° {latitude_deg}°: {brightness} for {s10}");
            }
        }
    }

    #[test]
    fn the_table_is_met_at_its_nodes_and_even_between() {
        for (row, longitude_deg) in LONGITUDES_DEG.iter().enumerate() {
            for (column, latitude_deg) in LATITUDES_DEG.iter().enumerate() {
                assert!((table_at(*longitude_deg, *latitude_deg) / TABLE[row][column] - 1.0).abs() < 1e-12);
            }
        }
        assert!((table_at(97.5, 0.0) - (259.0_f64 * 212.0).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn the_ecliptic_is_that_of_sofa() {
        let direction: [f64; 3] = [0.36, -0.48, 0.8];
        let (ra, dec) = (direction[1].atan2(direction[0]), direction[2].asin());
        let (longitude, latitude) = sofars::coords::eqec06(crate::units::J2000_JD, 0.0, ra, dec);
        let [ours, our_latitude] = ecliptic_rad(direction);
        assert!((ours.rem_euclid(std::f64::consts::TAU) - longitude).abs() < 1e-6 && (our_latitude - latitude).abs() < 1e-6);
    }
}
