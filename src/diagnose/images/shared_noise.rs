//! Noise that neighbours in a row share and neighbours in a column do not: the chain of the read-out remembers the pixel before.
//!
//! A response y = (1 − k)·N + k·m with a memory m of the pixels before, which forgets the share 1 − q = 1 − e^(−1/τ) from pixel to pixel (page of
//! overshoot), makes white noise share ρ₁ = k·(1 − q) with the next pixel and ρ₂ = q·ρ₁ with the one after. What is added after the chain shares
//! nothing; of the noise so much counts as the photons make. Smoothing and stars that were not found act along rows and columns alike.

use super::counted::{Counted, MAX_SURPRISE};
use super::noise_kind::DeclaredDetector;
use crate::diagnose::causes::COMPRESSION;
use crate::diagnose::channels::Channel;
use crate::effects::CentroidShift;
use crate::effects::detector::charge_transfer_inefficiency::ChargeTransferInefficiency;
use crate::effects::detector::overshoot;
use crate::pixel_statistics::{Estimate, PixelStatistics};
use crate::statistics::median;
use crate::statistics::significance::neg_ln_chi2_sf;

const OVERSHOOT: &str = <overshoot::Overshoot as CentroidShift>::ID;
/// Smaller coefficients are as large as the structure of a sky makes them,
const MIN_SHARED: f64 = 0.009;
/// and are known no better than this.
const MIN_ERROR: f64 = 0.002;
/// What the pixel after the next shares of it at most: more is no memory of the pixel before, but an offset of the whole row.
const MAX_KEPT: f64 = 0.8;
/// So many standard errors apart are shares along rows and columns that differ.
const AXES_DIFFER: f64 = 3.0;
/// Neighbours in a column share at most this part of what those in a row do.
const MAX_ACROSS: f64 = 0.35;

/// Overshoot by the noise; nothing where neighbours in rows and columns share alike. `others`: what else was counted.
pub(super) fn shared_noise(pixels: &PixelStatistics, detector: &DeclaredDetector, others: &[&str]) -> Option<Counted> {
    let neighbours = pixels.neighbours.as_ref().filter(|_| !others.contains(&COMPRESSION))?;
    let (along, across) = (neighbours.column, neighbours.row);
    let sigma = along.sigma.hypot(across.sigma).hypot(MIN_ERROR);
    let surprise = neg_ln_chi2_sf(1.0, ((along.value - across.value) / sigma).powi(2)).min(MAX_SURPRISE);
    let kept = (neighbours.two_columns.value / along.value).max(0.0);
    let is_along = along.value.abs() > MIN_SHARED && across.value.abs() < MAX_ACROSS * along.value.abs();
    if !is_along || kept > MAX_KEPT || !Counted::is_surprising(surprise) {
        return None;
    }
    let share = photon_share(pixels, detector).unwrap_or(1.0);
    let [relative, error] = [along.value, sigma].map(|value| value / ((1.0 - kept) * share));
    let mut parameters = vec![("tail_relative", relative, error, "")];
    // A memory that is gone after a pixel has no length.
    if kept > 0.05 {
        parameters.push(("tail_px", -kept.ln().recip(), 0.0, "px"));
    }
    let (what, alike): (_, &[&'static str]) =
        if relative < 0.0 { ("less of", &[]) } else { ("more of", &[<ChargeTransferInefficiency as CentroidShift>::ID]) };
    let sentence = format!(
        "Neighbouring pixels of a row share {:.3} of their noise and those of a column {:.3}: each pixel has {what} what its row held before it.",
        along.value, across.value
    );
    Some(Counted::of_stars(OVERSHOOT, Channel::Noise, parameters, surprise, "x", sentence).or(alike))
}

/// The ratio of the gains (less one) that noise with such a memory pretends, with its error, along the axis where neighbours share more; nothing where they
/// share alike along both. Of the variance of the photons −2ρ₁/(1 − q) is added, to first order, whether the read-out remembers the pixel before or charge
/// arrives late: so much is seen in the variance before the share itself is beyond chance.
pub(super) fn gain_by_memory(pixels: &PixelStatistics, detector: &DeclaredDetector) -> Option<[f64; 2]> {
    let own = pixels.neighbours.as_ref()?;
    let of_photons = photon_share(pixels, detector).unwrap_or(1.0);
    let of_axis = |(along, after, across): (Estimate, Estimate, Estimate)| {
        let (share, sigma) = (along.value - across.value, along.sigma.hypot(across.sigma));
        let is_along = along.value.abs() > across.value.abs() && share.abs() > AXES_DIFFER * sigma;
        let kept = (after.value / along.value).clamp(0.0, MAX_KEPT);
        is_along.then(|| [share, sigma].map(|value| 2.0 * value / ((1.0 - kept) * of_photons)))
    };
    [(own.column, own.two_columns, own.row), (own.row, own.two_rows, own.column)].into_iter().find_map(of_axis)
}

/// The part of the sky's variance that its light makes.
fn photon_share(pixels: &PixelStatistics, detector: &DeclaredDetector) -> Option<f64> {
    let (gain, bias) = (detector.gain_e_per_dn?, detector.bias_dn?);
    let shares: Vec<f64> = pixels.transfer_points.iter().map(|point| (point.level_dn - bias) / (gain * point.variance_dn2)).collect();
    median(&shares).map(|share| share.clamp(0.05, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixel_statistics::NeighbourCorrelation;

    fn told(column: f64, row: f64, two_columns: f64) -> Option<(f64, Vec<String>)> {
        let estimate = |value: f64| Estimate { value, sigma: 6e-4 };
        let neighbours = NeighbourCorrelation {
            column: estimate(column),
            row: estimate(row),
            two_columns: estimate(two_columns),
            ..NeighbourCorrelation::default()
        };
        let pixels = PixelStatistics { neighbours: Some(neighbours), ..PixelStatistics::default() };
        let found = shared_noise(&pixels, &DeclaredDetector::default(), &[])?.reported().1?;
        Some((found.parameters[0].value, found.indistinguishable_from))
    }

    #[test]
    fn a_memory_along_rows_is_told_by_the_noise() {
        // k = −0.06, q = 1/2.
        let (relative, alike) = told(-0.03, 0.001, -0.015).unwrap();
        assert!((relative + 0.06).abs() < 1e-9 && alike.is_empty());
        let (relative, alike) = told(0.03, 0.001, 0.0).unwrap();
        assert!((relative - 0.03).abs() < 1e-9 && alike == ["charge-transfer-inefficiency"]);
    }

    #[test]
    fn what_rows_and_columns_share_alike_is_none() {
        for (column, row) in [(0.03, 0.028), (-0.02, -0.03), (0.004, 0.0), (0.0, 0.05)] {
            assert!(told(column, row, 0.01).is_none(), "{column} {row}");
        }
    }

    /// Shares that are too small to be called an overshoot say what variance they bring; alike along both axes, or within chance, they say nothing.
    #[test]
    fn a_small_share_along_one_axis_pretends_a_gain() {
        let pretended = |column: f64, row: f64, after: f64| {
            let estimate = |value: f64| Estimate { value, sigma: 5e-4 };
            let neighbours = NeighbourCorrelation {
                column: estimate(column),
                row: estimate(row),
                two_columns: estimate(after),
                two_rows: estimate(after),
                ..NeighbourCorrelation::default()
            };
            let pixels = PixelStatistics { neighbours: Some(neighbours), ..PixelStatistics::default() };
            gain_by_memory(&pixels, &DeclaredDetector::default()).map(|own| own[0])
        };
        // More variance is a smaller gain: k = −0.008 and q = 1/2 add 0.016 of it.
        assert!((pretended(-0.004, 0.0, -0.002).unwrap() + 0.016).abs() < 1e-9);
        // Charge that arrives late takes variance away, along columns.
        assert!((pretended(0.0, 0.005, 0.0).unwrap() - 0.01).abs() < 1e-9);
        assert_eq!(pretended(0.006, 0.005, 0.0), None, "stars that were not found");
        assert_eq!(pretended(-0.002, 0.0, 0.0), None, "chance");
    }
}
