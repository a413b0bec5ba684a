//! The forms of `recording.toml` and of star lists, from which their JSON Schemas are made. The readers (`manifest`, `star_list`) take files
//! apart by hand, so that a fault has its line; a test here holds the keys of both against each other.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

use super::{FirstRow, Mount, Shutter};

/// The format string that a star list goes by; the list itself bears none, since it is a table.
pub const STAR_LIST_FORMAT: &str = "star-recording/1/star-list";

/// `recording.toml`.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct RecordingFile {
    /// Always `star-recording/1`.
    pub format: String,
    /// The star list that stands in the place of images; the frames then have no `file`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stars: Option<String>,
    /// The camera as its maker or the ground knows it.
    pub camera: RecordingCameraTable,
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

/// `[camera]`.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct RecordingCameraTable {
    /// Columns of a frame.
    #[schemars(range(min = 1, max = 1_048_576))]
    pub width_px: usize,
    /// Rows of a frame.
    #[schemars(range(min = 1, max = 1_048_576))]
    pub height_px: usize,
    /// Distance from pixel to pixel along x and y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_pitch_um: Option<[f64; 2]>,
    /// Focal length as the lens has it engraved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub focal_length_mm: Option<f64>,
    /// Principal distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub focal_length_px: Option<f64>,
    /// Where the optical axis meets the frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub principal_point_px: Option<[f64; 2]>,
    /// Radial distortion, px⁻².
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
    /// Decentring, px⁻¹.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p1: Option<f64>,
    /// Decentring, px⁻¹.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p2: Option<f64>,
    /// Electrons a count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub gain_e_per_dn: Option<f64>,
    /// Counts of no light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bias_dn: Option<f64>,
    /// Read noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0))]
    pub read_noise_e: Option<f64>,
    /// Counts at which a pixel is full.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub saturation_dn: Option<f64>,
    /// Electrons that a star of magnitude 0 gives in a second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub zero_point_e_per_s: Option<f64>,
    /// Whether all rows are exposed at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<Shutter>,
    /// Time from row to row of a rolling shutter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub line_time_us: Option<f64>,
    /// The row that a rolling shutter reads first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first_row: Option<FirstRow>,
    /// The passband of magnitudes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub passband: Option<String>,
}

/// `[mount]`.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct RecordingMountTable {
    /// Free, or fixed to the turning Earth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<Mount>,
}

/// `[site]`.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct RecordingSiteTable {
    /// Latitude, north positive.
    #[schemars(range(min = -90, max = 90))]
    pub latitude_deg: f64,
    /// Longitude, east positive.
    #[schemars(range(min = -180, max = 360))]
    pub longitude_deg: f64,
    /// Height above the ellipsoid; 0 where it is not given.
    #[serde(default)]
    #[schemars(range(min = -1000, max = 100_000))]
    pub height_m: f64,
    /// Air pressure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1200))]
    pub pressure_hpa: Option<f64>,
    /// Air temperature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -150, max = 100))]
    pub temperature_c: Option<f64>,
    /// Relative humidity, 1 = saturated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1))]
    pub relative_humidity: Option<f64>,
}

/// `[[frames]]`.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RecordingFrameTable {
    /// The image, relative to the folder; absent where the recording has a star list, required else.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Middle of the exposure, ISO 8601.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_utc: Option<String>,
    /// Length of the exposure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub exposure_s: Option<f64>,
    /// Temperature of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 1000))]
    pub temperature_c: Option<f64>,
    /// Barycentric velocity of the camera, ICRS axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity_km_s: Option<[f64; 3]>,
    /// Rotation of the camera, camera axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_deg_s: Option<[f64; 3]>,
    /// Quaternion, scalar last: components in ICRS axes to components in camera axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_from_icrs: Option<[f64; 4]>,
    /// Standard error of that attitude about each axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub attitude_sigma_arcsec: Option<f64>,
    /// Where the camera looks, roughly: right ascension and declination.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boresight_radec_deg: Option<[f64; 2]>,
    /// The same as altitude and azimuth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
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

    use super::super::manifest::{CAMERA_KEYS, FRAME_KEYS, MOUNT_KEYS, SITE_KEYS, TOP_KEYS};
    use super::super::star_list::{COLUMNS, REQUIRED};
    use super::*;

    fn keys(schema: &Value) -> BTreeSet<&str> {
        schema["properties"].as_object().unwrap().keys().map(String::as_str).collect()
    }

    fn required(schema: &Value) -> BTreeSet<&str> {
        schema["required"].as_array().unwrap().iter().filter_map(Value::as_str).collect()
    }

    #[test]
    fn the_schemas_have_the_keys_of_the_readers() {
        let schema = schemars::schema_for!(RecordingFile).to_value();
        let of = |names: &[&'static str]| names.iter().copied().collect::<BTreeSet<_>>();
        assert_eq!(keys(&schema), of(TOP_KEYS));
        assert_eq!(required(&schema), of(&["format", "camera"]));
        for (table, known) in [
            ("RecordingCameraTable", CAMERA_KEYS),
            ("RecordingMountTable", MOUNT_KEYS),
            ("RecordingSiteTable", SITE_KEYS),
            ("RecordingFrameTable", FRAME_KEYS),
        ] {
            assert_eq!(keys(&schema["$defs"][table]), of(known), "{table}");
        }
        let row = schemars::schema_for!(StarListRow).to_value();
        assert_eq!(keys(&row), of(&COLUMNS));
        assert_eq!(required(&row), of(&REQUIRED));
    }
}
