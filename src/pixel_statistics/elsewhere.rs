//! What bright stars leave at other places of a frame, frame by frame.

use super::halos::{FrameHalo, frame_halo};
use super::partner_places::{CopiesFrame, PartnerSum};

/// What one frame shows of it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ElsewhereFrame {
    /// Number in the recording.
    pub(crate) number: usize,
    /// Columns and rows.
    pub(crate) size_px: [usize; 2],
    /// Light at partner places.
    pub(crate) sums: Vec<PartnerSum>,
    /// Halos about its stars.
    pub(crate) halo: Option<FrameHalo>,
}

impl ElsewhereFrame {
    pub(crate) fn of(number: usize, copies: &CopiesFrame<'_>) -> Self {
        Self {
            number,
            size_px: [copies.frame.width_px, copies.frame.height_px],
            sums: copies.partner_sums(),
            halo: frame_halo(copies.frame, copies.stars, copies.bad, copies.noise_dn),
        }
    }
}
