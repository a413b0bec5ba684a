//! Calibration on control points made from a known camera: no image is rendered or measured here.

mod bad_input;
mod compare;
mod effects;
mod inseparable;
mod joint;
mod joint_statistics;
mod published;
mod select;
mod sequential;
mod supported;
mod trial;
mod uncertainty;

use boresight::calibrate::{CalibrateOptions, Method};
use boresight::camera::Camera;
use boresight::coordinates::{Attitude, PixelPoint};
use boresight::effects::{StarImage, StarState};
use boresight::identify::{ControlPoint, ControlPoints, KnownAttitude};
use boresight::units::DEG_RAD;
use nalgebra::{Unit, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal, UnitSphere};
use rand_pcg::Pcg64Mcg;

/// How control points are made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Night {
    pub(crate) frames: usize,
    pub(crate) stars: usize,
    /// Centroid noise per axis.
    pub(crate) noise_px: f64,
    /// Share of stars in each frame that are held to be another one.
    pub(crate) misidentified: f64,
    pub(crate) truth: Camera,
    pub(crate) nominal: Camera,
}

impl Night {
    /// The case of the published table: 12 frames × 25 stars, 1024 px, f = 2800 px, 0.1 px.
    pub(crate) fn published() -> Self {
        let truth = Camera {
            width_px: 1024,
            height_px: 1024,
            principal_point_px: [516.3, 507.9],
            focal_length_px: 2800.0,
            k1: 5e-9,
            p1: 2e-7,
            p2: -1.5e-7,
        };
        Self { frames: 12, stars: 25, noise_px: 0.1, misidentified: 0.0, truth, nominal: Camera::pinhole(1024, 1024, 2800.0 * 1.004) }
    }

    /// Control points and, for each, whether its star is wrong.
    pub(crate) fn observe(&self, seed: u64) -> (ControlPoints, Vec<bool>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let noise = Normal::new(0.0, self.noise_px).unwrap();
        let (mut points, mut wrong, mut attitudes) = (Vec::new(), Vec::new(), Vec::new());
        for frame in 0..self.frames {
            let attitude = random_attitude(&mut rng);
            attitudes.push(Some(attitude));
            let bad = (self.misidentified * self.stars as f64).round() as usize;
            for star in 0..self.stars {
                let place = PixelPoint {
                    x_px: rng.random_range(0.0..self.truth.width_px as f64 - 1.0),
                    y_px: rng.random_range(0.0..self.truth.height_px as f64 - 1.0),
                };
                let mut direction = attitude.apparent_from_camera(&self.truth.direction(place));
                if star < bad {
                    // The direction of a point 0.05–2° away.
                    let axis = Vector3::from(UnitSphere.sample(&mut rng)).cross(&Vector3::from(direction.xyz));
                    let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), rng.random_range(0.05..2.0) * DEG_RAD);
                    let moved = turn * Vector3::from(direction.xyz);
                    direction = boresight::coordinates::Direction::along([moved.x, moved.y, moved.z]);
                }
                points.push(ControlPoint {
                    frame,
                    hip: (frame * self.stars + star) as u32 + 1,
                    direction,
                    x_px: place.x_px + noise.sample(&mut rng),
                    y_px: place.y_px + noise.sample(&mut rng),
                    covariance_px2: [self.noise_px.powi(2), 0.0, self.noise_px.powi(2)],
                    catalog_sigma_rad: 0.0,
                    has_proper_motion: true,
                    magnitude: 5.0,
                    colour: None,
                    star: StarState { direction: direction.xyz, ..StarState::default() },
                    image: StarImage::default(),
                });
                wrong.push(star < bad);
            }
        }
        (ControlPoints::new(self.nominal, attitudes, points), wrong)
    }
}

/// Any rotation, all equally likely.
pub(crate) fn random_attitude(rng: &mut Pcg64Mcg) -> Attitude {
    let normal = Normal::new(0.0, 1.0).unwrap();
    let q: [f64; 4] = std::array::from_fn(|_| normal.sample(rng));
    Attitude::from(q)
}

/// Gives every frame an attitude from elsewhere, with errors of this size.
pub(crate) fn know_attitudes(points: &mut ControlPoints, attitudes: &[Attitude], sigma_rad: f64) {
    let mut rng = Pcg64Mcg::seed_from_u64(77);
    let normal = Normal::new(0.0, sigma_rad).unwrap();
    for (state, attitude) in points.frames.iter_mut().zip(attitudes) {
        let error: [f64; 3] = std::array::from_fn(|_| normal.sample(&mut rng));
        let turned = UnitQuaternion::from_scaled_axis(Vector3::from(error)) * attitude.camera_from_icrs;
        state.known_attitude = Some(KnownAttitude { camera_from_icrs: Attitude::new(turned), sigma_rad });
    }
}

pub(crate) fn options(method: Method) -> CalibrateOptions {
    CalibrateOptions { method, held_out: false, ..CalibrateOptions::default() }
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    f64::midpoint(values[(n - 1) / 2], values[n / 2])
}
