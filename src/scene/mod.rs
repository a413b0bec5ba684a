//! Scene: a camera, its sky and its exposures, read from a TOML file.
//!
//! A scene keeps two cameras apart: `[camera]` is the truth, which is rendered; `[nominal]` is what the maker said of it, which
//! the recording declares and which may be wrong.

mod binning;
mod check;
mod dark_frame;
mod declared;
mod detector;
#[cfg(feature = "bench")]
pub mod effect_demo;
mod effects;
#[cfg(feature = "bench")]
mod effects_told;
mod exposures;
mod file;
mod lights;
mod motion;
mod orbit;
mod pointing;
mod presets;
mod psf;
mod psf_table;
mod quadrature;
mod schema;
mod sky_light;
mod spline;
mod tables;
mod track;
mod work;

use hifitime::Epoch;
use thiserror::Error;

pub use exposures::Exposures;
pub use psf::PsfKind;
pub use schema::schema;
pub use tables::{
    BandTable, BinningMethod, BinningSite, BinningTable, ColourFiltersTable, CosmicRayTable, DetectorTable, EffectTable, FrameTable,
    GhostTable, JitterTable, LineTable, MountTable, NominalTable, OrbitTable, PixelTable, PsfTable, QuantumEfficiencyTable, SceneFile,
    SeriesTable, SiteTable, SkyTable, StreakKind, StreakTable, TrueCameraTable, VaryTable,
};
inner!(declared::{declared_entry, declared_recording});
inner!(schema::FORMAT);
inner!(schema::schema_of_type);
inner!(file::DEMO_TOML);
inner!(lights::{LIGHT_PAGES, LightForm, LightKind, LightPage, OtherLight});
inner!(motion::{EARTH_RATE_RAD_S, Motion});
inner!(presets::{ListedPreset, PRESET_FORMAT, PRESETS, Preset, PresetList, preset});
inner!(psf::{Psf, PsfNodes, Spot, Third});
inner!(spline::RotationSpline);
inner!(track::{Sample, StarTrack});

use dark_frame::DarkFrame;
use sky_light::SkyLight;

use crate::camera::{Camera, GroundSite, Model, ObserverError, Physics, PhysicsError, SkyChain, Term};
use crate::coordinates::{Attitude, PixelPoint};
use crate::effects::detector::colour_filters::FilterResponse;
use crate::effects::detector::quantum_efficiency::ColourResponse;
use crate::effects::ids;
pub use crate::imaging::{Binning, BinningPlace, EffectSetting};
use crate::recording::{CameraInfo, FirstRow, FrameEntry, Mount, Recording, Shutter, Site};
use crate::units::DEG_RAD;

/// What is wrong with a scene.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The file cannot be read.
    #[error("{path}: the scene cannot be read ({source})")]
    Read {
        /// The file.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file is no TOML, or has a key or a type that a scene does not know.
    #[error("{path}: {message}")]
    Parse {
        /// The file.
        path: String,
        /// Line, key and remedy.
        message: String,
    },
    /// A value lies outside its range.
    #[error("{path}: {key} = {value} {remedy}")]
    Value {
        /// The file.
        path: String,
        /// The key.
        key: String,
        /// The value given.
        value: String,
        /// What is allowed.
        remedy: &'static str,
    },
    /// An effect named in `physics` is unknown or cannot be computed.
    #[error("{path}: sky.physics: {source}")]
    Physics {
        /// The file.
        path: String,
        /// What is wrong with it.
        source: PhysicsError,
    },
    /// A time outside the range of the Earth's ephemeris.
    #[error("{path}: {source}")]
    Time {
        /// The file.
        path: String,
        /// The time.
        source: ObserverError,
    },
}

/// The displacement that a scene's shutter is, when the camera turns.
const ROLLING_SHUTTER: &str = ids::ROLLING_SHUTTER;

/// A scene ready to be rendered.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Seed of all random draws.
    pub seed: u64,
    /// Number of the first exposure among all that the camera takes.
    pub first_frame: u32,
    /// The true camera.
    pub camera: Camera,
    /// The true camera with the effects behind the lens.
    pub model: Model,
    /// The same without the shutter, which [`Scene::star_tracks`] follows itself.
    optics: Model,
    /// The true projection, focal length and principal point without any displacement.
    undisplaced: Model,
    /// How much later each row of a higher number is exposed; 0 with a global shutter.
    pub line_time_s: f64,
    /// What the recording declares as the time from row to row of a rolling shutter, µs.
    pub nominal_line_time_us: Option<f64>,
    /// The row that is read first, where it is known.
    pub first_row: Option<FirstRow>,
    /// Whether the camera stands fast on the ground.
    pub is_fixed: bool,
    /// The camera as the recording declares it.
    pub nominal: Camera,
    /// The true detector; its PSF is the width that stands for [`Self::psf`].
    pub detector: DetectorTable,
    /// How the detector's own pixels are joined into those of the frame.
    pub binning: Option<Binning>,
    /// How the electrons of a star follow its colour.
    pub colour_response: ColourResponse,
    /// How the filters of a mosaic share a star's light.
    pub colour_filters: Option<FilterResponse>,
    /// The same as [`Self::psf`] on the detector's own pixels, of which several may be joined into one of the frame.
    pub own_psf: Psf,
    /// How the light of a star is spread.
    pub psf: Psf,
    /// The same as written, if it was.
    pub psf_table: Option<PsfTable>,
    /// A real dark frame in the place of read noise.
    pub(crate) dark_frame: Option<DarkFrame>,
    /// Ghosts of bright stars.
    pub ghosts: Vec<GhostTable>,
    /// Trails of satellites and meteors.
    pub streaks: Vec<StreakTable>,
    /// Particles that cross the detector.
    pub cosmic_rays: Option<CosmicRayTable>,
    /// The true sky.
    pub sky: SkyTable,
    /// What lights the sky between the stars unevenly.
    sky_light: SkyLight,
    /// What works on pixels, from the sky to the converter.
    pub pixel_effects: Vec<EffectSetting>,
    /// The place on the ground, if any.
    pub site: Option<SiteTable>,
    /// The exposures in order of time.
    pub exposures: Exposures,
}

/// One exposure of a scene.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Exposure {
    /// Middle of the exposure.
    pub time: Option<Epoch>,
    /// Its length.
    pub exposure_s: f64,
    /// How the camera is turned at the middle of the exposure of the middle row.
    pub attitude: Attitude,
    /// The same without jitter: what [`Motion::attitude`] starts from.
    pub course: Attitude,
    /// How it turns during the exposure.
    pub motion: Motion,
    /// The displacements in force on the way to the camera.
    pub sky: SkyChain,
    /// What the recording says of the frame beside its time.
    pub telemetry: ExposureTelemetry,
}

/// What is measured beside the image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct ExposureTelemetry {
    /// Camera velocity, barycentric, ICRS axes.
    pub velocity_km_s: Option<[f64; 3]>,
    /// Rate of the camera in its own axes.
    pub rate_deg_s: Option<[f64; 3]>,
    /// Temperature of the optics.
    pub temperature_c: Option<f64>,
    /// Air pressure at the camera.
    pub pressure_hpa: Option<f64>,
}

/// Where and how bright a star is imaged: the truth of one star in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct TrueStarImage {
    /// Catalogue number.
    pub hip: u32,
    /// Where the light lands: the mean over the exposure, which for a camera at rest is also the position at its middle.
    pub position: PixelPoint,
    /// Electrons that the star sends during the exposure.
    pub electrons: f64,
    /// V magnitude.
    pub magnitude: f64,
}

impl Scene {
    /// What lights the sky between the stars unevenly: effects by their ids.
    pub(crate) fn glow_ids(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.sky_light.glow_ids()
    }

    /// Reads and checks a scene file.
    pub fn open(path: &std::path::Path) -> Result<Self, SceneError> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|source| SceneError::Read { path: name.clone(), source })?;
        Self::parse(&name, &text)
    }

    /// The scene of `boresight demo`.
    pub fn demo() -> Result<Self, SceneError> {
        Self::parse("the demo scene", DEMO_TOML)
    }

    /// Reads and checks the text of a scene; `path` is used in messages.
    ///
    /// ```
    /// use boresight::scene::Scene;
    ///
    /// let refused = Scene::parse("night.toml", "format = \"boresight-scene/1\"\ncamera = { width_px = 0 }\n").unwrap_err();
    /// assert!(refused.to_string().starts_with("night.toml: "));
    /// ```
    pub fn parse(path: &str, text: &str) -> Result<Self, SceneError> {
        file::parse(path, text)?.build(path)
    }

    /// Checks the tables of a scene that are read already; `path` is used in messages.
    pub(crate) fn from_table(path: &str, table: toml::Table) -> Result<Self, SceneError> {
        file::of_table(path, table)?.build(path)
    }

    /// Checks the tables of a series that a dataset takes its one exposure from; `path` is used in messages.
    pub(crate) fn check_series(path: &str, scene: &toml::Table) -> Result<(), SceneError> {
        let Some(series) = scene.get("series") else { return Ok(()) };
        if scene.contains_key("frames") {
            let (key, value, remedy) = ("series".to_owned(), "given".to_owned(), "stands beside [[frames]]: keep one of the two");
            return Err(SceneError::Value { path: path.to_owned(), key, value, remedy });
        }
        check::series_alone(path, &file::of_series(path, series)?)
    }

    /// The number of exposure `index` among all that the camera takes: with the seed, the key of its random numbers.
    #[must_use]
    pub fn frame_number(&self, index: usize) -> u32 {
        self.first_frame.wrapping_add(index as u32)
    }

    /// The same scene with another seed: other noise and, in a series, other pointings.
    pub fn parse_with_seed(path: &str, text: &str, seed: u64) -> Result<Self, SceneError> {
        let mut file = file::parse(path, text)?;
        file.seed = seed;
        file.build(path)
    }

    /// An angle from the boresight beyond which no star reaches the frame.
    fn field_radius_rad(&self, margin_px: f64) -> f64 {
        // What the sky chain moves (refraction and aberration, under 1.5°) and the proper motions of a century.
        const SLACK_RAD: f64 = 1.5 * DEG_RAD;
        let (right, bottom) = (self.camera.width_px as f64 - 0.5 + margin_px, self.camera.height_px as f64 - 0.5 + margin_px);
        let context = self.optics.reference_context();
        // A corner that no light reaches (outside the circle of a fisheye) leaves the whole sky.
        let farthest = [-0.5 - margin_px, right]
            .into_iter()
            .flat_map(|x_px| [-0.5 - margin_px, bottom].map(|y_px| PixelPoint { x_px, y_px }))
            .map(|corner| self.optics.direction(corner, &context).map_or(-1.0, |direction| direction.xyz[2]))
            .fold(1.0_f64, f64::min);
        farthest.clamp(-1.0, 1.0).acos() + SLACK_RAD
    }
}

impl SceneFile {
    /// Checks every value and works out the exposures.
    fn build(self, path: &str) -> Result<Scene, SceneError> {
        check::check(path, &self)?;
        let camera = self.camera.camera();
        let nominal = self.nominal.camera(&camera);
        let physics: Physics = self.sky.physics.parse().map_err(|source| SceneError::Physics { path: path.to_owned(), source })?;
        let effects::InForce { terms, pixels, glows } = effects::in_force(path, &self.effects, &self.detector)?;
        let mut model = self.camera.model(path)?;
        let undisplaced = self.camera.undisplaced(path)?;
        effects::behind_the_lens(path, &mut model, &terms)?;
        if let Some(line_time_us) = self.camera.line_time_us {
            let shutter = Term { effect: ROLLING_SHUTTER.to_owned(), parameters: vec![line_time_us] };
            effects::behind_the_lens(path, &mut model, &[shutter])?;
        }
        let mut optics = model.clone();
        optics.remove(ROLLING_SHUTTER);
        let backwards = if self.camera.first_row == Some(FirstRow::Bottom) { -1.0 } else { 1.0 };
        let line_time_us = model.terms().find(|(id, _)| *id == ROLLING_SHUTTER).map_or(0.0, |(_, parameters)| parameters[0]);
        let line_time_s = backwards * 1e-6 * line_time_us;
        let nominal_line_time_us = self.nominal.line_time_us.or(self.camera.line_time_us);
        let first_row = self.camera.first_row;
        let is_fixed = self.mount.is_some_and(|mount| mount.kind == Mount::Fixed);
        let exposures = self.exposures(path, physics, &terms)?;
        effects::check_telemetry(path, &self.effects, &terms, &exposures)?;
        effects::check_psf_telemetry(path, self.psf.as_ref(), &exposures)?;
        let mut sky = self.sky.clone();
        let sky_light = SkyLight::new(path, &mut sky, glows, [self.camera.width_px, self.camera.height_px], exposures.kinds())?;
        let size_px = [camera.width_px, camera.height_px];
        let kelvins = exposures.kinds().map(|exposure| exposure.sky.observation().temperature_offset_k.unwrap_or_default());
        let temperatures_k = kelvins.fold([0.0_f64; 2], |[low, high], kelvin| [low.min(kelvin), high.max(kelvin)]);
        let psf = psf_table::read(path, self.psf.as_ref(), self.detector.psf_sigma_px, size_px, temperatures_k)?;
        let binning = self.camera.binning.map(BinningTable::binning);
        let wrong_psf = |(key, value, remedy): (&str, String, &'static str)| {
            let key = format!("psf.{key}");
            SceneError::Value { path: path.to_owned(), key, value, remedy }
        };
        let own_psf = psf.on_own_pixels(binning.map_or(1, |binning| binning.factor)).map_err(wrong_psf)?;
        work::check(path, &self, &own_psf)?;
        let dark_frame = dark_frame::read(path, &self.detector, &pixels, (size_px, binning.is_some()))?;
        let read_noise_e = dark_frame.as_ref().map_or(self.detector.read_noise_e, |dark| dark.noise_e);
        let saturation_dn = Some(self.detector.top_dn());
        let detector = DetectorTable { psf_sigma_px: psf.typical_px, saturation_dn, read_noise_e, ..self.detector.clone() };
        let colour_response = detector.colour_response();
        let colour_filters = detector.colour_filters.as_ref().map(|table| table.response(detector.quantum_efficiency.as_ref()));
        let pixel_effects = self.pixel_effects(&sky, pixels, colour_filters.as_ref());
        Ok(Scene {
            seed: self.seed,
            first_frame: self.first_frame,
            camera,
            model,
            optics,
            undisplaced,
            line_time_s,
            nominal_line_time_us,
            first_row,
            is_fixed,
            nominal,
            detector,
            binning,
            colour_response,
            colour_filters,
            own_psf,
            psf,
            psf_table: self.psf,
            dark_frame,
            ghosts: self.ghosts,
            streaks: self.streaks,
            cosmic_rays: self.cosmic_rays,
            sky,
            sky_light,
            pixel_effects,
            site: self.site,
            exposures,
        })
    }

    /// What works on pixels: of those that are listed, what the filters of the mosaic bring, and what every camera has; a dark frame is read noise.
    fn pixel_effects(&self, sky: &SkyTable, mut listed: Vec<EffectSetting>, filters: Option<&FilterResponse>) -> Vec<EffectSetting> {
        if let Some([red, blue]) = filters.and_then(FilterResponse::white)
            && listed.iter().all(|other| other.id != ids::BAYER)
        {
            listed.push(EffectSetting::new(ids::BAYER, &[("red_relative", red), ("blue_relative", blue)]));
        }
        let mut effects = effects::of_camera(&self.detector, &self.sky_of_own_pixel(sky), &listed);
        effects.retain(|effect| self.detector.dark_frame.is_none() || effect.id != ids::READ_NOISE);
        effects
    }

    /// The sky as one of the detector's own pixels sees it.
    fn sky_of_own_pixel(&self, sky: &SkyTable) -> SkyTable {
        let pixels = self.camera.binning.map_or(1.0, |table| table.binning().pixels());
        SkyTable { background_e_per_px_s: Some(sky.even_e_per_px_s() / pixels), ..sky.clone() }
    }

    /// The exposures, each with the physics in force.
    fn exposures(&self, path: &str, physics: Physics, terms: &[Term]) -> Result<Exposures, SceneError> {
        let info = CameraInfo {
            width_px: self.camera.width_px,
            height_px: self.camera.height_px,
            shutter: self.camera.line_time_us.map(|_| Shutter::Rolling),
            line_time_us: self.camera.line_time_us,
            first_row: self.camera.first_row,
            ..CameraInfo::default()
        };
        let recording = Recording { site: self.site.as_ref().map(Site::from), ..Recording::new(info) };
        let (terms, jitter) = (terms.to_vec(), self.jitter.clone());
        Exposures::new(
            self,
            exposures::Making { path: path.to_owned(), seed: self.seed, first_frame: self.first_frame, physics, terms, jitter, recording },
        )
    }
}

impl ExposureTelemetry {
    /// As a recording has it.
    #[must_use]
    pub fn entry(&self) -> FrameEntry {
        FrameEntry {
            velocity_km_s: self.velocity_km_s,
            rate_deg_s: self.rate_deg_s,
            temperature_c: self.temperature_c,
            covariates: self.pressure_hpa.map(|pressure| ("pressure_hpa".to_owned(), pressure)).into_iter().collect(),
            ..FrameEntry::default()
        }
    }
}

impl From<&SiteTable> for Site {
    fn from(site: &SiteTable) -> Self {
        Self {
            latitude_deg: site.latitude_deg,
            longitude_deg: site.longitude_deg,
            height_m: site.height_m,
            pressure_hpa: site.pressure_hpa,
            temperature_c: site.temperature_c,
            relative_humidity: site.relative_humidity,
        }
    }
}

impl SiteTable {
    /// The site in the units of the ephemeris.
    #[must_use]
    pub fn ground_site(&self) -> GroundSite {
        GroundSite {
            pressure_hpa: self.pressure_hpa,
            temperature_c: self.temperature_c,
            relative_humidity: self.relative_humidity,
            ..GroundSite::from_degrees(self.latitude_deg, self.longitude_deg, self.height_m)
        }
    }
}
