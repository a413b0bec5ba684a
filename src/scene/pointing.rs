//! Pointing of the camera in each exposure.

use hifitime::Epoch;
use nalgebra::{Matrix3, Rotation3, RowVector3, UnitQuaternion};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::motion::{Course, through};
use super::{ExposureTelemetry, SceneError, SceneFile, SeriesTable};
use crate::coordinates::Attitude;
use crate::dual::dot;
use crate::effects::Observation;
use crate::units::DEG_RAD;

/// One planned exposure.
pub(super) struct Plan {
    pub(super) time: Option<Epoch>,
    pub(super) exposure_s: f64,
    pub(super) attitude: Attitude,
    pub(super) course: Course,
    pub(super) telemetry: ExposureTelemetry,
}

/// Gives an exposure the attitude to the ground that the first one has, which is kept in `camera_from_earth`.
pub(super) fn stand_fast(
    path: &str,
    plan: &mut Plan,
    known: &Observation,
    camera_from_earth: &mut Option<UnitQuaternion<f64>>,
) -> Result<(), SceneError> {
    let Some(rows) = known.earth_from_icrs else {
        let (key, value) = ("mount.kind".to_owned(), "fixed".to_owned());
        let remedy = "needs the time of every exposure: give series.start_utc, or time_utc of each frame";
        return Err(SceneError::Value { path: path.to_owned(), key, value, remedy });
    };
    let matrix = Matrix3::from_rows(&rows.map(RowVector3::from));
    let earth_from_icrs = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    let stands = *camera_from_earth.get_or_insert(plan.attitude.camera_from_icrs * earth_from_icrs.inverse());
    plan.attitude = Attitude::new(stands * earth_from_icrs);
    plan.course = Course::Earth(rows[2]);
    Ok(())
}

/// The next exposure of a series.
pub(super) fn drawn(series: &SeriesTable, time: Option<Epoch>, zenith: Option<[f64; 3]>, chance: &mut Pcg64) -> Plan {
    let sin_lowest = (series.lowest_altitude_deg * DEG_RAD).sin();
    let (ra, dec) = loop {
        let ra = chance.random_range(0.0..std::f64::consts::TAU);
        let dec = chance.random_range(-1.0_f64..1.0).asin();
        let direction = [ra.cos() * dec.cos(), ra.sin() * dec.cos(), dec.sin()];
        if zenith.is_none_or(|zenith| dot(direction, zenith) >= sin_lowest) {
            break (ra, dec);
        }
    };
    let roll = chance.random_range(0.0..std::f64::consts::TAU);
    Plan {
        time,
        exposure_s: series.exposure_s,
        attitude: Attitude::from_pointing(ra, dec, roll),
        course: even(series.rate_deg_s),
        telemetry: ExposureTelemetry { rate_deg_s: series.rate_deg_s, ..ExposureTelemetry::default() },
    }
}

/// The exposures of a list, in order of time.
pub(super) fn listed(path: &str, file: &SceneFile) -> Result<Vec<Plan>, SceneError> {
    let mut plans: Vec<Plan> = Vec::new();
    for (index, frame) in file.frames.iter().enumerate() {
        let key = format!("frames[{index}].time_utc");
        let time = frame.time_utc.as_deref().map(|text| time(path, &key, text)).transpose()?;
        if let (Some(now), Some(before)) = (time, plans.iter().rev().find_map(|plan| plan.time))
            && now < before
        {
            let remedy = "is earlier than the frame before; list the frames in order of time";
            return Err(SceneError::Value { path: path.to_owned(), key, value: now.to_string(), remedy });
        }
        let [ra_deg, dec_deg] = frame.boresight_radec_deg.unwrap_or_default();
        let mut attitude = Attitude::from_pointing(ra_deg * DEG_RAD, dec_deg * DEG_RAD, frame.roll_deg * DEG_RAD);
        let mut course = even(frame.rate_deg_s);
        if !frame.attitude_samples.is_empty() {
            let rows_s = file.camera.line_time_us.unwrap_or_default() * 1e-6 * file.camera.height_px as f64;
            (attitude, course) = through(&frame.attitude_samples, 0.5 * (frame.exposure_s + rows_s)).map_err(|remedy| {
                let key = format!("frames[{index}].attitude_samples");
                SceneError::Value { path: path.to_owned(), key, value: format!("{} samples", frame.attitude_samples.len()), remedy }
            })?;
        }
        let telemetry = ExposureTelemetry {
            velocity_km_s: frame.velocity_km_s,
            rate_deg_s: frame.rate_deg_s.or_else(|| Some(course.rate_rad_s()?.map(|component| component / DEG_RAD))),
            temperature_c: frame.temperature_c,
            pressure_hpa: frame.pressure_hpa,
        };
        plans.push(Plan { time, exposure_s: frame.exposure_s, attitude, course, telemetry });
    }
    Ok(plans)
}

/// An even turn, or none.
fn even(rate_deg_s: Option<[f64; 3]>) -> Course {
    match rate_deg_s {
        Some(rate) if rate != [0.0; 3] => Course::Rate(rate.map(|component| component * DEG_RAD)),
        _ => Course::Still,
    }
}

/// A time of the file.
pub(super) fn time(path: &str, key: &str, text: &str) -> Result<Epoch, SceneError> {
    text.parse().map_err(|_| SceneError::Value {
        path: path.to_owned(),
        key: key.to_owned(),
        value: format!("{text:?}"),
        remedy: "is no time; write it as 2026-03-01T22:15:07.250Z",
    })
}
