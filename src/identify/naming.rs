//! Which of the stars near a detection it is, if any: by place and brightness, weighed against being none of them.
//!
//! A detection of magnitude m at the distance d from where star i belongs speaks for it by
//!
//! ```text
//! w = c(Vᵢ) · t₂(d; σ) · t₁(m + Z − Vᵢ; σ_m) / ρ(m)
//! ```
//! t₁ and t₂ are Student's distributions with four degrees of freedom in one and two dimensions (lenses and colours have tails),
//! σ, Z and σ_m the robust scatter of places, zero point and scatter of brightness of the nearest pairs, c the share of the
//! catalogue's stars of this brightness that are found in the frame, ρ the number of detections of this brightness, per px² and
//! magnitude, that belong to no star. The probability of a pair is w over 1 and all w of its detection and of its star
//! (likelihood ratio of Sutherland & Saunders, MNRAS 259, 413, 1992, section 2).

use crate::statistics::{mad_sigma, median};

/// A pair is named if its probability is at least this.
const SURE: f64 = 0.99;
/// Brightness speaks only if so many pairs tell its zero point.
const FEWEST_FOR_BRIGHTNESS: usize = 4;
/// Least scatter of brightness, magnitudes, and of places, px.
const LEAST_SIGMA_MAG: f64 = 0.25;
const LEAST_SIGMA_PX: f64 = 0.05;
/// Detections are of the same brightness within this, magnitudes; stars of the catalogue, of which there are more, within that.
const SAME_DETECTION_MAG: f64 = 0.75;
const SAME_STAR_MAG: f64 = 0.375;
/// Median length of a vector whose two components are normal with standard deviation 1: √(2 ln 2).
pub(super) const MEDIAN_LENGTH: f64 = 1.177_410_022_515_474_7;

/// A detection and a star that may belong together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    /// Index of the detection.
    pub(super) detection: usize,
    /// Index of the star in the list of those in the frame.
    pub(super) star: usize,
    /// The square of their distance, px².
    pub(super) distance2_px2: f64,
}

/// The pairs that are sure.
///
/// `detection_mag`: −2.5·log10 of each detection's flux (`None` where it has none); `star_mag`: V of each star in the frame;
/// `pairs`: all within some radius.
pub(super) fn sure_pairs(mut pairs: Vec<Pair>, detection_mag: &[Option<f64>], star_mag: &[f64], area_px2: f64) -> Vec<Pair> {
    pairs
        .sort_unstable_by(|a, b| a.distance2_px2.total_cmp(&b.distance2_px2).then(a.detection.cmp(&b.detection)).then(a.star.cmp(&b.star)));
    let (mut of_detection, mut of_star) = (vec![false; detection_mag.len()], vec![false; star_mag.len()]);
    let mut nearest = Vec::new();
    for pair in &pairs {
        if !of_detection[pair.detection] && !of_star[pair.star] {
            (of_detection[pair.detection], of_star[pair.star]) = (true, true);
            nearest.push(*pair);
        }
    }
    let Some(middle) = nearest.get(nearest.len() / 2) else { return Vec::new() };
    let sigma_px = (middle.distance2_px2.sqrt() / MEDIAN_LENGTH).max(LEAST_SIGMA_PX);
    let zero_points: Vec<f64> = nearest.iter().filter_map(|pair| Some(star_mag[pair.star] - detection_mag[pair.detection]?)).collect();
    let brightness = zero_point(&zero_points);
    let lone = Sorted::new((0..detection_mag.len()).filter(|&d| !of_detection[d]).filter_map(|d| detection_mag[d]));
    let all_stars = Sorted::new(star_mag.iter().copied());
    let found_stars = Sorted::new((0..star_mag.len()).filter(|&s| of_star[s]).map(|s| star_mag[s]));
    let weight = |pair: &Pair| {
        let place = (1.0 + pair.distance2_px2 / (4.0 * sigma_px * sigma_px)).powi(-3) / (std::f64::consts::TAU * sigma_px * sigma_px);
        let (Some((zero, sigma_mag)), Some(mag)) = (brightness, detection_mag[pair.detection]) else {
            return place * area_px2 / (detection_mag.len() - nearest.len()).max(1) as f64;
        };
        let off = mag + zero - star_mag[pair.star];
        let bright = 0.375 / sigma_mag * (1.0 + off * off / (4.0 * sigma_mag * sigma_mag)).powf(-2.5);
        let density = (lone.within(mag, SAME_DETECTION_MAG) as f64 + 0.5) / (2.0 * SAME_DETECTION_MAG * area_px2);
        // Whether this very star was found is the question: it does not speak for itself.
        let found = found_stars.within(star_mag[pair.star], SAME_STAR_MAG) - usize::from(of_star[pair.star]);
        let alike = all_stars.within(star_mag[pair.star], SAME_STAR_MAG);
        (found as f64 + 0.5) / alike as f64 * place * bright / density
    };
    let weights: Vec<f64> = pairs.iter().map(weight).collect();
    let (mut sum_detection, mut sum_star) = (vec![1.0; detection_mag.len()], vec![0.0; star_mag.len()]);
    for (pair, w) in pairs.iter().zip(&weights) {
        sum_detection[pair.detection] += w;
        sum_star[pair.star] += w;
    }
    let sure = |(pair, w): (&Pair, &f64)| (*w >= SURE * (sum_detection[pair.detection] + sum_star[pair.star] - w)).then_some(*pair);
    pairs.iter().zip(&weights).filter_map(sure).collect()
}

/// Median and robust standard deviation; `None` of too few.
fn zero_point(values: &[f64]) -> Option<(f64, f64)> {
    if values.len() < FEWEST_FOR_BRIGHTNESS {
        return None;
    }
    Some((median(values)?, mad_sigma(values)?.max(LEAST_SIGMA_MAG)))
}

/// Magnitudes in order, to be counted.
struct Sorted(Vec<f64>);

impl Sorted {
    fn new(values: impl Iterator<Item = f64>) -> Self {
        let mut all: Vec<f64> = values.collect();
        all.sort_unstable_by(f64::total_cmp);
        Self(all)
    }

    /// How many lie within `reach` of `middle`, ends included.
    fn within(&self, middle: f64, reach: f64) -> usize {
        self.0.partition_point(|v| *v <= middle + reach) - self.0.partition_point(|v| *v < middle - reach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten stars, each with its detection 0.3 px away; further pairs as given.
    fn named(further: &[Pair], detection_mag: &[f64], star_mag: &[f64]) -> Vec<(usize, usize)> {
        let mut pairs: Vec<Pair> = (0..10).map(|i| Pair { detection: i, star: i, distance2_px2: 0.09 }).collect();
        pairs.extend_from_slice(further);
        let own = [2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.2, 5.4, 5.6];
        let detections: Vec<_> = own.iter().chain(detection_mag).map(|m| Some(m - 20.0)).collect();
        let stars: Vec<_> = own.iter().chain(star_mag).copied().collect();
        let mut named: Vec<_> = sure_pairs(pairs, &detections, &stars, 1e6).iter().map(|pair| (pair.detection, pair.star)).collect();
        named.sort_unstable();
        named
    }

    fn own() -> Vec<(usize, usize)> {
        (0..10).map(|i| (i, i)).collect()
    }

    #[test]
    fn a_faint_star_that_is_nearer_does_not_take_the_name() {
        assert_eq!(named(&[], &[], &[]), own());
        assert_eq!(named(&[Pair { detection: 6, star: 10, distance2_px2: 0.01 }], &[], &[7.8]), own());
    }

    #[test]
    fn one_of_two_alike_stars_is_not_named() {
        let mut without = own();
        without.remove(6);
        assert_eq!(named(&[Pair { detection: 6, star: 10, distance2_px2: 0.16 }], &[], &[5.1]), without);
    }

    #[test]
    fn a_detection_far_off_gets_no_name_among_many_that_are_no_star() {
        let many: Vec<f64> = (0..100).map(|i| 1.0 + 0.05 * f64::from(i)).collect();
        assert_eq!(named(&[Pair { detection: 90, star: 10, distance2_px2: 2.0 }], &many, &[6.2]), own());
        // The same place, but a star as bright as the others that are found, well met.
        let mut all = own();
        all.push((90, 10));
        assert_eq!(named(&[Pair { detection: 90, star: 10, distance2_px2: 0.02 }], &many, &[5.0]), all);
    }

    #[test]
    fn without_brightness_places_decide() {
        let pairs = vec![Pair { detection: 0, star: 0, distance2_px2: 0.01 }, Pair { detection: 1, star: 1, distance2_px2: 0.04 }];
        assert_eq!(sure_pairs(pairs, &[None, None], &[3.0, 4.0], 1e6).len(), 2);
        assert!(sure_pairs(Vec::new(), &[], &[], 1e6).is_empty());
    }
}
