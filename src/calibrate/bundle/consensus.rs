//! Consensus start of the bundle adjustment: a focal length and attitudes that more star images agree on than chance allows, even if half of the
//! identifications are wrong and the ground values of the camera are off.
//!
//! 1. **Focal length.** For two images the angle between their stars fixes the focal length (a quadratic equation in f²). Wrong pairs
//!    scatter over all values, right ones agree to the distortion's size; the fullest place of the histogram of ln f is taken.
//! 2. **Attitudes.** For each frame pairs of images are taken, those whose angle fits first; each gives an attitude, on which all images
//!    of the frame vote. The best is fitted to the images that agree with it.
//!
//! Everything is tried in a fixed order, so the same points give the same start.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::problem::{Exposure, Problem, State, earth_from_icrs};
use crate::camera::Model;
use crate::coordinates::PixelPoint;
use crate::parallel;
use crate::statistics::order::sort_by_key;

/// Images agree with an attitude within this share of the frame's diagonal, before the distortion is known.
pub(super) const TOLERANCE: f64 = 0.006;
/// Pairs looked at in each frame for the focal length.
const SCALE_PAIRS: usize = 120;
/// Width of a histogram cell in ln f.
const CELL: f64 = 0.002;
/// Cells on either side that are counted together: seven (1.4 %) are the width that distortion gives to the right ones.
const HALF: usize = 3;
/// How far from the ground value the focal length is searched, in ln f.
const SEARCH: f64 = 0.6;
/// Attitudes that are voted on in each frame.
const MAX_VOTES: usize = 150;

/// Directions of a frame's images through a model's optics, the places where it has none left out.
pub(super) struct Rays {
    /// Index of the image and its direction in camera axes.
    rays: Vec<(usize, Vector3<f64>)>,
}

/// The images' directions.
pub(super) fn rays(model: &Model, exposure: &Exposure) -> Rays {
    let reference = model.is_reference_behind_the_lens();
    let ray = |(index, image): (usize, &super::problem::Image)| {
        let pixel = PixelPoint { x_px: image.pixel[0], y_px: image.pixel[1] };
        let direction =
            if reference { Some(model.camera().direction(pixel)) } else { model.direction(pixel, &image.context(&exposure.observation)) };
        direction.map(|direction| (index, Vector3::from(direction.xyz)))
    };
    Rays { rays: exposure.images.iter().enumerate().filter_map(ray).collect() }
}

/// Focal lengths that the pairs of images agree on, the most agreed on first, as factors of the model's.
pub(super) fn focal_length_factors(problem: &Problem, model: &Model) -> Vec<f64> {
    let cells = (2.0 * SEARCH / CELL) as usize;
    let camera = model.camera();
    let shortest = 0.12 * camera.width_px.min(camera.height_px) as f64;
    let f = camera.focal_length_px;
    let of_frame = |exposure: &Exposure| -> Vec<u32> {
        let mut counts = vec![0_u32; cells];
        let rays = rays(model, exposure).rays;
        let n = rays.len();
        let mut left = SCALE_PAIRS;
        // Every image meets others at growing distance in the list.
        'all: for step in 1..n {
            for i in 0..n - step {
                if left == 0 {
                    break 'all;
                }
                let ((a, first), (b, second)) = (rays[i], rays[i + step]);
                let plane = |v: Vector3<f64>| [v.x / v.z * f, v.y / v.z * f];
                let (p, q) = (plane(first), plane(second));
                if (p[0] - q[0]).hypot(p[1] - q[1]) < shortest || first.z <= 0.0 || second.z <= 0.0 {
                    continue;
                }
                left -= 1;
                let cosine = Vector3::from(exposure.images[a].apparent).dot(&Vector3::from(exposure.images[b].apparent));
                for found in focal_lengths(p, q, cosine).into_iter().flatten() {
                    let cell = ((found / f).ln() + SEARCH) / CELL;
                    if cell >= 0.0 && cell < cells as f64 {
                        counts[cell as usize] += 1;
                    }
                }
            }
        }
        counts
    };
    let counts = problem.exposures.par_iter().map(of_frame).reduce(
        || vec![0; cells],
        |mut sum, one| {
            sum.iter_mut().zip(one).for_each(|(a, b)| *a += b);
            sum
        },
    );
    let smooth: Vec<u32> =
        (0..cells).map(|cell| (cell.saturating_sub(HALF)..(cell + HALF + 1).min(cells)).map(|k| counts[k]).sum()).collect();
    let mut order: Vec<usize> = (0..cells).collect();
    sort_by_key(&mut order, |cell| (std::cmp::Reverse(smooth[*cell]), *cell));
    let mut factors: Vec<f64> = Vec::new();
    for cell in order {
        if smooth[cell] == 0 || factors.len() == 3 {
            break;
        }
        // The mean within the window, so that the cells' width does not matter.
        let window = cell.saturating_sub(HALF)..(cell + HALF + 1).min(cells);
        let sum: f64 = window.clone().map(|k| f64::from(counts[k]) * ((k as f64 + 0.5) * CELL - SEARCH)).sum();
        let factor = (sum / f64::from(smooth[cell])).exp();
        if factors.iter().all(|other| (factor / other).ln().abs() > 4.0 * CELL * HALF as f64) {
            factors.push(factor);
        }
    }
    factors
}

/// The focal lengths at which two points of the ideal focal plane lie this far apart on the sky:
/// (a + f²)² = c²·(b₁ + f²)·(b₂ + f²) with a = p·q and b = p², q².
fn focal_lengths(p: [f64; 2], q: [f64; 2], cosine: f64) -> [Option<f64>; 2] {
    let a = p[0] * q[0] + p[1] * q[1];
    let (b1, b2) = (p[0] * p[0] + p[1] * p[1], q[0] * q[0] + q[1] * q[1]);
    let c2 = cosine * cosine;
    let (square, linear, constant) = (1.0 - c2, 2.0 * a - c2 * (b1 + b2), a * a - c2 * b1 * b2);
    let discriminant = linear * linear - 4.0 * square * constant;
    if discriminant < 0.0 || square <= 0.0 {
        return [None, None];
    }
    let root = discriminant.sqrt();
    [1.0, -1.0].map(|sign| {
        let s = (-linear + sign * root) / (2.0 * square);
        // The equation was squared: the cosine must have the right sign.
        (s > 0.0 && (a + s) * cosine > 0.0).then(|| s.sqrt())
    })
}

/// The attitude on which most images of a frame agree within `tolerance_rad`, and how many these are. `None` with fewer than three.
pub(super) fn attitude(exposure: &Exposure, rays: &Rays, tolerance_rad: f64) -> Option<(UnitQuaternion<f64>, usize)> {
    let rays = &rays.rays;
    let n = rays.len();
    let apparent: Vec<Vector3<f64>> = rays.iter().map(|(index, _)| Vector3::from(exposure.images[*index].apparent)).collect();
    let limit = tolerance_rad * tolerance_rad;
    let mut best: Option<(f64, UnitQuaternion<f64>)> = None;
    let mut votes = 0;
    'all: for step in 1..n {
        for i in 0..n {
            let j = (i + step) % n;
            if step * 2 > n || (step * 2 == n && i >= step) {
                break 'all;
            }
            let (seen, catalogued) = ((rays[i].1, rays[j].1), (apparent[i], apparent[j]));
            let (measured, expected) = ((seen.0 - seen.1).norm_squared(), (catalogued.0 - catalogued.1).norm_squared());
            // Chords instead of angles: cheaper, and as good for small differences.
            if measured < 25.0 * limit || (measured.sqrt() - expected.sqrt()).abs() > 2.0 * tolerance_rad {
                continue;
            }
            let Some(rotation) = from_two(seen, catalogued) else { continue };
            votes += 1;
            let score: f64 =
                rays.iter().zip(&apparent).map(|((_, ray), star)| (1.0 - (rotation * star - ray).norm_squared() / limit).max(0.0)).sum();
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, rotation));
            }
            if votes >= MAX_VOTES || best.as_ref().is_some_and(|(most, _)| *most > 0.7 * n as f64) {
                break 'all;
            }
        }
    }
    let (_, mut rotation) = best?;
    let mut agreeing = 0;
    for _ in 0..3 {
        let mut profile = Matrix3::zeros();
        agreeing = 0;
        for ((_, ray), star) in rays.iter().zip(&apparent) {
            if (rotation * star - ray).norm_squared() < limit {
                profile += ray * star.transpose();
                agreeing += 1;
            }
        }
        if agreeing < 3 {
            return None;
        }
        rotation = optimal_rotation(&profile)?;
    }
    Some((rotation, agreeing))
}

/// The rotation that takes two stars' directions to those seen (TRIAD, the middle of the two exact).
fn from_two(seen: (Vector3<f64>, Vector3<f64>), stars: (Vector3<f64>, Vector3<f64>)) -> Option<UnitQuaternion<f64>> {
    let axes = |(a, b): (Vector3<f64>, Vector3<f64>)| {
        let middle = (a + b).try_normalize(1e-9)?;
        let normal = a.cross(&b).try_normalize(1e-9)?;
        Some(Matrix3::from_columns(&[middle, normal, middle.cross(&normal)]))
    };
    let rotation = axes(seen)? * axes(stars)?.transpose();
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

/// The optimal rotation (Wahba's problem by singular value decomposition, Markley 1988).
pub(crate) fn optimal_rotation(profile: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = profile.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let proper = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = u * proper * v_t;
    rotation.iter().all(|c| c.is_finite()).then(|| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

/// For each frame the attitude that most of its images agree on, and how many images agree in all.
pub(super) fn attitudes(problem: &Problem, tolerance_rad: f64) -> (Vec<Option<UnitQuaternion<f64>>>, usize) {
    let found: Vec<_> = parallel::map(&problem.exposures, |exposure| attitude(exposure, &rays(&problem.model, exposure), tolerance_rad));
    let agreeing = found.iter().flatten().map(|(_, agreeing)| agreeing).sum();
    (found.into_iter().map(|found| found.map(|(attitude, _)| attitude)).collect(), agreeing)
}

/// One attitude to the ground from those of the frames: that on which most agree. Whether most do.
pub(super) fn fix_mount(problem: &Problem, state: &mut State, tolerance_rad: f64) -> bool {
    let earth: Vec<_> = problem.exposures.iter().map(|exposure| earth_from_icrs(&exposure.observation)).collect();
    let mounts: Vec<UnitQuaternion<f64>> =
        state.attitudes.iter().zip(&earth).filter_map(|(attitude, earth)| Some((*attitude)? * (*earth)?.inverse())).collect();
    let near = |a: &UnitQuaternion<f64>| mounts.iter().filter(|b| a.angle_to(b) < tolerance_rad).count();
    let Some(best) = mounts.iter().max_by_key(|mount| near(mount)) else { return false };
    if 2 * near(best) < mounts.len() {
        return false;
    }
    let mut profile = Matrix3::zeros();
    for mount in mounts.iter().filter(|mount| mount.angle_to(best) < tolerance_rad) {
        profile += mount.to_rotation_matrix().matrix();
    }
    let Some(mount) = optimal_rotation(&profile) else { return false };
    state.mount = mount;
    for (attitude, earth) in state.attitudes.iter_mut().zip(earth) {
        *attitude = earth.map(|earth| mount * earth);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_angle_fixes_the_focal_length() {
        let (p, q, f) = ([300.0, -120.0], [-50.0, 400.0], 1234.5_f64);
        let cosine =
            (p[0] * q[0] + p[1] * q[1] + f * f) / ((p[0] * p[0] + p[1] * p[1] + f * f) * (q[0] * q[0] + q[1] * q[1] + f * f)).sqrt();
        let found = focal_lengths(p, q, cosine);
        assert!(found.iter().flatten().any(|length| (length - f).abs() < 1e-6), "{found:?}");
    }
}
