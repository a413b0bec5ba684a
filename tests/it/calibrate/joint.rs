//! The joint method: what wrong stars and known attitudes do to it, frames held out, and any number of threads.

use boresight::calibrate::trial::{Trial, TrialNight, WrongStars};
use boresight::calibrate::{AttitudeModel, CalibrateOptions, Calibration, Method, calibrate, calibrate_identifying_anew, mapping_error_px};
use boresight::camera::{Camera, Model};
use boresight::catalog::Catalog;
use boresight::coordinates::{Attitude, PixelPoint};
use boresight::effects::Sensor;
use boresight::identify::{ControlPoints, FrameState, KnownAttitude};
use nalgebra::{Matrix2x3, Matrix3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::effects::{Pointing, SkyNight, camera, largest_pull, solving};
use super::{Night, know_attitudes, options};

pub(super) fn joint() -> CalibrateOptions {
    options(Method::Bundle)
}

pub(super) fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value * value;
        count += 1.0;
    }
    f64::sqrt(sum / count)
}

pub(super) fn error_px(truth: &Camera, result: &Calibration) -> f64 {
    mapping_error_px(truth, &result.camera).unwrap().rms_px
}

pub(super) fn sigma(result: &Calibration, name: &str) -> f64 {
    result.parameters.iter().find(|p| p.name == name).unwrap().sigma
}

// ---- Wrong stars ----

fn trial_night(wrong_stars: WrongStars, wrong_share: f64, seed: u64) -> TrialNight {
    Trial { wrong_stars, wrong_share, ..Trial::published() }.night(Catalog::embedded(), seed)
}

/// The same night without its wrong points.
fn without_wrong(night: &TrialNight) -> ControlPoints {
    let mut points = night.control_points.clone();
    let mut wrong = night.wrong.iter();
    points.points.retain(|_| !wrong.next().unwrap());
    points
}

#[test]
fn wrong_stars_cost_no_more_than_their_absence() {
    const NIGHTS: u64 = 10;
    let cases = [
        (WrongStars::Random, 0.2),
        (WrongStars::Random, 0.4),
        (WrongStars::Random, 0.5),
        (WrongStars::NearNeighbour, 0.2),
        (WrongStars::NearNeighbour, 0.4),
        (WrongStars::NATURAL, 0.2),
        (WrongStars::NATURAL, 0.4),
    ];
    let clean = rms((0..NIGHTS).into_par_iter().map(|seed| solve_trial(&trial_night(WrongStars::Random, 0.0, seed))).collect::<Vec<_>>());
    for (kind, share) in cases {
        let errors: Vec<[f64; 3]> = (0..NIGHTS)
            .into_par_iter()
            .map(|seed| {
                let night = trial_night(kind, share, seed);
                let removed = calibrate(&without_wrong(&night), &joint()).unwrap();
                let anew = calibrate_identifying_anew(&night.control_points, &[], Catalog::embedded(), None, &joint()).unwrap();
                [solve_trial(&night), error_px(&night.truth, &removed), error_px(&night.truth, &anew)]
            })
            .collect();
        let [wrong, removed, anew] = [0, 1, 2].map(|k| rms(errors.iter().map(|e| e[k])));
        println!(
            "{kind:?} {share}: {wrong:.4} px, without the wrong {removed:.4} ({:.3}), anew {anew:.4}, clean {clean:.4} ({:.3})",
            wrong / removed,
            anew / clean
        );
        assert!(wrong < 1.1 * removed, "{kind:?} {share}: {wrong} {removed}");
        assert!(anew < 1.1 * clean, "{kind:?} {share}: {anew} {clean}");
    }
}

fn solve_trial(night: &TrialNight) -> f64 {
    error_px(&night.truth, &calibrate(&night.control_points, &joint()).unwrap())
}

// ---- Attitudes ----

#[test]
fn a_fixed_mount_tells_more_than_free_attitudes() {
    let truth = Model::new(camera());
    let (points, _) = SkyNight { pointing: Pointing::Fixed, frames: 10, ..SkyNight::new(truth.clone()) }.observe(3);
    let fixed = calibrate(&points, &solving(&[])).unwrap();
    let free = calibrate(&points, &CalibrateOptions { attitudes: AttitudeModel::Free, ..solving(&[]) }).unwrap();
    assert!(fixed.gauge.contains("mount"), "{}", fixed.gauge);
    for result in [&fixed, &free] {
        let (pull, name) = largest_pull(result, &truth);
        assert!(pull < 4.5, "{name} is off by {pull} σ");
    }
    for name in ["x0", "y0", "f"] {
        println!("{name}: ± {:.4} fixed, ± {:.4} free", sigma(&fixed, name), sigma(&free, name));
    }
    assert!(["x0", "y0", "f"].iter().all(|name| sigma(&fixed, name) < sigma(&free, name)));
}

#[test]
fn a_mount_that_is_not_fixed_is_found_out() {
    let truth = Model::new(camera());
    let (mut points, _) = SkyNight { frames: 8, ..SkyNight::new(truth.clone()) }.observe(4);
    points.fixed_mount = true;
    let result = calibrate(&points, &solving(&[])).unwrap();
    assert!(result.warnings.iter().any(|warning| warning.contains("do not fit one place")), "{:?}", result.warnings);
    assert!(largest_pull(&result, &truth).0 < 4.5);
}

/// Information of a frame's star images on its attitude, the camera held.
fn attitude_information(
    points: &ControlPoints,
    frame: usize,
    attitude: UnitQuaternion<f64>,
    camera: &Camera,
    variance_px2: f64,
) -> Matrix3<f64> {
    const STEP_RAD: f64 = 1e-6;
    let mut information = Matrix3::zeros();
    for point in points.points.iter().filter(|point| point.frame == frame) {
        let at = |turn: Vector3<f64>| {
            let attitude = Attitude::new(UnitQuaternion::from_scaled_axis(turn) * attitude);
            camera.pixel(&attitude.camera_from_apparent(&point.direction)).unwrap()
        };
        let columns = [0, 1, 2].map(|axis| {
            let mut turn = Vector3::zeros();
            turn[axis] = STEP_RAD;
            let (plus, minus) = (at(turn), at(-turn));
            [(plus.x_px - minus.x_px) / (2.0 * STEP_RAD), (plus.y_px - minus.y_px) / (2.0 * STEP_RAD)]
        });
        let jacobian = Matrix2x3::from_fn(|side, axis| columns[axis][side]);
        information += jacobian.transpose() * jacobian / variance_px2;
    }
    information
}

#[test]
fn a_known_attitude_pulls_as_much_as_it_is_trusted() {
    let night = Night::published();
    let (mut points, _) = night.observe(5);
    let options = CalibrateOptions { solve: vec!["f".to_owned()], ..joint() };
    points.nominal = Camera { focal_length_px: 2801.0, ..night.truth };
    let free = calibrate(&points, &options).unwrap();
    let found = free.per_frame[2].camera_from_icrs.unwrap().camera_from_icrs;
    let variance = night.noise_px.powi(2) + free.noise.unwrap().floor_px.powi(2);
    let information = attitude_information(&points, 2, found, &free.camera, variance);
    for sigma_rad in [2e-6, 1e-5, 3e-5] {
        let off = Vector3::new(2e-5, -1e-5, 6e-5);
        let known = Attitude::new(UnitQuaternion::from_scaled_axis(off) * found);
        points.frames = vec![FrameState::default(); night.frames];
        points.frames[2].known_attitude = Some(KnownAttitude { camera_from_icrs: known, sigma_rad });
        let result = calibrate(&points, &options).unwrap();
        let moved = (result.per_frame[2].camera_from_icrs.unwrap().camera_from_icrs * found.inverse()).scaled_axis();
        let trust = Matrix3::identity() / (sigma_rad * sigma_rad);
        let expected = (information + trust).try_inverse().unwrap() * trust * off;
        println!("± {sigma_rad}: {:?}, expected {:?}", moved.as_slice(), expected.as_slice());
        assert!((moved - expected).norm() < 0.03 * expected.norm(), "{moved} {expected}");
    }
}

#[test]
fn known_attitudes_tell_the_principal_point_and_the_drift() {
    let mut truth = Model::new(camera());
    truth.set("boresight-drift", &[0.05, -0.03, 0.0, 0.0]).unwrap();
    let (mut points, attitudes) = SkyNight::new(truth.clone()).observe(6);
    let free = calibrate(&points, &solving(&["boresight-drift"])).unwrap();
    // 2″, a tenth of what the stars say of each frame's attitude.
    know_attitudes(&mut points, &attitudes, 1e-5);
    let known = calibrate(&points, &solving(&["boresight-drift"])).unwrap();
    for result in [&free, &known] {
        let (pull, name) = largest_pull(result, &truth);
        println!("{pull:.2} {name}: {:?}", result.parameters.iter().map(|p| (p.name.as_str(), p.value, p.sigma)).collect::<Vec<_>>());
        assert!(pull < 4.5, "{name} is off by {pull} σ");
    }
    for name in ["x0", "y0", "boresight-drift.x_px_per_kelvin", "boresight-drift.y_px_per_kelvin"] {
        assert!(sigma(&known, name) < 0.2 * sigma(&free, name), "{name}: {} {}", sigma(&known, name), sigma(&free, name));
    }
}

#[test]
fn unknown_rates_of_a_rolling_shutter_do_not_bend_the_camera() {
    let truth = Model::new(camera());
    let line_time_s = 30e-6;
    let mut turning = truth.clone();
    turning.set("rolling-shutter", &[30.0]).unwrap();
    let (mut points, _) = SkyNight { noise_px: 0.02, ..SkyNight::new(turning) }.observe(7);
    for state in &mut points.frames {
        state.observation.sensor = Some(Sensor { line_time_s: Some(line_time_s), ..state.observation.sensor.unwrap() });
        state.observation.rate_rad_s = None;
    }
    let auto = calibrate(&points, &solving(&[])).unwrap();
    let free = calibrate(&points, &CalibrateOptions { attitudes: AttitudeModel::Free, ..solving(&[]) }).unwrap();
    let (pull, name) = largest_pull(&auto, &truth);
    let errors = [&auto, &free].map(|result| mapping_error_px(&camera(), &result.camera).unwrap().rms_px);
    println!("{errors:?} px, σ {:?}, pull {pull:.2} ({name}); rms {:?} {:?}", auto.map_sigma_px, auto.rms_px, free.rms_px);
    assert!(auto.gauge.contains("rates"), "{}", auto.gauge);
    assert!(pull < 4.5, "{name} is off by {pull} σ");
    assert!(auto.rms_px.unwrap() < 0.03 && free.rms_px.unwrap() > 2.0 * auto.rms_px.unwrap());
    assert!(errors[0] < 3.0 * auto.map_sigma_px.unwrap().max && errors[0] < 0.5 * errors[1], "{errors:?}");
}

// ---- Held-out frames ----

/// 2-D rms of the star images with weight of each frame, the camera solved without it, its attitude fitted to them.
fn held_out_the_slow_way(points: &ControlPoints, weights: &[f64], options: &CalibrateOptions) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for frame in 0..points.attitudes.len() {
        let mut rest = points.clone();
        rest.points.retain(|point| point.frame != frame);
        let others = calibrate(&rest, options).unwrap();
        let own: Vec<_> = points
            .points
            .iter()
            .zip(weights)
            .filter(|(point, weight)| point.frame == frame && **weight > 0.5)
            .map(|(point, _)| point)
            .collect();
        let mut attitude = points.attitudes[frame].unwrap().camera_from_icrs;
        let residual = |attitude: UnitQuaternion<f64>| -> Vec<f64> {
            own.iter()
                .flat_map(|point| {
                    let PixelPoint { x_px, y_px } =
                        others.camera.pixel(&Attitude::new(attitude).camera_from_apparent(&point.direction)).unwrap();
                    [point.x_px - x_px, point.y_px - y_px]
                })
                .collect()
        };
        for _ in 0..6 {
            let now = residual(attitude);
            let columns: Vec<Vec<f64>> = (0..3)
                .map(|axis| {
                    let mut turn = Vector3::zeros();
                    turn[axis] = 1e-6;
                    residual(UnitQuaternion::from_scaled_axis(turn) * attitude).iter().zip(&now).map(|(a, b)| (a - b) / 1e-6).collect()
                })
                .collect();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let normal = Matrix3::from_fn(|i, j| dot(&columns[i], &columns[j]));
            let right = Vector3::from_fn(|i, _| -dot(&columns[i], &now));
            attitude = UnitQuaternion::from_scaled_axis(normal.try_inverse().unwrap() * right) * attitude;
        }
        for r in residual(attitude) {
            sum += r * r;
        }
        count += own.len() as f64;
    }
    f64::sqrt(sum / count)
}

#[test]
fn held_out_frames_are_judged_as_if_solved_without_them() {
    for (kind, share, seed) in [(WrongStars::Random, 0.0, 1), (WrongStars::Random, 0.0, 2), (WrongStars::NearNeighbour, 0.2, 3)] {
        let night = Trial { frames: 6, wrong_stars: kind, wrong_share: share, ..Trial::published() }.night(Catalog::embedded(), seed);
        let result = calibrate(&night.control_points, &CalibrateOptions { held_out: true, ..joint() }).unwrap();
        let quick = result.held_out_rms_px.unwrap();
        let weights: Vec<f64> = result.points.iter().map(|point| point.weight).collect();
        let slow = held_out_the_slow_way(&night.control_points, &weights, &joint());
        println!("{kind:?} {share}: {quick:.5} px, solved anew {slow:.5} px, in sample {:.5}", result.rms_px.unwrap());
        assert!((quick / slow - 1.0).abs() < 0.01, "{quick} {slow}");
        assert!(quick > result.rms_px.unwrap());
    }
}

// ---- Determinism ----

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let night = trial_night(WrongStars::NATURAL, 0.3, 8);
    let options = CalibrateOptions { select_model: true, held_out: true, ..joint() };
    let bytes = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut result = calibrate_identifying_anew(&night.control_points, &[], Catalog::embedded(), None, &options).unwrap();
            result.seconds = 0.0;
            serde_json::to_vec(&result).unwrap()
        })
    };
    let one = bytes(1);
    assert!(one == bytes(2) && one == bytes(3));
}
