//! How long a calibration takes: a usual night, and ten million pairs.

use boresight::calibrate::{CalibrateOptions, Method, calibrate};
use boresight::camera::Camera;
use boresight::coordinates::{Attitude, PixelPoint};
use boresight::effects::{StarImage, StarState};
use boresight::identify::{ControlPoint, ControlPoints};
use divan::Bencher;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;

fn main() {
    divan::main();
}

/// Frames of random stars seen by a camera other than the nominal one, with 0.1 px of noise.
fn night(frames: usize, stars: usize) -> ControlPoints {
    let truth = Camera { k1: 5e-9, p1: 2e-7, p2: -1e-7, ..Camera::pinhole(1024, 1024, 2800.0) };
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let noise = Normal::new(0.0, 0.1).unwrap_or_else(|_| unreachable!("a positive width"));
    let mut points = Vec::new();
    for frame in 0..frames {
        let attitude = Attitude::from_pointing(frame as f64, 0.3, 0.1 * frame as f64);
        for star in 0..stars {
            let place = PixelPoint { x_px: rng.random_range(0.0..1023.0), y_px: rng.random_range(0.0..1023.0) };
            points.push(ControlPoint {
                frame,
                hip: (frame * stars + star) as u32 + 1,
                direction: attitude.apparent_from_camera(&truth.direction(place)),
                x_px: place.x_px + noise.sample(&mut rng),
                y_px: place.y_px + noise.sample(&mut rng),
                covariance_px2: [0.01, 0.0, 0.01],
                catalog_sigma_rad: 0.0,
                has_proper_motion: true,
                magnitude: 5.0,
                colour: None,
                star: StarState::default(),
                image: StarImage::default(),
            });
        }
    }
    ControlPoints::new(Camera::pinhole(1024, 1024, 2811.0), vec![None; frames], points)
}

/// Frames × stars a frame; the held-out solutions are left away.
#[divan::bench(args = [(12, 25), (40, 30), (20, 1000)], sample_count = 5)]
fn variable_weights(bencher: Bencher, (frames, stars): (usize, usize)) {
    let points = night(frames, stars);
    let options = CalibrateOptions { method: Method::VariableWeights, held_out: false, ..CalibrateOptions::default() };
    bencher.bench_local(|| calibrate(&points, &options));
}

/// The joint method, held-out frames included: a usual night, and how the cost grows up to a million star images.
#[divan::bench(args = [(12, 25), (40, 30), (100, 100), (1000, 100), (10_000, 100)], sample_count = 3)]
fn bundle(bencher: Bencher, (frames, stars): (usize, usize)) {
    let points = night(frames, stars);
    bencher.bench_local(|| calibrate(&points, &CalibrateOptions::default()));
}
