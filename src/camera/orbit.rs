//! A camera on a satellite: how fast it moves.
//!
//! From two-line elements its place follows by SGP4 (F. R. Hoots, R. L. Roehrich, Spacetrack Report 3, 1980; D. A. Vallado et al., "Revisiting Spacetrack
//! Report #3", AIAA 2006-6753), in the frame TEME of its time. That is turned into the axes of the ICRS: TEME is the Earth's true equator with the origin
//! of the mean sidereal time of 1982, so R3(GMST82) leads from it to the turning Earth, R3(−ERA) on to the celestial intermediate frame, and the matrix of
//! precession and nutation (IAU 2006/2000A) to the GCRS. UT1 is taken as UTC, and falls out but for 1e-8 of the angle.
//!
//! From a state vector in the GCRS it follows as an ellipse about the Earth, by Lagrange's coefficients in the eccentric anomaly (R. H. Battin, An Introduction
//! to the Mathematics and Methods of Astrodynamics, 1999, section 4.3). Neglected there: the Earth's flattening, which turns the plane of a low orbit by up
//! to 8° a day and so its velocity by 1 km/s, the air, Sun and Moon.

use hifitime::Epoch;
use sofars::{erst, pnp};
use thiserror::Error;

use crate::dual::cross;
use crate::dual::dot;
use crate::units::J2000_JD;

/// The Earth's gravity (WGS 84), km³/s².
const EARTH_KM3_S2: f64 = 398_600.441_8;
/// The Earth's equatorial radius, km.
pub const EARTH_RADIUS_KM: f64 = 6378.137;

/// Why an orbit cannot be had.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum OrbitError {
    /// Lines that are no two-line elements.
    #[error("these are no two-line elements ({0}); copy both lines with all of their 69 characters")]
    Lines(String),
    /// Elements for which there is no orbit.
    #[error("no orbit belongs to these two-line elements ({0}); take others")]
    Elements(String),
    /// A state that is no orbit.
    #[error("this position and velocity are no orbit about the Earth: {0}; the units are km and km/s, the axes those of the GCRS")]
    State(&'static str),
    /// A time at which the orbit is no more.
    #[error("at {time} there is no orbit any more ({reason}); take elements that are nearer to it")]
    Decayed {
        /// When.
        time: Epoch,
        /// Why.
        reason: String,
    },
}

/// Position and velocity relative to the Earth's centre, axes of the GCRS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrbitState {
    /// Position, km.
    pub position_km: [f64; 3],
    /// Velocity, km/s.
    pub velocity_km_s: [f64; 3],
}

/// An orbit about the Earth.
#[derive(Clone, Debug)]
pub struct Orbit {
    epoch: Epoch,
    law: Law,
}

#[derive(Clone, Debug)]
enum Law {
    Sgp4(Box<sgp4::Constants>),
    Ellipse(OrbitState),
}

impl Orbit {
    /// From the two lines of a satellite's elements.
    pub fn from_tle(lines: [&str; 2]) -> Result<Self, OrbitError> {
        let [first, second] = lines.map(|line| line.trim_end().as_bytes());
        let elements = sgp4::Elements::from_tle(None, first, second).map_err(|error| OrbitError::Lines(error.to_string()))?;
        // Elements are made with the constants of this mode.
        let constants =
            sgp4::Constants::from_elements_afspc_compatibility_mode(&elements).map_err(|error| OrbitError::Elements(error.to_string()))?;
        let since_1970_us = elements.datetime.and_utc().timestamp_micros();
        let epoch = Epoch::from_unix_seconds(since_1970_us as f64 * 1e-6);
        Ok(Self { epoch, law: Law::Sgp4(Box::new(constants)) })
    }

    /// From a state in the axes of the GCRS at a time.
    pub fn from_state(epoch: Epoch, state: OrbitState) -> Result<Self, OrbitError> {
        let OrbitState { position_km, velocity_km_s } = state;
        let r = dot(position_km, position_km).sqrt();
        let v2 = dot(velocity_km_s, velocity_km_s);
        if !(r.is_finite() && v2.is_finite() && r > EARTH_RADIUS_KM) {
            return Err(OrbitError::State("the position lies within the Earth or is no number"));
        }
        let inverse_a = 2.0 / r - v2 / EARTH_KM3_S2;
        if inverse_a <= 0.0 {
            return Err(OrbitError::State("the satellite would leave the Earth"));
        }
        let moment = cross(position_km, velocity_km_s);
        let eccentricity = (1.0 - dot(moment, moment) * inverse_a / EARTH_KM3_S2).max(0.0).sqrt();
        if (1.0 - eccentricity) / inverse_a < EARTH_RADIUS_KM {
            return Err(OrbitError::State("its perigee lies within the Earth"));
        }
        Ok(Self { epoch, law: Law::Ellipse(state) })
    }

    /// The time of the elements.
    #[must_use]
    pub fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// Where the satellite is, and how fast.
    pub fn at(&self, time: Epoch) -> Result<OrbitState, OrbitError> {
        let seconds = (time - self.epoch).to_seconds();
        match &self.law {
            Law::Ellipse(state) => Ok(along_ellipse(state, seconds)),
            Law::Sgp4(constants) => {
                let decayed = |reason: String| OrbitError::Decayed { time, reason };
                let teme = constants
                    .propagate_afspc_compatibility_mode(sgp4::MinutesSinceEpoch(seconds / 60.0))
                    .map_err(|error| decayed(error.to_string()))?;
                let state = OrbitState { position_km: teme.position, velocity_km_s: teme.velocity };
                if !state.position_km.iter().chain(&state.velocity_km_s).all(|component| component.is_finite()) {
                    return Err(decayed("the model gives no number".to_owned()));
                }
                Ok(gcrs_from_teme(time, state))
            }
        }
    }
}

/// Turns a state from TEME into the GCRS.
fn gcrs_from_teme(time: Epoch, state: OrbitState) -> OrbitState {
    let tt_days = time.to_jde_tt_days() - J2000_JD;
    let ut_days = time.to_jde_utc_days() - J2000_JD;
    let (sine, cosine) = (erst::gmst82(J2000_JD, ut_days) - erst::era00(J2000_JD, ut_days)).sin_cos();
    let cirs_from_gcrs = pnp::c2i06a(J2000_JD, tt_days);
    let turned = |v: [f64; 3]| {
        let cirs = [cosine * v[0] + sine * v[1], cosine * v[1] - sine * v[0], v[2]];
        [0, 1, 2].map(|axis| (0..3).map(|row| cirs_from_gcrs[row][axis] * cirs[row]).sum())
    };
    OrbitState { position_km: turned(state.position_km), velocity_km_s: turned(state.velocity_km_s) }
}

/// The state some time later on an ellipse.
fn along_ellipse(state: &OrbitState, seconds: f64) -> OrbitState {
    const ROUNDS: usize = 50;
    let (r0, v0) = (state.position_km, state.velocity_km_s);
    let r = dot(r0, r0).sqrt();
    let a = 1.0 / (2.0 / r - dot(v0, v0) / EARTH_KM3_S2);
    let root = (EARTH_KM3_S2 * a).sqrt();
    let mean_motion = (EARTH_KM3_S2 / a).sqrt() / a;
    let radial = dot(r0, v0) / root;
    // Kepler's equation for the difference of eccentric anomalies; whole turns change nothing.
    let mean = (mean_motion * seconds) % std::f64::consts::TAU;
    let mut turn = mean;
    for _ in 0..ROUNDS {
        let (sine, cosine) = turn.sin_cos();
        let off = turn - (1.0 - r / a) * sine + radial * (1.0 - cosine) - mean;
        let step = off / (1.0 - (1.0 - r / a) * cosine + radial * sine);
        turn -= step;
        if step.abs() < 1e-14 {
            break;
        }
    }
    let (sine, cosine) = turn.sin_cos();
    let f = 1.0 - a / r * (1.0 - cosine);
    let g = mean / mean_motion - (turn - sine) / mean_motion;
    let position_km = [0, 1, 2].map(|axis| f * r0[axis] + g * v0[axis]);
    let distance = dot(position_km, position_km).sqrt();
    let f_rate = -root / (distance * r) * sine;
    let g_rate = 1.0 - a / distance * (1.0 - cosine);
    OrbitState { position_km, velocity_km_s: [0, 1, 2].map(|axis| f_rate * r0[axis] + g_rate * v0[axis]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VANGUARD: [&str; 2] = [
        "1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753",
        "2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667",
    ];

    fn near(found: [f64; 3], expected: [f64; 3], tolerance: f64) {
        let far = (0..3).map(|axis| (found[axis] - expected[axis]).abs()).fold(0.0, f64::max);
        assert!(far < tolerance, "{found:?} for {expected:?}");
    }

    /// Vallado et al. (2006), verification of satellite 00005: TEME, 0 and 360 minutes after the epoch.
    #[test]
    fn sgp4_gives_the_published_states() {
        let Law::Sgp4(constants) = Orbit::from_tle(VANGUARD).unwrap().law else { panic!("no SGP4") };
        for (minutes, position, velocity) in [
            (0.0, [7_022.465_292_66, -1_400.082_967_55, 0.039_951_55], [1.893_841_015, 6.405_893_759, 4.534_807_250]),
            (360.0, [-7_154.031_202_02, -3_783.176_825_04, -3_536.194_122_94], [4.741_887_409, -4.151_817_765, -2.093_935_425]),
        ] {
            let state = constants.propagate_afspc_compatibility_mode(sgp4::MinutesSinceEpoch(minutes)).unwrap();
            near(state.position, position, 1e-6);
            near(state.velocity, velocity, 1e-8);
        }
    }

    /// The same two states turned by astropy 8.0.2 (TEME to GCRS, UT1 = UTC): both by the matrix of its turned axes, since it turns velocities by way of
    /// differences over a second, which are off by 2 cm/s.
    #[test]
    fn the_axes_are_turned_as_astropy_turns_them() {
        let orbit = Orbit::from_tle(VANGUARD).unwrap();
        for (minutes, position, velocity) in [
            (0.0, [7_022.312_443_790, -1_400.849_397_260, -0.110_867_862], [1.894_617_993_09, 6.405_589_014_73, 4.534_913_171_72]),
            (360.0, [-7_154.505_595_304, -3_782.318_345_620, -3_536.152_686_634], [4.741_397_514_52, -4.152_290_661_74, -2.094_107_062_65]),
        ] {
            let state = orbit.at(orbit.epoch() + minutes * hifitime::Unit::Minute).unwrap();
            near(state.position_km, position, 2e-3);
            near(state.velocity_km_s, velocity, 1e-9);
        }
    }

    #[test]
    fn an_ellipse_closes_and_keeps_energy_and_area() {
        let epoch: Epoch = "2026-03-01T00:00:00Z".parse().unwrap();
        let start = OrbitState { position_km: [7000.0, 300.0, -200.0], velocity_km_s: [0.4, 5.5, 6.3] };
        let orbit = Orbit::from_state(epoch, start).unwrap();
        let at = |seconds: f64| orbit.at(epoch + seconds * hifitime::Unit::Second).unwrap();
        let energy = |s: &OrbitState| 0.5 * dot(s.velocity_km_s, s.velocity_km_s) - EARTH_KM3_S2 / dot(s.position_km, s.position_km).sqrt();
        let period_s = std::f64::consts::TAU * EARTH_KM3_S2 / (-2.0 * energy(&start)).powf(1.5);
        for turns in [1.0, -1.0, 15.0] {
            near(at(turns * period_s).position_km, start.position_km, 1e-4);
        }
        for seconds in [-4000.0, 1.0, 1000.0, 86_400.0] {
            let state = at(seconds);
            assert!((energy(&state) / energy(&start) - 1.0).abs() < 1e-12);
            near(cross(state.position_km, state.velocity_km_s), cross(start.position_km, start.velocity_km_s), 1e-6);
        }
        // A step of time against Newton's law itself.
        let (before, now, after) = (at(499.5), at(500.0), at(500.5));
        let pull = now.position_km.map(|c| -EARTH_KM3_S2 * c / dot(now.position_km, now.position_km).powf(1.5));
        near([0, 1, 2].map(|k| after.velocity_km_s[k] - before.velocity_km_s[k]), pull, 1e-8);
        near([0, 1, 2].map(|k| after.position_km[k] - before.position_km[k]), now.velocity_km_s, 1e-6);
    }

    #[test]
    fn what_is_no_orbit_is_refused() {
        let epoch: Epoch = "2026-03-01T00:00:00Z".parse().unwrap();
        let state =
            |position_km, velocity_km_s| Orbit::from_state(epoch, OrbitState { position_km, velocity_km_s }).unwrap_err().to_string();
        assert!(state([100.0, 0.0, 0.0], [0.0, 7.5, 0.0]).contains("within the Earth"));
        assert!(state([7000.0, 0.0, 0.0], [0.0, 12.0, 0.0]).contains("leave"));
        assert!(state([7000.0, 0.0, 0.0], [0.0, 5.0, 0.0]).contains("perigee"));
        let wrong = VANGUARD[0].replace("28098-4", "28099-4");
        let lines =
            [[wrong.as_str(), VANGUARD[1]], ["", ""], [VANGUARD[1], VANGUARD[0]], [VANGUARD[0], &VANGUARD[1][..40]], ["1 é", "2 é"]];
        for lines in lines {
            assert!(matches!(Orbit::from_tle(lines), Err(OrbitError::Lines(_))), "{lines:?}");
        }
    }
}
