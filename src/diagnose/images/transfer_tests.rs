//! What variance against level tells: a gain, a response that bends, charge that is pushed into neighbours.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::judge::{Judged, Pixels, judge};
use super::noise_kind::DeclaredDetector;
use super::tests::{Added, FRAMES, asked, found, nothing, size, stars};
use crate::pixel_statistics::{Estimate, NeighbourCorrelation, PhotonTransfer, PixelStatistics, TransferPoint};

const GAIN_E_PER_DN: f64 = 2.0;
const BIAS_DN: f64 = 100.0;
const READ_NOISE_E: f64 = 4.0;
const FULL_DN: f64 = 16_000.0;

/// A sky that is measured at four levels of every frame. `variance_dn2`: of a pixel by its level above the bias.
fn judged(seed: u64, added: Added, variance_dn2: impl Fn(f64) -> f64) -> Judged {
    judged_beside(None, seed, added, variance_dn2)
}

/// The same where neighbouring pixels share so much of their noise.
fn judged_beside(shared: Option<f64>, seed: u64, added: Added, variance_dn2: impl Fn(f64) -> f64) -> Judged {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let point = |k: usize| {
        let level_dn = 800.0 + 110.0 * k as f64;
        let pixels = 40_000;
        let (value, off): (f64, f64) = (variance_dn2(level_dn), StandardNormal.sample(&mut rng));
        let sigma_dn2 = value * (2.0 / pixels as f64).sqrt();
        TransferPoint { frame: k % FRAMES, level_dn: BIAS_DN + level_dn, variance_dn2: value + sigma_dn2 * off, sigma_dn2, pixels }
    };
    let transfer_points: Vec<TransferPoint> = (0..4 * FRAMES).map(point).collect();
    let line = PhotonTransfer {
        gain_e_per_dn: None,
        gain_sigma: None,
        slope_dn: 0.5,
        slope_sigma_dn: 0.1,
        intercept_dn2: 0.0,
        intercept_sigma_dn2: 1.0,
        covariance_dn3: 0.0,
        curvature: 0.0,
        curvature_sigma: 1.0,
        chi2_per_dof: 1.0,
        step_dn: 1.0,
        levels_dn: [900.0, 6100.0],
        points: transfer_points.len(),
        stars: None,
    };
    let along = |value: f64| Estimate { value, sigma: 6e-4 };
    let neighbours =
        shared.map(|shared| NeighbourCorrelation { column: along(shared), row: along(shared), ..NeighbourCorrelation::default() });
    let statistics = PixelStatistics { transfer_points, photon_transfer: Some(line), neighbours, ..PixelStatistics::default() };
    let detector = DeclaredDetector {
        gain_e_per_dn: Some(GAIN_E_PER_DN),
        bias_dn: Some(BIAS_DN),
        read_noise_e: Some(READ_NOISE_E),
        saturation_dn: Some(BIAS_DN + FULL_DN),
    };
    let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
    let pixels = Pixels { statistics: &statistics, detector: &detector, places: &places, views: &[] };
    judge(&stars(seed, added), Some(&pixels), FRAMES, &asked(1e-3), &[]).unwrap()
}

/// Reading and rounding, DN².
fn quiet() -> f64 {
    (READ_NOISE_E / GAIN_E_PER_DN).powi(2) + 1.0 / 12.0
}

#[test]
fn a_declared_gain_that_is_right_is_not_named() {
    for seed in 0..6 {
        let judged = judged(seed, nothing, |level| level / GAIN_E_PER_DN + quiet());
        assert!(found(&judged).is_empty(), "seed {seed}: {:?}", judged.proposed);
    }
}

#[test]
fn a_declared_gain_that_is_wrong_is_named_with_its_ratio() {
    for seed in 10..13 {
        let judged = judged(seed, nothing, |level| level / (1.15 * GAIN_E_PER_DN) + quiet() / 1.15_f64.powi(2));
        assert_eq!(found(&judged), ["gain-noise"], "seed {seed}: {:?}", judged.proposed);
        let [more, sigma] = size(&judged, "gain-noise").unwrap();
        // The column is linear in the inverse of the gain.
        assert!(((1.0 - more).recip() - 1.15).abs() < 0.01 + 4.0 * sigma, "{more} ± {sigma}");
    }
}

/// A response that bends takes light of bright stars and noise of bright skies: both have one size, and the gain is not blamed.
#[test]
fn a_response_that_bends_is_told_by_stars_and_sky() {
    const LACK: f64 = 0.05;
    let added: Added = |image| {
        let peak = image.fullness.unwrap();
        (1.0857 * LACK * (0.567 * peak + 0.02), [0.444 * LACK * peak, 0.0, 0.444 * LACK * peak])
    };
    // The level seen is S = N(1 − αN/W), and the variance has the square of the slope.
    let variance = |level: f64| {
        let electrons = level * (1.0 + LACK * level / FULL_DN * (1.0 + 2.0 * LACK * level / FULL_DN));
        electrons * (1.0 - 2.0 * LACK * electrons / FULL_DN).powi(2) / GAIN_E_PER_DN + quiet()
    };
    for seed in 20..23 {
        let judged = judged(seed, added, variance);
        assert_eq!(found(&judged), ["nonlinearity"], "seed {seed}: {:?}", judged.proposed);
        let [value, sigma] = size(&judged, "nonlinearity").unwrap();
        assert!((value - LACK).abs() < 0.006 + 3.0 * sigma && sigma < 0.01, "{value} ± {sigma}");
    }
}

/// Charge that is pushed aside widens bright stars and takes noise of the sky, each with a size of its own.
#[test]
fn charge_that_is_pushed_aside_is_no_response_that_bends() {
    let added: Added = |image| (0.0, [0.1 * image.fullness.unwrap(), 0.0, 0.1 * image.fullness.unwrap()]);
    for seed in 30..33 {
        let judged = judged(seed, added, |level| level * (1.0 - 0.15 * level / FULL_DN) / GAIN_E_PER_DN + quiet());
        assert_eq!(found(&judged), ["brighter-fatter"], "seed {seed}: {:?}", judged.proposed);
        let own = judged.proposed.iter().find(|own| own.against.is_empty()).unwrap();
        let [[wider, wider_sigma], [less, less_sigma]] = [own.sizes[0], own.sizes[1]];
        assert!((wider - 0.05).abs() < 4.0 * wider_sigma, "{wider} ± {wider_sigma}");
        assert!((less - 0.15).abs() < 4.0 * less_sigma, "{less} ± {less_sigma}");
    }
}

/// Neighbours of smoothed frames share their noise: what it has less of is no gain.
#[test]
fn smoothed_noise_is_no_gain() {
    let smoothed = |level: f64| 0.5 * (level / GAIN_E_PER_DN + quiet());
    for (shared, names) in [(0.3, &[][..]), (0.0, &["gain-noise"][..])] {
        assert_eq!(found(&judged_beside(Some(shared), 50, nothing, smoothed)), names, "{shared}");
    }
}

/// Stars that were not found add to the variance, and neighbours share that: it is no gain. Where neighbours share nothing a small error of the gain shows,
/// and where nobody knows what they share it does not.
#[test]
fn neighbours_tell_stars_from_a_gain() {
    let with_stars = |level: f64| 1.015 * (level / GAIN_E_PER_DN + quiet());
    let wrong_gain = |level: f64| level / (0.97 * GAIN_E_PER_DN) + quiet() / 0.97_f64.powi(2);
    for seed in 40..43 {
        let of = |shared: Option<f64>, variance: &dyn Fn(f64) -> f64| found(&judged_beside(shared, seed, nothing, variance));
        assert!(of(Some(0.009), &with_stars).is_empty(), "seed {seed}");
        assert_eq!(of(Some(0.0), &wrong_gain), ["gain-noise"], "seed {seed}");
        assert!(of(None, &wrong_gain).is_empty(), "seed {seed}");
    }
}
