//! Every number of a scene file against its range.

use super::{NominalTable, SceneError, SceneFile, binning, detector, lights, motion};
use crate::camera::Model;
use crate::coordinates::PixelPoint;
use crate::recording::Mount;

/// Whether some pixel of the frame's edge has a direction whose image is another pixel, or none. A corner outside the circle of a fisheye has no
/// direction and is dark.
fn folds_over(model: &Model) -> bool {
    const STEPS: u32 = 32;
    let camera = model.camera();
    let context = model.reference_context();
    let (right, bottom) = (camera.width_px as f64 - 0.5, camera.height_px as f64 - 0.5);
    (0..=STEPS).any(|step| {
        let share = f64::from(step) / f64::from(STEPS);
        let (x, y) = (share * (right + 0.5) - 0.5, share * (bottom + 0.5) - 0.5);
        [[x, -0.5], [x, bottom], [-0.5, y], [right, y]].into_iter().any(|[x_px, y_px]| {
            let Some(direction) = model.direction(PixelPoint { x_px, y_px }, &context) else { return false };
            let back = model.pixel(&direction, &context);
            back.is_none_or(|back| (back.x_px - x_px).hypot(back.y_px - y_px) > 1e-6)
        })
    })
}

/// Checks every number against its range.
pub(super) fn check(path: &str, file: &SceneFile) -> Result<(), SceneError> {
    let refuse = |key: &str, value: String, remedy: &'static str| -> Result<(), SceneError> {
        Err(SceneError::Value { path: path.to_owned(), key: key.to_owned(), value, remedy })
    };
    let positive = |key: &str, value: f64| {
        if value.is_finite() && value > 0.0 { Ok(()) } else { refuse(key, value.to_string(), "must be a number above 0") }
    };
    let not_negative = |key: &str, value: f64| {
        if value.is_finite() && value >= 0.0 { Ok(()) } else { refuse(key, value.to_string(), "must be a number not below 0") }
    };
    if file.format != "boresight-scene/1" {
        return refuse("format", format!("{:?}", file.format), "must be \"boresight-scene/1\"");
    }
    let camera = &file.camera;
    for (key, size) in [("camera.width_px", camera.width_px), ("camera.height_px", camera.height_px)] {
        if !(16..=16_384).contains(&size) {
            return refuse(key, size.to_string(), "must lie between 16 and 16384");
        }
    }
    positive("camera.focal_length_px", camera.focal_length_px)?;
    for (key, value) in [("camera.k1", camera.k1), ("camera.p1", camera.p1), ("camera.p2", camera.p2)] {
        if !value.is_finite() {
            return refuse(key, value.to_string(), "must be a finite number");
        }
    }
    let near_frame = |key: &str, point: Option<[f64; 2]>| match point {
        Some([x, y]) if !(x.abs() <= 1e5 && y.abs() <= 1e5) => {
            refuse(key, format!("[{x}, {y}]"), "must be a point in px, not further than 100000 from the corner")
        }
        _ => Ok(()),
    };
    near_frame("camera.principal_point_px", camera.principal_point_px)?;
    near_frame("nominal.principal_point_px", file.nominal.principal_point_px)?;
    let NominalTable { k1, p1, p2, .. } = file.nominal;
    for (key, value) in [("nominal.k1", k1), ("nominal.p1", p1), ("nominal.p2", p2)] {
        if let Some(value) = value.filter(|value| !value.is_finite()) {
            return refuse(key, value.to_string(), "must be a finite number");
        }
    }
    if camera.projection.is_none() && !camera.projection_parameters.is_empty() {
        let remedy = "need a projection that has them: set camera.projection";
        return refuse("camera.projection_parameters", format!("{:?}", camera.projection_parameters), remedy);
    }
    for (key, model) in [("camera", camera.model(path)?), ("nominal", camera.declared(&file.nominal).model(path)?)] {
        if folds_over(&model) {
            let camera = model.camera();
            let value = format!("[k1 = {}, p1 = {}, p2 = {}]", camera.k1, camera.p1, camera.p2);
            return refuse(key, value, "is so strong a distortion that the image folds over within the frame; choose smaller values");
        }
    }
    if let Some(f) = file.nominal.focal_length_px {
        positive("nominal.focal_length_px", f)?;
    }
    detector::check(path, &file.detector)?;
    binning::check(path, camera, &file.detector)?;
    not_negative("sky.background_e_per_px_s", file.sky.even_e_per_px_s())?;
    not_negative("sky.background_image_scale", file.sky.background_image_scale)?;
    if !(0.0..=10.0).contains(&file.sky.extinction_mag_per_airmass) {
        let value = file.sky.extinction_mag_per_airmass.to_string();
        return refuse("sky.extinction_mag_per_airmass", value, "must lie between 0 and 10");
    }
    if !file.sky.faintest_magnitude.is_finite() {
        return refuse("sky.faintest_magnitude", file.sky.faintest_magnitude.to_string(), "must be a finite number");
    }
    if let Some(site) = &file.site {
        if !(-90.0..=90.0).contains(&site.latitude_deg) {
            return refuse("site.latitude_deg", site.latitude_deg.to_string(), "must lie between -90 and 90");
        }
        if !(-360.0..=360.0).contains(&site.longitude_deg) {
            return refuse("site.longitude_deg", site.longitude_deg.to_string(), "must lie between -360 and 360");
        }
        if !(-500.0..=20_000.0).contains(&site.height_m) {
            return refuse("site.height_m", site.height_m.to_string(), "must lie between -500 and 20000");
        }
    }
    if let Some(site) = &file.site {
        let air = [
            ("site.pressure_hpa", site.pressure_hpa, 0.0, 2000.0),
            ("site.temperature_c", site.temperature_c, -150.0, 100.0),
            ("site.relative_humidity", site.relative_humidity, 0.0, 1.0),
        ];
        for (key, value, low, high) in air {
            if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
                return refuse(
                    key,
                    value.to_string(),
                    "is no air on Earth: hPa from 0 to 2000, degrees from -150 to 100, humidity from 0 to 1",
                );
            }
        }
    }
    match (&file.series, file.frames.is_empty()) {
        (None, true) => return refuse("frames", "none".into(), "exist: add a [series] or one [[frames]] for each exposure"),
        (Some(_), false) => return refuse("series", "given".into(), "stands beside [[frames]]: keep one of the two"),
        _ => {}
    }
    let is_line_time = |value: f64| (0.0..=1e6).contains(&value);
    for (key, value) in [("camera.line_time_us", camera.line_time_us), ("nominal.line_time_us", file.nominal.line_time_us)] {
        if let Some(value) = value.filter(|value| !is_line_time(*value)) {
            return refuse(key, value.to_string(), "must lie between 0 and 1000000 (first_row says in which direction rows are read)");
        }
    }
    if camera.line_time_us.is_some() && file.effects.iter().any(|effect| effect.id.replace('_', "-") == "rolling-shutter") {
        return refuse("camera.line_time_us", "given".into(), "stands beside the effect rolling-shutter: keep one of the two");
    }
    if let Some(jitter) = &file.jitter {
        motion::check(path, jitter)?;
    }
    lights::check(path, &file.ghosts, &file.streaks, file.cosmic_rays.as_ref())?;
    let is_fixed = file.mount.is_some_and(|mount| mount.kind == Mount::Fixed);
    let is_turning = |rate: Option<[f64; 3]>| rate.is_some_and(|rate| rate != [0.0; 3]);
    if let Some(series) = &file.series {
        check_rate(path, "series.rate_deg_s", series.rate_deg_s)?;
        if is_fixed && is_turning(series.rate_deg_s) {
            return refuse("series.rate_deg_s", "given".into(), "stands beside a fixed mount: keep one of the two");
        }
        if !(1..=1_000_000).contains(&series.count) {
            return refuse("series.count", series.count.to_string(), "must lie between 1 and 1000000");
        }
        positive("series.exposure_s", series.exposure_s)?;
        not_negative("series.interval_s", series.interval_s)?;
        if !(-90.0..=85.0).contains(&series.lowest_altitude_deg) {
            return refuse("series.lowest_altitude_deg", series.lowest_altitude_deg.to_string(), "must lie between -90 and 85");
        }
    }
    for (index, frame) in file.frames.iter().enumerate() {
        positive(&format!("frames[{index}].exposure_s"), frame.exposure_s)?;
        let follows = !frame.attitude_samples.is_empty() || (is_fixed && index > 0);
        if frame.boresight_radec_deg.is_some() == follows {
            let (value, remedy) = if follows {
                ("given", "is not free: the attitude follows from the samples or from the fixed mount; leave it out")
            } else {
                ("none", "must say where the boresight points at the middle of the exposure, or attitude_samples must")
            };
            return refuse(&format!("frames[{index}].boresight_radec_deg"), value.into(), remedy);
        }
        if !frame.attitude_samples.is_empty() && (is_fixed || frame.rate_deg_s.is_some()) {
            let remedy = "stand beside a rate or a fixed mount: keep one of them";
            return refuse(&format!("frames[{index}].attitude_samples"), "given".into(), remedy);
        }
        if is_fixed && is_turning(frame.rate_deg_s) {
            return refuse(&format!("frames[{index}].rate_deg_s"), "given".into(), "stands beside a fixed mount: keep one of the two");
        }
        let [ra, dec] = frame.boresight_radec_deg.unwrap_or_default();
        if !ra.is_finite() || !(-90.0..=90.0).contains(&dec) {
            let remedy = "must be right ascension and declination in degrees, the latter between -90 and 90";
            return refuse(&format!("frames[{index}].boresight_radec_deg"), format!("[{ra}, {dec}]"), remedy);
        }
        if let Some(velocity) = frame.velocity_km_s.filter(|velocity| !velocity.iter().all(|v| v.abs() < 3e5)) {
            let remedy = "must be three numbers in km/s, each below the speed of light";
            return refuse(&format!("frames[{index}].velocity_km_s"), format!("{velocity:?}"), remedy);
        }
        check_rate(path, &format!("frames[{index}].rate_deg_s"), frame.rate_deg_s)?;
        for (key, value) in [("temperature_c", frame.temperature_c), ("pressure_hpa", frame.pressure_hpa)] {
            if let Some(value) = value.filter(|value| !value.is_finite()) {
                return refuse(&format!("frames[{index}].{key}"), value.to_string(), "must be a finite number");
            }
        }
        if !frame.roll_deg.is_finite() {
            return refuse(&format!("frames[{index}].roll_deg"), frame.roll_deg.to_string(), "must be a finite number");
        }
    }
    Ok(())
}

fn check_rate(path: &str, key: &str, rate_deg_s: Option<[f64; 3]>) -> Result<(), SceneError> {
    match rate_deg_s.filter(|rate| !rate.iter().all(|component| component.abs() <= 1e4)) {
        None => Ok(()),
        Some(rate) => Err(SceneError::Value {
            path: path.to_owned(),
            key: key.to_owned(),
            value: format!("{rate:?}"),
            remedy: "must be three numbers in degrees per second, not beyond 10000",
        }),
    }
}
