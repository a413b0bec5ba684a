//! Whether the error bars are true.

use boresight::calibrate::{Calibration, Method, calibrate, compare, map, mapping_error_px};

use super::{Night, median, options};

const SETS: u64 = 400;

fn sets(night: &Night, first_seed: u64, count: u64) -> Vec<Calibration> {
    (0..count).map(|seed| calibrate(&night.observe(first_seed + seed).0, &options(Method::VariableWeights)).unwrap()).collect()
}

#[test]
fn standard_errors_match_the_scatter() {
    let night = Night::published();
    let results = sets(&night, 20_000, SETS);
    let truth = night.truth.parameters();
    for (k, true_value) in truth.into_iter().enumerate() {
        let pulls: Vec<f64> = results.iter().map(|result| (result.parameters[k].value - true_value) / result.parameters[k].sigma).collect();
        let mean = pulls.iter().sum::<f64>() / pulls.len() as f64;
        let scatter = (pulls.iter().map(|pull| pull * pull).sum::<f64>() / pulls.len() as f64).sqrt();
        let joint = median(results.iter().map(|result| result.parameters[k].sigma_joint / result.parameters[k].sigma).collect());
        println!(
            "{}: pulls {mean:+.3} ± {scatter:.3} (rms), a joint adjustment would reach {joint:.3} of σ",
            results[0].parameters[k].name
        );
        // The rms of 400 pulls has a standard error of 1/√800 = 3.5 %.
        assert!((scatter - 1.0).abs() < 0.11, "rms pull {scatter}");
        assert!(mean.abs() < 0.16, "mean pull {mean}");
        assert!((0.8..=1.0).contains(&joint), "{joint}");
    }
    // The map: predicted and actual error over the frame.
    let actual = results.iter().map(|r| mapping_error_px(&night.truth, &r.camera).unwrap().rms_px.powi(2)).sum::<f64>() / SETS as f64;
    let sigma = median(results.iter().map(|r| r.map_sigma_px.unwrap().median).collect());
    let noise = results.iter().map(|r| r.unit_weight_sigma_px.powi(2)).sum::<f64>() / SETS as f64;
    println!("map: rms error {:.4} px, median σ over the frame {sigma:.4} px; noise per axis found {:.4} px", actual.sqrt(), noise.sqrt());
    // The rms is more than the median as the corners are worse.
    assert!((0.7..0.95).contains(&(sigma / actual.sqrt())));
    assert!((noise.sqrt() / 0.1 - 1.0).abs() < 0.01, "unit-weight standard deviation {} px where 0.1 px went in", noise.sqrt());
}

#[test]
fn standard_errors_hold_with_wrong_stars_and_a_sharp_threshold() {
    let night = Night { misidentified: 0.1, ..Night::published() };
    let mut square = [0.0; 6];
    let count = 150;
    for seed in 0..count {
        let options = boresight::calibrate::CalibrateOptions { f_threshold: 4.0, max_iterations: 300, ..options(Method::VariableWeights) };
        let result = calibrate(&night.observe(seed).0, &options).unwrap();
        for (k, sum) in square.iter_mut().enumerate() {
            *sum += ((result.parameters[k].value - night.truth.parameters()[k]) / result.parameters[k].sigma).powi(2);
        }
    }
    let rms = square.map(|sum| (sum / count as f64).sqrt());
    println!("rms pulls at F = 4 and 10 % wrong: {rms:.2?}");
    // 5.8 % standard error each.
    assert!(rms.iter().all(|rms| (0.82..1.2).contains(rms)), "{rms:?}");
}

#[test]
fn held_out_and_in_sample_stand_where_they_should() {
    for frames in [12, 24] {
        let night = Night { frames, ..Night::published() };
        let (points, _) = night.observe(77);
        let options = boresight::calibrate::CalibrateOptions { held_out: true, ..options(Method::VariableWeights) };
        let result = calibrate(&points, &options).unwrap();
        let (inside, outside) = (result.rms_px.unwrap(), result.held_out_rms_px.unwrap());
        println!("{frames} frames: in sample {inside:.4} px, held out {outside:.4} px");
        // In sample σ·√(2 − (3·frames + 6)/n), held out a little above as the camera's error comes on top.
        assert!(outside > inside && outside < 1.08 * inside, "{inside} {outside}");
        // 2-D rms as an angle: one pixel is 1/f near the axis.
        let arcsec = result.rms_arcsec.unwrap() / (inside / 2800.0).to_degrees() / 3600.0;
        assert!((0.95..1.01).contains(&arcsec), "{arcsec}");
        // An angle between two stars has the errors of two ends along the line: σ·√2/f.
        let angle = result.interstar_angle_rms_arcsec.unwrap() / (0.1 * 2_f64.sqrt() / 2800.0).to_degrees() / 3600.0;
        assert!((0.85..1.1).contains(&angle), "{angle}");
    }
}

#[test]
fn attitude_errors_follow_the_stars() {
    let (points, _) = Night::published().observe(78);
    let sigma = calibrate(&points, &options(Method::VariableWeights)).unwrap().attitude_sigma_arcsec.unwrap();
    let arcsec = |rad: f64| rad.to_degrees() * 3600.0;
    // Across: σ/(f·√n) for n stars (the two axes of rotation are fitted with the roll, a little more). About: σ/√(Σ r²),
    // r² = 2·1024²/12 on average.
    let across = arcsec(0.1 / (2800.0 * 25_f64.sqrt()));
    let about = arcsec(0.1 / (25.0 * 1024_f64.powi(2) / 6.0).sqrt());
    assert!((0.95..1.25).contains(&(sigma.across / across)), "{sigma:?} {across}");
    assert!((0.9..1.2).contains(&(sigma.about / about)), "{sigma:?} {about}");
}

#[test]
fn two_nights_of_one_camera_agree_and_a_changed_one_does_not() {
    let night = Night::published();
    let results = sets(&night, 40_000, 200);
    let p: Vec<f64> = results.chunks(2).map(|pair| compare(&pair[0], &pair[1]).unwrap().p_value.unwrap()).collect();
    let below = |limit: f64| p.iter().filter(|p| **p < limit).count();
    println!("of 100 pairs of nights: p < 0.05 in {}, < 0.5 in {}", below(0.05), below(0.5));
    // Binomial: 5 ± 2.2 and 50 ± 5.
    assert!(below(0.05) <= 13 && (33..=67).contains(&below(0.5)));
    let longer = boresight::camera::Camera { focal_length_px: night.truth.focal_length_px + 1.5, ..night.truth };
    let after = calibrate(&Night { truth: longer, ..night }.observe(9).0, &options(Method::VariableWeights)).unwrap();
    let change = compare(&results[0], &after).unwrap();
    println!("focal length + 1.5 px: rms {:.3} px, p = {:.1e}", change.rms_px, change.p_value.unwrap());
    assert!(change.p_value.unwrap() < 1e-6 && change.rms_px > 0.1);
    assert!(!compare(&results[0], &results[0]).unwrap().warnings.is_empty(), "the same night twice is no independent test");
}

#[test]
fn a_rotation_of_the_camera_is_no_mapping_error() {
    // A camera whose axes are turned by a small angle about z has p1, p2 and the centre turned too and the same map.
    let truth = Night::published().truth;
    assert!(mapping_error_px(&truth, &truth).unwrap().max_px < 1e-9);
    // A shift of the centre alone is mostly a rotation: (x/f)² of it is left, 512²/2800² = 3 % at the edge.
    let [x0, y0] = truth.principal_point_px;
    let shifted = boresight::camera::Camera { principal_point_px: [x0 + 1.0, y0], k1: 0.0, p1: 0.0, p2: 0.0, ..truth };
    let still = boresight::camera::Camera { k1: 0.0, p1: 0.0, p2: 0.0, ..truth };
    let error = mapping_error_px(&still, &shifted).unwrap();
    assert!((0.005..0.03).contains(&error.rms_px), "{error:?}");
}

#[test]
fn the_map_lists_directions_from_edge_to_edge() {
    let (points, _) = Night::published().observe(1);
    let result = calibrate(&points, &options(Method::VariableWeights)).unwrap();
    let map = map(&result, 5);
    assert_eq!(map.points.len(), 25);
    assert_eq!((map.points[0].x_px, map.points[24].y_px), (0.0, 1023.0));
    for point in map.points {
        let direct = result.camera.direction(boresight::coordinates::PixelPoint { x_px: point.x_px, y_px: point.y_px });
        let difference = (0..3).map(|axis| (point.direction[axis] - direct.xyz[axis]).abs()).fold(0.0, f64::max);
        assert!(difference < 1e-15, "{difference:e}");
    }
}
