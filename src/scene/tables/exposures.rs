//! `[series]`, `[[frames]]`, `[orbit]` and `[jitter]`: when, where to and how still.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[series]`: exposures at regular times, pointed by chance (from the seed) all over the sky, or with a site over the sky above
/// `lowest_altitude_deg`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SeriesTable {
    /// How many.
    pub count: usize,
    /// Middle of the first exposure, UTC.
    pub start_utc: Option<String>,
    /// From middle to middle.
    #[serde(default)]
    pub interval_s: f64,
    /// Length of each.
    pub exposure_s: f64,
    /// Rate of the camera in its own axes during each exposure.
    pub rate_deg_s: Option<[f64; 3]>,
    /// With a site: the lowest altitude of the boresight.
    #[serde(default = "default_altitude")]
    pub lowest_altitude_deg: f64,
}

fn default_altitude() -> f64 {
    30.0
}

/// `[[frames]]`: one exposure.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FrameTable {
    /// Middle of the exposure, UTC.
    pub time_utc: Option<String>,
    /// Its length.
    pub exposure_s: f64,
    /// Where the boresight points at the middle of the exposure, ICRS axes. It is needed unless the attitude follows from `attitude_samples`
    /// or from a fixed mount and the first exposure.
    pub boresight_radec_deg: Option<[f64; 2]>,
    /// Position angle of the frame's upward direction, north through east.
    #[serde(default)]
    pub roll_deg: f64,
    /// Camera velocity, barycentric, ICRS axes.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Rate of the camera in its own axes: it turns evenly, and the stars are smeared.
    pub rate_deg_s: Option<[f64; 3]>,
    /// Attitudes on the way: `[t, i, j, k, w]`, t in seconds from the middle of the exposure, the quaternion camera_from_icrs. The camera
    /// follows a cubic spline through them.
    #[serde(default)]
    pub attitude_samples: Vec<[f64; 5]>,
    /// Temperature of the optics.
    pub temperature_c: Option<f64>,
    /// Air pressure at the camera.
    pub pressure_hpa: Option<f64>,
    /// Where the zenith stands, ICRS axes: what refraction goes by where no place or no time is given. A recording does not tell it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zenith_radec_deg: Option<[f64; 2]>,
}

/// `[orbit]`: two-line elements, or a state vector at a time. It gives every exposure the velocity of the camera, that of the Earth with it; the few
/// thousand km by which it stands beside the Earth's centre move no star by a tenth of a milliarcsecond and are left out.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OrbitTable {
    /// Both lines of two-line elements, followed by SGP4.
    pub tle: Option<[String; 2]>,
    /// Time of the state, UTC.
    pub epoch_utc: Option<String>,
    /// Position from the Earth's centre, axes of the GCRS.
    pub position_km: Option<[f64; 3]>,
    /// Velocity, axes of the GCRS; an ellipse about the Earth is followed, without what disturbs it.
    pub velocity_km_s: Option<[f64; 3]>,
}

/// `[jitter]`: how the camera trembles, about its own axes x, y, z.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct JitterTable {
    /// Standard deviation of what is faster than any exposure; it widens the images.
    pub sigma_arcsec: [f64; 3],
    /// Lines of the spectrum.
    pub lines: Vec<LineTable>,
    /// Bands of even spectral density.
    pub bands: Vec<BandTable>,
}

/// A line of the jitter's spectrum.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LineTable {
    /// Frequency.
    pub frequency_hz: f64,
    /// Amplitude about each axis.
    pub amplitude_arcsec: [f64; 3],
}

/// A band of the jitter's spectrum.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BandTable {
    /// Lowest frequency.
    pub low_hz: f64,
    /// Highest frequency.
    pub high_hz: f64,
    /// Standard deviation about each axis.
    pub sigma_arcsec: [f64; 3],
}
