//! Stars as measured, and the brightness that the catalogue lets expect of them.

use std::collections::{BTreeMap, BTreeSet};

use crate::detect::Moments;
use crate::effects::ImageContext;
use crate::statistics::median;

/// Stars that are expected to be fainter than this are found where noise has made them brighter, and tell that.
pub(super) const MIN_SNR: f64 = 10.0;
/// Fewer bright stars tell no zero point of a frame.
const MIN_ZERO: usize = 5;
/// A zero point that is off by so much is another one, whatever few stars tell it: catalogues and blends are not that wrong in the median.
const OTHER_ZERO_MAG: f64 = 0.3;
/// Where so large a part of the frames have the common zero point, a frame without bright stars has it too.
const ALIKE_SHARE: f64 = 0.9;

/// What was measured of one star image beside its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StarMeasurement {
    /// The control point that it belongs to.
    pub point: usize,
    /// Number of its frame in the recording.
    pub frame: usize,
    /// Number of its star.
    pub star: usize,
    /// V of the catalogue.
    pub magnitude: f64,
    /// Light above the background, DN.
    pub flux_dn: f64,
    /// Its standard error.
    pub flux_sigma_dn: f64,
    /// Moments, where they were measured.
    pub moments: Option<Moments>,
    /// What brightness and shape may depend on.
    pub image: ImageContext,
}

/// A star that is bright enough by the catalogue, what depends on its brightness taken at the expected one.
#[derive(Clone, Copy, Debug)]
pub(super) struct ExpectedStar {
    pub(super) star: StarMeasurement,
    /// Expected light, DN.
    pub(super) flux_dn: f64,
    /// Expected signal-to-noise ratio.
    pub(super) snr: f64,
}

/// The stars that are bright enough by the catalogue, whatever was measured of them, each with its expected signal-to-noise ratio. A choice by the
/// measured flux would prefer what noise has made brighter, and a column that holds it would follow the errors of the fluxes: what depends on
/// brightness is taken at the expected one. The zero point is that of the frame's bright stars.
pub(super) fn expected_bright(stars: &[StarMeasurement]) -> Vec<ExpectedStar> {
    let is_bright = |star: &&StarMeasurement| star.flux_dn > 3.0 * MIN_SNR * star.flux_sigma_dn && star.magnitude.is_finite();
    let zero_point = |star: &StarMeasurement| -2.5 * star.flux_dn.log10() - star.magnitude;
    let all: Vec<f64> = stars.iter().filter(is_bright).map(zero_point).collect();
    // The error of a flux hardly hangs on the flux of a faint star: that of the typical faint one stands for all.
    let faint: Vec<f64> = stars.iter().filter(|star| !is_bright(star)).map(|star| star.flux_sigma_dn).collect();
    let (Some(common), Some(sigma_dn)) =
        (median(&all), median(&faint).or_else(|| median(&stars.iter().map(|star| star.flux_sigma_dn).collect::<Vec<_>>())))
    else {
        return Vec::new();
    };
    let mut by_frame: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for star in stars.iter().filter(is_bright) {
        by_frame.entry(star.frame).or_default().push(zero_point(star));
    }
    let is_common = |own: &Vec<f64>| median(own).is_some_and(|own| (own - common).abs() < OTHER_ZERO_MAG);
    let are_alike = by_frame.values().filter(|own| is_common(own)).count() as f64 >= ALIKE_SHARE * by_frame.len() as f64;
    // Of a few stars the zero point is that of all frames, unless it is clearly another: a frame of another exposure.
    let of_frame = |frame: usize| -> Option<f64> {
        let Some(bright) = by_frame.get(&frame) else { return are_alike.then_some(common) };
        let own = median(bright)?;
        Some(if bright.len() >= MIN_ZERO || (own - common).abs() > OTHER_ZERO_MAG { own } else { common })
    };
    let zero_points: BTreeMap<usize, Option<f64>> =
        stars.iter().map(|star| star.frame).collect::<BTreeSet<_>>().into_iter().map(|frame| (frame, of_frame(frame))).collect();
    // A peak is lower where charge has moved, and by the place in the pixel: what a star of so much light has on average stands for it.
    let per_dn = median(&stars.iter().filter(is_bright).filter_map(|star| Some(star.image.fullness? / star.flux_dn)).collect::<Vec<_>>());
    let expected = |star: &StarMeasurement| {
        let zero_point = zero_points[&star.frame]?;
        let flux_dn = 10.0_f64.powf(-0.4 * (star.magnitude + zero_point));
        let ratio = flux_dn / star.flux_dn;
        let mut own = *star;
        own.image.fullness = own.image.fullness.and(per_dn).map(|per_dn| per_dn * flux_dn);
        own.image.relative_flux = own.image.relative_flux.map(|flux| flux * ratio);
        Some(ExpectedStar { star: own, flux_dn, snr: flux_dn / sigma_dn })
    };
    stars.iter().filter(|star| star.flux_dn > 0.0).filter_map(expected).filter(|own| own.snr > MIN_SNR).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{nothing, stars};
    use super::*;

    /// Every third frame is exposed for a tenth of the time, and has few bright stars or none.
    #[test]
    fn frames_with_few_bright_stars_have_their_own_zero_point() {
        let true_dn =
            |star: &StarMeasurement| 10.0_f64.powf(-0.4 * (star.magnitude - 12.5)) * if star.frame.is_multiple_of(3) { 0.1 } else { 1.0 };
        for few in [0, 3] {
            let mut all = stars(7, nothing);
            for star in all.iter_mut().filter(|star| star.frame.is_multiple_of(3)) {
                star.flux_dn *= 0.1;
                // Of most the error is too large for a bright star.
                star.flux_sigma_dn = if star.star < few { 0.01 } else { 0.1 } * star.flux_dn;
            }
            let expected = expected_bright(&all);
            let short = expected.iter().filter(|own| own.star.frame.is_multiple_of(3)).count();
            assert_eq!(short > 0, few > 0, "{short}");
            for own in &expected {
                assert!((own.flux_dn / true_dn(&own.star) - 1.0).abs() < 0.2, "{own:?}");
            }
        }
    }
}
