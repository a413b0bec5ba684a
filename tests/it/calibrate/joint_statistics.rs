//! The joint method: whether its error bars are true, what priors and uneven noise do, and which parameters it selects.

use std::collections::BTreeSet;

use boresight::calibrate::{CalibrateOptions, Calibration, ParameterPrior, calibrate};
use boresight::camera::{Camera, Model};
use boresight::identify::ControlPoints;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::joint::{error_px, joint, rms, sigma};
use super::{Night, median};

fn value(result: &Calibration, name: &str) -> f64 {
    result.parameters.iter().find(|p| p.name == name).unwrap().value
}

// ---- Priors and selection ----

#[test]
fn a_prior_and_the_stars_are_weighed_by_their_variances() {
    for (seed, stated_px) in [(1, 0.1), (2, 0.1), (3, 0.2)] {
        let (mut points, _) = Night::published().observe(seed);
        for point in &mut points.points {
            point.covariance_px2 = [stated_px * stated_px, 0.0, stated_px * stated_px];
        }
        let alone = calibrate(&points, &joint()).unwrap();
        for (off, size) in [(3.0, 0.5), (-2.0, 1.0), (1.0, 3.0)] {
            let (mean, sigma_alone) = (value(&alone, "f"), sigma(&alone, "f"));
            let prior = ParameterPrior { name: "f".to_owned(), value: mean + off * sigma_alone, sigma: size * sigma_alone };
            let with = calibrate(&points, &CalibrateOptions { priors: vec![prior.clone()], ..joint() }).unwrap();
            let (a, b) = (1.0 / sigma_alone.powi(2), 1.0 / prior.sigma.powi(2));
            let expected = (mean * a + prior.value * b) / (a + b);
            let sigma_expected = (1.0 / (a + b)).sqrt();
            println!("{:.4} ± {:.4}, expected {expected:.4} ± {sigma_expected:.4}", value(&with, "f"), sigma(&with, "f"));
            assert!((value(&with, "f") - expected).abs() < 0.05 * sigma_expected, "{} {expected}", value(&with, "f"));
            assert!((sigma(&with, "f") / sigma_expected - 1.0).abs() < 0.03, "{} {sigma_expected}", sigma(&with, "f"));
        }
    }
}

#[test]
fn the_true_parameters_are_selected() {
    const NIGHTS: u64 = 10;
    let base = Camera::pinhole(1024, 1024, 2300.0);
    let mut strong = Model::new(Camera { k1: 2e-8, ..base });
    strong.set("radial-high-order", &[1.0, 0.0]).unwrap();
    let truths: [(Model, &[&str]); 3] = [
        (Model::new(Camera { k1: 8e-9, ..base }), &["f", "k1"]),
        (Model::new(Camera { k1: 8e-9, principal_point_px: [541.0, 489.0], ..base }), &["f", "k1", "x0", "y0"]),
        (strong, &["f", "k1", "radial-high-order.k2_norm"]),
    ];
    let mut right = 0;
    for (case, (truth, names)) in (0_u64..).zip(&truths) {
        let results: Vec<Calibration> = (100 * case..100 * case + NIGHTS)
            .into_par_iter()
            .map(|seed| calibrate(&through(truth, seed), &CalibrateOptions { select_model: true, ..joint() }).unwrap())
            .collect();
        let mut own = 0;
        for (seed, result) in results.iter().enumerate() {
            let report = result.selection.as_ref().unwrap();
            assert_eq!(report.begun_with, ["f"]);
            assert!(report.tried.iter().filter(|tried| tried.taken).all(|tried| tried.delta_bic < 0.0 && tried.delta_chi2 < 0.0));
            assert!(report.tried.iter().all(|tried| tried.held_out_rms_px.is_some()));
            let [model, wanted] = [result.model.clone(), names.iter().map(|name| (*name).to_owned()).collect()].map(BTreeSet::from_iter);
            if model == wanted {
                own += 1;
            } else {
                println!("{seed}: {model:?}, {:?}", report.tried);
            }
        }
        println!("{names:?}: {own} of {NIGHTS}");
        right += own;
    }
    // The criterion lets each needless group in with one per cent: 114 of 120 nights of this kind are right.
    assert!(right >= 27, "{right}");
}

/// A published night through this chain.
fn through(truth: &Model, seed: u64) -> ControlPoints {
    let night = Night { truth: *truth.camera(), nominal: Camera::pinhole(1024, 1024, 2310.0), ..Night::published() };
    let (mut points, _) = night.observe(seed);
    let context = truth.reference_context();
    for point in &mut points.points {
        // The direction that the plain camera sees there is seen by the chain a little elsewhere.
        let attitude = points.attitudes[point.frame].unwrap();
        let seen = attitude.camera_from_apparent(&point.direction);
        let plain = truth.camera().pixel(&seen).unwrap();
        let chain = truth.pixel(&seen, &context).unwrap();
        point.x_px += chain.x_px - plain.x_px;
        point.y_px += chain.y_px - plain.y_px;
    }
    points
}

// ---- Noise ----

/// A night in which every image has its own covariance; `extra_px` is what the covariances do not say.
fn uneven(frames: usize, stars: usize, extra_px: f64, seed: u64) -> ControlPoints {
    let (mut points, _) = Night { frames, stars, noise_px: 0.0, ..Night::published() }.observe(seed);
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0xabcd);
    for point in &mut points.points {
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let [a, b, c, d] = [normal(), normal(), normal(), normal()];
        // From 0.02 to 0.5 px, all sizes alike, with axes of any ratio up to two and any direction.
        let size = 0.02 * 25_f64.powf(rng.random_range(0.0..1.0));
        let (major, minor) = (size, size * rng.random_range(0.5..1.0));
        let (sin, cos) = rng.random_range(0.0..std::f64::consts::PI).sin_cos();
        let (u, v) = (major * a, minor * b);
        point.x_px += cos * u - sin * v + extra_px * c;
        point.y_px += sin * u + cos * v + extra_px * d;
        let (uu, vv) = (major * major, minor * minor);
        point.covariance_px2 = [cos * cos * uu + sin * sin * vv, sin * cos * (uu - vv), sin * sin * uu + cos * cos * vv];
    }
    points
}

#[test]
fn error_bars_are_true_for_uneven_noise() {
    const NIGHTS: u64 = 200;
    let truth = Night::published().truth;
    for extra_px in [0.0, 0.1] {
        let results: Vec<(Vec<f64>, f64)> = (0..NIGHTS)
            .into_par_iter()
            .map(|seed| {
                let result = calibrate(&uneven(5, 16, extra_px, seed), &joint()).unwrap();
                let parameters = result.parameters.iter().zip(truth.parameters());
                (parameters.map(|(p, truth)| (p.value - truth) / p.sigma).collect(), result.noise.unwrap().floor_px)
            })
            .collect();
        let pulls: Vec<f64> = (0..6).map(|k| rms(results.iter().map(|(pulls, _)| pulls[k]))).collect();
        let floor = median(results.iter().map(|(_, floor)| *floor).collect());
        println!("extra {extra_px} px: pulls {pulls:.3?}, floor {floor:.4} px");
        // The rms of 200 has a standard error of 5 %.
        for (pull, name) in pulls.iter().zip(["x0", "y0", "f", "k1", "p1", "p2"]) {
            assert!((pull - 1.0).abs() < 0.16, "{name}: {pull}");
        }
        if extra_px > 0.0 {
            assert!((floor / extra_px - 1.0).abs() < 0.1, "{floor}");
        } else {
            assert!(floor < 0.02, "{floor}");
        }
    }
}

#[test]
fn a_bad_frame_is_weighed_down() {
    let truth = Night::published().truth;
    let runs: Vec<[f64; 3]> = (0..12_u64)
        .into_par_iter()
        .map(|seed| {
            let (mut points, _) = Night { noise_px: 0.1, ..Night::published() }.observe(seed);
            let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x77);
            for point in points.points.iter_mut().filter(|point| point.frame == 4) {
                let [x, y]: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
                point.x_px += 0.49 * x;
                point.y_px += 0.49 * y;
            }
            let with = calibrate(&points, &joint()).unwrap();
            points.points.retain(|point| point.frame != 4);
            let without = calibrate(&points, &joint()).unwrap();
            let others = with.per_frame.iter().filter(|frame| frame.frame != 4);
            assert!(others.map(|frame| frame.variance_factor).fold(0.0, f64::max) < 3.0, "{:?}", with.warnings);
            assert!(with.warnings.iter().any(|warning| warning.starts_with("frame 4 is worse")), "{:?}", with.warnings);
            [with.per_frame[4].variance_factor, error_px(&truth, &with), error_px(&truth, &without)]
        })
        .collect();
    let [with, without] = [1, 2].map(|k| rms(runs.iter().map(|run| run[k])));
    let factors: Vec<f64> = runs.iter().map(|run| run[0]).collect();
    println!("factors {factors:.0?}, {with:.4} px with the frame, {without:.4} px without");
    assert!(factors.iter().all(|factor| *factor > 8.0), "{factors:?}");
    assert!((median(factors) / 25.0 - 1.0).abs() < 0.4);
    assert!(with < 1.1 * without, "{with} {without}");
}
