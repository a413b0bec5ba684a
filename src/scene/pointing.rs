//! Where the camera points in each exposure.

use hifitime::{Epoch, Unit};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::{SceneError, SceneFile, Telemetry};
use crate::coordinates::Attitude;
use crate::dual::dot;
use crate::effects::Observation;
use crate::units::DEG_RAD;

/// One planned exposure.
pub(super) struct Plan {
    pub(super) time: Option<Epoch>,
    pub(super) exposure_s: f64,
    pub(super) attitude: Attitude,
    pub(super) telemetry: Telemetry,
}

/// The exposures of a scene in order of time.
pub(super) fn plan(
    path: &str,
    file: &SceneFile,
    circumstances: &dyn Fn(Option<Epoch>, Option<[f64; 3]>) -> Result<Observation, SceneError>,
) -> Result<Vec<Plan>, SceneError> {
    let Some(series) = &file.series else {
        return listed(path, file);
    };
    let start = series.start_utc.as_deref().map(|text| time(path, "series.start_utc", text)).transpose()?;
    // Its own stream of random numbers: pointings do not change when the noise of the frames is drawn in another way.
    let mut rng = Pcg64::seed_from_u64(file.seed);
    let sin_lowest = (series.lowest_altitude_deg * DEG_RAD).sin();
    (0..series.count)
        .map(|index| {
            let time = start.map(|start| start + series.interval_s * index as f64 * Unit::Second);
            let zenith = circumstances(time, None)?.zenith;
            let (ra, dec) = loop {
                let ra = rng.random_range(0.0..std::f64::consts::TAU);
                let dec = rng.random_range(-1.0_f64..1.0).asin();
                let direction = [ra.cos() * dec.cos(), ra.sin() * dec.cos(), dec.sin()];
                if zenith.is_none_or(|zenith| dot(direction, zenith) >= sin_lowest) {
                    break (ra, dec);
                }
            };
            let roll = rng.random_range(0.0..std::f64::consts::TAU);
            Ok(Plan {
                time,
                exposure_s: series.exposure_s,
                attitude: Attitude::from_pointing(ra, dec, roll),
                telemetry: Telemetry::default(),
            })
        })
        .collect()
}

fn listed(path: &str, file: &SceneFile) -> Result<Vec<Plan>, SceneError> {
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
        let [ra_deg, dec_deg] = frame.boresight_radec_deg;
        let attitude = Attitude::from_pointing(ra_deg * DEG_RAD, dec_deg * DEG_RAD, frame.roll_deg * DEG_RAD);
        let telemetry = Telemetry {
            velocity_km_s: frame.velocity_km_s,
            rate_deg_s: frame.rate_deg_s,
            temperature_c: frame.temperature_c,
            pressure_hpa: frame.pressure_hpa,
        };
        plans.push(Plan { time, exposure_s: frame.exposure_s, attitude, telemetry });
    }
    Ok(plans)
}

fn time(path: &str, key: &str, text: &str) -> Result<Epoch, SceneError> {
    text.parse().map_err(|_| SceneError::Value {
        path: path.to_owned(),
        key: key.to_owned(),
        value: format!("{text:?}"),
        remedy: "is no time; write it as 2026-03-01T22:15:07.250Z",
    })
}
