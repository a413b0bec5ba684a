//! Answers of a system under test, and the files that hold them.

mod astrometry_wcs;
mod csv_file;
mod json;
mod lost;
mod read;
mod sidecars;
mod tetra3;
mod types;

pub use read::{read_answers, usual_conventions};
pub use types::{AnswerFile, AnswerStatus, AnsweredCamera, AnsweredStar, TrackerAnswer};

pub(super) use read::read_stream_line;
pub(super) use sidecars::{camera_of, centroids_of};

#[cfg(test)]
mod tests;
