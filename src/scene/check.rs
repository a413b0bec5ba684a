//! Every number of a scene file against its range.

use super::{DetectorTable, NominalTable, SceneError, SceneFile, lights, motion};
use crate::camera::Model;
use crate::coordinates::PixelPoint;
use crate::effects::detector::adc::full_scale_dn;
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
    let detector = &file.detector;
    positive("detector.psf_sigma_px", detector.psf_sigma_px)?;
    if !(0.2..=20.0).contains(&detector.psf_sigma_px) {
        return refuse("detector.psf_sigma_px", detector.psf_sigma_px.to_string(), "must lie between 0.2 and 20");
    }
    positive("detector.zero_point_e_per_s", detector.zero_point_e_per_s)?;
    positive("detector.gain_e_per_dn", detector.gain_e_per_dn)?;
    not_negative("detector.bias_dn", detector.bias_dn)?;
    not_negative("detector.read_noise_e", detector.read_noise_e)?;
    positive("detector.full_well_e", detector.full_well_e)?;
    if !(8..=16).contains(&detector.bits) {
        return refuse("detector.bits", detector.bits.to_string(), "must lie between 8 and 16");
    }
    let top_dn = detector.top_dn();
    if !(top_dn <= full_scale_dn(f64::from(detector.bits)) && top_dn > detector.bias_dn) {
        let key = if detector.saturation_dn.is_some() { "detector.saturation_dn" } else { "detector.bits" };
        let value = if detector.saturation_dn.is_some() { top_dn.to_string() } else { detector.bits.to_string() };
        return refuse(
            key,
            value,
            "must put the converter's top above detector.bias_dn and not above 2^bits - 1 (65535 where no bits are given)",
        );
    }
    check_colours(path, detector)?;
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

/// What the electrons have to do with the star's colour.
fn check_colours(path: &str, detector: &DetectorTable) -> Result<(), SceneError> {
    let refuse = |key: &str, value: String, remedy: &'static str| -> Result<(), SceneError> {
        Err(SceneError::Value { path: path.to_owned(), key: format!("detector.{key}"), value, remedy })
    };
    if let Some(term) = detector.colour_term_mag_per_mag.filter(|term| !(term.abs() <= 2.0)) {
        return refuse("colour_term_mag_per_mag", term.to_string(), "must lie between -2 and 2");
    }
    let Some(table) = &detector.quantum_efficiency else { return Ok(()) };
    if detector.colour_term_mag_per_mag.is_some() {
        return refuse("colour_term_mag_per_mag", "given".into(), "stands beside [detector.quantum_efficiency]: keep one of the two");
    }
    check_curve(&table.wavelengths_nm, [("values", Some(&table.values)), ("transmission", table.transmission.as_ref())])
        .or_else(|(name, value, remedy)| refuse(&format!("quantum_efficiency.{name}"), value, remedy))?;
    let seen = |place: usize| table.values[place] * table.transmission.as_ref().map_or(1.0, |values| values[place]);
    if (0..table.values.len()).all(|place| seen(place) == 0.0) {
        return refuse("quantum_efficiency.values", "0 everywhere".into(), "must let some light through");
    }
    Ok(())
}

/// A curve's points: what is wrong with which of them.
fn check_curve<const N: usize>(
    wavelengths_nm: &[f64],
    curves: [(&'static str, Option<&Vec<f64>>); N],
) -> Result<(), (&'static str, String, &'static str)> {
    let is_in_range = |value: &f64| (100.0..=20_000.0).contains(value);
    if wavelengths_nm.len() < 2 || !wavelengths_nm.iter().all(is_in_range) || !wavelengths_nm.is_sorted_by(|a, b| a < b) {
        let remedy = "must be two wavelengths or more, increasing, between 100 and 20000 nm";
        return Err(("wavelengths_nm", format!("{wavelengths_nm:?}"), remedy));
    }
    for (name, values) in curves {
        let Some(values) = values else { continue };
        if values.len() != wavelengths_nm.len() {
            return Err((name, format!("{} numbers", values.len()), "must be as many as wavelengths_nm"));
        }
        if let Some(bad) = values.iter().find(|value| !(0.0..=1.0).contains(*value)) {
            return Err((name, bad.to_string(), "must hold numbers between 0 and 1 only"));
        }
    }
    Ok(())
}
