//! Stars in a chain: pieces of a streak that the search for stars has taken for stars.
//!
//! A faint streak is brighter than the noise over the size of a star image long before its single pixels are: the search finds stars all along it, and
//! where stars are left out the streak is left out with them. Stars by chance lie on a band in proportion to its area, and follow Poisson's distribution; a
//! band that has many more is a chain. All bands are counted at once, by the lines through every star. Source: R. O. Duda and P. E. Hart, Communications
//! of the ACM 15, 11 (1972).

use super::sky_frame::StarDisc;

/// Directions of bands, over half a turn.
const ANGLES: usize = 360;
/// Width of a band; bands overlap by half.
const BAND_PX: f64 = 4.0;
/// A chain has so many stars at least,
const MIN_STARS: f64 = 10.0;
/// and more than chance brings in one of so many frames: whoever takes a chain of stars for a streak finds their light in it.
const FRAMES_WITHOUT: f64 = 1e4;
/// Bands nearer than this to an axis, rad: columns that bleed and rows of hot pixels are no streaks.
const AXIS_RAD: f64 = 0.02;
/// Of more stars the brightest are asked.
const MAX_STARS: usize = 5000;

/// Of each star whether it lies in a chain.
pub(super) fn in_chains(stars: &[StarDisc], size_px: [usize; 2]) -> Vec<bool> {
    in_chains_of(FRAMES_WITHOUT, stars, size_px)
}

/// The same of chains that chance brings in one of so many frames.
fn in_chains_of(frames_without: f64, stars: &[StarDisc], size_px: [usize; 2]) -> Vec<bool> {
    let [width, height] = size_px.map(|side| side as f64);
    let asked = &stars[..stars.len().min(MAX_STARS)];
    let step = 0.5 * BAND_PX;
    let half = 0.5 * width.hypot(height) + BAND_PX;
    let bands = (2.0 * half / step).ceil() as usize + 1;
    let mut chained = vec![false; stars.len()];
    let by_chance = (frames_without * (ANGLES * bands) as f64).ln();
    for angle in 0..ANGLES {
        let (sin, cos) = (std::f64::consts::PI * (angle as f64 + 0.5) / ANGLES as f64).sin_cos();
        if sin.abs().min(cos.abs()) < AXIS_RAD {
            continue;
        }
        // Distance from the middle of the frame across the band.
        let across = |star: &StarDisc| (star.x_px - 0.5 * (width - 1.0)) * cos + (star.y_px - 0.5 * (height - 1.0)) * sin;
        let mut steps = vec![0.0; bands];
        for star in asked {
            let place = (across(star) + half) / step;
            if place >= 0.0 && place < bands as f64 {
                steps[place as usize] += 1.0;
            }
        }
        for band in 0..bands - 1 {
            let count = steps[band] + steps[band + 1];
            let middle = (band as f64 + 1.0) * step - half;
            let expected = asked.len() as f64 * BAND_PX * chord(middle, [cos, sin], [width, height]) / (width * height);
            if count < MIN_STARS || surprise(count, expected) < by_chance {
                continue;
            }
            for (star, chained) in asked.iter().zip(&mut chained) {
                *chained |= (across(star) - middle).abs() <= step;
            }
        }
    }
    chained
}

/// −ln of the probability of so many stars or more where fewer are expected, at least (Chernoff's bound of Poisson's tail).
fn surprise(count: f64, expected: f64) -> f64 {
    if count > expected { count * (count / expected).ln() - count + expected } else { 0.0 }
}

/// Length within the frame of the line at a distance from its middle along a normal, px.
fn chord(distance: f64, [cos, sin]: [f64; 2], [width, height]: [f64; 2]) -> f64 {
    // A point of the line moves along (−sin, cos); each pair of sides bounds how far.
    let start = [distance * cos, distance * sin];
    let [mut low, mut high] = [f64::NEG_INFINITY, f64::INFINITY];
    for (at, along, side) in [(start[0], -sin, width), (start[1], cos, height)] {
        let [a, b] = [(-0.5 * side - at) / along, (0.5 * side - at) / along];
        (low, high) = (low.max(a.min(b)), high.min(a.max(b)));
    }
    (high - low).max(0.0)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const SIZE_PX: [usize; 2] = [640, 480];

    fn scattered(seed: u64, count: usize) -> Vec<StarDisc> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        (0..count).map(|_| StarDisc { x_px: rng.random_range(0.0..640.0), y_px: rng.random_range(0.0..480.0), radius_px: 5.0 }).collect()
    }

    #[test]
    fn stars_by_chance_are_no_chain() {
        for (seed, count) in [(1, 20), (2, 100), (3, 400), (4, 2000), (5, 6000)] {
            let found = in_chains(&scattered(seed, count), SIZE_PX);
            assert!(!found.contains(&true) && found.len() == count, "{count} stars");
        }
    }

    /// Few stars in many frames: bands with ten of them come by chance in some, and are no chains.
    #[test]
    fn many_frames_have_no_chain_by_chance() {
        const FRAMES: u64 = 400;
        let with_any = |frames_without: f64| {
            let has_any = |seed: &u64| in_chains_of(frames_without, &scattered(1000 + seed, 150), SIZE_PX).contains(&true);
            (0..FRAMES).filter(has_any).count()
        };
        assert_eq!(with_any(FRAMES_WITHOUT), 0);
        assert!(with_any(0.01) > 0, "the test could not fail");
    }

    /// Whole ways across the frame, among few stars and many.
    #[test]
    fn the_pieces_of_a_streak_are_a_chain() {
        for (way, pieces, others) in [([[-20.0, 40.0], [660.0, 400.0]], 60, 400), ([[100.0, 470.0], [300.0, 10.0]], 25, 100)] {
            let mut stars = scattered(7, others);
            let piece = |k: usize| {
                let share = (k as f64 + 0.5) / pieces as f64;
                let [x_px, y_px] = [0, 1].map(|axis| way[0][axis] + share * (way[1][axis] - way[0][axis]));
                StarDisc { x_px, y_px, radius_px: 5.0 }
            };
            stars.extend((0..pieces).map(piece));
            let found = in_chains(&stars, SIZE_PX);
            let count = |own: &[bool]| own.iter().filter(|own| **own).count();
            assert!(count(&found[others..]) >= pieces - 2, "{:?}", &found[others..]);
            assert!(count(&found[..others]) <= others / 20, "{} of {others}", count(&found[..others]));
        }
    }

    #[test]
    fn a_chord_is_as_long_as_the_frame_lets_it() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((chord(0.0, [half, half], [100.0, 100.0]) - 100.0 / half).abs() < 1e-9);
        assert!((chord(30.0, [1e-9, 1.0], [100.0, 80.0]) - 100.0).abs() < 1e-6);
        assert_eq!(chord(90.0, [half, half], [100.0, 100.0]), 0.0);
    }
}
