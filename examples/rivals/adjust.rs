//! Least squares at the level of stars: one camera, one rotation for each frame, all stars in use with equal weight.

use boresight::camera::{Camera, PARAMETER_COUNT};
use boresight::coordinates::{Apparent, Attitude, Direction, PixelPoint};
use boresight::identify::ControlPoints;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};

use super::columns::{Columns, FrameNormal, Matrix6, Vector6, inverse};

/// A star image with the direction of the star it is held to be.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Star {
    pub(crate) pixel: PixelPoint,
    pub(crate) direction: Vector3<f64>,
}

/// Gauss–Newton steps at most.
const ITERATIONS: usize = 30;
/// The end of the iteration: the step in units of the parameters' own errors at 1 px noise.
const SMALL_STEP: f64 = 1e-7;

/// The stars of each frame, without those that are named twice in it: the calibrator leaves them out as well.
pub(crate) fn frames_of(points: &ControlPoints, keep: impl Fn(usize) -> bool) -> Vec<Vec<Star>> {
    let mut names = std::collections::BTreeMap::new();
    let kept: Vec<usize> = (0..points.points.len()).filter(|index| keep(*index)).collect();
    for &index in &kept {
        *names.entry((points.points[index].frame, points.points[index].hip)).or_insert(0_usize) += 1;
    }
    let mut frames = vec![Vec::new(); points.attitudes.len()];
    for point in kept.into_iter().map(|index| &points.points[index]).filter(|point| names[&(point.frame, point.hip)] == 1) {
        let pixel = PixelPoint { x_px: point.x_px, y_px: point.y_px };
        frames[point.frame].push(Star { pixel, direction: Vector3::from(point.direction.xyz) });
    }
    frames
}

/// The rotation that takes the stars' directions best onto the measured ones (Wahba's problem by singular value decomposition).
pub(crate) fn wahba(pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)>) -> Option<UnitQuaternion<f64>> {
    let mut profile = Matrix3::zeros();
    for (measured, star) in pairs {
        profile += measured * star.transpose();
    }
    let svd = profile.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let proper = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = u * proper * v_t;
    rotation.iter().all(|c| c.is_finite()).then(|| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

/// What the adjustment comes to.
#[derive(Clone, Debug)]
pub(crate) struct Adjusted {
    pub(crate) camera: Camera,
    /// Of each frame with two or more stars in use.
    pub(crate) attitudes: Vec<Option<UnitQuaternion<f64>>>,
}

/// Adjusts the `free` parameters of the camera and an attitude for each frame to the stars that are `used`.
pub(crate) fn adjust(frames: &[Vec<Star>], used: &[Vec<bool>], start: &Camera, free: [bool; PARAMETER_COUNT]) -> Option<Adjusted> {
    let stars: Vec<Vec<Star>> = frames
        .iter()
        .zip(used)
        .map(|(stars, used)| stars.iter().zip(used).filter(|(_, used)| **used).map(|(star, _)| *star).collect())
        .collect();
    let mut camera = *start;
    let measured = |star: &Star| (Vector3::from(start.direction(star.pixel).xyz), star.direction);
    let mut attitudes: Vec<Option<UnitQuaternion<f64>>> =
        stars.iter().map(|stars| if stars.len() < 2 { None } else { wahba(stars.iter().map(measured)) }).collect();
    for _ in 0..ITERATIONS {
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        let mut followers = Vec::with_capacity(stars.len());
        for (stars, attitude) in stars.iter().zip(&attitudes) {
            let Some(attitude) = attitude else {
                followers.push(None);
                continue;
            };
            let mut own = FrameNormal::new();
            let (mut camera_right, mut rotation_right) = (Vector6::zeros(), Vector3::zeros());
            for star in stars {
                let (Some(columns), Some(residual)) = (Columns::at(&camera, star.pixel), residual_px(&camera, attitude, star)) else {
                    continue;
                };
                own.add(&columns);
                camera_right += columns.camera.transpose() * residual;
                rotation_right += columns.rotation.transpose() * residual;
            }
            let (gain, factor) = (own.gain()?, own.rotation.cholesky()?);
            normal += own.camera - own.cross * gain;
            right += camera_right - gain.transpose() * rotation_right;
            followers.push(Some((gain, factor.solve(&rotation_right))));
        }
        let step = inverse(&normal, free)? * right;
        let mut parameters = camera.parameters();
        for (value, step) in parameters.iter_mut().zip(step.iter()) {
            *value += step;
        }
        camera = camera.with_parameters(parameters);
        for (attitude, follower) in attitudes.iter_mut().zip(&followers) {
            if let (Some(attitude), Some((gain, own))) = (attitude.as_mut(), follower) {
                *attitude = UnitQuaternion::from_scaled_axis(own - gain * step) * *attitude;
            }
        }
        if !parameters.iter().all(|value| value.is_finite()) || camera.focal_length_px <= 0.0 {
            return None;
        }
        if step.dot(&right).abs().sqrt() < SMALL_STEP {
            break;
        }
    }
    Some(Adjusted { camera, attitudes })
}

/// Measured minus predicted position, px.
pub(crate) fn residual_px(camera: &Camera, attitude: &UnitQuaternion<f64>, star: &Star) -> Option<Vector2<f64>> {
    let direction = Direction::<Apparent>::from_unit(star.direction.into());
    let predicted = camera.pixel(&Attitude::new(*attitude).camera_from_apparent(&direction))?;
    let residual = Vector2::new(star.pixel.x_px - predicted.x_px, star.pixel.y_px - predicted.y_px);
    residual.iter().all(|value| value.is_finite()).then_some(residual)
}
