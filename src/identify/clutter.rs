//! Clutter: detections that look like no star beside the others of the frame. Letters, edges and trails come in clumps, glows are wide.
//!
//! What they are is not decided here. A frame that has many of them is searched without them first, and then as it is.

use super::pose::Points;

/// Within the radius around a point in which by chance so many others stand …
const BY_CHANCE: f64 = 0.3;
/// … no star has so many.
const CLUMP: u64 = 3;
/// Stars are not so much wider than the narrowest quarter of the detections.
const WIDE: f64 = 2.5;
/// Fewer points do not decide it.
const MIN_POINTS: usize = 12;
/// Among so many of the brightest points the search begins …
const BRIGHTEST: usize = 32;
/// … and so many of them that look like no star are worth a look without.
const WORTH_A_LOOK: usize = 6;
/// So often what is left is asked again: without one clump another stands out.
const ROUNDS: usize = 3;

/// The points that look like stars, each with the width of its image, px, brightest first; `None` if that is nearly all of them.
pub(super) fn without_clutter(points: &Points, widths_px: &[f64]) -> Option<Points> {
    let count = points.centred_px.len();
    if count < MIN_POINTS {
        return None;
    }
    let mut sorted = widths_px.to_vec();
    sorted.retain(|width| width.is_finite());
    let quarter = sorted.len() / 4;
    let widest_px = if sorted.is_empty() { f64::INFINITY } else { WIDE * *sorted.select_nth_unstable_by(quarter, f64::total_cmp).1 };
    let mut lone: Vec<usize> = (0..count).collect();
    lone.retain(|&point| widths_px.get(point).is_none_or(|width| *width <= widest_px));
    for _ in 0..ROUNDS {
        let before = lone.len();
        leave_clumps(points, &mut lone);
        if lone.len() == before || lone.len() < MIN_POINTS {
            break;
        }
    }
    let left = lone.iter().filter(|&&point| point < BRIGHTEST).count();
    (lone.len() >= MIN_POINTS && left + WORTH_A_LOOK <= count.min(BRIGHTEST)).then(|| points.only(&lone))
}

/// Leaves of some points those that do not stand in a clump of them.
fn leave_clumps(points: &Points, some: &mut Vec<usize>) {
    let radius2_px2 = BY_CHANCE * points.area_px2() / (std::f64::consts::PI * some.len() as f64);
    let axis = |axis: usize| some.iter().map(|&point| points.centred_px[point][axis]).collect::<Vec<f64>>();
    let (xs, ys) = (axis(0), axis(1));
    // How many stand near each, itself too.
    let count = |(x, y): (&f64, &f64)| {
        let near = |(other_x, other_y): (&f64, &f64)| u64::from((x - other_x).powi(2) + (y - other_y).powi(2) <= radius2_px2);
        xs.iter().zip(&ys).map(near).sum::<u64>()
    };
    let near: Vec<u64> = xs.iter().zip(&ys).map(count).collect();
    let mut near = near.into_iter();
    some.retain(|_| near.next().is_some_and(|near| near <= CLUMP));
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn points(centred_px: Vec<[f64; 2]>) -> Points {
        let detection = (0..centred_px.len()).collect();
        Points { centred_px, detection, half_px: [512.0; 2], size_px: 1024.0, corner_px: 724.0, reach_px: 724.0 }
    }

    fn scattered(count: usize, seed: u64) -> Vec<[f64; 2]> {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        (0..count).map(|_| [rng.random_range(-512.0..512.0), rng.random_range(-512.0..512.0)]).collect()
    }

    #[test]
    fn points_by_chance_are_looked_at_as_they_are() {
        for seed in 0..200 {
            let count = 4 + 2 * seed as usize;
            assert!(without_clutter(&points(scattered(count, seed)), &vec![1.0; count]).is_none(), "{count} points");
        }
    }

    #[test]
    fn a_line_of_writing_and_wide_glows_are_left_out_and_stars_are_not() {
        let stars = scattered(60, 1);
        let writing = (0..40).map(|letter| [-480.0 + 12.0 * f64::from(letter), 490.0 + f64::from(letter * 7 % 5)]);
        let glows = scattered(10, 2);
        let all: Vec<[f64; 2]> = writing.chain(glows).chain(stars).collect();
        let widths: Vec<f64> = (0..110).map(|point| if (40..50).contains(&point) { 6.0 } else { 1.2 }).collect();
        let lone = without_clutter(&points(all), &widths).unwrap();
        // The ends of a line have fewer beside them.
        let (mut kept, mut others) = (0, 0);
        for detection in lone.detection {
            if detection >= 50 { kept += 1 } else { others += 1 }
        }
        assert!(kept >= 55 && others <= 3, "{kept} stars of 60, {others} others");
    }
}
