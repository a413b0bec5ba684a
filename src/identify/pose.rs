//! Points of a frame, and the pose that is held of its camera: attitude, focal length, distortion.

use nalgebra::{Matrix3, Vector3};

use super::projection::Projection;

/// Detections ready to be matched: centred on the middle of the frame, brightest first.
#[derive(Clone, Debug)]
pub(super) struct Points {
    /// Position relative to the middle of the frame, px (not un-mirrored).
    pub(super) centred_px: Vec<[f64; 2]>,
    /// Index into the detections.
    pub(super) detection: Vec<usize>,
    /// Half the width and half the height, px.
    pub(super) half_px: [f64; 2],
    /// √(width·height), px: the size of the frame in which lengths are measured.
    pub(super) size_px: f64,
    /// Half the diagonal, px: the unit of radius for κ.
    pub(super) corner_px: f64,
    /// No point is further from the middle than this, px.
    pub(super) reach_px: f64,
}

impl Points {
    /// The area in which there can be points, px²: the frame, or the disc within reach.
    pub(super) fn area_px2(&self) -> f64 {
        let frame = 4.0 * self.half_px[0] * self.half_px[1];
        let disc = std::f64::consts::PI * self.reach_px * self.reach_px;
        if self.reach_px < self.corner_px { frame.min(disc) } else { frame }
    }

    /// Some of the points, in the order given.
    pub(super) fn only(&self, some: &[usize]) -> Self {
        Self {
            centred_px: some.iter().map(|&point| self.centred_px[point]).collect(),
            detection: some.iter().map(|&point| self.detection[point]).collect(),
            ..*self
        }
    }

    /// The first of the points.
    pub(super) fn first(mut self, count: usize) -> Self {
        self.centred_px.truncate(count);
        self.detection.truncate(count);
        self
    }
}

/// A hypothesis about how the camera is turned and what it is like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    /// camera_from_icrs.
    pub(super) rotation: Matrix3<f64>,
    /// Focal length, px.
    pub(super) focal_px: f64,
    /// Relative displacement at the corner: the point at radius r belongs at r·(1 − κ·(r/corner)²); κ = k1·corner².
    pub(super) kappa: f64,
    /// −1 if mirrored.
    pub(super) parity: f64,
    /// The law of the lens.
    pub(super) projection: Projection,
    /// The principal point, relative to the middle of the un-mirrored frame, px: that middle, but of fisheyes.
    pub(super) principal_px: [f64; 2],
}

impl Pose {
    /// Where a direction (ICRS axes) appears, relative to the middle of the un-mirrored frame, px.
    pub(super) fn project(&self, direction: &Vector3<f64>, corner_px: f64) -> Option<[f64; 2]> {
        let v = turned(&self.rotation, direction);
        if !self.projection.sees(v.z) {
            return None;
        }
        let scale = self.focal_px * self.projection.scale(v.z)[0];
        let ideal = [scale * v.x, scale * v.y];
        let target2 = (ideal[0] * ideal[0] + ideal[1] * ideal[1]) / (corner_px * corner_px);
        if target2 > 9.0 {
            return None;
        }
        let [x0, y0] = self.principal_px;
        if self.kappa == 0.0 {
            return Some([ideal[0] + x0, ideal[1] + y0]);
        }
        let stretch = stretch(self.kappa * target2)?;
        Some([ideal[0] * stretch + x0, ideal[1] * stretch + y0])
    }

    /// The angle from the boresight within which all that the points can be stands, with a margin; rad.
    pub(super) fn reach_rad(&self, points: &Points, margin: f64) -> f64 {
        let share = points.reach_px / points.corner_px;
        self.projection.angle_rad(points.reach_px * (1.0 - self.kappa.min(0.0) * share * share) * margin / self.focal_px)
    }
}

/// The factor q of a radius that distortion brings: r_ideal = r (1 − κ r²) with r = q·r_ideal, so q − c·q³ = 1 with c = κ·r_ideal², by Newton's method.
/// `None` beyond the fold.
fn stretch(c: f64) -> Option<f64> {
    // The series of q in c, where it is one: mostly a single step is left to do.
    let mut q = if c.abs() < 0.03 { 1.0 + c * (1.0 + c * (3.0 + 12.0 * c)) } else { 1.0 };
    for _ in 0..8 {
        let slope = 1.0 - 3.0 * c * q * q;
        if slope < 0.05 {
            return None;
        }
        let step = (1.0 - q * (1.0 - c * q * q)) / slope;
        q += step;
        // What a step leaves goes with its square: below the last digits but for a few.
        if step.abs() < 1e-8 {
            break;
        }
    }
    (q > 0.0 && q.is_finite()).then_some(q)
}

/// A vector turned by a rotation. Written out: the library's product of a matrix and a vector is a loop.
pub(super) fn turned(rotation: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let along = |row: usize| rotation[(row, 0)] * v.x + rotation[(row, 1)] * v.y + rotation[(row, 2)] * v.z;
    Vector3::new(along(0), along(1), along(2))
}

/// A matched pair: index into the points, index into the catalogue.
pub(super) type Pair = (usize, u32);

#[cfg(test)]
mod tests {
    use super::*;

    /// The factor solves its equation, up to the fold at κ·r² = 1/3, and there is none beyond.
    #[test]
    fn a_stretch_undoes_the_distortion() {
        for k in -3000..=148 {
            let c = f64::from(k) / 1000.0;
            // At the fold q = 1/√(3c), and 2/3 of it is left: c = 4/27 = 0.148.
            let Some(q) = stretch(c) else {
                assert!(c > 0.14, "c = {c} has a solution");
                continue;
            };
            assert!((q - c * q.powi(3) - 1.0).abs() < 1e-14 * q.max(1.0), "c = {c}: q = {q}");
        }
        assert_eq!(stretch(0.2), None);
    }
}
