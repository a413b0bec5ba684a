//! Residuals of single stars under a fixed camera, with one free attitude (a rotation) for each frame.
//!
//! The attitude starts from the optimal rotation of the measured onto the catalogue directions (Wahba's problem by singular
//! value decomposition, Markley 1988) and is refined by Gauss–Newton steps in pixels, so that what is minimised is what is
//! reported: measured minus predicted position.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::geometry::{LocalDirection, Scaling};
use super::pairs::{FrameStars, Star};
use crate::camera::Camera;
use crate::coordinates::{Apparent, Attitude, Direction};

/// Gauss–Newton steps at most; two or three are enough.
const ITERATIONS: usize = 20;
/// A rotation step below this (rad) is the end of the iteration: 2e-7 arcsec.
const SMALL_STEP_RAD: f64 = 1e-12;

/// A frame's attitude and its stars' residuals.
#[derive(Clone, Debug)]
pub(super) struct FrameFit {
    /// The attitude.
    pub(super) attitude: Attitude,
    /// Measured minus predicted position of every star, also of those not used, px; `None` where the camera has no image of
    /// the star's direction.
    pub(super) residuals_px: Vec<Option<[f64; 2]>>,
    /// Σ DᵀD of the stars used: the normal matrix of the attitude in camera axes, px²/rad².
    pub(super) rotation_normal: Matrix3<f64>,
}

/// Fits the attitude of one frame to the stars that are `used`. `None` if these leave it open.
pub(super) fn fit_attitude(camera: &Camera, stars: &[Star], used: &[bool]) -> Option<FrameFit> {
    let scaling = Scaling { px_per_unit: [1.0; 6], free: [true; 6] };
    let locals: Vec<LocalDirection> = stars.iter().map(|star| scaling.local_direction(camera, star.pixel)).collect();
    let mut rotation = optimal_rotation(stars, &locals, used)?;
    let mut rotation_normal = Matrix3::zeros();
    for _ in 0..ITERATIONS {
        let attitude = Attitude::new(rotation);
        rotation_normal = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for ((star, local), _) in stars.iter().zip(&locals).zip(used).filter(|(_, used)| **used) {
            let (Some(residual), Some((_, columns))) = (residual_px(camera, &attitude, star), local.pixel_columns()) else { continue };
            rotation_normal += columns.transpose() * columns;
            right += columns.transpose() * nalgebra::Vector2::from(residual);
        }
        let step = well_conditioned(&rotation_normal)?.solve(&right);
        rotation = UnitQuaternion::from_scaled_axis(step) * rotation;
        if step.norm() < SMALL_STEP_RAD {
            break;
        }
    }
    let attitude = Attitude::new(rotation);
    let residuals_px = stars.iter().map(|star| residual_px(camera, &attitude, star)).collect();
    Some(FrameFit { attitude, residuals_px, rotation_normal })
}

/// Fits every frame.
pub(super) fn fit_frames(camera: &Camera, frames: &[FrameStars], used: &[Vec<bool>]) -> Vec<Option<FrameFit>> {
    frames.iter().zip(used).map(|(frame, used)| fit_attitude(camera, &frame.stars, used)).collect()
}

/// Measured minus predicted position.
pub(super) fn residual_px(camera: &Camera, attitude: &Attitude, star: &Star) -> Option<[f64; 2]> {
    let direction = Direction::<Apparent>::from_unit(star.direction);
    let predicted = camera.pixel(&attitude.camera_from_apparent(&direction))?;
    let residual = [star.pixel.x_px - predicted.x_px, star.pixel.y_px - predicted.y_px];
    residual.iter().all(|r| r.is_finite()).then_some(residual)
}

/// The rotation that takes the catalogue directions best onto the measured ones.
fn optimal_rotation(stars: &[Star], locals: &[LocalDirection], used: &[bool]) -> Option<UnitQuaternion<f64>> {
    let mut profile = Matrix3::zeros();
    for ((star, local), _) in stars.iter().zip(locals).zip(used).filter(|(_, used)| **used) {
        profile += Vector3::from(local.direction) * Vector3::from(star.direction).transpose();
    }
    let svd = profile.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let proper = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = u * proper * v_t;
    rotation.iter().all(|c| c.is_finite()).then(|| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

/// The Cholesky factor of an attitude's normal matrix, unless the stars leave the attitude open (fewer than two stars, or all
/// in one place).
fn well_conditioned(normal: &Matrix3<f64>) -> Option<nalgebra::Cholesky<f64, nalgebra::Const<3>>> {
    const SMALLEST_EIGENVALUE_RATIO: f64 = 1e-12;
    let eigen = normal.symmetric_eigenvalues();
    if eigen.min().is_nan() || eigen.min() <= SMALLEST_EIGENVALUE_RATIO * eigen.max() {
        return None;
    }
    normal.cholesky()
}

/// Sums over the star images used of all frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ResidualSums {
    /// Σ (x² + y²), px².
    pub(super) square_px2: f64,
    /// Star images in it.
    pub(super) stars: usize,
    /// Frames whose attitude took three degrees of freedom.
    pub(super) frames: usize,
}

impl ResidualSums {
    /// Over the stars that are `used` and have an image.
    pub(super) fn of(fits: &[Option<FrameFit>], used: &[Vec<bool>]) -> Self {
        let mut sums = Self::default();
        for (fit, used) in fits.iter().zip(used).filter_map(|(fit, used)| fit.as_ref().map(|fit| (fit, used))) {
            sums.frames += 1;
            for residual in fit.residuals_px.iter().zip(used).filter(|(_, used)| **used).filter_map(|(residual, _)| *residual) {
                sums.square_px2 += residual[0] * residual[0] + residual[1] * residual[1];
                sums.stars += 1;
            }
        }
        sums
    }

    /// 2-D rms, px.
    pub(super) fn rms_px(&self) -> Option<f64> {
        (self.stars > 0).then(|| (self.square_px2 / self.stars as f64).sqrt())
    }

    /// Coordinates minus attitudes minus camera parameters.
    pub(super) fn degrees_of_freedom(&self, camera_parameters: usize) -> Option<usize> {
        (2 * self.stars).checked_sub(3 * self.frames + camera_parameters).filter(|degrees| *degrees > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coordinates::PixelPoint;

    #[test]
    fn the_attitude_is_the_minimum_in_pixels() {
        let camera = Camera { k1: 3e-8, ..Camera::pinhole(1024, 1024, 1800.0) };
        let true_attitude = Attitude::from_pointing(1.0, -0.4, 2.0);
        // Deterministic "noise" of up to half a pixel.
        let stars: Vec<Star> = (0..15_u32)
            .map(|i| {
                let place = PixelPoint { x_px: f64::from(i * 397 % 1024), y_px: f64::from(i * 613 % 1024) };
                let direction = true_attitude.apparent_from_camera(&camera.direction(place)).xyz;
                let noise = |k: u32| f64::from((i * k) % 11) / 10.0 - 0.5;
                Star { point: 0, pixel: PixelPoint { x_px: place.x_px + noise(7), y_px: place.y_px + noise(3) }, direction }
            })
            .collect();
        let mut used = vec![true; 15];
        used[4] = false;
        let fit = fit_attitude(&camera, &stars, &used).unwrap();
        let square = |attitude: &Attitude| -> f64 {
            let residuals =
                stars.iter().zip(&used).filter(|(_, used)| **used).map(|(star, _)| residual_px(&camera, attitude, star).unwrap());
            residuals.map(|[x, y]| x * x + y * y).sum()
        };
        let least = square(&fit.attitude);
        for axis in 0..3 {
            for angle in [-1e-4, 1e-4] {
                let mut turn = Vector3::zeros();
                turn[axis] = angle;
                let other = Attitude::new(UnitQuaternion::from_scaled_axis(turn) * fit.attitude.camera_from_icrs);
                // Near the minimum the sum rises with the normal matrix: measured at the stars, so to the size of the residuals.
                let rise = angle * angle * fit.rotation_normal[(axis, axis)];
                assert!(((square(&other) - least) / rise - 1.0).abs() < 0.02, "{axis} {angle}");
            }
        }
    }

    #[test]
    fn one_star_leaves_the_attitude_open() {
        let camera = Camera::pinhole(1024, 1024, 1800.0);
        let star = |x_px: f64| {
            let pixel = PixelPoint { x_px, y_px: 300.0 };
            Star { point: 0, pixel, direction: camera.direction(pixel).xyz }
        };
        assert!(fit_attitude(&camera, &[star(100.0)], &[true]).is_none());
        assert!(fit_attitude(&camera, &[star(100.0), star(100.0)], &[true, true]).is_none());
        assert!(fit_attitude(&camera, &[star(100.0), star(500.0)], &[true, true]).is_some());
        assert!(fit_attitude(&camera, &[star(100.0), star(500.0)], &[true, false]).is_none());
    }
}
