//! Which points enter.

use boresight::calibrate::{CalibrateOptions, LeftOutReason, Method, calibrate, mapping_error_px};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;

use super::{Night, options};

#[test]
fn points_that_do_more_harm_than_good_are_left_out() {
    // A third of the points has ten times the noise, and says so.
    let night = Night::published();
    let (mut with, mut without) = (0.0, 0.0);
    for seed in 0..10 {
        let (mut points, _) = night.observe(seed);
        let mut rng = Pcg64Mcg::seed_from_u64(900 + seed);
        let noise = Normal::new(0.0, 1.0).unwrap();
        for point in points.points.iter_mut().step_by(3) {
            point.x_px += noise.sample(&mut rng);
            point.y_px += noise.sample(&mut rng);
            point.covariance_px2 = [1.01, 0.0, 1.01];
        }
        let selected = calibrate(&points, &options(Method::LeastSquares)).unwrap();
        assert_eq!((selected.left_out[0].reason, selected.left_out[0].points), (LeftOutReason::Imprecise, 100));
        let all = calibrate(&points, &CalibrateOptions { leave_out_imprecise: false, ..options(Method::LeastSquares) }).unwrap();
        assert!(all.left_out.is_empty());
        with += mapping_error_px(&night.truth, &selected.camera).unwrap().rms_px;
        without += mapping_error_px(&night.truth, &all.camera).unwrap().rms_px;
    }
    println!("mapping error {with:.3} with the selection, {without:.3} without (sums over ten sets, px)");
    assert!(with < 0.5 * without);
}

#[test]
fn a_usual_spread_of_brightness_costs_no_star() {
    // Photon noise over four magnitudes above a floor: 0.005 to 0.09 px.
    let (mut points, _) = Night { noise_px: 0.05, ..Night::published() }.observe(1);
    for (i, point) in points.points.iter_mut().enumerate() {
        let sigma = 0.015 * 10_f64.powf(0.2 * 4.0 * (i % 25) as f64 / 24.0);
        point.covariance_px2 = [sigma * sigma, 0.0, sigma * sigma];
    }
    assert!(calibrate(&points, &options(Method::VariableWeights)).unwrap().left_out.is_empty());
}

#[test]
fn limits_that_are_asked_for_hold() {
    let (mut points, _) = Night::published().observe(1);
    for point in points.points.iter_mut().step_by(10) {
        point.has_proper_motion = false;
    }
    points.points[1].catalog_sigma_rad = 1e-4; // 0.28 px
    let limited = CalibrateOptions {
        proper_motion_only: true,
        max_position_sigma_px: Some(0.2),
        leave_out_imprecise: false,
        ..options(Method::VariableWeights)
    };
    let result = calibrate(&points, &limited).unwrap();
    let counts: Vec<_> = result.left_out.iter().map(|group| (group.reason, group.points)).collect();
    assert_eq!(counts, [(LeftOutReason::NoProperMotion, 30), (LeftOutReason::AboveLimit, 1)]);
    assert_eq!(result.points[1].left_out, Some(LeftOutReason::AboveLimit));
    assert_eq!(result.stars_offered, 300);
}
