//! A concealed recording in the program's own form: on disk, and straight in memory with the same content.

use std::collections::BTreeMap;

use super::generate::Lists;
use crate::camera::Physics;
use crate::catalog::Catalog;
use crate::identify::{ControlPoints, PreidentifiedError, listed_control_points};
use crate::recording::{CameraInfo, Form, FrameEntry, ListedStar, Recording, Site, StarList};

/// The recording, as it would be read back from its folder.
#[must_use]
pub fn recording(lists: &Lists) -> Recording {
    let [width_px, height_px] = lists.size_px;
    let mut recording = Recording::new(CameraInfo {
        width_px,
        height_px,
        focal_length_px: Some(lists.focal_length_px),
        zero_point_e_per_s: Some(lists.zero_point_e_per_s),
        passband: Some("V".to_owned()),
        ..CameraInfo::default()
    });
    recording.form = Form::StarList;
    recording.site = lists.site.map(|[latitude_deg, longitude_deg, pressure_hpa, temperature_c]| Site {
        latitude_deg,
        longitude_deg,
        height_m: 0.0,
        pressure_hpa: Some(pressure_hpa),
        temperature_c: Some(temperature_c),
        relative_humidity: Some(0.0),
    });
    recording.frames = lists
        .frames
        .iter()
        .enumerate()
        .map(|(number, line)| FrameEntry {
            number,
            time_utc: line.time,
            exposure_s: Some(lists.exposure_s),
            temperature_c: line.temperature_c,
            velocity_km_s: line.velocity_km_s,
            rate_deg_s: line.rate_deg_s,
            covariates: line.extra.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
            ..FrameEntry::default()
        })
        .collect();
    let frames = lists.stars.iter().map(|stars| {
        let listed = stars.iter().map(|star| ListedStar {
            x_px: star.x_px,
            y_px: star.y_px,
            flux_e: Some(star.flux_e),
            magnitude: None,
            covariance_px2: Some([star.sigma_px * star.sigma_px, 0.0, star.sigma_px * star.sigma_px]),
            hip: Some(star.hip),
            radec_deg: None,
        });
        listed.collect()
    });
    recording.stars = Some(StarList { frames: frames.collect() });
    recording
}

/// The control points of a concealed recording, for a model with these effects of the sky.
pub fn control_points(recording: &Recording, model: &[&str], catalog: &Catalog) -> Result<ControlPoints, PreidentifiedError> {
    let physics = Physics::List(model.iter().map(|id| (*id).to_owned()).collect());
    listed_control_points(recording, catalog, &physics)
}

/// Numbers of each frame that a mismatch may follow.
#[must_use]
pub fn telemetry(recording: &Recording) -> Vec<BTreeMap<String, f64>> {
    let of = |frame: &FrameEntry| {
        let mut numbers = frame.covariates.clone();
        numbers.extend(frame.temperature_c.map(|temperature| ("temperature".to_owned(), temperature)));
        numbers
    };
    recording.frames.iter().map(of).collect()
}
