//! Stars as measured, and the brightness that the catalogue lets expect of them.

use std::collections::BTreeMap;

use crate::detect::Moments;
use crate::effects::ImageContext;
use crate::statistics::median;

/// Stars that are expected to be fainter than this are found where noise has made them brighter, and tell that.
pub(super) const MIN_SNR: f64 = 10.0;
/// Fewer bright stars tell no zero point of a frame.
const MIN_ZERO: usize = 5;
/// A zero point that is off by so much is another one, whatever few stars tell it: catalogues and blends are not that wrong in the median.
const OTHER_ZERO_MAG: f64 = 0.3;

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
    let mut by_frame: BTreeMap<usize, [Vec<f64>; 2]> = BTreeMap::new();
    for star in stars.iter().filter(|star| star.flux_dn > 0.0 && star.magnitude.is_finite()) {
        by_frame.entry(star.frame).or_default()[usize::from(is_bright(&star))].push(zero_point(star));
    }
    // Of a few stars the zero point is that of all frames, unless it is clearly another: a frame of another exposure.
    let is_other = |own: f64| (own - common).abs() > OTHER_ZERO_MAG;
    // Of faint stars, too: they are found where noise has made them brighter, which is less than makes another zero point.
    let of_frame = |[faint, bright]: &[Vec<f64>; 2]| -> Option<f64> {
        let own = median(if bright.is_empty() { faint } else { bright })?;
        Some(if bright.len() >= MIN_ZERO || is_other(own) { own } else { common })
    };
    let zero_points: BTreeMap<usize, f64> = by_frame.iter().filter_map(|(frame, own)| Some((*frame, of_frame(own)?))).collect();
    // A peak is lower where charge has moved, and by the place in the pixel: what a star of so much light has on average stands for it.
    let per_dn = median(&stars.iter().filter(is_bright).filter_map(|star| Some(star.image.fullness? / star.flux_dn)).collect::<Vec<_>>());
    let expected = |star: &StarMeasurement| {
        let zero_point = zero_points.get(&star.frame)?;
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

    /// Every third frame has few bright stars or none, and some other zero point or the common one.
    #[test]
    fn frames_with_few_bright_stars_have_their_own_zero_point() {
        for (share, few) in [(0.1, 0), (0.1, 3), (1.0, 0), (1.0, 3)] {
            let true_dn = |star: &StarMeasurement| {
                10.0_f64.powf(-0.4 * (star.magnitude - 12.5)) * if star.frame.is_multiple_of(3) { share } else { 1.0 }
            };
            let mut all = stars(7, nothing);
            for star in all.iter_mut().filter(|star| star.frame.is_multiple_of(3)) {
                star.flux_dn *= share;
                // Of most the error is too large for a bright star.
                star.flux_sigma_dn = if star.star < few { 0.01 } else { 0.1 } * star.flux_dn;
            }
            let expected = expected_bright(&all);
            let short = expected.iter().filter(|own| own.star.frame.is_multiple_of(3)).count();
            assert!(short > 10, "{share}, {few}: {short}");
            for own in &expected {
                assert!((own.flux_dn / true_dn(&own.star) - 1.0).abs() < 0.2, "{own:?}");
            }
        }
    }
}
