//! Light at places where a bright star may leave a copy of itself: a partner amplifier's pixel, the point mirrored at the frame's middle, its own
//! place in the frame after.
//!
//! The light of a star and that at its partner place are sums under one weight, which are linear in the counts: their ratio is the copy's
//! share whatever the image is (the sums are those of [`super::star_images`], without a search for the centre). Stars that were not found lie at any
//! place: the same sum is taken at places around the partner that nothing leads to, and says how often that much is there by chance.
//!
//! Sources: partner pixels of detectors with several outputs: P. O'Connor, JINST 10, C05010 (2015); light that the lens reflects through its axis:
//! ISO 9358:1994; charge that is released late: R. Smith et al., Proc. SPIE 7021, 70210J (2008).

use super::sky_frame::StarDisc;
use crate::frame::Frame;

/// Stars of a frame that are looked at, the brightest.
pub(crate) const SOURCES: usize = 40;
/// Places around a partner that nothing leads to.
pub(crate) const CONTROLS: usize = 8;
/// They lie so far from it, px, and so many σ of the weight farther.
const CONTROL_PX: f64 = 16.0;
const CONTROL_SIGMAS: f64 = 4.0;
/// Variance of a pixel along an axis, px².
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;
/// A narrower weight sees the places of the pixels more than the image.
const MIN_WEIGHT_PX: f64 = 0.75;
/// The sum reaches so many σ of the weight; the ring begins so far beyond, and is so wide, px.
const REACH: f64 = 2.5;
const GAP_PX: f64 = 1.5;
const RING_PX: f64 = 4.0;
const MIN_RING: usize = 30;
/// A star found at a partner place is the copy itself, or is there by chance as one found at a control is, if it is fainter than this share of the
/// source and so near: σ of the weight.
const MAX_COPY: f64 = 0.2;
const COPY_SIGMAS: f64 = 1.0;
/// Nothing is asked so near a star brighter than this share of the source, px: its wings are no copy.
const BRIGHT: f64 = 0.3;
const BRIGHT_PX: f64 = 20.0;

/// Where a copy may lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Partner {
    /// Columns mirrored: two amplifiers that read from the sides.
    MirroredColumn,
    /// Rows mirrored.
    MirroredRow,
    /// Both: an amplifier in each corner, or the lens.
    MirroredPoint,
    /// Half the frame's width apart: two amplifiers that read in the same direction.
    HalfWidth,
    /// Half its height apart.
    HalfHeight,
    /// The same place in the frame after.
    FrameAfter,
}

impl Partner {
    /// The partner of a place in a frame of that size.
    pub(crate) fn of(self, [x, y]: [f64; 2], [width_px, height_px]: [usize; 2]) -> [f64; 2] {
        let [mirrored_x, mirrored_y] = [width_px as f64 - 1.0 - x, height_px as f64 - 1.0 - y];
        let apart = |at: f64, length: usize| {
            let half = (length / 2) as f64;
            if at < half - 0.5 { at + half } else { at - half }
        };
        match self {
            Self::MirroredColumn => [mirrored_x, y],
            Self::MirroredRow => [x, mirrored_y],
            Self::MirroredPoint => [mirrored_x, mirrored_y],
            Self::HalfWidth => [apart(x, width_px), y],
            Self::HalfHeight => [x, apart(y, height_px)],
            Self::FrameAfter => [x, y],
        }
    }
}

/// A partner place, and how wide the copy there is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Look {
    pub(crate) partner: Partner,
    /// σ of the weight, px; nothing: as sharp as the stars.
    pub(crate) wide_px: Option<f64>,
}

const fn look(partner: Partner, wide_px: Option<f64>) -> Look {
    Look { partner, wide_px }
}

/// All that are asked. What a lens reflects may be out of focus.
pub(crate) const LOOKS: [Look; 8] = [
    look(Partner::MirroredColumn, None),
    look(Partner::MirroredRow, None),
    look(Partner::HalfWidth, None),
    look(Partner::HalfHeight, None),
    look(Partner::MirroredPoint, None),
    look(Partner::MirroredPoint, Some(4.0)),
    look(Partner::MirroredPoint, Some(8.0)),
    look(Partner::FrameAfter, None),
];

/// A star that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FoundStar {
    pub(crate) disc: StarDisc,
    pub(crate) flux_dn: f64,
    /// Whether the frame's edge does not cut it.
    pub(crate) is_whole: bool,
    /// Whether pixels of it are full: it has more light than is told.
    pub(crate) is_full: bool,
}

/// The light at a star's partner place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PartnerSum {
    /// Number in [`LOOKS`].
    pub(crate) look: usize,
    /// The star's place among those of its frame, the brightest first.
    pub(crate) rank: usize,
    /// The same sum at the star itself, DN,
    pub(crate) flux_dn: f64,
    /// and whether that is at least so much, of a star with full pixels.
    pub(crate) is_least: bool,
    /// The sum, DN, and its standard error by the noise of the sky.
    pub(crate) sum_dn: f64,
    pub(crate) sigma_dn: f64,
    /// The sum at the controls over its standard error, where it can be taken; else NaN.
    pub(crate) controls: [f64; CONTROLS],
}

/// A frame in which copies are looked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CopiesFrame<'a> {
    pub(crate) frame: &'a Frame,
    /// Its stars, the brightest first.
    pub(crate) stars: &'a [FoundStar],
    /// Those of the frame before.
    pub(crate) before: &'a [FoundStar],
    /// Pixels that say nothing.
    pub(crate) bad: Option<&'a [bool]>,
    /// Typical width (Gaussian σ) of its images, px.
    pub(crate) sigma_px: f64,
    /// Noise of a sky pixel, DN.
    pub(crate) noise_dn: f64,
}

/// The brightest stars that lie whole within the frame, with their place among them.
fn sources(stars: &[FoundStar]) -> impl Iterator<Item = (usize, &FoundStar)> {
    stars.iter().filter(|star| star.is_whole && star.flux_dn > 0.0).take(SOURCES).enumerate()
}

impl CopiesFrame<'_> {
    /// The sums at all partner places that hold neither an edge nor a bad pixel nor another star.
    pub(crate) fn partner_sums(&self) -> Vec<PartnerSum> {
        let mut all = Vec::new();
        for (number, look) in LOOKS.iter().enumerate() {
            let weight_px = look.wide_px.unwrap_or_else(|| (self.sigma_px * self.sigma_px + PIXEL_VARIANCE).sqrt().max(MIN_WEIGHT_PX));
            let own = |star: &FoundStar| self.sum([star.disc.x_px, star.disc.y_px], weight_px, |other| other == star);
            // What a sum holds of the light: of stars with full pixels, and of those of the frame before, whose pixels are gone.
            let shares: Vec<f64> = sources(self.stars).filter_map(|(_, star)| Some(own(star)?[0] / star.flux_dn)).collect();
            let share = crate::statistics::median(&shares);
            if look.partner == Partner::FrameAfter {
                let Some(share) = share else { continue };
                all.extend(sources(self.before).filter_map(|star| self.partner_sum(number, weight_px, star, share * star.1.flux_dn)));
            } else {
                let of =
                    |star: &FoundStar| if star.is_full { share.map(|share| share * star.flux_dn) } else { own(star).map(|[sum, _]| sum) };
                all.extend(sources(self.stars).filter_map(|star| self.partner_sum(number, weight_px, star, of(star.1)?)));
            }
        }
        all
    }

    fn partner_sum(&self, look: usize, weight_px: f64, (rank, source): (usize, &FoundStar), flux_dn: f64) -> Option<PartnerSum> {
        let size = [self.frame.width_px, self.frame.height_px];
        let place = LOOKS[look].partner.of([source.disc.x_px, source.disc.y_px], size);
        let [sum_dn, sigma_dn] = self.free_sum(place, weight_px, source)?;
        let apart_px = CONTROL_PX + CONTROL_SIGMAS * weight_px;
        let controls = std::array::from_fn(|k| {
            let (sin, cos) = (std::f64::consts::TAU * (k as f64 + 0.25) / CONTROLS as f64).sin_cos();
            let beside = [place[0] + apart_px * cos, place[1] + apart_px * sin];
            self.free_sum(beside, weight_px, source).map_or(f64::NAN, |[sum, sigma]| sum / sigma)
        });
        (flux_dn > 0.0).then_some(PartnerSum { look, rank, flux_dn, is_least: source.is_full, sum_dn, sigma_dn, controls })
    }

    /// The sum at a place where no other star is than one that could be a copy.
    fn free_sum(&self, [x, y]: [f64; 2], weight_px: f64, source: &FoundStar) -> Option<[f64; 2]> {
        let is_copy = |star: &FoundStar| {
            let away_px2 = star.disc.distance_px2([x, y]);
            away_px2 < (COPY_SIGMAS * weight_px).powi(2) && star.flux_dn < MAX_COPY * source.flux_dn
        };
        let is_taken = |star: &FoundStar| {
            let away_px2 = star.disc.distance_px2([x, y]);
            let is_bright = star.flux_dn > BRIGHT * source.flux_dn && away_px2 < (BRIGHT_PX + REACH * weight_px).powi(2);
            is_bright || (away_px2 < (star.disc.radius_px + REACH * weight_px).powi(2) && !is_copy(star))
        };
        if self.stars.iter().any(is_taken) {
            return None;
        }
        self.sum([x, y], weight_px, is_copy)
    }

    /// Weighted sum of the counts above a ring, and its standard error; nothing where a bad or full pixel or the edge lies in it. The ring leaves
    /// out what other stars light; `is_own` tells of a star that it is the one that is summed.
    fn sum(&self, [x, y]: [f64; 2], weight_px: f64, is_own: impl Fn(&FoundStar) -> bool) -> Option<[f64; 2]> {
        let reach_px = REACH * weight_px;
        let from_px = reach_px + GAP_PX;
        let to_px = from_px + RING_PX;
        let near = |star: &&FoundStar| star.disc.distance_px2([x, y]) < (star.disc.radius_px + to_px).powi(2) && !is_own(star);
        let others: Vec<&StarDisc> = self.stars.iter().filter(near).map(|star| &star.disc).collect();
        let span = |at: f64, length: usize| {
            let (low, high) = ((at - to_px).ceil(), (at + to_px).floor());
            (low >= 0.0 && high < length as f64).then_some(low as usize..=high as usize)
        };
        let (columns, rows) = (span(x, self.frame.width_px)?, span(y, self.frame.height_px)?);
        let (mut light, mut weights, mut squares) = (0.0, 0.0, 0.0);
        let (mut level, mut count) = (0.0, 0_usize);
        for (column, row) in rows.flat_map(|row| columns.clone().map(move |column| (column, row))) {
            let (at_x, at_y) = (column as f64, row as f64);
            let away_px2 = (at_x - x) * (at_x - x) + (at_y - y) * (at_y - y);
            if away_px2 >= to_px * to_px {
                continue;
            }
            let index = row * self.frame.width_px + column;
            let counts = self.frame.pixels_dn[index];
            let is_usable = counts < self.frame.saturation_dn && self.bad.is_none_or(|bad| !bad[index]);
            if away_px2 < reach_px * reach_px {
                if !is_usable {
                    return None;
                }
                let weight = (-0.5 * away_px2 / (weight_px * weight_px)).exp();
                light += weight * f64::from(counts);
                weights += weight;
                squares += weight * weight;
                continue;
            }
            let is_lit = || others.iter().any(|disc| disc.lights([at_x, at_y]));
            if away_px2 > from_px * from_px && is_usable && !is_lit() {
                level += f64::from(counts);
                count += 1;
            }
        }
        let sigma_dn = self.noise_dn * (squares + weights * weights / count.max(1) as f64).sqrt();
        (count >= MIN_RING && sigma_dn > 0.0).then(|| [light - weights * level / count as f64, sigma_dn])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The partner of a partner is the place itself, and pixels lie on pixels.
    #[test]
    fn places_and_partners_change_places() {
        for size in [[512, 384], [301, 200]] {
            for look in LOOKS {
                let there = look.partner.of([20.25, 37.5], size);
                let back = look.partner.of(there, size);
                assert!((back[0] - 20.25).abs() < 1e-12 && (back[1] - 37.5).abs() < 1e-12, "{look:?} {size:?}: {there:?} {back:?}");
                assert!(there.iter().zip(size).all(|(at, length)| *at >= 0.0 && *at < length as f64), "{look:?} {size:?}: {there:?}");
            }
        }
        assert_eq!(Partner::MirroredPoint.of([0.0, 3.0], [10, 10]), [9.0, 6.0]);
        assert_eq!(Partner::HalfWidth.of([7.0, 3.0], [10, 10]), [2.0, 3.0]);
    }

    /// A sharp copy has just its share of the sum, wherever the star stands in its pixel.
    #[test]
    fn a_copy_is_a_share_of_its_star() {
        const SIDE: usize = 120;
        let (x, y, share) = (20.3, 34.7, 0.01);
        let image = |column: usize, row: usize, [x, y]: [f64; 2]| {
            (1.0 + f64::midpoint((column as f64 - x).powi(2), (row as f64 - y).powi(2))).powf(-2.5)
        };
        let mirrored = Partner::MirroredColumn.of([x, y], [SIDE; 2]);
        let pixel = |k: usize| 100.0 + 1e5 * (image(k % SIDE, k / SIDE, [x, y]) + share * image(k % SIDE, k / SIDE, mirrored));
        let frame =
            Frame { width_px: SIDE, height_px: SIDE, pixels_dn: (0..SIDE * SIDE).map(|k| pixel(k) as f32).collect(), saturation_dn: 1e9 };
        let star = FoundStar { disc: StarDisc { x_px: x, y_px: y, radius_px: 12.0 }, flux_dn: 4e5, is_whole: true, is_full: false };
        let copies = CopiesFrame { frame: &frame, stars: &[star], before: &[], bad: None, sigma_px: 1.2, noise_dn: 3.0 };
        let sums = copies.partner_sums();
        let sum = sums.iter().find(|sum| sum.look == 0).unwrap();
        // The light of a winged star reaches its partner by less than a thousandth of the copy.
        assert!((sum.sum_dn / sum.flux_dn / share - 1.0).abs() < 1e-2, "{sum:?}");
        assert!(sums.iter().filter(|sum| sum.look > 0).all(|sum| (sum.sum_dn / sum.flux_dn).abs() < 1e-4), "{sums:?}");
    }
}
