//! Crowding test: do the brightest points of a frame stand together in a part of it? Leaves, lamps and clouds do, and are brighter than the stars
//! beside them; tests of stars then use the other parts.

/// Parts of the frame, about.
const PARTS: f64 = 40.0;
/// So many of the brightest points are looked at …
pub(crate) const BRIGHTEST: usize = 64;
/// … and more of them than this share in a quarter of the parts are too many. Of 64 points by chance, in 40 parts, the fullest quarter holds 0.48 on
/// average, and 0.61 in one frame of a thousand.
const TOO_MANY: f64 = 0.65;
/// A part with so many times more points than the middle one is full of something else.
const FULL: f64 = 3.0;

/// Where a point stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Standing {
    /// How many points of its part are as bright or brighter, itself among them.
    pub rank: usize,
    /// Whether its part is full of something else than stars.
    pub is_crowded: bool,
}

/// Where each of some points stands (px from a corner of a frame of this size; brightest first); `None` if the brightest are spread over the frame, or
/// too few to tell (by chance alone the fullest quarter holds a larger share of them).
#[must_use]
pub fn crowding(at_px: &[[f64; 2]], size_px: [f64; 2]) -> Option<Vec<Standing>> {
    if at_px.len() < BRIGHTEST {
        return None;
    }
    let [width, height] = size_px;
    let side = (width * height / PARTS).sqrt();
    let (columns, rows) = (((width / side).round() as usize).max(1), ((height / side).round() as usize).max(1));
    let part = |&[x, y]: &[f64; 2]| {
        let along = |at: f64, size: f64, parts: usize| ((at / size * parts as f64).max(0.0) as usize).min(parts - 1);
        along(y, height, rows) * columns + along(x, width, columns)
    };
    let of: Vec<usize> = at_px.iter().map(part).collect();
    let holds = |first: usize| {
        let mut held = vec![0_usize; columns * rows];
        for part in of.iter().take(first) {
            held[*part] += 1;
        }
        held
    };
    let mut bright = holds(BRIGHTEST);
    bright.sort_unstable_by(|a, b| b.cmp(a));
    let in_quarter: usize = bright.iter().take((columns * rows).div_ceil(4)).sum();
    if in_quarter as f64 <= TOO_MANY * BRIGHTEST as f64 {
        return None;
    }
    let held = holds(at_px.len());
    let mut sorted = held.clone();
    sorted.sort_unstable();
    let middle = sorted[sorted.len() / 2].max(1) as f64;
    let mut rank = vec![0_usize; columns * rows];
    let standing = of.iter().map(|&part| {
        rank[part] += 1;
        Standing { rank: rank[part], is_crowded: held[part] as f64 > FULL * middle }
    });
    Some(standing.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    const SIZE_PX: [f64; 2] = [1280.0, 960.0];

    #[test]
    fn points_by_chance_do_not_stand_together() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        for count in (10..400).step_by(3) {
            let all: Vec<[f64; 2]> = (0..count).map(|_| [rng.random_range(0.0..1280.0), rng.random_range(0.0..960.0)]).collect();
            assert!(crowding(&all, SIZE_PX).is_none(), "{count} points");
        }
    }

    #[test]
    fn brighter_leaves_beside_stars_are_told() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        let mut all: Vec<[f64; 2]> = (0..300).map(|_| [rng.random_range(960.0..1280.0), rng.random_range(0.0..960.0)]).collect();
        all.extend((0..52).map(|_| [rng.random_range(0.0..900.0), rng.random_range(0.0..960.0)]));
        let standing = crowding(&all, SIZE_PX).expect("the brightest stand together");
        assert!(standing[..300].iter().filter(|own| own.is_crowded).count() > 290);
        // By chance a few parts hold three times as many stars as the middle one.
        assert!(standing[300..].iter().filter(|own| !own.is_crowded).count() > 40);
    }
}
