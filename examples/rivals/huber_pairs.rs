//! Least squares on the cosines between the stars of a frame, iteratively weighted after Huber (k = 1.345; scale from the median absolute
//! residual, found anew at each iteration).

use boresight::camera::{Camera, PARAMETER_COUNT, PARAMETER_NAMES};
use boresight::statistics::{median_in_place, robust::SIGMA_PER_MAD};

use super::adjust::Star;
use super::columns::{Columns, Matrix6, Vector6, inverse};

/// Huber's constant: 95 % efficient for normal errors.
const HUBER_K: f64 = 1.345;
const ITERATIONS: usize = 500;
/// The end of the iteration: movement of the corner of the frame, px.
const SMALL_STEP_PX: f64 = 1e-6;

/// The camera, and whether the iteration came to its end.
pub(crate) fn solve(frames: &[Vec<Star>], start: &Camera) -> Option<(Camera, bool)> {
    let mut camera = *start;
    for _ in 0..ITERATIONS {
        let rows = rows(frames, &camera);
        let mut sizes: Vec<f64> = rows.iter().map(|(_, residual)| residual.abs()).collect();
        let scale = SIGMA_PER_MAD * median_in_place(&mut sizes)?;
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for (row, residual) in &rows {
            let weight = if residual.abs() <= HUBER_K * scale { 1.0 } else { HUBER_K * scale / residual.abs() };
            normal += row * row.transpose() * weight;
            right += row * (residual * weight);
        }
        let step = inverse(&normal, [true; PARAMETER_COUNT])? * right;
        let moved = camera.with_parameters(std::array::from_fn(|k| camera.parameters()[k] + step[k]));
        if !moved.parameters().iter().all(|value| value.is_finite()) || moved.focal_length_px <= 0.0 {
            return None;
        }
        let step_px = largest_step_px(&camera, &step);
        camera = moved;
        if step_px < SMALL_STEP_PX {
            return Some((camera, true));
        }
    }
    Some((camera, false))
}

/// For each pair of stars of a frame: the derivative of the measured cosine, and star cosine minus measured cosine.
fn rows(frames: &[Vec<Star>], camera: &Camera) -> Vec<(Vector6, f64)> {
    let mut rows = Vec::new();
    for stars in frames {
        let seen: Vec<_> = stars.iter().filter_map(|star| Some((star, Columns::at(camera, star.pixel)?))).collect();
        for (index, (star, a)) in seen.iter().enumerate() {
            for (other, b) in &seen[index + 1..] {
                let row = a.by_parameter.transpose() * b.direction + b.by_parameter.transpose() * a.direction;
                rows.push((row, star.direction.dot(&other.direction) - a.direction.dot(&b.direction)));
            }
        }
    }
    rows
}

/// How far a step of each parameter alone moves the corner of the frame, the largest of them.
fn largest_step_px(camera: &Camera, step: &Vector6) -> f64 {
    let radius_px = (camera.width_px as f64).hypot(camera.height_px as f64) / 2.0;
    let reach = |name: &str| match name {
        "f" => radius_px / camera.focal_length_px,
        "k1" => radius_px.powi(3),
        "p1" | "p2" => 3.0 * radius_px.powi(2),
        _ => 1.0,
    };
    PARAMETER_NAMES.iter().zip(step.iter()).map(|(name, step)| step.abs() * reach(name)).fold(0.0, f64::max)
}
