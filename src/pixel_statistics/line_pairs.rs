//! Rows and columns that are offset alike in all frames: frame against frame.
//!
//! An offset that stays with the line is in the means of that line in two frames, and the noise of the two is independent: over the lines, the
//! covariance of the two frames' means is the variance of the offsets. One half of a line in one frame is held against the other half in the other: the
//! same half has the same pixels, whose own offsets do not average out over them. Of F frames all F(F − 1)/2 pairs tell it, which is the information of
//! the mean of all frames, where each frame alone tells √F times less. Frames of one pointing share the stars that were not found, and are not compared.

use super::fixed_pattern::{MIN_FRAMES, PatternFrame};
use super::lines::{Estimate, FrameLines, KEPT_BY_PLANE};
use super::sky_pixels::BLOCK_PX;

/// Two frames of different pointings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LinePair {
    /// Numbers of the frames.
    pub(crate) frames: [usize; 2],
    /// Variance of what rows are offset by in both, DN².
    pub(crate) rows: Option<Estimate>,
    /// The same of columns.
    pub(crate) columns: Option<Estimate>,
}

/// All pairs of the frames that are compared.
pub(super) fn line_pairs(compared: Vec<(&PatternFrame, &FrameLines)>) -> Vec<LinePair> {
    let Some(size_px) = compared.first().map(|(frame, _)| frame.size_px()) else { return Vec::new() };
    let compared: Vec<(&PatternFrame, &FrameLines)> = compared.into_iter().filter(|(frame, _)| frame.size_px() == size_px).collect();
    let patterns: Vec<&PatternFrame> = compared.iter().map(|(frame, _)| *frame).collect();
    let chosen: Vec<(&PatternFrame, &FrameLines)> =
        PatternFrame::places_of_different(&patterns).into_iter().map(|place| compared[place]).collect();
    if chosen.len() < MIN_FRAMES {
        return Vec::new();
    }
    let of_pair = |one: &(&PatternFrame, &FrameLines), other: &(&PatternFrame, &FrameLines)| LinePair {
        frames: [one.0.frame, other.0.frame],
        rows: covariance(&one.1.row_halves, &other.1.row_halves),
        columns: covariance(&one.1.column_halves, &other.1.column_halves),
    };
    chosen.iter().enumerate().flat_map(|(k, one)| chosen[k + 1..].iter().map(move |other| of_pair(one, other))).collect()
}

/// Covariance of two lists over the lines that both have, of each half of the one with the other half of the other; lines of two kinds are no offsets, so
/// the means of odd and even ones are taken out.
fn covariance(one: &[[f32; 2]], other: &[[f32; 2]]) -> Option<Estimate> {
    let both = one.iter().zip(other).map(|(a, b)| [a[0], a[1], b[0], b[1]].map(f64::from)).enumerate();
    let all: Vec<(usize, [f64; 4])> =
        both.filter(|(_, own)| own.iter().all(|own| !own.is_nan())).map(|(line, own)| (line % 2, own)).collect();
    if all.len() < 2 * BLOCK_PX {
        return None;
    }
    let mean = [0, 1].map(|parity| {
        let own = all.iter().filter(|(of, _)| *of == parity);
        let (sum, count) = own.fold(([0.0; 4], 0.0), |(sum, count), (_, own)| (std::array::from_fn(|k| sum[k] + own[k]), count + 1.0_f64));
        sum.map(|sum| sum / count.max(1.0))
    });
    let count = all.len() as f64;
    let rest: Vec<[f64; 4]> = all.iter().map(|(parity, own)| std::array::from_fn(|k| own[k] - mean[*parity][k])).collect();
    let product = |a: usize, b: usize| rest.iter().map(|own| own[a] * own[b]).sum::<f64>() / count;
    let kept = KEPT_BY_PLANE * (1.0 - 2.0 / count);
    // Without offsets all four are independent: each product has the product of their variances, over the lines that a block's plane leaves independent.
    let variance = 0.25 * (product(0, 0) * product(3, 3) + product(1, 1) * product(2, 2)) / (KEPT_BY_PLANE * count);
    (variance > 0.0).then(|| Estimate { value: 0.5 * (product(0, 3) + product(1, 2)) / kept, sigma: variance.sqrt() / kept })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines whose offsets are the same in both lists, beside noise of each half's own, what the same half has in both, and a difference of odd and even
    /// lines.
    #[test]
    fn what_two_frames_share_is_the_variance_of_the_offsets() {
        let wave = |k: usize, turns: f64| (std::f64::consts::TAU * turns * k as f64 / 512.0).sin();
        let list = |own: [f64; 2], parity: f64| -> Vec<[f32; 2]> {
            let of = |k: usize, half: usize| {
                let pixels = 0.5 * wave(k, [19.0, 23.0][half]);
                0.3 * wave(k, 37.0) + pixels + wave(k, own[half]) + if k.is_multiple_of(2) { parity } else { -parity }
            };
            (0..512).map(|k| [of(k, 0) as f32, of(k, 1) as f32]).collect()
        };
        let (one, other) = (list([101.0, 103.0], 2.0), list([67.0, 71.0], 3.0));
        let found = covariance(&one, &other).unwrap();
        let kept = KEPT_BY_PLANE * (1.0 - 2.0 / 512.0);
        assert!((found.value * kept - 0.5 * 0.09).abs() < 1e-6, "{found:?}");
        // All have the variance ½(0.3² + 0.5² + 1), and of two products that are independent the mean is taken.
        assert!((found.sigma * kept - 0.67 / (2.0 * KEPT_BY_PLANE * 512.0).sqrt()).abs() < 1e-6, "{found:?}");
        let mut cut = other;
        cut[..500].fill([f32::NAN, 0.0]);
        assert_eq!(covariance(&one, &cut), None);
    }
}
