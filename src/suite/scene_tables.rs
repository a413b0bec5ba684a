//! The tables of a scene: values that are set by path, and exposures in the place of its own.

use hifitime::{Epoch, Unit};
use toml::{Table, Value};

use crate::camera::observation;
use crate::coordinates::Attitude;
use crate::dataset::{PlaceKind, ScenePath};
use crate::scene::SiteTable;

/// A path with `[2]` as `.2`.
pub(super) fn dotted(path: &str) -> String {
    path.replace('[', ".").replace(']', "")
}

/// Sets a value; an effect or a table is switched on and off by a truth value.
pub(super) fn put(path: &ScenePath, tables: &mut Table, value: &Value) -> Result<(), String> {
    match (&path.kind, value) {
        (PlaceKind::Effect | PlaceKind::Table, Value::Boolean(is_on)) => path.switch(tables, *is_on),
        (PlaceKind::Number, Value::Integer(number)) => path.set(tables, Value::Float(*number as f64)),
        _ => path.set(tables, value.clone()),
    }
}

/// Whether a scene's exposures can be pointed elsewhere.
pub(super) fn check_pointable(tables: &Table) -> Result<(), String> {
    let as_it_is = "write attitudes = \"scene\", which leaves its exposures as they are";
    if tables.get("mount").and_then(|mount| mount.get("kind")).and_then(Value::as_str) == Some("fixed") {
        return Err(format!("the scene's camera stands fixed on the ground and cannot be pointed; {as_it_is}"));
    }
    let follows = |frame: &Value| frame.get("attitude_samples").and_then(Value::as_array).is_some_and(|samples| !samples.is_empty());
    if templates(tables).iter().any(|frame| follows(&Value::Table(frame.clone()))) {
        return Err(format!("the scene's exposures follow attitude_samples and cannot be pointed; {as_it_is}"));
    }
    if templates(tables).is_empty() {
        return Err("the scene has neither [[frames]] nor [series]; write one exposure into it".to_owned());
    }
    Ok(())
}

/// Gives a scene with a series an exposure that paths lead to; the series goes on to tell the times.
pub(super) fn list_exposures(tables: &mut Table) {
    if !tables.contains_key("frames") {
        let made: Vec<Value> = templates(tables).into_iter().map(Value::Table).collect();
        if !made.is_empty() {
            tables.insert("frames".to_owned(), Value::Array(made));
        }
    }
}

/// The exposures of a scene that frames are made after.
pub(super) fn templates(tables: &Table) -> Vec<Table> {
    if let Some(frames) = tables.get("frames").and_then(Value::as_array) {
        return frames.iter().filter_map(|frame| frame.as_table().cloned()).collect();
    }
    let Some(series) = tables.get("series").and_then(Value::as_table) else { return Vec::new() };
    let mut frame = Table::new();
    for key in ["exposure_s", "rate_deg_s"] {
        if let Some(value) = series.get(key) {
            frame.insert(key.to_owned(), value.clone());
        }
    }
    vec![frame]
}

/// The time of a frame of a series.
pub(super) fn series_time(tables: &Table, number: usize) -> Option<String> {
    let series = tables.get("series")?;
    let start: Epoch = series.get("start_utc")?.as_str()?.parse().ok()?;
    let interval = series.get("interval_s");
    let interval_s = interval.and_then(|value| value.as_float().or(value.as_integer().map(|whole| whole as f64))).unwrap_or(0.0);
    // A series that runs for years would leave the range of the ephemeris: it begins anew after a day.
    let seconds = (interval_s * number as f64) % 86_400.0;
    Some((start + seconds * Unit::Second).to_isoformat() + "Z")
}

/// The zenith of a frame, where the scene has a site and a time.
pub(super) fn zenith(tables: &Table, time_utc: Option<&str>) -> Option<[f64; 3]> {
    let site: SiteTable = tables.get("site")?.clone().try_into().ok()?;
    let time: Epoch = time_utc?.parse().ok()?;
    observation(Some(time), Some(&site.ground_site()), None).ok()?.zenith
}

/// The text of a scene with these attitudes and numbers of frames in the place of its own exposures.
pub(super) fn with_frames(tables: &Table, frames: &[(Attitude, usize)], keeps_exposures: bool) -> String {
    let mut scene = tables.clone();
    if !keeps_exposures {
        let all = templates(tables);
        let made = frames.iter().map(|(attitude, number)| {
            let mut frame = all.get(number % all.len().max(1)).cloned().unwrap_or_default();
            let [ra, dec, roll] = attitude.pointing_rad().map(f64::to_degrees);
            frame.insert("boresight_radec_deg".to_owned(), Value::Array(vec![Value::Float(ra.rem_euclid(360.0)), Value::Float(dec)]));
            frame.insert("roll_deg".to_owned(), Value::Float(roll));
            if let Some(time) = series_time(tables, *number) {
                frame.insert("time_utc".to_owned(), Value::String(time));
            }
            Value::Table(frame)
        });
        let made: Vec<Value> = made.collect();
        scene.remove("series");
        scene.insert("frames".to_owned(), Value::Array(made));
        scene.insert("first_frame".to_owned(), Value::Integer(frames.first().map_or(0, |(_, number)| number.cast_signed() as i64)));
    }
    toml::to_string(&scene).unwrap_or_default()
}
