//! Means of rows, columns and pixels over the frames that are compared: what the pictures of the noise show.

use super::fixed_pattern::PatternFrame;
use super::lines::FrameLines;

/// Means over frames. They are for pictures: what is judged are the variances beside them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelMeans {
    /// Of rows.
    pub rows: LineMeans,
    /// Of columns.
    pub columns: LineMeans,
    /// Of single pixels.
    pub pixels: PixelHistogram,
}

/// What each row (or column) has more than those around it, DN; NaN where it has no sky.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineMeans {
    /// Frames.
    pub frames: usize,
    /// In the first of them.
    pub first_dn: Vec<f32>,
    /// Mean of all.
    pub mean_dn: Vec<f32>,
}

/// How far the pixels' means over the frames are from those of the pixels around them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelHistogram {
    /// Frames.
    pub frames: usize,
    /// Pixels by their deviation, in units of what the noise of the frames makes of a mean: bins of [`Self::STEP`] from −[`Self::REACH`] on. The first
    /// and the last hold what is beyond.
    pub pixels: Vec<u64>,
}

impl PixelMeans {
    pub(super) fn of(lines: &[FrameLines], patterns: &[PatternFrame]) -> Self {
        let means = |of: fn(&FrameLines) -> &[f32]| {
            let told: Vec<&[f32]> = lines.iter().map(of).filter(|means| !means.is_empty()).collect();
            LineMeans { frames: told.len(), first_dn: told.first().map_or_else(Vec::new, |first| first.to_vec()), mean_dn: means(&told) }
        };
        Self { rows: means(|own| &own.row_means), columns: means(|own| &own.column_means), pixels: PixelHistogram::of(patterns) }
    }
}

/// Mean of each place over the lists that have a number there; of lists as long as the first.
fn means(lists: &[&[f32]]) -> Vec<f32> {
    let Some(first) = lists.first() else { return Vec::new() };
    let mean = |k: usize| {
        let own = lists.iter().filter(|list| list.len() == first.len()).map(|list| list[k]).filter(|value| !value.is_nan());
        let (sum, count) = own.fold((0.0, 0.0), |(sum, count), value| (sum + f64::from(value), count + 1.0));
        if count > 0.0 { (sum / count) as f32 } else { f32::NAN }
    };
    (0..first.len()).map(mean).collect()
}

impl PixelHistogram {
    /// Width of a bin.
    pub const STEP: f64 = 0.25;
    /// Farthest deviation with a bin of its own.
    pub const REACH: f64 = 12.0;

    fn of(patterns: &[PatternFrame]) -> Self {
        /// A pixel that fewer frames show has no mean.
        const MIN_FRAMES: f64 = 3.0;
        let bins = (2.0 * Self::REACH / Self::STEP).round() as usize;
        let [width_px, height_px] = patterns.first().map_or([0; 2], PatternFrame::size_px);
        let mut pixels = vec![0; bins];
        for index in 0..width_px * height_px {
            let own = patterns.iter().filter_map(|frame| frame.value(index));
            let (sum, count) = own.fold((0.0, 0.0_f64), |(sum, count), value| (sum + value, count + 1.0));
            if count >= MIN_FRAMES {
                let bin = (sum / count.sqrt() + Self::REACH) / Self::STEP;
                pixels[(bin.max(0.0) as usize).min(bins - 1)] += 1;
            }
        }
        Self { frames: patterns.len(), pixels }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_the_frames_that_have_a_number() {
        let (one, other, short) = ([1.0, f32::NAN, 3.0], [3.0, 5.0, f32::NAN], [9.0]);
        assert_eq!(means(&[&one, &other, &short]), [2.0, 5.0, 3.0]);
        assert!(means(&[&[f32::NAN], &[f32::NAN]])[0].is_nan());
        assert!(means(&[]).is_empty());
        assert_eq!(PixelHistogram::of(&[]).pixels.iter().sum::<u64>(), 0);
    }
}
