//! Errors of a camera exchange.

use thiserror::Error;

use crate::camera::ModelError;

/// Why an export or an import failed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ExchangeError {
    /// A file is not what it should be.
    #[error("{file}: line {line}: {problem}")]
    File {
        /// The file.
        file: String,
        /// The line, from 1.
        line: usize,
        /// What is wrong and what to do about it.
        problem: String,
    },
    /// A file as a whole is not what it should be.
    #[error("{file}: {problem}")]
    Content {
        /// The file.
        file: String,
        /// What is wrong and what to do about it.
        problem: String,
    },
    /// Part of the frame has no direction, or a direction no image.
    #[error(
        "{what} has no one-to-one map over the frame (at column {x_px:.1}, row {y_px:.1} its distortion folds over): calibrate again with frames that cover the corners, or hold the distortion"
    )]
    Folds {
        /// Whose map.
        what: String,
        /// Column.
        x_px: f64,
        /// Row.
        y_px: f64,
    },
    /// Part of the frame sees no place of the catalogue.
    #[error(
        "the light at column {x_px:.1}, row {y_px:.1} comes from no one place of the sky (it is bent by air near or below the horizon, or the camera's distortion folds over): world coordinates of the light as it arrives can be had with --wcs apparent"
    )]
    NoPlace {
        /// Column.
        x_px: f64,
        /// Row.
        y_px: f64,
    },
    /// The format has no room for the camera.
    #[error("{format} cannot hold this camera: {reason}")]
    NoRoom {
        /// The format.
        format: &'static str,
        /// Why.
        reason: String,
    },
    /// A fit has no solution.
    #[error("{what} cannot be fitted: the equations have no finite solution; check the values of the camera")]
    NoFit {
        /// What was fitted.
        what: &'static str,
    },
    /// A model that cannot be made.
    #[error(transparent)]
    Model(#[from] ModelError),
}

impl ExchangeError {
    /// A fault of a line.
    pub(super) fn at(file: &str, line: usize, problem: impl Into<String>) -> Self {
        Self::File { file: file.to_owned(), line, problem: problem.into() }
    }

    /// A fault of a whole file.
    pub(super) fn of(file: &str, problem: impl Into<String>) -> Self {
        Self::Content { file: file.to_owned(), problem: problem.into() }
    }
}
