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

    /// The lowest count, DN; infinite where there is none.
    #[must_use]
    pub fn lowest_dn(&self) -> f32 {
        self.pixels_dn.iter().copied().fold(f32::INFINITY, f32::min)
    }

    /// Lowers the count at which pixels are full to the last step of the counts, where these come in steps of a power of two: of twelve bits in
    /// the upper part of sixteen a full pixel has 65 520, and a converter that has lost its lowest three bits gives 4088.
    pub fn lower_saturation_to_step(&mut self) {
        const MAX_COUNT: f32 = 16_777_216.0;
        let Some(first) = self.pixels_dn.first().map(|count| *count as u32) else { return };
        let mut differing = 0;
        for count in &self.pixels_dn {
            if !(0.0..MAX_COUNT).contains(count) || count.fract() != 0.0 {
                return;
            }
            differing |= *count as u32 ^ first;
            if differing & 1 == 1 {
                return;
            }
        }
        if differing == 0 || !(0.0..MAX_COUNT).contains(&self.saturation_dn) {
            return;
        }
        let step = 1 << differing.trailing_zeros();
        let (rest, top) = (first % step, self.saturation_dn as u32);
        if top >= rest {
            self.saturation_dn = (top - (top - rest) % step) as f32;
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_full_at_the_last_step() {
        let top = |counts: &[u16], saturation_dn: f32| {
            let pixels_dn: Vec<f32> = counts.iter().map(|count| f32::from(*count)).collect();
            let mut frame = Frame { width_px: counts.len(), height_px: 1, pixels_dn, saturation_dn };
            frame.lower_saturation_to_step();
            frame.saturation_dn
        };
        assert_eq!(top(&[0, 16, 160, 65_520], 65_535.0), 65_520.0);
        assert_eq!(top(&[8, 16, 240, 4088], 4095.0), 4088.0);
        // Steps that begin at three.
        assert_eq!(top(&[3, 7, 15], 255.0), 255.0);
        assert_eq!(top(&[3, 7, 15], 256.0), 255.0);
        // Every count, one count alone, and counts that are none.
        assert_eq!(top(&[1, 2, 3, 4], 4095.0), 4095.0);
        assert_eq!(top(&[16; 4], 4095.0), 4095.0);
        let mut frame = Frame { width_px: 2, height_px: 1, pixels_dn: vec![0.5, 16.0], saturation_dn: 4095.0 };
        frame.lower_saturation_to_step();
        assert_eq!(frame.saturation_dn, 4095.0);
    }
}
