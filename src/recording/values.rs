//! What the values of `recording.toml` must be. Serde reads each through one of these functions; a refusal is a sentence that begins with "must be".

use std::fmt::Display;

use serde::de::value::Error as Unread;
use serde::de::{Deserialize, DeserializeOwned, Deserializer, Error, IntoDeserializer};

/// No camera in the solar system moves faster against its barycentre.
const FASTEST_KM_S: f64 = 1000.0;
/// The largest number of columns or rows.
const MAXIMUM_SIDE_PX: usize = 1 << 20;
/// A quaternion's length may be off one by so much (digits cut off in telemetry).
const QUATERNION_LENGTH_TOLERANCE: f64 = 0.01;

fn refusal<E: Error>(what: impl Display) -> E {
    E::custom(format_args!("must be {what}"))
}

/// A finite number, whole or not, that `accept` accepts; for a key that may be absent or may not.
fn number<'de, D: Deserializer<'de>, T: From<f64>>(value: D, what: impl Display, accept: impl Fn(f64) -> bool) -> Result<T, D::Error> {
    let read = f64::deserialize(value).ok().filter(|number| number.is_finite() && accept(*number));
    read.map(T::from).ok_or_else(|| refusal(what))
}

fn within<'de, D: Deserializer<'de>, T: From<f64>>(value: D, low: f64, high: f64) -> Result<T, D::Error> {
    number(value, format_args!("a number from {low} to {high}"), |number| (low..=high).contains(&number))
}

/// An array of `N` finite numbers that `accept` accepts.
fn numbers<'de, D: Deserializer<'de>, const N: usize>(
    value: D,
    what: &str,
    accept: impl Fn(&[f64; N]) -> bool,
) -> Result<Option<[f64; N]>, D::Error> {
    let read: Option<[f64; N]> = Vec::<f64>::deserialize(value).ok().and_then(|numbers| numbers.try_into().ok());
    let accepted = read.filter(|numbers| numbers.iter().all(|number| number.is_finite()) && accept(numbers));
    accepted.map(Some).ok_or_else(|| refusal(what))
}

fn length(numbers: &[f64]) -> f64 {
    numbers.iter().map(|number| number * number).sum::<f64>().sqrt()
}

pub(super) fn text<'de, D: Deserializer<'de>, T: From<String>>(value: D) -> Result<T, D::Error> {
    String::deserialize(value).map(T::from).map_err(|_| refusal("a text in quotes"))
}

/// A time as text, or written without quotes.
pub(super) fn time_text<'de, D: Deserializer<'de>>(value: D) -> Result<Option<String>, D::Error> {
    match toml::Value::deserialize(value) {
        Ok(toml::Value::String(text)) => Ok(Some(text)),
        Ok(toml::Value::Datetime(time)) => Ok(Some(time.to_string())),
        _ => Err(refusal("a time such as \"2026-03-01T22:15:07.250Z\"")),
    }
}

/// One of the words of an enumeration.
pub(super) fn choice<'de, D: Deserializer<'de>, T: DeserializeOwned>(value: D) -> Result<Option<T>, D::Error> {
    let read = |word: &str| T::deserialize(IntoDeserializer::<Unread>::into_deserializer(word));
    String::deserialize(value).ok().and_then(|word| read(&word).ok()).map(Some).ok_or_else(|| {
        // asked for a word that is none, serde lists those that are: "unknown variant ``, expected `a` or `b`"
        let listed = read("").err().map(|error| error.to_string()).unwrap_or_default();
        refusal(listed.rsplit("expected ").next().unwrap_or_default().replace('`', "\""))
    })
}

pub(super) fn side_px<'de, D: Deserializer<'de>>(value: D) -> Result<usize, D::Error> {
    let read = usize::deserialize(value).ok().filter(|side| (1..=MAXIMUM_SIDE_PX).contains(side));
    read.ok_or_else(|| refusal(format_args!("a whole number from 1 to {MAXIMUM_SIDE_PX}")))
}

pub(super) fn finite<'de, D: Deserializer<'de>>(value: D) -> Result<Option<f64>, D::Error> {
    number(value, "a finite number", |_| true)
}

pub(super) fn positive<'de, D: Deserializer<'de>>(value: D) -> Result<Option<f64>, D::Error> {
    number(value, "a number greater than 0", |number| number > 0.0)
}

pub(super) fn not_negative<'de, D: Deserializer<'de>>(value: D) -> Result<Option<f64>, D::Error> {
    number(value, "a number of 0 or more", |number| number >= 0.0)
}

pub(super) fn latitude_deg<'de, D: Deserializer<'de>>(value: D) -> Result<f64, D::Error> {
    within(value, -90.0, 90.0)
}

pub(super) fn longitude_deg<'de, D: Deserializer<'de>>(value: D) -> Result<f64, D::Error> {
    within(value, -180.0, 360.0)
}

pub(super) fn height_m<'de, D: Deserializer<'de>>(value: D) -> Result<f64, D::Error> {
    within(value, -1000.0, 100_000.0)
}

pub(super) fn pressure_hpa<'de, D: Deserializer<'de>>(value: D) -> Result<Option<f64>, D::Error> {
    within(value, 0.0, 1200.0)
}

/// The temperature of air.
pub(super) fn air_c<'de, D: Deserializer<'de>>(value: D) -> Result<Option<f64>, D::Error> {
    within(value, -150.0, 100.0)
}

/// The temperature of a camera.
pub(super) fn camera_c<'de, D: Deserializer<'de>>(value: D) -> Result<Option<f64>, D::Error> {
    within(value, -273.15, 1000.0)
}

/// A part of a whole.
pub(super) fn share<'de, D: Deserializer<'de>>(value: D) -> Result<Option<f64>, D::Error> {
    within(value, 0.0, 1.0)
}

pub(super) fn pitch_um<'de, D: Deserializer<'de>>(value: D) -> Result<Option<[f64; 2]>, D::Error> {
    numbers(value, "two numbers greater than 0, [x, y]", |pitch| pitch.iter().all(|&um| um > 0.0))
}

pub(super) fn point_px<'de, D: Deserializer<'de>>(value: D) -> Result<Option<[f64; 2]>, D::Error> {
    numbers(value, "two numbers [x, y]", |_| true)
}

pub(super) fn three<'de, D: Deserializer<'de>>(value: D) -> Result<Option<[f64; 3]>, D::Error> {
    numbers(value, "three numbers [x, y, z]", |_| true)
}

pub(super) fn velocity_km_s<'de, D: Deserializer<'de>>(value: D) -> Result<Option<[f64; 3]>, D::Error> {
    let what = "three numbers [x, y, z] in km/s, together below 1000 km/s (is it m/s?)";
    numbers(value, what, |velocity| length(velocity) < FASTEST_KM_S)
}

pub(super) fn quaternion<'de, D: Deserializer<'de>>(value: D) -> Result<Option<[f64; 4]>, D::Error> {
    let what = "a quaternion of length 1, four numbers [x, y, z, scalar]";
    numbers(value, what, |quaternion| (length(quaternion) - 1.0).abs() <= QUATERNION_LENGTH_TOLERANCE)
}

pub(super) fn radec_deg<'de, D: Deserializer<'de>>(value: D) -> Result<Option<[f64; 2]>, D::Error> {
    numbers(value, "[right ascension, declination], from 0 to 360 and -90 to 90", |&[ra, dec]| {
        (-180.0..=360.0).contains(&ra) && (-90.0..=90.0).contains(&dec)
    })
}

pub(super) fn altitude_azimuth_deg<'de, D: Deserializer<'de>>(value: D) -> Result<Option<[f64; 2]>, D::Error> {
    numbers(value, "[altitude, azimuth], from -90 to 90 and -180 to 360", |&[altitude, azimuth]| {
        (-90.0..=90.0).contains(&altitude) && (-180.0..=360.0).contains(&azimuth)
    })
}
