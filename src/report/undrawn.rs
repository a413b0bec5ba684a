//! In the place of the drawing where the feature `plots` is off: pictures are left out, which is said once.

use std::path::Path;

use super::{FieldMap, Figure, Mark, OffOn, Plot, ProfilePlot, Ranking, ReportError, VectorPanel};
use crate::frame::Frame;

/// What a build without pictures says once, at the first picture that it leaves out. A picture goes beside results, so they are written all the same.
#[expect(clippy::unnecessary_wraps, reason = "what draws may fail, and this stands in its place")]
fn left_out(path: &Path) -> Result<(), ReportError> {
    static SAID: std::sync::Once = std::sync::Once::new();
    SAID.call_once(|| {
        tracing::warn!(
            "this build draws no pictures: it was compiled without the feature `plots`; {} and all others are left out",
            path.display()
        );
    });
    Ok(())
}

/// Leaves the picture of a frame out.
pub fn frame_picture(path: &Path, _: &Frame, _: &[Mark], _: &[Figure]) -> Result<(), ReportError> {
    left_out(path)
}

/// Leaves the map of the remainder out.
pub fn remainder_map(path: &Path, _: &str, _: &str, _: (usize, usize), _: &[[f64; 5]]) -> Result<(), ReportError> {
    left_out(path)
}

/// Leaves the panels of residual vectors out.
pub fn residual_vectors(path: &Path, _: &str, _: (usize, usize), _: [&VectorPanel; 2]) -> Result<(), ReportError> {
    left_out(path)
}

/// Leaves the panels of residual vectors out.
pub fn residual_vectors_on_one_scale(path: &Path, _: &str, _: (usize, usize), _: [&VectorPanel; 2]) -> Result<(), ReportError> {
    left_out(path)
}

#[expect(clippy::unused_self, reason = "the twin of what draws")]
impl FieldMap {
    /// Leaves the map out.
    pub fn write(&self, path: &Path, _: (usize, usize)) -> Result<(), ReportError> {
        left_out(path)
    }
}

#[expect(clippy::unused_self, reason = "the twin of what draws")]
impl OffOn {
    /// Leaves the two frames out.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        left_out(path)
    }
}

#[expect(clippy::unused_self, reason = "the twin of what draws")]
impl Plot {
    /// Leaves the plot out.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        left_out(path)
    }
}

#[expect(clippy::unused_self, reason = "the twin of what draws")]
impl ProfilePlot {
    /// Leaves the plot out.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        left_out(path)
    }
}

#[expect(clippy::unused_self, reason = "the twin of what draws")]
impl Ranking {
    /// Leaves the bars out.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        left_out(path)
    }
}
