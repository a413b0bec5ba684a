//! How a scene file is read, and the cameras and the sky that its tables describe.

use super::{FrameTable, NominalTable, SceneError, SceneFile, SeriesTable, SkyTable, TrueCameraTable};
use crate::camera::{Camera, Model};
use crate::coordinates::{Direction, Icrs};
use crate::effects::Observation;
use crate::toml_file::{tables, with_suggestion};
use crate::units::DEG_RAD;

/// The scene that `boresight demo` renders.
pub const DEMO_TOML: &str = include_str!("demo.toml");

impl SkyTable {
    /// The background that is even over the frame, electrons per pixel and second.
    #[must_use]
    pub fn even_e_per_px_s(&self) -> f64 {
        /// Of a dark sky, a fast lens and pixels of an arcminute.
        const USUAL: f64 = 50.0;
        self.background_e_per_px_s.unwrap_or(if self.background_image.is_some() { 0.0 } else { USUAL })
    }
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
    tables(text).map_err(|message| SceneError::Parse { path: path.to_owned(), message })
}

/// `[series]` by itself.
pub(super) fn of_series(path: &str, series: &toml::Value) -> Result<SeriesTable, SceneError> {
    let wrong = |error: toml::de::Error| SceneError::Parse {
        path: path.to_owned(),
        message: format!("series: {}", with_suggestion(error.message())),
    };
    series.clone().try_into().map_err(wrong)
}

/// The tables of a text that is read already.
pub(super) fn of_table(path: &str, table: toml::Table) -> Result<SceneFile, SceneError> {
    table.try_into().map_err(|error: toml::de::Error| {
        // What serde says of the place stands in a line of its own: "in `camera.width_px`".
        let message = with_suggestion(error.message());
        let place = error.to_string().lines().find_map(|line| Some(line.trim().strip_prefix("in `")?.trim_end_matches('`').to_owned()));
        SceneError::Parse { path: path.to_owned(), message: place.map_or(message.clone(), |place| format!("{place}: {message}")) }
    })
}
