//! How well star images cover the frame: of a change of the map by 1 px (rms over the frame, the best rotation removed), how much do the stars see
//! at least (rms, attitudes free)?

use super::error::CalibrateError;

/// Below this share of a map change that the star images see (rms at the stars over rms over the frame), the map is not
/// determined: errors of the positions themselves would drive the solution.
const BLIND_SHARE: f64 = 0.01;
/// Below this share the map is determined badly enough to be said.
const WEAK_SHARE: f64 = 0.15;

/// The least visible change of the map.
#[derive(Clone, Debug)]
pub(super) struct Coverage {
    /// The least share seen.
    pub(super) share: f64,
    /// Names of the parameters in it.
    pub(super) combination: String,
}

impl Coverage {
    /// Refuses stars that leave the map open.
    pub(super) fn checked(self) -> Result<Self, CalibrateError> {
        if self.share.is_nan() || self.share < BLIND_SHARE {
            return Err(CalibrateError::Uncovered { combination: self.combination, share: self.share });
        }
        Ok(self)
    }

    /// A sentence if the coverage of a part of the frame is weak. `measure`: what the 1 px is.
    pub(super) fn warning(&self, part: &str, measure: &str) -> Option<String> {
        (self.share < WEAK_SHARE).then(|| {
            format!(
                "the star images cover {part} badly: a change of the mapping by 1 px ({measure}) in {} moves them by only {:.3} px; \
                 the mapping is uncertain where no stars are",
                self.combination, self.share
            )
        })
    }
}
