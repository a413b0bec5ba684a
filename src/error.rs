//! One error for a whole pipeline: every stage's error becomes it by `?`.

/// What went wrong, by stage.
///
/// ```
/// use std::path::Path;
///
/// fn width(path: &Path) -> boresight::Result<usize> {
///     Ok(boresight::scene::Scene::open(path)?.camera.width_px)
/// }
/// assert!(matches!(width(Path::new("nowhere.toml")), Err(boresight::Error::Scene(_))));
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Of the catalogue.
    #[error(transparent)]
    Catalog(#[from] crate::catalog::CatalogError),
    /// Of a scene.
    #[error(transparent)]
    Scene(#[from] crate::scene::SceneError),
    /// Of rendering.
    #[error(transparent)]
    Imaging(#[from] crate::imaging::ImagingError),
    /// Of a recording and its frames.
    #[error(transparent)]
    Recording(#[from] crate::recording::RecordingError),
    /// Of detection.
    #[error(transparent)]
    Detect(#[from] crate::detect::DetectError),
    /// A frame that was asked for is not identified.
    #[error(transparent)]
    Identify(#[from] crate::identify::Refusal),
    /// Of a recording on its way to control points.
    #[error(transparent)]
    Pipeline(#[from] crate::pipeline::PipelineError),
    /// Of calibration.
    #[error(transparent)]
    Calibrate(#[from] crate::calibrate::CalibrateError),
    /// Of diagnosis.
    #[error(transparent)]
    Diagnose(#[from] crate::diagnose::DiagnoseError),
    /// Of a camera of another program.
    #[error(transparent)]
    Exchange(#[from] crate::exchange::ExchangeError),
    /// Of a camera's model.
    #[error(transparent)]
    Model(#[from] crate::camera::ModelError),
}

/// A result of any stage.
pub type Result<T, E = Error> = std::result::Result<T, E>;
