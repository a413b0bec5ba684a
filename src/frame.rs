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

/// A frame of which some pixels have no value: NaN or BLANK in a reduced image.
#[derive(Clone, Debug, PartialEq)]
pub struct MaskedFrame {
    /// The pixels; those without a value have the median of the others.
    pub frame: Frame,
    /// Which pixels have no value, row by row; `None` if every one has.
    pub undefined: Option<Vec<bool>>,
}

impl MaskedFrame {
    /// Marks the pixels that are no finite number. `None` if none is one.
    #[must_use]
    pub fn new(mut frame: Frame) -> Option<Self> {
        if frame.pixels_dn.iter().all(|pixel| pixel.is_finite()) {
            return Some(Self { frame, undefined: None });
        }
        let undefined: Vec<bool> = frame.pixels_dn.iter().map(|pixel| !pixel.is_finite()).collect();
        let mut defined: Vec<f32> = frame.pixels_dn.iter().copied().filter(|pixel| pixel.is_finite()).collect();
        if defined.is_empty() {
            return None;
        }
        let middle = defined.len() / 2;
        let (_, level, _) = defined.select_nth_unstable_by(middle, f32::total_cmp);
        for (pixel, undefined) in frame.pixels_dn.iter_mut().zip(&undefined) {
            if *undefined {
                *pixel = *level;
            }
        }
        Some(Self { frame, undefined: Some(undefined) })
    }

    /// How many pixels have no value.
    #[must_use]
    pub fn count_undefined(&self) -> usize {
        self.undefined.as_ref().map_or(0, |mask| mask.iter().filter(|undefined| **undefined).count())
    }
}

impl From<Frame> for MaskedFrame {
    /// A frame of which every pixel has a value.
    fn from(frame: Frame) -> Self {
        Self { frame, undefined: None }
    }
}
