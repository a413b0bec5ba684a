//! Sun and Moon as a camera has them: what the brightness of the sky depends on.

use hifitime::Epoch;
use sofars::eph;

use crate::dual::{dot, normalize};
use crate::effects::Observation;
use crate::effects::sky::glow::{Circumstances, Moon};
use crate::units::{AU_KM, J2000_JD};

/// Radius of the Earth, km; its flattening moves the Moon by 10″ at most.
const EARTH_RADIUS_KM: f64 = 6371.0;

/// Where Sun, Moon and zenith stand at this time for a camera with this position, without the sky's own numbers (extinction, faintest star).
///
/// The Moon is that of SOFA's `moon98` (to 10″), seen from the ground where there is a zenith, else from the Earth's centre. Directions are
/// geometric, without aberration and refraction.
#[must_use]
pub fn circumstances(time: Option<Epoch>, observation: &Observation) -> Circumstances {
    let sun_au = observation.sun_au.map(|from_sun| from_sun.map(|component| -component));
    let moon = time.zip(sun_au).map(|(time, sun_au)| {
        let [geocentric_au, _] = eph::moon98(J2000_JD, time.to_jde_tt_days() - J2000_JD);
        let here_au = observation.zenith.map_or([0.0; 3], |zenith| zenith.map(|component| component * EARTH_RADIUS_KM / AU_KM));
        let moon_au = [0, 1, 2].map(|axis| geocentric_au[axis] - here_au[axis]);
        let sun_from_moon = [0, 1, 2].map(|axis| sun_au[axis] - moon_au[axis]);
        let direction = normalize(moon_au);
        let phase_angle_rad = (-dot(direction, normalize(sun_from_moon))).clamp(-1.0, 1.0).acos();
        Moon { direction, phase_angle_rad }
    });
    Circumstances { sun: sun_au.map(normalize), moon, zenith: observation.zenith, ..Circumstances::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{GroundSite, observation};
    use crate::units::DEG_RAD;

    /// Places of astropy 8.0.2 (`get_body` at a site, its own ephemeris): a Moon just before its total eclipse, and at its first quarter.
    #[test]
    fn the_moon_stands_where_astropy_has_it() {
        for (time, [latitude, longitude, height_m], direction, phase_deg) in [
            ("2026-03-03T11:38:00Z", [19.8, -155.5, 4200.0], [-0.953_034_42, 0.282_310_96, 0.109_662_76], 0.683_9),
            ("2026-09-18T20:44:00Z", [-24.6, -70.4, 2600.0], [-0.070_179_23, -0.879_641_38, -0.470_431_64], 89.464),
        ] {
            let time: Epoch = time.parse().unwrap();
            let site = GroundSite::from_degrees(latitude, longitude, height_m);
            let here = circumstances(Some(time), &observation(Some(time), Some(&site), None).unwrap());
            let moon = here.moon.unwrap();
            let apart = dot(moon.direction, direction).clamp(-1.0, 1.0).acos() / DEG_RAD;
            assert!(apart < 0.02, "{apart}°");
            assert!((moon.phase_angle_rad / DEG_RAD - phase_deg).abs() < 0.05, "{}", moon.phase_angle_rad / DEG_RAD);
            assert!((dot(here.sun.unwrap(), here.sun.unwrap()) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn without_a_time_nothing_is_known() {
        assert_eq!(circumstances(None, &Observation::default()), Circumstances::default());
    }
}
