//! Order of detections that is even over the frame, for frames whose brightest points stand together: leaves, lamps and clouds fill a part of a
//! frame and are brighter than the stars beside them.
//!
//! The brightest of every part of the frame come first, then the second of every part, and so on; parts that hold many more points than most come
//! last in each round.

use super::pose::Points;
use crate::statistics::crowding::{BRIGHTEST, crowding};

/// The points spread over the frame; `None` if the brightest are that already.
pub(super) fn spread(points: &Points) -> Option<Points> {
    if points.centred_px.len() < BRIGHTEST {
        return None;
    }
    let [half_x, half_y] = points.half_px;
    let at_px: Vec<[f64; 2]> = points.centred_px.iter().map(|[x, y]| [x + half_x, y + half_y]).collect();
    let standing = crowding(&at_px, [2.0 * half_x, 2.0 * half_y])?;
    let mut order: Vec<(usize, bool, usize)> =
        standing.into_iter().enumerate().map(|(point, own)| (own.rank, own.is_crowded, point)).collect();
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
    fn stars_beside_brighter_leaves_come_early() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        let mut all: Vec<[f64; 2]> = (0..300).map(|_| [rng.random_range(320.0..640.0), rng.random_range(-480.0..480.0)]).collect();
        all.extend((0..52).map(|_| [rng.random_range(-640.0..320.0), rng.random_range(-480.0..480.0)]));
        let spread = spread(&points(all)).expect("the brightest stand together");
        let stars = |first: usize| spread.detection.iter().take(first).filter(|&&detection| detection >= 300).count();
        assert!(stars(12) >= 11 && stars(40) >= 26, "{} of 12, {} of 40", stars(12), stars(40));
    }
}
