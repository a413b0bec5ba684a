//! Saturated and hot pixels, which take no part in fits.

use crate::frame::Frame;
use crate::parallel;

/// A lone pixel counts as hot from this many σ of its background on.
const HOT_SIGMA: f32 = 8.0;
/// Eight neighbours of the sharpest real star (σ 0.45 px, centred on the pixel) hold this share of the centre's light or more.
const MIN_NEIGHBOUR_SHARE: f32 = 0.7;

/// Counts at and above which pixels are full: as declared, or lower where counts pile up at the frame's highest value (12-bit
/// counts in a 16-bit file do).
pub(super) fn saturation_dn(frame: &Frame) -> f32 {
    const MIN_AT_TOP: usize = 6;
    const MIN_PAIRS: usize = 2;
    let (mut low, mut top) = (f32::INFINITY, f32::NEG_INFINITY);
    for &v in &frame.pixels_dn {
        low = low.min(v);
        top = top.max(v);
    }
    if top >= frame.saturation_dn || top <= low {
        return frame.saturation_dn;
    }
    let at_top = frame.pixels_dn.iter().filter(|v| **v == top).count();
    // more than a fiftieth of all at the top is a background, not stars
    if at_top < MIN_AT_TOP || at_top * 50 > frame.pixels_dn.len() {
        return frame.saturation_dn;
    }
    let pairs = frame.pixels_dn.chunks_exact(frame.width_px).flat_map(|row| row.windows(2)).filter(|p| p[0] == top && p[1] == top);
    if pairs.count() < MIN_PAIRS { frame.saturation_dn } else { top }
}

/// Which pixels are hot, from residuals in units of their noise: bright, with neighbours darker than any lens leaves them.
pub(super) fn hot_pixels(normalised: &[f32], width: usize) -> Vec<bool> {
    let height = normalised.len() / width;
    let mut hot = vec![false; normalised.len()];
    parallel::for_each_part(&mut hot, width, |y, row| {
        for (x, hot) in row.iter_mut().enumerate() {
            let own = normalised[y * width + x];
            if own < HOT_SIGMA {
                continue;
            }
            let (mut sum, mut count) = (0.0, 0.0_f32);
            for ny in y.saturating_sub(1)..(y + 2).min(height) {
                for nx in x.saturating_sub(1)..(x + 2).min(width) {
                    if (nx, ny) != (x, y) {
                        sum += normalised[ny * width + nx];
                        count += 1.0;
                    }
                }
            }
            // 3σ of the sum stay between it and what a star leaves there; at the edge of the frame fewer neighbours share
            *hot = count > 0.0 && sum + 3.0 * count.sqrt() < MIN_NEIGHBOUR_SHARE * own * count / 8.0;
        }
    });
    hot
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_of_the_counts_is_found_below_the_files_range() {
        let mut pixels_dn: Vec<f32> = (0..10_000).map(|i| (i % 7) as f32).collect();
        for i in [500, 501, 502, 600, 601, 602] {
            pixels_dn[i] = 4095.0;
        }
        let mut frame = Frame { width_px: 100, height_px: 100, pixels_dn, saturation_dn: 65535.0 };
        assert_eq!(saturation_dn(&frame), 4095.0);
        frame.pixels_dn[502] = 4000.0;
        assert_eq!(saturation_dn(&frame), 65535.0);
    }
}
