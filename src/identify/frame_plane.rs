//! Tangent plane of a frame, to single precision: which of many stars are in the frame, and where. What is decided by it has a margin, and is asked
//! again with all digits.

use super::pose::{Points, Pose};
use super::sky::LANES;

/// Directions nearer to the plane through the camera than this, z, have no image.
const MIN_DEPTH: f32 = 0.05;
/// Steps of Newton's method for the distortion.
const STEPS: usize = 5;
/// Where the radius in the frame grows by less than this over that without distortion, the image folds.
const MIN_SLOPE: f32 = 0.05;
/// What the steps may leave, as a share of the radius.
const LEFT: f32 = 1e-3;

/// The plane of a pinhole camera's frame.
pub(super) struct FramePlane {
    /// From a direction to x·z, y·z, px, and to z.
    rows: [[f32; 3]; 3],
    /// κ over the square of the corner's radius, px⁻².
    bend: f32,
}

impl FramePlane {
    pub(super) fn new(pose: &Pose, points: &Points) -> Self {
        let scale = [pose.focal_px, pose.focal_px, 1.0];
        let row = |axis: usize| std::array::from_fn(|column| (scale[axis] * pose.rotation[(axis, column)]) as f32);
        Self { rows: [row(0), row(1), row(2)], bend: (pose.kappa / (points.corner_px * points.corner_px)) as f32 }
    }

    /// Where directions appear without distortion, relative to the middle of the un-mirrored frame, px; nowhere near it where they do not.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into loops over many stars")]
    pub(super) fn ideal(&self, [x, y, z]: &[[f32; LANES]; 3]) -> [[f32; LANES]; 2] {
        let (mut at_x, mut at_y, mut scales) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        let along = |row: [f32; 3], lane: usize| row[0] * x[lane] + row[1] * y[lane] + row[2] * z[lane];
        // One thing after another: so compilers do each on many numbers together.
        for (lane, scale) in scales.iter_mut().enumerate() {
            *scale = along(self.rows[2], lane);
        }
        for scale in &mut scales {
            let per_depth = 1.0 / *scale;
            *scale = if *scale > MIN_DEPTH { per_depth } else { f32::INFINITY };
        }
        for lane in 0..LANES {
            at_x[lane] = along(self.rows[0], lane) * scales[lane];
            at_y[lane] = along(self.rows[1], lane) * scales[lane];
        }
        [at_x, at_y]
    }

    /// Where they appear with it.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into loops over many stars")]
    pub(super) fn places(&self, directions: &[[f32; LANES]; 3]) -> [[f32; LANES]; 2] {
        let [mut at_x, mut at_y] = self.ideal(directions);
        if self.bend == 0.0 {
            return [at_x, at_y];
        }
        for (x, y) in at_x.iter_mut().zip(&mut at_y) {
            // The factor q of the radius: q − c·q³ = 1.
            let bent = self.bend * (*x * *x + *y * *y);
            let mut q = 1.0_f32;
            for _ in 0..STEPS {
                let slope = (1.0 - 3.0 * bent * q * q).max(MIN_SLOPE);
                q -= (q - bent * q * q * q - 1.0) / slope;
            }
            let folds = 1.0 - 3.0 * bent * q * q < MIN_SLOPE || (q - bent * q * q * q - 1.0).abs() > LEFT || q.is_nan() || q <= 0.0;
            let q = if folds { f32::INFINITY } else { q };
            (*x, *y) = (*x * q, *y * q);
        }
        [at_x, at_y]
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::*;
    use crate::identify::projection::Projection;

    #[test]
    fn places_are_those_of_the_pose_to_a_hundredth_of_a_pixel() {
        let points = Points {
            centred_px: Vec::new(),
            detection: Vec::new(),
            half_px: [512.0; 2],
            size_px: 1024.0,
            corner_px: 724.0,
            reach_px: 724.0,
        };
        let rotation = *Rotation3::new(Vector3::new(0.4, -0.3, 1.1)).matrix();
        for kappa in [0.0, 0.04, -0.05, -0.2] {
            let pose = Pose { rotation, focal_px: 3889.0, kappa, parity: 1.0, projection: Projection::Pinhole, principal_px: [0.0; 2] };
            let plane = FramePlane::new(&pose, &points);
            let (mut inside, mut behind) = (0, 0);
            for i in 0..2000 {
                let (a, b) = ((f64::from(i) * 0.618_034).fract() - 0.5, (f64::from(i) * 0.754_878).fract() - 0.5);
                let direction = rotation.transpose() * Vector3::new(0.3 * a, 0.3 * b, if i % 7 == 0 { -1.0 } else { 1.0 }).normalize();
                let [x, y, z] = [0, 1, 2].map(|axis| [direction[axis] as f32; LANES]);
                let [px, py] = plane.places(&[x, y, z]).map(|lanes| f64::from(lanes[LANES - 1]));
                if let Some([x, y]) = pose.project(&direction, points.corner_px) {
                    inside += 1;
                    assert!((px - x).hypot(py - y) < 0.01, "{kappa}: {px} {x} {py} {y}");
                } else {
                    behind += 1;
                    assert!(!px.is_finite() || !py.is_finite() || px.hypot(py) > 1000.0, "{kappa}: {px} {py}");
                }
            }
            assert!(inside > 1000 && behind > 200, "{inside} {behind}");
        }
    }
}
