//! The points in another order than by brightness, where the bright ones stand together: leaves, lamps and clouds fill a part of a frame and are
//! brighter than the stars beside them.
//!
//! The brightest of every part of the frame come first, then the second of every part, and so on; parts that hold many more points than most come
//! last in each turn.

use super::refine::Points;

/// Parts of the frame, about.
const PARTS: f64 = 40.0;
/// So many of the brightest points are looked at …
const BRIGHTEST: usize = 64;
/// … and more of them than this share in a quarter of the parts are too many. Of 64 points by chance, in 40 parts, the fullest quarter holds 0.48 on
/// average, and 0.61 in one frame of a thousand.
const TOO_MANY: f64 = 0.65;
/// Of fewer points it cannot be told: by chance alone the fullest quarter holds a larger share of them.
const FEWEST: usize = BRIGHTEST;
/// A part with so many times more points than the middle one is full of something else.
const FULL: f64 = 3.0;

/// The points spread over the frame; `None` if the brightest are that already.
pub(super) fn spread(points: &Points) -> Option<Points> {
    let count = points.centred_px.len();
    if count < FEWEST {
        return None;
    }
    let [width, height] = points.half_px.map(|half| 2.0 * half);
    let side = (width * height / PARTS).sqrt();
    let (columns, rows) = (((width / side).round() as usize).max(1), ((height / side).round() as usize).max(1));
    let part = |&[x, y]: &[f64; 2]| {
        let along = |at: f64, size: f64, parts: usize| (((at / size + 0.5) * parts as f64).max(0.0) as usize).min(parts - 1);
        along(y, height, rows) * columns + along(x, width, columns)
    };
    let of: Vec<usize> = points.centred_px.iter().map(part).collect();
    let fullest = |first: usize| {
        let mut held = vec![0_usize; columns * rows];
        for part in of.iter().take(first) {
            held[*part] += 1;
        }
        held
    };
    let mut bright = fullest(BRIGHTEST);
    bright.sort_unstable_by(|a, b| b.cmp(a));
    let in_quarter: usize = bright.iter().take((columns * rows).div_ceil(4)).sum();
    if in_quarter as f64 <= TOO_MANY * BRIGHTEST as f64 {
        return None;
    }
    let held = fullest(count);
    let mut sorted = held.clone();
    sorted.sort_unstable();
    let middle = sorted[sorted.len() / 2].max(1) as f64;
    let mut turn = vec![0_usize; columns * rows];
    let mut order: Vec<(usize, bool, usize)> = of
        .iter()
        .enumerate()
        .map(|(point, &part)| {
            turn[part] += 1;
            (turn[part], held[part] as f64 > FULL * middle, point)
        })
        .collect();
    order.sort_unstable();
    Some(points.only(&order.into_iter().map(|(_, _, point)| point).collect::<Vec<_>>()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn points(centred_px: Vec<[f64; 2]>) -> Points {
        let detection = (0..centred_px.len()).collect();
        Points { centred_px, detection, half_px: [640.0, 480.0], size_px: 1108.0, corner_px: 800.0, reach_px: 800.0 }
    }

    #[test]
    fn points_by_chance_stay_in_their_order() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        for count in (10..400).step_by(3) {
            let all = (0..count).map(|_| [rng.random_range(-640.0..640.0), rng.random_range(-480.0..480.0)]).collect();
            assert!(spread(&points(all)).is_none(), "{count} points");
        }
    }

    #[test]
    fn stars_beside_brighter_leaves_come_early() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        let mut all: Vec<[f64; 2]> = (0..300).map(|_| [rng.random_range(320.0..640.0), rng.random_range(-480.0..480.0)]).collect();
        all.extend((0..52).map(|_| [rng.random_range(-640.0..320.0), rng.random_range(-480.0..480.0)]));
        let spread = spread(&points(all)).expect("the brightest stand together");
        let stars = |first: usize| spread.detection.iter().take(first).filter(|&&detection| detection >= 300).count();
        assert!(stars(12) >= 11 && stars(40) >= 26, "{} of 12, {} of 40", stars(12), stars(40));
    }
}
