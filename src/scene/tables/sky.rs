//! `[sky]` and `[site]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[sky]`: background, depth and physics. Light of the sky by models (zodiacal light, starlight, airglow, moonlight, twilight) is listed in `[[effects]]`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SkyTable {
    /// Sky background, even over the frame. If absent, 50, or 0 where the sky's light is given by an image or by models.
    pub background_e_per_px_s: Option<f64>,
    /// An image (FITS, TIFF, PNG, …) of the size of the frame whose values, times the scale, are a background in electrons per pixel and second.
    /// A path that is not absolute begins at the folder of the scene.
    pub background_image: Option<String>,
    /// Electrons per pixel and second of a value of 1 in that image.
    pub background_image_scale: f64,
    /// Extinction of the air in the V band, magnitudes per air mass, for light of the sky by models; without a site there is no air.
    pub extinction_mag_per_airmass: f64,
    /// Faintest V magnitude rendered.
    pub faintest_magnitude: f64,
    /// Which displacements act at their full, known size: `known`, `none` or a list of effects.
    pub physics: String,
}

impl Default for SkyTable {
    fn default() -> Self {
        Self {
            background_e_per_px_s: None,
            background_image: None,
            background_image_scale: 1.0,
            extinction_mag_per_airmass: 0.172,
            faintest_magnitude: 9.0,
            physics: "known".into(),
        }
    }
}

/// `[site]`: as in a recording. Stars below its horizon have no image.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SiteTable {
    /// Geodetic latitude.
    pub latitude_deg: f64,
    /// Longitude, east positive.
    pub longitude_deg: f64,
    /// Height.
    #[serde(default)]
    pub height_m: f64,
    /// Air pressure.
    pub pressure_hpa: Option<f64>,
    /// Air temperature.
    pub temperature_c: Option<f64>,
    /// Relative humidity, 0…1.
    pub relative_humidity: Option<f64>,
}
