//! A camera that moved during single exposures, where no rates are declared that tell it.
//!
//! A uniform motion of length L widens images along its direction by L²/12 (the variance of a box), so that what it adds to their elongation it adds to
//! their size: (xx + yy)/2 by L²/24, (xx − yy)/2 and xy by L²/24 times cosine and sine of twice its angle.
//!
//! All stars of a frame are drawn out along one direction. A companion that is not resolved draws out its own star alone, but in all frames along the same
//! direction of the sky: by chance the mean of a few such stars is far from zero, and turns with the camera from frame to frame. The elongation, as the
//! complex number (xx − yy)/2 + i·xy, is therefore held against that of OTHER stars in the same frame, and the sum of those products against the sums
//! that result where each star is turned by an angle of its own, the same in all its frames (a wild bootstrap of stars instead of images).

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::counted::{Counted, MAX_SURPRISE};
use super::judge::Judged;
use super::stars::{DIAGONAL, ELONGATION, SIZE};
use crate::diagnose::causes::MOTION_SMEAR;
use crate::diagnose::channels::Channel;
use crate::statistics::median;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Fewer frames tell nothing of one among them.
const MIN_FRAMES: usize = 5;
/// Of what is added to the elongation by a motion so much at least is added to the size, and so much at most.
const SMEAR_SLOPE: [f64; 2] = [0.4, 1.6];
/// The stars agree by so many standard deviations of the turned ones. Of many stars that keep their elongations in all frames the squared sum is
/// exponentially distributed: that many happen once in e⁹.
const AGREES: f64 = 8.0;
/// A frame has at least so many stars.
const MIN_STARS: usize = 10;
/// Draws of the angles: their standard deviation is known to 5 to 10 %.
const DRAWS: usize = 256;

/// Residual and variance of a row.
type Measured = [f64; 2];

/// Second moments of one star in one frame less the fit: size, elongation along the axes and along the diagonals.
struct Image {
    star: usize,
    moments: [Measured; 3],
}

/// Elongations that change from frame to frame and that the stars of a frame have in common.
pub(super) fn moved(judged: &Judged) -> Option<Counted> {
    let mut frames = images(judged)?;
    if frames.len() < MIN_FRAMES {
        return None;
    }
    // What all frames have in common is the image.
    for moment in 0..3 {
        let middle = median(&frames.iter().map(|images| mean(images, moment)[0]).collect::<Vec<_>>())?;
        frames.iter_mut().flatten().for_each(|image| image.moments[moment][0] -= middle);
    }
    let mut statistic = 0.0;
    let (mut sizes, mut strengths, mut variance) = (Vec::new(), 0.0, 0.0);
    for images in &frames {
        let [[s, s_variance], [e, e_variance], [d, d_variance]] = [0, 1, 2].map(|moment| mean(images, moment));
        statistic += e * e / e_variance + d * d / d_variance;
        let strength = (e * e + d * d - e_variance - d_variance).max(0.0).sqrt();
        sizes.push([strength, s, s_variance.recip()]);
        strengths += strength;
        // Along the direction of the motion.
        variance += 0.5 * (e_variance + d_variance);
    }
    // Means take one from every number.
    let degrees = 2.0 * (frames.len() as f64 - 1.0);
    let surprise = neg_ln_chi2_sf(degrees, statistic).min(MAX_SURPRISE);
    let slope = slope(&sizes);
    let is_motion = slope > SMEAR_SLOPE[0] && slope < SMEAR_SLOPE[1] && agreement(&frames) > AGREES;
    // Lengths are squared: 24 times the mean strength.
    let count = frames.len() as f64;
    let rms = (24.0 * strengths / count).sqrt();
    let error = 12.0 * variance.sqrt() / count / rms.max(f64::MIN_POSITIVE);
    is_motion.then(|| {
        Counted::of_stars(
            MOTION_SMEAR,
            Channel::Shape,
            vec![("length_px", rms, error, "px")],
            surprise,
            "frame",
            format!("Images are drawn out by {rms:.2} px (rms over the frames), in every frame along a direction of its own, and are wider by as much: the camera moved."),
        )
    })
}

/// The images of each frame that has enough of them.
fn images(judged: &Judged) -> Option<Vec<Vec<Image>>> {
    let fit = judged.standing();
    let mut of_moment: [BTreeMap<(usize, usize), Measured>; 3] = Default::default();
    for (own, name) in of_moment.iter_mut().zip([SIZE, ELONGATION, DIAGONAL]) {
        let number = judged.rows.kinds.iter().position(|kind| kind.name == name)?;
        let rows = judged.rows.kinds[number].rows.iter().zip(judged.rows.ranges()[number].clone());
        let taken = rows.filter(|(row, k)| fit.take[*k] && row.point.is_some());
        *own = taken.map(|(row, k)| ((row.frame, row.star), [fit.rest[k], fit.noise[number].variance(row)])).collect();
    }
    let [size, along, diagonal] = of_moment;
    let mut frames: BTreeMap<usize, Vec<Image>> = BTreeMap::new();
    for (key @ (frame, star), along) in along {
        if let (Some(size), Some(diagonal)) = (size.get(&key), diagonal.get(&key)) {
            frames.entry(frame).or_default().push(Image { star, moments: [*size, along, *diagonal] });
        }
    }
    Some(frames.into_values().filter(|images| images.len() >= MIN_STARS).collect())
}

/// Weighted mean of a moment, and its variance.
fn mean(images: &[Image], moment: usize) -> Measured {
    let [sum, weight] = images.iter().fold([0.0; 2], |[sum, weight], image| {
        let [value, variance] = image.moments[moment];
        [sum + value / variance, weight + variance.recip()]
    });
    [sum / weight, weight.recip()]
}

/// Products of the elongations of different stars in the same frame, summed, in standard deviations of that sum where each star is turned.
fn agreement(frames: &[Vec<Image>]) -> f64 {
    let mut number_of: BTreeMap<usize, usize> = frames.iter().flatten().map(|image| (image.star, 0)).collect();
    for (number, own) in number_of.values_mut().enumerate() {
        *own = number;
    }
    // Both components of an image have nearly the same variance; a turn needs one.
    let of_frame: Vec<Vec<(usize, [f64; 2])>> = frames
        .iter()
        .map(|images| {
            let own = |image: &Image| {
                let [_, [e, e_variance], [d, d_variance]] = image.moments;
                let weight = 2.0 / (e_variance + d_variance);
                (number_of[&image.star], [e * weight.sqrt(), d * weight.sqrt()])
            };
            images.iter().map(own).collect()
        })
        .collect();
    let products = |turns: &[[f64; 2]]| -> f64 {
        let of = |images: &Vec<(usize, [f64; 2])>| {
            let (mut sum, mut own) = ([0.0; 2], 0.0);
            for (star, [e, d]) in images {
                let [cos, sin] = turns[*star];
                sum = [sum[0] + e * cos - d * sin, sum[1] + e * sin + d * cos];
                own += e * e + d * d;
            }
            sum[0] * sum[0] + sum[1] * sum[1] - own
        };
        of_frame.iter().map(of).sum()
    };
    let mut rng = Pcg64Mcg::seed_from_u64(DRAWS as u64);
    let mut turned = || {
        let turns: Vec<[f64; 2]> = number_of
            .iter()
            .map(|_| {
                let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
                [cos, sin]
            })
            .collect();
        products(&turns).powi(2)
    };
    let variance = (0..DRAWS).map(|_| turned()).sum::<f64>() / DRAWS as f64;
    if variance > 0.0 { products(&vec![[1.0, 0.0]; number_of.len()]) / variance.sqrt() } else { 0.0 }
}

/// Slope of a line through points (x, y, weight); 0 where all x are the same.
fn slope(points: &[[f64; 3]]) -> f64 {
    let sum = |of: &dyn Fn(&[f64; 3]) -> f64| points.iter().map(|point| point[2] * of(point)).sum::<f64>();
    let weight = sum(&|_| 1.0);
    let [x, y] = [sum(&|point| point[0]) / weight, sum(&|point| point[1]) / weight];
    let square = sum(&|point| (point[0] - x).powi(2));
    if square > 0.0 { sum(&|point| (point[0] - x) * (point[1] - y)) / square } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::super::expected_stars::StarMeasurement;
    use super::super::judge::judge;
    use super::super::tests::{FRAMES, asked, nothing, stars};
    use super::*;

    /// Name and length, with its error, that are told of stars without declared rates.
    fn told(mut stars: Vec<StarMeasurement>) -> Option<(String, [f64; 2])> {
        for star in &mut stars {
            star.image.trail_px = None;
        }
        let judged = judge(&stars, None, FRAMES, &asked(1e-3), &[]).unwrap();
        let found = moved(&judged)?.reported().1?;
        Some((found.id, [found.parameters[0].value, found.parameters[0].sigma]))
    }

    /// Adds a variance along a direction.
    fn widen(star: &mut StarMeasurement, added_px2: f64, angle_rad: f64) {
        let (sin, cos) = angle_rad.sin_cos();
        let moments = star.moments.as_mut().unwrap();
        for (value, more) in moments.second_px2.iter_mut().zip([cos * cos, sin * cos, sin * sin]) {
            *value += added_px2 * more;
        }
    }

    /// Images drawn out by `length_px`, in every frame along another direction.
    fn drawn_out(seed: u64, length_px: f64) -> Vec<StarMeasurement> {
        let mut stars = stars(seed, nothing);
        for star in &mut stars {
            // Where all lengths are the same the images are wider by the same, and that is the image; what goes with the time is a focus.
            let longer = length_px * (0.4 + 0.1 * ((5 * star.frame) % FRAMES) as f64);
            widen(star, longer * longer / 12.0, TAU * 0.29 * star.frame as f64);
        }
        stars
    }

    #[test]
    fn a_motion_is_told_by_its_frames() {
        for seed in 30..33 {
            assert_eq!(told(drawn_out(seed, 0.0)), None, "seed {seed}");
            let smear = told(drawn_out(seed, 1.5));
            assert!(
                matches!(&smear, Some((id, [length, _])) if id == "motion-smear" && (length - 1.5).abs() < 0.2),
                "seed {seed}: {smear:?}"
            );
        }
    }

    #[test]
    fn lengths_scatter_by_their_errors() {
        const SEEDS: f64 = 40.0;
        let mean_square = (0..FRAMES).map(|k| (1.5 * (0.4 + 0.1 * k as f64)).powi(2)).sum::<f64>() / FRAMES as f64;
        let pulls: Vec<f64> = (0..SEEDS as u64)
            .map(|seed| {
                let (_, [length, sigma]) = told(drawn_out(100 + seed, 1.5)).unwrap();
                (length - mean_square.sqrt()) / sigma
            })
            .collect();
        let mean = pulls.iter().sum::<f64>() / SEEDS;
        let scatter = (pulls.iter().map(|pull| (pull - mean).powi(2)).sum::<f64>() / (SEEDS - 1.0)).sqrt();
        println!("found/sigma of lengths: mean {mean:.2}, standard deviation {scatter:.2}");
        assert!(mean.abs() < 0.6 && (0.7..1.3).contains(&scatter), "{mean} {scatter}: {pulls:?}");
    }

    /// Frames of stars of which every third has a companion that is not resolved and stands still in the sky; the camera turns from frame to frame.
    fn blended(seed: u64) -> Vec<Vec<Image>> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let companions: Vec<[f64; 2]> = (0..10).map(|_| [1.0 + 9.0 * rng.random::<f64>(), TAU * rng.random::<f64>()]).collect();
        let frame = |frame: usize| {
            let mut image = |star: usize| {
                let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
                let [size, along, diagonal] = [noise(), noise(), noise()];
                let [length, angle_rad] = if star.is_multiple_of(3) { companions[star / 3] } else { [0.0; 2] };
                let (sin, cos) = (angle_rad + 0.29 * TAU * frame as f64).sin_cos();
                Image { star, moments: [size + length, along + length * cos, diagonal + length * sin].map(|value| [value, 1.0]) }
            };
            (0..30).map(&mut image).collect()
        };
        (0..FRAMES).map(frame).collect()
    }

    /// A few stars with the same direction in the sky by chance agree in every frame, and that is one chance, not one of each frame.
    #[test]
    fn blends_that_turn_with_the_sky_are_no_motion() {
        let agreements = |seeds: std::ops::Range<u64>, is_known: bool| -> Vec<f64> {
            let of = |seed| {
                let mut frames = blended(seed);
                if !is_known {
                    frames.iter_mut().flatten().enumerate().for_each(|(number, image)| image.star = number);
                }
                agreement(&frames)
            };
            seeds.map(of).collect()
        };
        let known = agreements(0..300, true);
        assert!(known.iter().all(|own| *own < AGREES), "{known:?}");
        // The sum of the products is a squared length: its scatter is its mean, which is taken off.
        let mean = known.iter().sum::<f64>() / 300.0;
        let scatter = (known.iter().map(|own| (own - mean).powi(2)).sum::<f64>() / 300.0).sqrt();
        assert!(mean.abs() < 0.2 && (scatter - 1.0).abs() < 0.2, "{mean} {scatter}");
        // Where each image counts as a star of its own they are taken for a motion.
        let unknown = agreements(0..300, false);
        assert!(unknown.iter().filter(|own| **own > AGREES).count() >= 4, "{unknown:?}");
    }
}
