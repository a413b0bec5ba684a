//! One exposure as pixels: what a recording gives and what the renderer makes.

/// The pixels of one exposure in counts (DN), stored row by row, first row on top.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// `width_px · height_px` counts, every one finite.
    pub pixels_dn: Vec<f32>,
    /// Counts at and above which a pixel is full: declared by the recording, or the top of the file's number range.
    pub saturation_dn: f32,
}

impl Frame {
    /// The count at column `x`, row `y`.
    ///
    /// # Panics
    /// If the pixel lies outside the frame.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.pixels_dn[y * self.width_px + x]
    }
}
