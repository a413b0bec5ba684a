//! Whether the counts of a frame, as they were read, are a colour mosaic: pixels of a 2 × 2 cell that see the sky through filters of their own.
//!
//! The greens of a mosaic lie on one diagonal of the cell. Of every cell a, b / c, d the number (a − b − c + d)/4 is half the difference of the two
//! diagonals: a slope of the sky, and rows or columns that differ, leave it at zero, and the noise σ of the pixels makes it scatter by σ/2.

use super::sky_pixels::{MIN_MOSAIC_ERRORS, MIN_MOSAIC_SIGMAS};
use crate::statistics::{mad_sigma, median};

/// Cells that are looked at, at most.
const MAX_CELLS: usize = 1 << 14;
/// Cells in stars and on edges lie farther out than so many standard deviations.
const CLIP_SIGMAS: f64 = 4.0;

/// Whether a frame is one; `usable` tells of its pixels, row by row.
pub(super) fn is_mosaic(pixels_dn: &[f32], width_px: usize, usable: impl Fn(usize) -> bool) -> bool {
    let (columns, rows) = (width_px / 2, pixels_dn.len() / width_px.max(1) / 2);
    let stride = (columns * rows).div_ceil(MAX_CELLS).max(1);
    let diagonal = |cell: usize| -> Option<f64> {
        let first = cell / columns * 2 * width_px + cell % columns * 2;
        let own = [first, first + 1, first + width_px, first + width_px + 1];
        let is_told = own.iter().all(|index| pixels_dn[*index].is_finite() && usable(*index));
        let [a, b, c, d] = own.map(|index| f64::from(pixels_dn[index]));
        is_told.then_some(0.25 * (a - b - c + d))
    };
    let all: Vec<f64> = (0..columns * rows).step_by(stride).filter_map(diagonal).collect();
    let Some((middle, scatter)) = median(&all).zip(mad_sigma(&all)) else { return false };
    let kept: Vec<f64> = all.into_iter().filter(|own| (own - middle).abs() <= CLIP_SIGMAS * scatter).collect();
    let count = kept.len().max(1) as f64;
    let mean = kept.iter().sum::<f64>() / count;
    let sigma = (kept.iter().map(|own| (own - mean).powi(2)).sum::<f64>() / count).sqrt();
    // The pixels have twice the scatter of the diagonals.
    sigma > 0.0 && mean.abs() > sigma * (2.0 * MIN_MOSAIC_SIGMAS).max(MIN_MOSAIC_ERRORS / count.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts of a frame of 64 × 64 pixels: `light` of a place and a saw-tooth of noise of σ about 3, which no 2 × 2 cell follows.
    fn frame(light: impl Fn(usize, usize) -> f64) -> Vec<f32> {
        let noise = |index: usize| (index.wrapping_mul(2_654_435_761) >> 7) % 11;
        (0..64 * 64).map(|index| (light(index % 64, index / 64) + noise(index) as f64).round() as f32).collect()
    }

    #[test]
    fn a_mosaic_is_told_by_its_diagonals() {
        let told = |light: &dyn Fn(usize, usize) -> f64| is_mosaic(&frame(light), 64, |_| true);
        let green = |x: usize, y: usize| if (x + y) % 2 == 1 { 110.0 } else { 100.0 };
        assert!(told(&green));
        assert!(!told(&|_, _| 100.0) && !told(&|x, y| 100.0 + 0.5 * x as f64 + y as f64));
        // Two amplifiers, one of each parity of columns, are none.
        assert!(!told(&|x, _| if x % 2 == 1 { 110.0 } else { 100.0 }));
        assert!(!is_mosaic(&frame(green), 64, |_| false) && !is_mosaic(&[], 0, |_| true));
    }
}
