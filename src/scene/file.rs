//! The scene file: its tables and their defaults.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{
    BinningTable, CosmicRayTable, DetectorTable, EffectTable, GhostTable, JitterTable, OrbitTable, PsfTable, SceneError, StreakTable,
};
use crate::camera::{Camera, Model};
use crate::coordinates::{Direction, Icrs};
use crate::effects::Observation;
use crate::guard::{Panicked, guarded};
use crate::recording::{FirstRow, Mount};
use crate::toml_file::{Lines, suggestion, unknown_field};
use crate::units::DEG_RAD;

/// The scene that `boresight demo` renders.
pub const DEMO_TOML: &str = include_str!("demo.toml");

/// A scene as written.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Always `boresight-scene/1`.
    pub format: String,
    /// Seed of all random draws.
    #[serde(default)]
    pub seed: u64,
    /// The true camera.
    pub camera: TrueCameraTable,
    /// What the recording declares instead of the truth.
    #[serde(default)]
    pub nominal: NominalTable,
    /// The true detector and PSF.
    #[serde(default)]
    pub detector: DetectorTable,
    /// The true sky.
    #[serde(default)]
    pub sky: SkyTable,
    /// The place on the ground.
    pub site: Option<SiteTable>,
    /// The orbit of a camera in space.
    pub orbit: Option<OrbitTable>,
    /// How the light of a star is spread; if absent, as a Gaussian of `detector.psf_sigma_px`.
    pub psf: Option<PsfTable>,
    /// How the camera stands.
    pub mount: Option<MountTable>,
    /// Ghosts of bright stars.
    #[serde(default)]
    pub ghosts: Vec<GhostTable>,
    /// Trails of satellites and meteors.
    #[serde(default)]
    pub streaks: Vec<StreakTable>,
    /// Particles that cross the detector.
    pub cosmic_rays: Option<CosmicRayTable>,
    /// How it trembles.
    pub jitter: Option<JitterTable>,
    /// Effects with parameters of their own.
    #[serde(default)]
    pub effects: Vec<EffectTable>,
    /// Exposures at regular times, pointed by chance.
    pub series: Option<SeriesTable>,
    /// Exposures one by one.
    #[serde(default)]
    pub frames: Vec<FrameTable>,
}

/// `[camera]`: the truth, in the units of the reference model.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrueCameraTable {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Focal length.
    pub focal_length_px: f64,
    /// Principal point; the middle of the frame if absent.
    pub principal_point_px: Option<[f64; 2]>,
    /// Radial distortion, px⁻².
    #[serde(default)]
    pub k1: f64,
    /// Decentring distortion, px⁻¹.
    #[serde(default)]
    pub p1: f64,
    /// Decentring distortion, px⁻¹.
    #[serde(default)]
    pub p2: f64,
    /// The detector's own pixels are joined into those that this scene describes.
    pub binning: Option<BinningTable>,
    /// How the lens maps angles to the focal plane: `pinhole` (if absent), `equidistant`, `equisolid`, `stereographic`, `kannala-brandt`.
    pub projection: Option<String>,
    /// What the projection has beyond focal length and principal point: k1 … k4 of `kannala-brandt`.
    #[serde(default)]
    pub projection_parameters: Vec<f64>,
    /// With a rolling shutter, the time from one row to the next; a global shutter if absent.
    pub line_time_us: Option<f64>,
    /// The row that a rolling shutter reads first: `top` (row 0, also if absent) or `bottom`.
    pub first_row: Option<FirstRow>,
}

/// `[mount]`: how the camera stands.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MountTable {
    /// `free`: each exposure has its own attitude. `fixed`: the camera stands fast on the ground as in the first exposure, and the Earth turns.
    pub kind: Mount,
}

/// `[nominal]`: what the recording says of the camera. What is absent is said truly, but for the distortion and the principal point, of
/// which a maker says nothing: they are 0 and the middle of the frame.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NominalTable {
    /// Focal length.
    pub focal_length_px: Option<f64>,
    /// Principal point.
    pub principal_point_px: Option<[f64; 2]>,
    /// Radial distortion, px⁻².
    pub k1: Option<f64>,
    /// Decentring distortion, px⁻¹.
    pub p1: Option<f64>,
    /// Decentring distortion, px⁻¹.
    pub p2: Option<f64>,
    /// Time from row to row of a rolling shutter.
    pub line_time_us: Option<f64>,
}

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
    /// Which displacements act at their full, known size: `predicted`, `none` or a list of effects.
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

impl SkyTable {
    /// The background that is even over the frame, electrons per pixel and second.
    #[must_use]
    pub fn even_e_per_px_s(&self) -> f64 {
        /// Of a dark sky, a fast lens and pixels of an arcminute.
        const USUAL: f64 = 50.0;
        self.background_e_per_px_s.unwrap_or(if self.background_image.is_some() { 0.0 } else { USUAL })
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

impl FrameTable {
    /// What is known of the exposure, with the zenith that is written for it.
    pub(super) fn under_its_zenith(&self, known: &Observation) -> Observation {
        let Some([ra_deg, dec_deg]) = self.zenith_radec_deg else { return *known };
        let zenith = Direction::<Icrs>::from_radec_rad(ra_deg * DEG_RAD, dec_deg * DEG_RAD).xyz;
        Observation { zenith: Some(zenith), zenith_is_guessed: true, ..*known }
    }
}

impl TrueCameraTable {
    /// The true camera.
    pub(super) fn camera(&self) -> Camera {
        let mut camera = Camera::pinhole(self.width_px, self.height_px, self.focal_length_px);
        camera.principal_point_px = self.principal_point_px.unwrap_or(camera.principal_point_px);
        Camera { k1: self.k1, p1: self.p1, p2: self.p2, ..camera }
    }

    /// The same with what is declared of it in its place.
    pub(super) fn declared(&self, nominal: &NominalTable) -> Self {
        let Camera { focal_length_px, principal_point_px, k1, p1, p2, .. } = nominal.camera(&self.camera());
        Self { focal_length_px, principal_point_px: Some(principal_point_px), k1, p1, p2, ..self.clone() }
    }

    /// The same with its projection.
    pub(super) fn model(&self, path: &str) -> Result<Model, SceneError> {
        self.projected(path, self.camera())
    }

    /// The same without distortion.
    pub(super) fn undisplaced(&self, path: &str) -> Result<Model, SceneError> {
        self.projected(path, Camera { k1: 0.0, p1: 0.0, p2: 0.0, ..self.camera() })
    }

    fn projected(&self, path: &str, camera: Camera) -> Result<Model, SceneError> {
        let Some(id) = &self.projection else { return Ok(Model::new(camera)) };
        Model::new(camera).with_projection(id, &self.projection_parameters).map_err(|error| SceneError::Parse {
            path: path.to_owned(),
            message: format!("camera.projection = {id:?}: {error}; use pinhole, equidistant, equisolid, stereographic or kannala-brandt"),
        })
    }
}

impl NominalTable {
    /// The declared camera.
    pub(super) fn camera(&self, truth: &Camera) -> Camera {
        let f = self.focal_length_px.unwrap_or(truth.focal_length_px);
        let mut camera = Camera::pinhole(truth.width_px, truth.height_px, f);
        camera.principal_point_px = self.principal_point_px.unwrap_or(camera.principal_point_px);
        Camera { k1: self.k1.unwrap_or(0.0), p1: self.p1.unwrap_or(0.0), p2: self.p2.unwrap_or(0.0), ..camera }
    }
}

/// Reads the tables.
pub(super) fn parse(path: &str, text: &str) -> Result<SceneFile, SceneError> {
    let unreadable = |panicked: Panicked| SceneError::Parse { path: path.to_owned(), message: panicked.to_string() };
    guarded(|| toml::from_str(text)).map_err(unreadable)?.map_err(|error: toml::de::Error| {
        let line = Lines::new(text).line(error.span().map_or(0, |span| span.start));
        let message = format!("line {line}: {}", with_suggestion(error.message()));
        SceneError::Parse { path: path.to_owned(), message }
    })
}

/// Turns serde's "unknown field `x`, expected one of `a`, `b`" into a sentence with a suggestion.
fn with_suggestion(message: &str) -> String {
    let Some((given, known)) = unknown_field(message) else { return message.replace('\n', " ") };
    match suggestion(given, &known) {
        Some(known) => format!("unknown key {given}; did you mean {known}?"),
        None => message.replacen("unknown field", "unknown key", 1),
    }
}
