//! Why a table or a picture could not be written.

use std::path::PathBuf;

use crate::recording::OutputError;

/// Why a picture could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The drawing library refused.
    #[error("the picture {} cannot be drawn ({reason}): report this with the data at hand", path.display())]
    Draw {
        /// The picture.
        path: PathBuf,
        /// What the library says.
        reason: String,
    },
    /// The file system refused.
    #[error(transparent)]
    Write(#[from] OutputError),
    /// There is nothing finite to draw.
    #[error("the picture {} would show nothing: {what}", path.display())]
    Empty {
        /// The picture.
        path: PathBuf,
        /// What is missing.
        what: &'static str,
    },
}
