//! Unlit parts of a frame: the dark outside a fisheye's image circle, and the bars beside a picture in a wider frame.
//!
//! Its edge would be detected as stars, and those would spoil the ePSF. It is found in blocks: connected to the frame's border and nearer to the
//! frame's darkest level than to that of the sky, if they reach all four corners, as gaps between clouds do not, and end sharply, as a vignette and
//! the glow of a town do not.

use crate::frame::Frame;
use crate::statistics::median_in_place;

/// Side of a block, px.
const BLOCK_PX: usize = 8;
/// Fewer blocks a side tell nothing.
const MIN_BLOCKS: usize = 12;
/// A corner is so many blocks a side.
const CORNER: usize = 3;
/// The sky is brighter than the surround by so many times the scatter of the surround's blocks at least, and by so many counts.
const CLEARLY: f64 = 8.0;
const MIN_STEP_DN: f64 = 2.0;
/// The same over the scatter of all blocks: the darkest of the border is darker than the sky by chance too.
const ABOVE_NOISE: f64 = 6.0;
/// Over two blocks at the edge of a picture the light rises by this part of the way to the sky's level.
const SHARP: f64 = 0.4;
/// A surround covers at least this part of the frame, and at most that.
const COVERS: [f64; 2] = [0.005, 0.9];

/// Which pixels lie around the picture; `None` if the picture fills the frame.
pub(super) fn surround(frame: &Frame) -> Option<Vec<bool>> {
    let (columns, rows) = (frame.width_px / BLOCK_PX, frame.height_px / BLOCK_PX);
    if columns.min(rows) < MIN_BLOCKS {
        return None;
    }
    let level = block_levels(frame, columns, rows);
    let is_border = |block: usize| {
        let (column, row) = (block % columns, block / columns);
        column == 0 || row == 0 || column == columns - 1 || row == rows - 1
    };
    let mut border: Vec<f64> = (0..level.len()).filter(|&block| is_border(block)).map(|block| level[block]).collect();
    let mut inner: Vec<f64> = (0..level.len())
        .filter(|block| {
            (columns / 3..=2 * columns / 3).contains(&(block % columns)) && (rows / 3..=2 * rows / 3).contains(&(block / columns))
        })
        .map(|block| level[block])
        .collect();
    let sky = median_in_place(&mut inner)?;
    border.sort_unstable_by(f64::total_cmp);
    let dark = border[border.len() / 20];
    let step = sky - dark;
    if step < MIN_STEP_DN || step < ABOVE_NOISE * scatter(&level, columns) {
        return None;
    }
    let outside = hanging_together(&level, columns, dark + 0.5 * step, is_border);
    let count = outside.iter().filter(|out| **out).count();
    // Writing may stand in the corner itself.
    let reaches = |x0: usize, y0: usize| (0..CORNER).any(|y| (0..CORNER).any(|x| outside[(y0 + y) * columns + x0 + x]));
    let (right, bottom) = (columns - CORNER, rows - CORNER);
    if !(reaches(0, 0) && reaches(right, 0) && reaches(0, bottom) && reaches(right, bottom)) {
        return None;
    }
    if !(COVERS[0]..=COVERS[1]).contains(&(count as f64 / level.len() as f64)) || !ends_sharply(&level, &outside, columns, dark, step) {
        return None;
    }
    Some(as_pixels(frame, &outside, columns, rows))
}

/// The level of every block, without its brightest pixels: stars are no sky.
fn block_levels(frame: &Frame, columns: usize, rows: usize) -> Vec<f64> {
    let mut values = Vec::with_capacity(BLOCK_PX * BLOCK_PX);
    let mut level = Vec::with_capacity(columns * rows);
    for block in 0..columns * rows {
        let (x0, y0) = (block % columns * BLOCK_PX, block / columns * BLOCK_PX);
        values.clear();
        for y in y0..y0 + BLOCK_PX {
            let row = y * frame.width_px;
            values.extend(frame.pixels_dn[row + x0..row + x0 + BLOCK_PX].iter().map(|v| f64::from(*v)));
        }
        // The mean of what is no star: counts of few bits have no median between their steps.
        values.sort_unstable_by(f64::total_cmp);
        let kept = &values[..3 * values.len() / 4];
        level.push(kept.iter().sum::<f64>() / kept.len() as f64);
    }
    level
}

/// The scatter of blocks by their noise: from the differences of neighbours, in which slopes hardly count.
fn scatter(level: &[f64], columns: usize) -> f64 {
    let rows = level.chunks_exact(columns).flat_map(|row| row.windows(2));
    let mut differences: Vec<f64> = rows.map(|pair| (pair[1] - pair[0]).abs()).collect();
    // Of a normal distribution the median of differences is 0.95 σ.
    median_in_place(&mut differences).unwrap_or(0.0) / 0.95
}

/// The blocks below a level that hang together with the border.
fn hanging_together(level: &[f64], columns: usize, below: f64, is_border: impl Fn(usize) -> bool) -> Vec<bool> {
    let mut outside = vec![false; level.len()];
    let mut open: Vec<usize> = (0..level.len()).filter(|&block| is_border(block) && level[block] < below).collect();
    for &block in &open {
        outside[block] = true;
    }
    while let Some(block) = open.pop() {
        for next in neighbours(block, columns, level.len()) {
            if !outside[next] && level[next] < below {
                outside[next] = true;
                open.push(next);
            }
        }
    }
    outside
}

/// The blocks beside, above and below.
fn neighbours(block: usize, columns: usize, count: usize) -> impl Iterator<Item = usize> {
    let column = block % columns;
    let beside = [(column > 0).then(|| block - 1), (column + 1 < columns).then(|| block + 1)];
    let along = [block.checked_sub(columns), Some(block + columns).filter(|next| *next < count)];
    beside.into_iter().chain(along).flatten()
}

/// Whether the light rises within two blocks where the surround ends, and what lies outside is of one level.
fn ends_sharply(level: &[f64], outside: &[bool], columns: usize, dark: f64, step: f64) -> bool {
    let mut rises = Vec::new();
    let mut levels: Vec<f64> = Vec::new();
    for (block, _) in outside.iter().enumerate().filter(|(_, out)| **out) {
        let mut at_edge = false;
        for inside in neighbours(block, columns, level.len()).filter(|&next| !outside[next]) {
            at_edge = true;
            // One block on, in the same direction, from the one inside and from the one outside.
            let on = |from: usize, to: usize| (2 * to).checked_sub(from).filter(|&block| block < level.len());
            let (Some(far_in), Some(far_out)) = (on(block, inside), on(inside, block)) else { continue };
            rises.push(level[far_in] - level[far_out].min(level[block]));
        }
        if !at_edge {
            levels.push(level[block]);
        }
    }
    let scatter = {
        let mut off: Vec<f64> = levels.iter().map(|level| (level - dark).abs()).collect();
        1.5 * median_in_place(&mut off).unwrap_or(0.0)
    };
    median_in_place(&mut rises).is_some_and(|rise| rise > SHARP * step) && step > CLEARLY * scatter
}

/// The surround's blocks as pixels, and those beside them, through which the edge runs.
fn as_pixels(frame: &Frame, outside: &[bool], columns: usize, rows: usize) -> Vec<bool> {
    let wide: Vec<bool> = (0..outside.len())
        .map(|block| {
            let (column, row) = (block % columns, block / columns);
            (row.saturating_sub(1)..(row + 2).min(rows))
                .any(|y| (column.saturating_sub(1)..(column + 2).min(columns)).any(|x| outside[y * columns + x]))
        })
        .collect();
    let block = |x: usize, y: usize| (y / BLOCK_PX).min(rows - 1) * columns + (x / BLOCK_PX).min(columns - 1);
    (0..frame.pixels_dn.len()).map(|i| wide[block(i % frame.width_px, i / frame.width_px)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// A frame whose level is a function of place, with noise.
    fn frame(level_dn: impl Fn(f64, f64) -> f64) -> Frame {
        let (width_px, height_px) = (400, 320);
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let noise = Normal::new(0.0, 3.0).unwrap();
        let pixels_dn = (0..width_px * height_px)
            .map(|i| (level_dn((i % width_px) as f64, (i / width_px) as f64) + noise.sample(&mut rng)).round().max(0.0) as f32)
            .collect();
        Frame { width_px, height_px, pixels_dn, saturation_dn: 255.0 }
    }

    #[test]
    fn the_outside_of_a_circle_and_the_bars_beside_a_picture_are_found() {
        let circle = frame(|x, y| if (x - 210.0).hypot(y - 150.0) < 140.0 { 60.0 } else { 8.0 });
        let bars = frame(|x, y| if (40.0..360.0).contains(&x) && (30.0..290.0).contains(&y) { 30.0 } else { 0.0 });
        for (name, frame, inside) in [("circle", circle, [[210.0, 150.0, 120.0]]), ("bars", bars, [[200.0, 160.0, 115.0]])] {
            let around = surround(&frame).unwrap_or_else(|| panic!("{name} is not found"));
            let dark = frame.pixels_dn.iter().zip(&around).filter(|(v, _)| **v < 15.0).filter(|(_, out)| **out).count();
            let all_dark = frame.pixels_dn.iter().filter(|v| **v < 15.0).count();
            assert!(dark as f64 > 0.97 * all_dark as f64, "{name}: {dark} of {all_dark}");
            for [x0, y0, radius] in inside {
                let kept = |i: &usize| ((i % 400) as f64 - x0).hypot((i / 400) as f64 - y0) < radius;
                assert!((0..around.len()).filter(kept).all(|i| !around[i]), "{name} takes sky");
            }
        }
    }

    #[test]
    fn sky_glow_vignettes_and_gaps_between_clouds_are_no_surround() {
        let frames = [
            ("sky", frame(|_, _| 40.0)),
            ("noisy sky", frame(|x, y| 200.0 + 40.0 * (12.9898 * x + 78.233 * y + 0.1 * x * y).sin())),
            ("glow", frame(|_, y| 20.0 + 0.4 * y)),
            ("vignette", frame(|x, y| 90.0 / (1.0 + ((x - 200.0).hypot(y - 160.0) / 150.0).powi(2)).powi(2))),
            ("clouds", frame(|x, y| if (0.03 * x).sin() + (0.02 * y).cos() > -0.3 && y > 30.0 { 90.0 } else { 40.0 })),
            ("black", frame(|_, _| 0.0)),
        ];
        for (name, frame) in frames {
            assert!(surround(&frame).is_none(), "{name}");
        }
    }
}
