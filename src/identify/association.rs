//! Probabilistic association of a detection with the stars near it, by place and brightness, against the hypothesis of no star.
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

use crate::statistics::median_and_mad_sigma;

/// A pair is named if its probability is at least this.
const SURE: f64 = 0.99;
/// Brightness speaks only if so many pairs tell its zero point.
const MIN_FOR_BRIGHTNESS: usize = 4;
/// Least scatter of brightness, magnitudes, and of places, px.
const MIN_SIGMA_MAG: f64 = 0.25;
const MIN_SIGMA_PX: f64 = 0.05;
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
    /// Index of the star in the list of those that pairs name.
    pub(super) star: usize,
    /// The square of their distance, px².
    pub(super) distance2_px2: f64,
}

/// Memory of an association, kept from one to the next.
#[derive(Default)]
pub(super) struct Scratch {
    of_detection: Vec<bool>,
    of_star: Vec<bool>,
    nearest: Vec<Pair>,
    zero_points: Vec<f64>,
    lone: Counted,
    paired: Counted,
    found_stars: Counted,
    weights: Vec<f64>,
    sum_detection: Vec<f64>,
    sum_star: Vec<f64>,
}

impl Scratch {
    /// Gives each detection and each star the nearest partner that is left, the nearest first.
    fn pair_up(&mut self, pairs: &[Pair], detections: usize, stars: usize) {
        let Self { of_detection, of_star, nearest, .. } = self;
        for (list, length) in [(&mut *of_detection, detections), (&mut *of_star, stars)] {
            list.clear();
            list.resize(length, false);
        }
        nearest.clear();
        nearest.reserve(pairs.len());
        for pair in pairs {
            if !of_detection[pair.detection] && !of_star[pair.star] {
                (of_detection[pair.detection], of_star[pair.star]) = (true, true);
                nearest.push(*pair);
            }
        }
    }
}

/// Leaves of the pairs those that are sure.
///
/// `detection_mag`: −2.5·log10 of each detection's flux (`None` where it has none); `star_mag`: V of the stars that pairs name, `in_frame`: of all
/// in the frame; `pairs`: all within a radius.
pub(super) fn keep_sure(
    pairs: &mut Vec<Pair>,
    detection_mag: &[Option<f64>],
    star_mag: &[f64],
    in_frame: &MagnitudeCounts,
    field: Field,
    scratch: &mut Scratch,
) {
    let area_px2 = field.area_px2;
    // No square is negative: the bits have the order of the numbers.
    pairs.sort_unstable_by_key(|pair| (pair.distance2_px2.to_bits(), pair.detection, pair.star));
    scratch.pair_up(pairs, detection_mag.len(), star_mag.len());
    let Scratch { of_detection, of_star, nearest, zero_points, lone, paired, found_stars, weights, sum_detection, sum_star } = scratch;
    let (of_detection, of_star) = (&*of_detection, &*of_star);
    let by_chance = field.share_by_chance(nearest, detection_mag.len(), in_frame.count());
    let Some(middle2_px2) = field.middle_of_true(nearest, by_chance, in_frame.count()) else { return pairs.clear() };
    let sigma_px = (middle2_px2.sqrt() / MEDIAN_LENGTH).max(MIN_SIGMA_PX);
    zero_points.clear();
    zero_points.reserve(nearest.len());
    zero_points.extend(nearest.iter().filter_map(|pair| Some(star_mag[pair.star] - detection_mag[pair.detection]?)));
    let brightness = zero_point(zero_points);
    let detections =
        |is_paired: bool| (0..detection_mag.len()).filter(move |&d| of_detection[d] == is_paired).filter_map(|d| detection_mag[d]);
    lone.take(detections(false));
    // Where no pair is by chance they are not asked for.
    paired.take(detections(true).filter(|_| by_chance > 0.0));
    found_stars.take((0..star_mag.len()).filter(|&s| of_star[s]).map(|s| star_mag[s]));
    // So often a star has a detection near it that is none of its own.
    let unrelated = (detection_mag.len() - nearest.len()) as f64 + by_chance * nearest.len() as f64;
    let met_by_chance = by_chance * field.chance_within(field.radius_px * field.radius_px, unrelated as usize);
    let weight = |pair: &Pair| {
        let place = (1.0 + pair.distance2_px2 / (4.0 * sigma_px * sigma_px)).powi(-3) / (std::f64::consts::TAU * sigma_px * sigma_px);
        let (Some((zero, sigma_mag)), Some(mag)) = (brightness, detection_mag[pair.detection]) else {
            return place * area_px2 / (detection_mag.len() - nearest.len()).max(1) as f64;
        };
        let off = mag + zero - star_mag[pair.star];
        let tail = 1.0 + off * off / (4.0 * sigma_mag * sigma_mag);
        let bright = 0.375 / (sigma_mag * tail * tail * tail.sqrt());
        let unrelated = lone.within(mag, SAME_DETECTION_MAG) as f64 + by_chance * paired.within(mag, SAME_DETECTION_MAG) as f64;
        let density = (unrelated + 0.5) / (2.0 * SAME_DETECTION_MAG * area_px2);
        // Whether this very star was found is the question: it does not speak for itself.
        let found = found_stars.within(star_mag[pair.star], SAME_STAR_MAG) - usize::from(of_star[pair.star]);
        let alike = in_frame.within(star_mag[pair.star], SAME_STAR_MAG).max(1.0);
        ((found as f64 - alike * met_by_chance).max(0.0) + 0.5) / alike * place * bright / density
    };
    weights.clear();
    weights.extend(pairs.iter().map(weight));
    for (list, length, first) in [(&mut *sum_detection, detection_mag.len(), 1.0), (&mut *sum_star, star_mag.len(), 0.0)] {
        list.clear();
        list.resize(length, first);
    }
    for (pair, w) in pairs.iter().zip(&*weights) {
        sum_detection[pair.detection] += w;
        sum_star[pair.star] += w;
    }
    let mut weights = weights.iter();
    let sure = |pair: &Pair| weights.next().is_some_and(|w| *w >= SURE * (sum_detection[pair.detection] + sum_star[pair.star] - w));
    pairs.retain(sure);
}

/// How many stars of a frame have which magnitude.
#[derive(Clone, Debug)]
pub(super) struct MagnitudeCounts {
    count: usize,
    of: [u32; MAGNITUDE_BINS],
}

/// A magnitude as it is counted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MagnitudeBin(u16);

impl MagnitudeBin {
    pub(super) fn of(magnitude: f32) -> Self {
        Self(((magnitude - FIRST_MAG as f32) * (1.0 / BIN_MAG) as f32).clamp(0.0, (MAGNITUDE_BINS - 1) as f32) as u16)
    }
}

impl Default for MagnitudeCounts {
    fn default() -> Self {
        Self { count: 0, of: [0; MAGNITUDE_BINS] }
    }
}

/// Bins of magnitudes: the first begins at the first number, and so wide are they.
const MAGNITUDE_BINS: usize = 512;
const FIRST_MAG: f64 = -3.0;
const BIN_MAG: f64 = 0.05;

impl MagnitudeCounts {
    pub(super) fn clear(&mut self) {
        self.count = 0;
        self.of.fill(0);
    }

    pub(super) fn add(&mut self, MagnitudeBin(bin): MagnitudeBin) {
        self.count += 1;
        self.of[usize::from(bin) % MAGNITUDE_BINS] += 1;
    }

    fn count(&self) -> usize {
        self.count
    }

    /// How many lie within `reach` of `middle`, those of the bins at the ends by parts.
    fn within(&self, middle: f64, reach: f64) -> f64 {
        let [low, high] = [middle - reach, middle + reach].map(|end| ((end - FIRST_MAG) / BIN_MAG).clamp(0.0, MAGNITUDE_BINS as f64));
        let [first, last] = [low, high].map(|end| (end as usize).min(MAGNITUDE_BINS - 1));
        let all = self.of[first..=last].iter().sum::<u32>();
        f64::from(all) - (low - first as f64) * f64::from(self.of[first]) - (last as f64 + 1.0 - high) * f64::from(self.of[last])
    }
}

/// Where pairs are looked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field {
    pub(super) area_px2: f64,
    /// Detections and stars further apart are no pairs.
    pub(super) radius_px: f64,
}

impl Field {
    /// The share of places that have one of so many others within this distance by chance, the square of it given.
    fn chance_within(self, distance2_px2: f64, others: usize) -> f64 {
        -(-(others as f64) * std::f64::consts::PI * distance2_px2 / self.area_px2).exp_m1()
    }

    /// The share of the nearest pairs, by distance, that are of detections which have nothing to do with their stars: as many as the outer half of
    /// the circle holds lead to expect in all of it, but not more than there are detections to be met by chance.
    fn share_by_chance(self, nearest: &[Pair], detections: usize, stars: usize) -> f64 {
        let all2_px2 = self.radius_px * self.radius_px;
        let outer = nearest.iter().filter(|pair| pair.distance2_px2 > 0.5 * all2_px2).count();
        let (half, whole) = (self.chance_within(0.5 * all2_px2, stars), self.chance_within(all2_px2, stars));
        if nearest.is_empty() || whole <= half {
            return 0.0;
        }
        let from_outer = outer as f64 * whole / (whole - half);
        from_outer.min(detections as f64 * whole).min(nearest.len() as f64) / nearest.len() as f64
    }

    /// The square of the distance below which half of the pairs lie that are not by chance; `None` where there are none such.
    fn middle_of_true(self, nearest: &[Pair], by_chance: f64, stars: usize) -> Option<f64> {
        let count = nearest.len() as f64;
        let whole = self.chance_within(self.radius_px * self.radius_px, stars).max(f64::MIN_POSITIVE);
        let half = 0.5 * (1.0 - by_chance) * count;
        let excess = |(index, pair): (usize, &Pair)| {
            let chance = if by_chance > 0.0 { by_chance * count * self.chance_within(pair.distance2_px2, stars) / whole } else { 0.0 };
            // The pair itself is in the middle when half of them lie before it.
            (index as f64 + 1.0 - chance > half).then_some(pair.distance2_px2)
        };
        nearest.iter().enumerate().find_map(excess)
    }
}

/// Median and robust standard deviation, overwriting the values; `None` of too few.
fn zero_point(values: &mut [f64]) -> Option<(f64, f64)> {
    if values.len() < MIN_FOR_BRIGHTNESS {
        return None;
    }
    median_and_mad_sigma(values).map(|(middle, sigma)| (middle, sigma.max(MIN_SIGMA_MAG)))
}

/// Magnitudes to be counted: in order, if they are many.
#[derive(Default)]
struct Counted(Vec<f64>);

impl Counted {
    /// So many are counted one by one as fast as they are put in order.
    const FEW: usize = 64;

    fn take(&mut self, values: impl Iterator<Item = f64>) {
        self.0.clear();
        self.0.reserve(values.size_hint().1.unwrap_or(0).min(Self::FEW));
        self.0.extend(values);
        if self.0.len() > Self::FEW {
            self.0.sort_unstable_by(f64::total_cmp);
        }
    }

    /// How many lie within `reach` of `middle`, ends included.
    fn within(&self, middle: f64, reach: f64) -> usize {
        let (low, high) = (middle - reach, middle + reach);
        if self.0.len() > Self::FEW {
            return self.0.partition_point(|v| *v <= high) - self.0.partition_point(|v| *v < low);
        }
        self.0.iter().filter(|v| **v <= high && **v >= low).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(magnitudes: &[f64]) -> MagnitudeCounts {
        magnitudes.iter().fold(MagnitudeCounts::default(), |mut counts, magnitude| {
            counts.add(MagnitudeBin::of(*magnitude as f32));
            counts
        })
    }

    #[test]
    fn magnitudes_are_counted_to_a_part_of_a_bin() {
        let all: Vec<f64> = (0..10_000).map(|i| 12.0 * (f64::from(i) * 0.618_034).fract()).chain([-9.0, 60.0]).collect();
        let counts = counts(&all);
        for middle in [-2.0, 0.4, 3.03, 6.0, 11.9] {
            let exact = all.iter().filter(|magnitude| (**magnitude - middle).abs() <= 0.375).count() as f64;
            let within = counts.within(middle, 0.375);
            assert!((within - exact).abs() < 6.0, "{middle}: {within} {exact}");
        }
        assert_eq!(counts.count(), all.len());
    }

    fn sure_pairs(
        mut pairs: Vec<Pair>,
        detection_mag: &[Option<f64>],
        star_mag: &[f64],
        in_frame: &MagnitudeCounts,
        field: Field,
    ) -> Vec<Pair> {
        keep_sure(&mut pairs, detection_mag, star_mag, in_frame, field, &mut Scratch::default());
        pairs
    }

    #[test]
    fn few_and_many_magnitudes_are_counted_alike() {
        let all: Vec<f64> = (0..100).map(|i| 10.0 * (f64::from(i) * 0.618_034).fract()).collect();
        for length in [0, 1, Counted::FEW, Counted::FEW + 1, 100] {
            let mut counted = Counted::default();
            counted.take(all[..length].iter().copied());
            for middle in [-1.0, 0.0, 3.3, 9.9] {
                let expected = all[..length].iter().filter(|v| (middle - 0.5..=middle + 0.5).contains(*v)).count();
                assert_eq!(counted.within(middle, 0.5), expected, "{length} {middle}");
            }
        }
    }

    /// Ten stars, each with its detection 0.3 px away; further pairs as given.
    fn named(further: &[Pair], detection_mag: &[f64], star_mag: &[f64]) -> Vec<(usize, usize)> {
        let mut pairs: Vec<Pair> = (0..10).map(|i| Pair { detection: i, star: i, distance2_px2: 0.09 }).collect();
        pairs.extend_from_slice(further);
        let own = [2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.2, 5.4, 5.6];
        let detections: Vec<_> = own.iter().chain(detection_mag).map(|m| Some(m - 20.0)).collect();
        let stars: Vec<_> = own.iter().chain(star_mag).copied().collect();
        let field = Field { area_px2: 1e6, radius_px: 3.0 };
        let mut named: Vec<_> =
            sure_pairs(pairs, &detections, &stars, &counts(&stars), field).iter().map(|pair| (pair.detection, pair.star)).collect();
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

    /// Twenty stars that are met to half a pixel, among thousands of blobs without a star within ten of which every catalogue star has one.
    #[test]
    fn stars_that_thousands_of_blobs_meet_by_chance_get_no_names() {
        use rand::{RngExt, SeedableRng};
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        let (side, radius_px) = (1000.0, 10.0);
        let mut place = || [rng.random_range(0.0..side), rng.random_range(0.0..side)];
        let stars: Vec<[f64; 2]> = (0..1500).map(|_| place()).collect();
        let mut found: Vec<[f64; 2]> = stars[..20].iter().map(|at| [at[0] + 0.3, at[1] - 0.4]).collect();
        found.extend((0..4000).map(|_| place()));
        let star_mag: Vec<f64> = (0..1500).map(|i| if i < 20 { 2.0 + 0.15 * f64::from(i) } else { 5.0 + 0.002 * f64::from(i) }).collect();
        let detection_mag: Vec<Option<f64>> =
            (0..4020).map(|i| Some(if i < 20 { star_mag[i] } else { 5.0 + 0.0001 * i as f64 } - 20.0)).collect();
        let mut pairs = Vec::new();
        for (detection, d) in found.iter().enumerate() {
            for (star, s) in stars.iter().enumerate() {
                let distance2_px2 = (d[0] - s[0]).powi(2) + (d[1] - s[1]).powi(2);
                if distance2_px2 <= radius_px * radius_px {
                    pairs.push(Pair { detection, star, distance2_px2 });
                }
            }
        }
        let named = sure_pairs(pairs, &detection_mag, &star_mag, &counts(&star_mag), Field { area_px2: side * side, radius_px });
        let right = named.iter().filter(|pair| pair.detection == pair.star).count();
        assert!(named.len() - right <= 1 && right >= 12, "{right} right of {}", named.len());
    }

    #[test]
    fn without_brightness_places_decide() {
        let pairs = vec![Pair { detection: 0, star: 0, distance2_px2: 0.01 }, Pair { detection: 1, star: 1, distance2_px2: 0.04 }];
        let field = Field { area_px2: 1e6, radius_px: 3.0 };
        assert_eq!(sure_pairs(pairs, &[None, None], &[3.0, 4.0], &counts(&[3.0, 4.0]), field).len(), 2);
        assert!(sure_pairs(Vec::new(), &[], &[], &counts(&[]), field).is_empty());
    }
}
