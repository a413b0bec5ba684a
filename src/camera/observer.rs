//! Where the camera was and how it moved: time and site → [`Observation`].
//!
//! The Earth's position and velocity, its orientation and the constants of refraction come from `sofars`, a port of the IAU's SOFA.
//! UT1 is taken as UTC (0.9 s at most: 14″ in the direction of the zenith, 4e-5 of the refraction); polar motion is left out (0.5″).

use hifitime::Epoch;
use sofars::{astro, eph, erst, pnp};
use thiserror::Error;

use crate::effects::{Observation, RefractionConstants};
use crate::units::{AU_KM, DAY_S, DEG_RAD, J2000_JD, JULIAN_YEAR_DAYS};

/// A camera's place on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundSite {
    /// Geodetic latitude.
    pub latitude_rad: f64,
    /// Longitude, east positive.
    pub longitude_rad: f64,
    /// Height above the ellipsoid.
    pub height_m: f64,
    /// Air pressure; where unknown, that of the standard atmosphere at this height.
    pub pressure_hpa: Option<f64>,
    /// Air temperature; where unknown, that of the standard atmosphere at this height.
    pub temperature_c: Option<f64>,
    /// Relative humidity, 0…1; where unknown, 0.5.
    pub relative_humidity: Option<f64>,
}

/// Why the circumstances of an exposure could not be computed.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ObserverError {
    /// The Earth's ephemeris does not reach so far.
    #[error("the time {0} lies outside 1900–2100, where the Earth's motion is known to this program; correct time_utc")]
    Time(Epoch),
}

impl GroundSite {
    /// The constants of refraction of the site's air for visible light (0.55 µm).
    #[must_use]
    pub fn refraction(&self) -> RefractionConstants {
        const WAVELENGTH_UM: f64 = 0.55;
        // ICAO standard atmosphere, troposphere.
        let standard_k = 288.15 - 0.0065 * self.height_m.clamp(-500.0, 11_000.0);
        let pressure = self.pressure_hpa.unwrap_or_else(|| 1013.25 * (standard_k / 288.15).powf(5.2559));
        let temperature = self.temperature_c.unwrap_or(standard_k - 273.15);
        let (a_rad, b_rad) = astro::refco(pressure, temperature, self.relative_humidity.unwrap_or(0.5), WAVELENGTH_UM);
        RefractionConstants { a_rad, b_rad }
    }
}

/// What is known of an exposure at this time, from this place.
///
/// `velocity_km_s` is the camera's own barycentric velocity where the recording gives it; else that of the site, else that of the
/// Earth's centre.
pub fn observation(time: Option<Epoch>, site: Option<&GroundSite>, velocity_km_s: Option<[f64; 3]>) -> Result<Observation, ObserverError> {
    let Some(time) = time else {
        return Ok(Observation { velocity_km_s, ..Observation::default() });
    };
    let tdb_days = time.to_tdb_days_since_j2000();
    let epoch_yr = 2000.0 + tdb_days / JULIAN_YEAR_DAYS;
    let in_range = (1900.0..=2100.0).contains(&epoch_yr);
    let (heliocentric, earth) = eph::epv00(J2000_JD, tdb_days).filter(|_| in_range).ok_or(ObserverError::Time(time))?;
    let mut position_au = earth[0];
    let mut sun_au = heliocentric[0];
    let mut earth_velocity_km_s = earth[1].map(|au_per_day| au_per_day * AU_KM / DAY_S);
    let mut zenith = None;
    let tt_days = time.to_jde_tt_days() - J2000_JD;
    let utc_days = time.to_jde_utc_days() - J2000_JD;
    let cirs_from_icrs = pnp::c2i06a(J2000_JD, tt_days);
    let rotation_angle = erst::era00(J2000_JD, utc_days);
    if let Some(site) = site {
        let mut local = [[0.0; 3]; 2];
        astro::pvtob(site.longitude_rad, site.latitude_rad, site.height_m, 0.0, 0.0, 0.0, rotation_angle, &mut local);
        let to_icrs = |v: [f64; 3]| [0, 1, 2].map(|column| (0..3).map(|row| cirs_from_icrs[row][column] * v[row]).sum::<f64>());
        let offset_m = to_icrs(local[0]);
        let velocity_m_s = to_icrs(local[1]);
        for axis in 0..3 {
            let offset_au = offset_m[axis] / (AU_KM * 1000.0);
            position_au[axis] += offset_au;
            sun_au[axis] += offset_au;
            earth_velocity_km_s[axis] += velocity_m_s[axis] / 1000.0;
        }
        let (sin_latitude, cos_latitude) = site.latitude_rad.sin_cos();
        let (sin_angle, cos_angle) = (rotation_angle + site.longitude_rad).sin_cos();
        zenith = Some(to_icrs([cos_latitude * cos_angle, cos_latitude * sin_angle, sin_latitude]));
    }
    let (sin_angle, cos_angle) = rotation_angle.sin_cos();
    let turned = |row: [f64; 2]| std::array::from_fn(|axis| row[0] * cirs_from_icrs[0][axis] + row[1] * cirs_from_icrs[1][axis]);
    let earth_from_icrs = [turned([cos_angle, sin_angle]), turned([-sin_angle, cos_angle]), cirs_from_icrs[2]];
    Ok(Observation {
        epoch_yr: Some(epoch_yr),
        position_au: Some(position_au),
        sun_au: Some(sun_au),
        velocity_km_s: Some(velocity_km_s.unwrap_or(earth_velocity_km_s)),
        zenith,
        refraction: site.map(GroundSite::refraction),
        earth_from_icrs: Some(earth_from_icrs),
        ..Observation::default()
    })
}

impl GroundSite {
    /// A site from degrees, as files give it.
    #[must_use]
    pub fn from_degrees(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Self {
        Self {
            latitude_rad: latitude_deg * DEG_RAD,
            longitude_rad: longitude_deg * DEG_RAD,
            height_m,
            pressure_hpa: None,
            temperature_c: None,
            relative_humidity: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of pyerfa 2.0.1.5 (epv00, pvtob, c2i06a, era00, c2t06a) and astropy 8.0.2 (times) with UT1 = UTC and no polar motion.
    #[test]
    fn agrees_with_erfa() {
        let time: Epoch = "2019-07-29T20:47:26Z".parse().unwrap();
        let site = GroundSite::from_degrees(52.22, 4.42, 5.0);
        let here = observation(Some(time), Some(&site), None).unwrap();
        assert!((here.epoch_yr.unwrap() - 2_019.573_900_270_721_4).abs() < 1e-10);
        let close = |got: [f64; 3], want: [f64; 3], tolerance: f64| {
            for axis in 0..3 {
                assert!((got[axis] - want[axis]).abs() < tolerance, "{got:?} {want:?}");
            }
        };
        close(
            here.position_au.unwrap(),
            [
                0.596_961_329_400_957 - 3.017_226_757e-6,
                -0.744_932_800_203_747_3 - 2.599_321_199_7e-5,
                -0.322_941_621_497_916_8 + 3.354_744_407_4e-5,
            ],
            2e-11, // 3 m: hifitime's TDB and ERFA's differ by 30 µs
        );
        close(
            here.sun_au.unwrap(),
            [
                0.599_448_913_558_682_5 - 3.017_226_757e-6,
                -0.751_923_416_844_879_1 - 2.599_321_199_7e-5,
                -0.325_958_810_849_125_5 + 3.354_744_407_4e-5,
            ],
            2e-11,
        );
        close(
            here.velocity_km_s.unwrap(),
            [
                23.555_896_366_899_333 + 0.283_549_066_988,
                16.034_094_619_690_162 - 0.033_599_429_254,
                6.949_839_510_758_909 - 0.000_531_344_674,
            ],
            1e-8,
        );
        close(here.zenith.unwrap(), [-0.070_610_337_111_643_94, -0.608_388_869_107_544_5, 0.790_491_723_068_004_7], 1e-9);
        let space = observation(Some(time), None, Some([1.0, 2.0, 3.0])).unwrap();
        assert_eq!(space.velocity_km_s, Some([1.0, 2.0, 3.0]));
        assert_eq!(space.zenith, None);
    }

    #[test]
    fn refuses_times_beyond_the_ephemeris() {
        let time: Epoch = "2150-01-01T00:00:00Z".parse().unwrap();
        assert!(matches!(observation(Some(time), None, None), Err(ObserverError::Time(_))));
    }
}
