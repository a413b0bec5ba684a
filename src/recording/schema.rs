//! The forms of `recording.toml` and of star lists: what is read, what is written, and what their JSON Schemas are made from. Only the reader of star
//! lists (`star_list`) takes its columns by hand; a test here holds them against the form.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FirstRow, Mount, Shutter, values};

/// The format string that a star list goes by; the list itself bears none, since it is a table.
pub const STAR_LIST_FORMAT: &str = "star-recording/1/star-list";

/// `recording.toml`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordingFile {
    /// Always `star-recording/1`.
    #[serde(deserialize_with = "values::text")]
    pub format: String,
    /// The star list that stands in the place of images; the frames then have no `file`.
    #[serde(default, deserialize_with = "values::text", skip_serializing_if = "Option::is_none")]
    pub stars: Option<String>,
    /// The camera as its maker or the ground knows it.
    pub camera: CameraInfo,
    /// How it stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<RecordingMountTable>,
    /// Where on the ground it stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<RecordingSiteTable>,
    /// The frames, in order.
    #[serde(default)]
    pub frames: Vec<RecordingFrameTable>,
}

/// `[camera]`: what the maker or the ground calibration said of the camera; it may be wrong.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "CameraTable", description = "`[camera]`.")]
pub struct CameraInfo {
    /// Columns of a frame.
    #[serde(deserialize_with = "values::side_px")]
    #[schemars(range(min = 1, max = 1_048_576))]
    pub width_px: usize,
    /// Rows of a frame.
    #[serde(deserialize_with = "values::side_px")]
    #[schemars(range(min = 1, max = 1_048_576))]
    pub height_px: usize,
    /// Distance from pixel to pixel along x and y.
    #[serde(default, deserialize_with = "values::pitch_um", skip_serializing_if = "Option::is_none")]
    pub pixel_pitch_um: Option<[f64; 2]>,
    /// Focal length as the lens has it engraved.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub focal_length_mm: Option<f64>,
    /// Principal distance; it goes before the focal length in millimetres.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub focal_length_px: Option<f64>,
    /// Where the optical axis meets the frame; its middle if absent.
    #[serde(default, deserialize_with = "values::point_px", skip_serializing_if = "Option::is_none")]
    pub principal_point_px: Option<[f64; 2]>,
    /// Radial distortion, px⁻².
    #[serde(default, deserialize_with = "values::finite", skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
    /// Decentring, px⁻¹.
    #[serde(default, deserialize_with = "values::finite", skip_serializing_if = "Option::is_none")]
    pub p1: Option<f64>,
    /// Decentring, px⁻¹.
    #[serde(default, deserialize_with = "values::finite", skip_serializing_if = "Option::is_none")]
    pub p2: Option<f64>,
    /// Electrons a count.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub gain_e_per_dn: Option<f64>,
    /// Counts of no light.
    #[serde(default, deserialize_with = "values::finite", skip_serializing_if = "Option::is_none")]
    pub bias_dn: Option<f64>,
    /// Read noise.
    #[serde(default, deserialize_with = "values::not_negative", skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0))]
    pub read_noise_e: Option<f64>,
    /// Counts at which a pixel is full.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub saturation_dn: Option<f64>,
    /// Electrons that a star of magnitude 0 gives in a second.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub zero_point_e_per_s: Option<f64>,
    /// Whether all rows are exposed at once.
    #[serde(default, deserialize_with = "values::choice", skip_serializing_if = "Option::is_none")]
    pub shutter: Option<Shutter>,
    /// Time from row to row of a rolling shutter.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub line_time_us: Option<f64>,
    /// The row that a rolling shutter reads first.
    #[serde(default, deserialize_with = "values::choice", skip_serializing_if = "Option::is_none")]
    pub first_row: Option<FirstRow>,
    /// The passband of magnitudes, free text.
    #[serde(default, deserialize_with = "values::text", skip_serializing_if = "Option::is_none")]
    pub passband: Option<String>,
}

/// `[mount]`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordingMountTable {
    /// Free, or fixed to the turning Earth.
    #[serde(default, deserialize_with = "values::choice", skip_serializing_if = "Option::is_none")]
    pub kind: Option<Mount>,
}

/// `[site]`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordingSiteTable {
    /// Latitude, north positive.
    #[serde(deserialize_with = "values::latitude_deg")]
    #[schemars(range(min = -90, max = 90))]
    pub latitude_deg: f64,
    /// Longitude, east positive.
    #[serde(deserialize_with = "values::longitude_deg")]
    #[schemars(range(min = -180, max = 360))]
    pub longitude_deg: f64,
    /// Height above the ellipsoid; 0 where it is not given.
    #[serde(default, deserialize_with = "values::height_m")]
    #[schemars(range(min = -1000, max = 100_000))]
    pub height_m: f64,
    /// Air pressure.
    #[serde(default, deserialize_with = "values::pressure_hpa", skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1200))]
    pub pressure_hpa: Option<f64>,
    /// Air temperature.
    #[serde(default, deserialize_with = "values::air_c", skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -150, max = 100))]
    pub temperature_c: Option<f64>,
    /// Relative humidity, 1 = saturated.
    #[serde(default, deserialize_with = "values::share", skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1))]
    pub relative_humidity: Option<f64>,
}

/// `[[frames]]`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct RecordingFrameTable {
    /// The image, relative to the folder; absent where the recording has a star list, required else.
    #[serde(default, deserialize_with = "values::text", skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Middle of the exposure, ISO 8601.
    #[serde(default, deserialize_with = "values::time_text", skip_serializing_if = "Option::is_none")]
    pub time_utc: Option<String>,
    /// Length of the exposure.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub exposure_s: Option<f64>,
    /// Temperature of the camera.
    #[serde(default, deserialize_with = "values::camera_c", skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 1000))]
    pub temperature_c: Option<f64>,
    /// Barycentric velocity of the camera, ICRS axes.
    #[serde(default, deserialize_with = "values::velocity_km_s", skip_serializing_if = "Option::is_none")]
    pub velocity_km_s: Option<[f64; 3]>,
    /// Rotation of the camera, camera axes.
    #[serde(default, deserialize_with = "values::three", skip_serializing_if = "Option::is_none")]
    pub rate_deg_s: Option<[f64; 3]>,
    /// Quaternion, scalar last: components in ICRS axes to components in camera axes.
    #[serde(default, deserialize_with = "values::quaternion", skip_serializing_if = "Option::is_none")]
    pub camera_from_icrs: Option<[f64; 4]>,
    /// Standard error of that attitude about each axis.
    #[serde(default, deserialize_with = "values::positive", skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub attitude_sigma_arcsec: Option<f64>,
    /// Where the camera looks, roughly: right ascension and declination.
    #[serde(default, deserialize_with = "values::radec_deg", skip_serializing_if = "Option::is_none")]
    pub boresight_radec_deg: Option<[f64; 2]>,
    /// The same as altitude and azimuth.
    #[serde(default, deserialize_with = "values::altitude_azimuth_deg", skip_serializing_if = "Option::is_none")]
    pub altitude_azimuth_deg: Option<[f64; 2]>,
    /// Any other number of telemetry, under its own name.
    #[serde(flatten)]
    pub telemetry: BTreeMap<String, f64>,
}

/// One line of a star list: its columns as keys, an empty field as a key that is absent.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(
    deny_unknown_fields,
    extend("dependentRequired" = {
        "sigma_x_px": ["sigma_y_px"], "sigma_y_px": ["sigma_x_px"], "cov_xy_px2": ["sigma_x_px"], "ra_deg": ["dec_deg"], "dec_deg": ["ra_deg"]
    })
)]
pub struct StarListRow {
    /// Index of the frame, from 0.
    pub frame: usize,
    /// Measured column.
    pub x_px: f64,
    /// Measured row.
    pub y_px: f64,
    /// Electrons of the star.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flux_e: Option<f64>,
    /// Magnitude as measured on board.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub magnitude: Option<f64>,
    /// Standard error of the column.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub sigma_x_px: Option<f64>,
    /// Standard error of the row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub sigma_y_px: Option<f64>,
    /// Covariance of the two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cov_xy_px2: Option<f64>,
    /// Catalogue number; 0 where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hip: Option<u32>,
    /// Right ascension, if the unit has identified the star.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -180, max = 360))]
    pub ra_deg: Option<f64>,
    /// Declination, if the unit has identified the star.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -90, max = 90))]
    pub dec_deg: Option<f64>,
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use serde_json::Value;
    use toml::de::ValueDeserializer;

    use super::super::star_list::{COLUMNS, REQUIRED};
    use super::*;

    #[test]
    fn the_schema_of_star_lists_has_the_columns_of_the_reader() {
        let of = |names: &[&'static str]| names.iter().copied().collect::<BTreeSet<_>>();
        let row = schemars::schema_for!(StarListRow).to_value();
        assert_eq!(row["properties"].as_object().unwrap().keys().map(String::as_str).collect::<BTreeSet<_>>(), of(&COLUMNS));
        assert_eq!(row["required"].as_array().unwrap().iter().filter_map(Value::as_str).collect::<BTreeSet<_>>(), of(&REQUIRED));
    }

    /// Reads a table that holds what it must and this number.
    fn is_read<T: for<'de> Deserialize<'de>>(required: &[(&str, f64)], key: &str, number: f64) -> bool {
        let asked = [(key, number)];
        let lines = required.iter().filter(|(name, _)| *name != key).chain(&asked);
        let text: Vec<String> = lines.map(|(name, number)| format!("{name} = {number}")).collect();
        T::deserialize(ValueDeserializer::parse(&format!("{{{}}}", text.join(", "))).unwrap()).is_ok()
    }

    /// How many numbers of a table have bounds; each is read at its bounds and refused beyond them.
    fn bounded<T: JsonSchema + for<'de> Deserialize<'de>>(required: &[(&str, f64)]) -> usize {
        let schema = schemars::schema_for!(T).to_value();
        let mut count = 0;
        for (key, rule) in schema["properties"].as_object().unwrap() {
            let bounds = [("minimum", -1.0, true), ("maximum", 1.0, true), ("exclusiveMinimum", -1.0, false)];
            let stated = bounds.map(|(word, outward, holds)| rule[word].as_f64().map(|bound| (bound, outward, holds)));
            for (bound, outward, holds) in stated.into_iter().flatten() {
                assert_eq!(is_read::<T>(required, key, bound), holds, "{key} = {bound}");
                assert!(!is_read::<T>(required, key, bound + outward), "{key} = {}", bound + outward);
                assert!(is_read::<T>(required, key, bound - outward), "{key} = {}", bound - outward);
            }
            count += usize::from(stated.iter().any(Option::is_some));
        }
        count
    }

    #[test]
    fn numbers_are_read_within_the_bounds_that_the_schema_states() {
        assert_eq!(bounded::<CameraInfo>(&[("width_px", 12.0), ("height_px", 10.0)]), 9);
        assert_eq!(bounded::<RecordingSiteTable>(&[("latitude_deg", 52.0), ("longitude_deg", 4.0)]), 6);
        assert_eq!(bounded::<RecordingFrameTable>(&[]), 3);
    }
}
