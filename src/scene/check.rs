//! Range checks of every number of a scene file.

use super::{FrameTable, SceneError, SceneFile, SeriesTable, TrueCameraTable, binning, detector, lights, motion};
use crate::camera::Model;
use crate::coordinates::PixelPoint;
use crate::effects::{displacement, id_of};
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

/// What a number may be.
#[derive(Clone, Copy, Debug)]
enum Rule {
    Finite,
    NotNegative,
    /// Between two numbers, or else this.
    Within(f64, f64, &'static str),
}

/// Why something is no air.
const NO_AIR: &str = "is no air on Earth: hPa from 0 to 2000, degrees from -150 to 100, humidity from 0 to 1";
/// More than the sky turns in a day; less than light needs to a detector.
const EXPOSURE: Rule = Rule::Within(1e-9, 1e5, "must lie between 1e-9 and 100000 s");
/// From a whole sky on a pixel to a hundredth of an arcsecond.
const FOCAL_LENGTH: Rule = Rule::Within(1e-2, 1e8, "must lie between 0.01 and 1e8 px");
const LINE_TIME: &str = "must lie between 0 and 1000000 (first_row says in which direction rows are read)";
const COORDINATE: &str = "must be a point in px, not further than 100000 from the corner";

/// Every number of the tables that stand once in a file, with its key; `None`: it is not given. The detector's stand with its table.
fn numbers(file: &SceneFile) -> Vec<(&'static str, Option<f64>, Rule)> {
    use Rule::{Finite, NotNegative, Within};
    let SceneFile { camera, nominal, sky, site, series, .. } = file;
    let size = Within(16.0, 16_384.0, "must lie between 16 and 16384");
    let mut numbers = vec![
        ("camera.width_px", Some(camera.width_px as f64), size),
        ("camera.height_px", Some(camera.height_px as f64), size),
        ("camera.focal_length_px", Some(camera.focal_length_px), FOCAL_LENGTH),
        ("camera.k1", Some(camera.k1), Finite),
        ("camera.p1", Some(camera.p1), Finite),
        ("camera.p2", Some(camera.p2), Finite),
        ("nominal.k1", nominal.k1, Finite),
        ("nominal.p1", nominal.p1, Finite),
        ("nominal.p2", nominal.p2, Finite),
        ("nominal.focal_length_px", nominal.focal_length_px, FOCAL_LENGTH),
        ("camera.line_time_us", camera.line_time_us, Within(0.0, 1e6, LINE_TIME)),
        ("nominal.line_time_us", nominal.line_time_us, Within(0.0, 1e6, LINE_TIME)),
        ("sky.background_e_per_px_s", Some(sky.even_e_per_px_s()), Within(0.0, 1e12, "must lie between 0 and 1e12")),
        ("sky.background_image_scale", Some(sky.background_image_scale), NotNegative),
        ("sky.extinction_mag_per_airmass", Some(sky.extinction_mag_per_airmass), Within(0.0, 10.0, "must lie between 0 and 10")),
        ("sky.faintest_magnitude", Some(sky.faintest_magnitude), Finite),
    ];
    if let Some(site) = site {
        numbers.extend([
            ("site.latitude_deg", Some(site.latitude_deg), Within(-90.0, 90.0, "must lie between -90 and 90")),
            ("site.longitude_deg", Some(site.longitude_deg), Within(-360.0, 360.0, "must lie between -360 and 360")),
            ("site.height_m", Some(site.height_m), Within(-500.0, 20_000.0, "must lie between -500 and 20000")),
            ("site.pressure_hpa", site.pressure_hpa, Within(0.0, 2000.0, NO_AIR)),
            ("site.temperature_c", site.temperature_c, Within(-150.0, 100.0, NO_AIR)),
            ("site.relative_humidity", site.relative_humidity, Within(0.0, 1.0, NO_AIR)),
        ]);
    }
    numbers.extend(series.iter().flat_map(series_numbers));
    numbers
}

/// Those of a series.
fn series_numbers(series: &SeriesTable) -> [(&'static str, Option<f64>, Rule); 4] {
    use Rule::Within;
    let altitude = Within(-90.0, 85.0, "must lie between -90 and 85");
    [
        ("series.count", Some(series.count as f64), Within(1.0, 1e6, "must lie between 1 and 1000000")),
        ("series.exposure_s", Some(series.exposure_s), EXPOSURE),
        ("series.interval_s", Some(series.interval_s), Within(0.0, 1e9, "must lie between 0 and 1000000000 s")),
        ("series.lowest_altitude_deg", Some(series.lowest_altitude_deg), altitude),
    ]
}

/// Checks a series by itself: in a dataset the rest of the scene is drawn before it is whole.
pub(super) fn series_alone(path: &str, series: &SeriesTable) -> Result<(), SceneError> {
    let refusal = Refusal(path);
    for (key, value, rule) in series_numbers(series) {
        value.map_or(Ok(()), |value| refusal.number(key, value, rule))?;
    }
    refusal.rate("series.rate_deg_s", series.rate_deg_s)
}

/// A number as a message shows it: without a hundred zeros.
pub(super) fn shown(value: f64) -> String {
    if value == 0.0 || (1e-6..1e16).contains(&value.abs()) { value.to_string() } else { format!("{value:e}") }
}

/// Says what is wrong in which file.
struct Refusal<'a>(&'a str);

impl Refusal<'_> {
    fn refuse(&self, key: &str, value: String, remedy: &'static str) -> Result<(), SceneError> {
        Err(SceneError::Value { path: self.0.to_owned(), key: key.to_owned(), value, remedy })
    }

    fn number(&self, key: &str, value: f64, rule: Rule) -> Result<(), SceneError> {
        let (is_allowed, remedy) = match rule {
            Rule::Finite => (value.is_finite(), "must be a finite number"),
            Rule::NotNegative => (value.is_finite() && value >= 0.0, "must be a number not below 0"),
            Rule::Within(low, high, remedy) => ((low..=high).contains(&value), remedy),
        };
        if is_allowed { Ok(()) } else { self.refuse(key, shown(value), remedy) }
    }

    fn rate(&self, key: &str, rate_deg_s: Option<[f64; 3]>) -> Result<(), SceneError> {
        match rate_deg_s.filter(|rate| !rate.iter().all(|component| component.abs() <= 1e4)) {
            None => Ok(()),
            Some(rate) => self.refuse(key, format!("{rate:?}"), "must be three numbers in degrees per second, not beyond 10000"),
        }
    }
}

/// Checks every number against its range, and what excludes one another.
pub(super) fn check(path: &str, file: &SceneFile) -> Result<(), SceneError> {
    let refusal = Refusal(path);
    if file.format != "boresight-scene/1" {
        return refusal.refuse("format", format!("{:?}", file.format), "must be \"boresight-scene/1\"");
    }
    for (key, value, rule) in numbers(file) {
        value.map_or(Ok(()), |value| refusal.number(key, value, rule))?;
    }
    check_camera(&refusal, file)?;
    detector::check(path, &file.detector)?;
    binning::check(path, &file.camera, &file.detector)?;
    if let Some(jitter) = &file.jitter {
        motion::check(path, jitter)?;
    }
    lights::check(path, &file.ghosts, &file.streaks, file.cosmic_rays.as_ref())?;
    match (&file.series, file.frames.is_empty()) {
        (None, true) => return refusal.refuse("frames", "none".into(), "exist: add a [series] or one [[frames]] for each exposure"),
        (Some(_), false) => return refusal.refuse("series", "given".into(), "stands beside [[frames]]: keep one of the two"),
        _ => {}
    }
    let is_fixed = file.mount.is_some_and(|mount| mount.kind == Mount::Fixed);
    if let Some(series) = &file.series {
        check_series(&refusal, series, is_fixed)?;
    }
    file.frames.iter().enumerate().try_for_each(|(index, frame)| check_frame(&refusal, index, frame, [is_fixed, file.site.is_some()]))
}

/// The two cameras.
fn check_camera(refusal: &Refusal<'_>, file: &SceneFile) -> Result<(), SceneError> {
    let SceneFile { camera, nominal, .. } = file;
    let points = [("camera.principal_point_px", camera.principal_point_px), ("nominal.principal_point_px", nominal.principal_point_px)];
    for (key, point) in points {
        if let Some([x, y]) = point.filter(|point| !point.iter().all(|place| place.abs() <= 1e5)) {
            return refusal.refuse(key, format!("[{x}, {y}]"), COORDINATE);
        }
    }
    if camera.projection.is_none() && !camera.projection_parameters.is_empty() {
        let remedy = "need a projection that has them: set camera.projection";
        return refusal.refuse("camera.projection_parameters", format!("{:?}", camera.projection_parameters), remedy);
    }
    check_projection(refusal, camera)?;
    for (key, model) in [("camera", camera.model(refusal.0)?), ("nominal", camera.declared(nominal).model(refusal.0)?)] {
        if folds_over(&model) {
            let camera = model.camera();
            let value = format!("[k1 = {}, p1 = {}, p2 = {}]", camera.k1, camera.p1, camera.p2);
            let remedy = "is so strong a distortion that the image folds over within the frame; choose smaller values";
            return refusal.refuse(key, value, remedy);
        }
    }
    if camera.line_time_us.is_some() && file.effects.iter().any(|effect| id_of(&effect.id) == super::ROLLING_SHUTTER) {
        return refusal.refuse("camera.line_time_us", "given".into(), "stands beside the effect rolling-shutter: keep one of the two");
    }
    Ok(())
}

/// The projection's own parameters are those of a lens: others bring a frame of light together in a pixel, which takes for ever to draw.
fn check_projection(refusal: &Refusal<'_>, camera: &TrueCameraTable) -> Result<(), SceneError> {
    let specs = camera.projection.as_deref().and_then(displacement).map_or(&[][..], |effect| effect.parameters());
    let own = specs.iter().filter(|spec| !["x0", "y0", "f"].contains(&spec.name));
    for (spec, value) in own.zip(&camera.projection_parameters) {
        if !(spec.range.0..=spec.range.1).contains(value) {
            let remedy = "is no lens's: keep to the range that `boresight effects` has for the parameters of the projection";
            return refusal.refuse("camera.projection_parameters", format!("{} = {value}", spec.name), remedy);
        }
    }
    Ok(())
}

fn is_turning(rate: Option<[f64; 3]>) -> bool {
    rate.is_some_and(|rate| rate != [0.0; 3])
}

fn check_series(refusal: &Refusal<'_>, series: &SeriesTable, is_fixed: bool) -> Result<(), SceneError> {
    refusal.rate("series.rate_deg_s", series.rate_deg_s)?;
    if is_fixed && is_turning(series.rate_deg_s) {
        return refusal.refuse("series.rate_deg_s", "given".into(), "stands beside a fixed mount: keep one of the two");
    }
    Ok(())
}

fn check_frame(refusal: &Refusal<'_>, index: usize, frame: &FrameTable, [is_fixed, has_site]: [bool; 2]) -> Result<(), SceneError> {
    let key = |name: &str| format!("frames[{index}].{name}");
    let numbers = [
        ("exposure_s", Some(frame.exposure_s), EXPOSURE),
        ("roll_deg", Some(frame.roll_deg), Rule::Finite),
        ("temperature_c", frame.temperature_c, Rule::Finite),
        ("pressure_hpa", frame.pressure_hpa, Rule::Finite),
    ];
    for (name, value, rule) in numbers {
        value.map_or(Ok(()), |value| refusal.number(&key(name), value, rule))?;
    }
    let follows = !frame.attitude_samples.is_empty() || (is_fixed && index > 0);
    if frame.boresight_radec_deg.is_some() == follows {
        let (value, remedy) = if follows {
            ("given", "is not free: the attitude follows from the samples or from the fixed mount; leave it out")
        } else {
            ("none", "must say where the boresight points at the middle of the exposure, or attitude_samples must")
        };
        return refusal.refuse(&key("boresight_radec_deg"), value.into(), remedy);
    }
    if !frame.attitude_samples.is_empty() && (is_fixed || frame.rate_deg_s.is_some()) {
        return refusal.refuse(&key("attitude_samples"), "given".into(), "stand beside a rate or a fixed mount: keep one of them");
    }
    if is_fixed && is_turning(frame.rate_deg_s) {
        return refusal.refuse(&key("rate_deg_s"), "given".into(), "stands beside a fixed mount: keep one of the two");
    }
    let [ra, dec] = frame.boresight_radec_deg.unwrap_or_default();
    if !ra.is_finite() || !(-90.0..=90.0).contains(&dec) {
        let remedy = "must be right ascension and declination in degrees, the latter between -90 and 90";
        return refusal.refuse(&key("boresight_radec_deg"), format!("[{ra}, {dec}]"), remedy);
    }
    if let Some([ra, dec]) = frame.zenith_radec_deg {
        if !ra.is_finite() || !(-90.0..=90.0).contains(&dec) {
            let remedy = "must be right ascension and declination in degrees, the latter between -90 and 90";
            return refusal.refuse(&key("zenith_radec_deg"), format!("[{ra}, {dec}]"), remedy);
        }
        if has_site && frame.time_utc.is_some() {
            let remedy = "stands beside [site] and the time of the frame, which tell the zenith: keep one of the two";
            return refusal.refuse(&key("zenith_radec_deg"), format!("[{ra}, {dec}]"), remedy);
        }
    }
    if let Some(velocity) = frame.velocity_km_s.filter(|velocity| !velocity.iter().all(|v| v.abs() < 3e5)) {
        let remedy = "must be three numbers in km/s, each below the speed of light";
        return refusal.refuse(&key("velocity_km_s"), format!("{velocity:?}"), remedy);
    }
    refusal.rate(&key("rate_deg_s"), frame.rate_deg_s)
}
