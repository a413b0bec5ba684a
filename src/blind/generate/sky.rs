//! The generator's own astronomy, from the textbook equations; nothing of it is shared with the program's effects.

use hifitime::Epoch;
use sofars::{eph, erst, pnp};

use super::vector::{V3, cross, dot, east_and_north, plus, times, turned_back, unit};
use crate::units::{ARCSEC_RAD, AU_KM, DAY_S, DEG_RAD, J2000_JD, JULIAN_YEAR_DAYS, SPEED_OF_LIGHT_KM_S};

/// Refraction at 45° of air of 1013 hPa and 283 K, tangent and cubed tangent, arcsec.
const REFRACTION_ARCSEC: [f64; 2] = [58.3, -0.067];
/// Pressure and temperature that these are of.
const AIR_HPA_K: [f64; 2] = [1013.0, 283.0];
/// Speed of the Earth's surface at the equator, km/s.
const EQUATOR_KM_S: f64 = 0.4651;
/// Obliquity of the ecliptic at J2000.0.
const OBLIQUITY_DEG: f64 = 23.439;

/// Julian year (TDB) of a time.
pub(super) fn julian_year(time: Epoch) -> f64 {
    2000.0 + time.to_tdb_days_since_j2000() / JULIAN_YEAR_DAYS
}

/// The direction after so many years of proper motion (east, north; rad per year).
pub(super) fn moved(at: V3, motion_rad_yr: [f64; 2], years: f64) -> V3 {
    let (east, north) = east_and_north(at);
    unit(plus(plus(at, motion_rad_yr[0] * years, east), motion_rad_yr[1] * years, north))
}

/// Change of a direction by the velocity of who looks: β − (β·d)d.
pub(super) fn aberration(at: V3, velocity_km_s: V3) -> V3 {
    let beta = times(velocity_km_s, 1.0 / SPEED_OF_LIGHT_KM_S);
    plus(beta, -dot(beta, at), at)
}

/// The unit vector from a direction towards the zenith along the sphere, and the tangent of the zenith distance.
fn towards(at: V3, zenith: V3) -> (V3, f64) {
    let cosine = dot(at, zenith);
    let across = plus(zenith, -cosine, at);
    let sine = dot(across, across).sqrt();
    (times(across, 1.0 / sine.max(1e-9)), sine / cosine.max(0.03))
}

/// Change of a direction by refraction, in units of the air's strength (1: 1013 hPa, 283 K). The law holds for the OBSERVED zenith distance,
/// which is found by going back and forth.
pub(super) fn refraction(at: V3, zenith: V3, strength: f64) -> V3 {
    let [a, b] = REFRACTION_ARCSEC.map(|arcsec| arcsec * ARCSEC_RAD * strength);
    let mut change = [0.0; 3];
    for _ in 0..4 {
        let (up, tangent) = towards(unit(plus(at, 1.0, change)), zenith);
        change = times(up, a * tangent + b * tangent.powi(3));
    }
    change
}

/// Refraction at 45°, arcsec, of such air.
pub(super) fn refraction_at_45deg_arcsec(strength: f64) -> f64 {
    (REFRACTION_ARCSEC[0] + REFRACTION_ARCSEC[1]) * strength
}

/// Strength of the air of a site.
pub(super) fn air(pressure_hpa: f64, temperature_c: f64) -> f64 {
    pressure_hpa / AIR_HPA_K[0] * AIR_HPA_K[1] / (temperature_c + 273.15)
}

/// Change of a direction by the dispersion of air: −ρ·c·tan z towards the zenith, ρ in arcsec per magnitude.
pub(super) fn dispersion(at: V3, zenith: V3, colour: f64, arcsec_per_mag: f64) -> V3 {
    let (up, tangent) = towards(at, zenith);
    times(up, -arcsec_per_mag * ARCSEC_RAD * colour * tangent)
}

/// Barycentric velocity of the Earth, km/s. `None` outside 1900 to 2100.
pub(super) fn earth_velocity_km_s(time: Epoch) -> Option<V3> {
    let (_, barycentric) = eph::epv00(J2000_JD, time.to_tdb_days_since_j2000())?;
    Some(times(barycentric[1], AU_KM / DAY_S))
}

/// Zenith of a site and the velocity that the Earth's rotation gives it, km/s.
pub(super) fn zenith(time: Epoch, latitude_deg: f64, longitude_deg: f64) -> (V3, V3) {
    let pole_and_equinox = pnp::c2i06a(J2000_JD, time.to_jde_tt_days() - J2000_JD);
    let angle = erst::era00(J2000_JD, time.to_jde_utc_days() - J2000_JD) + longitude_deg * DEG_RAD;
    let (sin_latitude, cos_latitude) = (latitude_deg * DEG_RAD).sin_cos();
    let here = [cos_latitude * angle.cos(), cos_latitude * angle.sin(), sin_latitude];
    let moving = [-EQUATOR_KM_S * cos_latitude * angle.sin(), EQUATOR_KM_S * cos_latitude * angle.cos(), 0.0];
    (turned_back(&pole_and_equinox, here), turned_back(&pole_and_equinox, moving))
}

/// The Sun's direction to a degree: enough to keep away from it.
pub(super) fn sun(time: Epoch) -> V3 {
    let days = time.to_tdb_days_since_j2000();
    let anomaly = (357.528 + 0.985_600_3 * days) * DEG_RAD;
    let longitude = (280.46 + 0.985_647_4 * days + 1.915 * anomaly.sin()) * DEG_RAD;
    let (sin_obliquity, cos_obliquity) = (OBLIQUITY_DEG * DEG_RAD).sin_cos();
    [longitude.cos(), longitude.sin() * cos_obliquity, longitude.sin() * sin_obliquity]
}

/// Rows of the rotation from ICRS axes to camera axes: boresight at `at`, the frame's upward direction turned by `roll_rad` from north through
/// east.
pub(super) fn attitude(at: V3, roll_rad: f64) -> [V3; 3] {
    let (east, north) = east_and_north(at);
    let up = plus(times(north, roll_rad.cos()), roll_rad.sin(), east);
    let down = times(up, -1.0);
    [cross(down, at), down, at]
}
