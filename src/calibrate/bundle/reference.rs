//! Derivatives of the reference model at one pixel, in closed form.
//!
//! With the ideal point u(x, θ) of the focal plane the direction is d = w/|w|, w = (u, f). Its derivative J = ∂d/∂x sees what is tangent
//! to d, so with M = ∂u/∂x, for any change b of the direction,
//!
//! ```text
//! J⁺·b = |w|·M⁻¹·(b_xy − (b_z/f)·u),   J⁺·∂d/∂θ = M⁻¹·∂u/∂θ,   J⁺·∂d/∂f = −M⁻¹·u/f
//! ```
//! which is what dual numbers through the whole chain would give, for a tenth of the work; ∂u comes from the one body of code there is.

use crate::camera::PARAMETER_COUNT;
use crate::dual::{Dual, Real};
use crate::effects::optics::brown_conrady::ideal_from_measured;

/// Derivatives by k1, p1, p2, and by the pixel.
type PointJet = Dual<5>;

/// The reference model with its values.
pub(super) struct Reference {
    principal_px: [f64; 2],
    focal_length_px: f64,
    distortion: [PointJet; 3],
}

/// The model at one pixel.
pub(super) struct ReferencePoint {
    /// u.
    ideal_px: [f64; 2],
    focal_length_px: f64,
    /// |w|.
    length_px: f64,
    /// M⁻¹, row by row.
    inverse: [[f64; 2]; 2],
    /// J⁺·∂d/∂θ for all parameters, px per unit.
    pub(super) by_parameter: [[f64; 2]; PARAMETER_COUNT],
}

impl Reference {
    /// From the values of all parameters of a model, the reference model's first.
    pub(super) fn new(values: &[f64]) -> Self {
        let distortion = std::array::from_fn(|k| PointJet::variable(values[3 + k], k));
        Self { principal_px: [values[0], values[1]], focal_length_px: values[2], distortion }
    }

    /// The model at a pixel; `None` where the map is singular.
    pub(super) fn at(&self, pixel: [f64; 2]) -> Option<ReferencePoint> {
        let variable = |axis: usize| PointJet::variable(pixel[axis] - self.principal_px[axis], 3 + axis);
        let [u, v] = ideal_from_measured(self.distortion, [variable(0), variable(1)]);
        let ([ux, uy], [vx, vy]) = ([u.partials[3], u.partials[4]], [v.partials[3], v.partials[4]]);
        let determinant = ux * vy - uy * vx;
        if !determinant.is_normal() {
            return None;
        }
        let inverse = [[vy / determinant, -uy / determinant], [-vx / determinant, ux / determinant]];
        let solved = |change: [f64; 2]| inverse.map(|row| row[0] * change[0] + row[1] * change[1]);
        let (ideal_px, f) = ([u.value(), v.value()], self.focal_length_px);
        let by = |k: usize| solved([u.partials[k], v.partials[k]]);
        let by_parameter = [[-1.0, 0.0], [0.0, -1.0], solved(ideal_px.map(|u| -u / f)), by(0), by(1), by(2)];
        let length_px = (ideal_px[0] * ideal_px[0] + ideal_px[1] * ideal_px[1] + f * f).sqrt();
        Some(ReferencePoint { ideal_px, focal_length_px: f, length_px, inverse, by_parameter })
    }
}

impl ReferencePoint {
    /// d.
    pub(super) fn direction(&self) -> [f64; 3] {
        [self.ideal_px[0], self.ideal_px[1], self.focal_length_px].map(|component| component / self.length_px)
    }

    /// J⁺·b: the change of the pixel that goes with a change of the direction.
    pub(super) fn pixels(&self, change: [f64; 3]) -> [f64; 2] {
        let along = change[2] / self.focal_length_px;
        let tangent: [f64; 2] = std::array::from_fn(|axis| self.length_px * (change[axis] - along * self.ideal_px[axis]));
        self.inverse.map(|row| row[0] * tangent[0] + row[1] * tangent[1])
    }

    /// J⁺·(φ × a) for the unit rotations φ about the three axes.
    pub(super) fn by_rotation(&self, [x, y, z]: [f64; 3]) -> [[f64; 2]; 3] {
        [self.pixels([0.0, -z, y]), self.pixels([z, 0.0, -x]), self.pixels([-y, x, 0.0])]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Model};

    /// The closed form is the pseudo-inverse of the chain's own derivatives.
    #[test]
    fn it_is_the_chain() {
        let camera = Camera { k1: 6e-9, p1: 2e-7, p2: -1e-7, principal_point_px: [530.0, 370.0], ..Camera::pinhole(1024, 768, 1500.0) };
        let model = Model::new(camera);
        let values = model.values();
        let wanted: Vec<usize> = (0..PARAMETER_COUNT).collect();
        let reference = Reference::new(&values);
        for pixel in [[0.0, 0.0], [530.0, 370.0], [1000.0, 40.0], [300.5, 700.25]] {
            let seen = model.seen(&values, &wanted, pixel, &model.reference_context()).unwrap();
            let point = reference.at(pixel).unwrap();
            let j = nalgebra::SMatrix::<f64, 3, 2>::from_fn(|row, column| seen.by_pixel[row][column]);
            let inverse = (j.transpose() * j).try_inverse().unwrap() * j.transpose();
            let near = |found: [f64; 2], change: [f64; 3]| {
                let expected = inverse * nalgebra::Vector3::from(change);
                let off = (found[0] - expected.x).hypot(found[1] - expected.y);
                assert!(off < 1e-11 * expected.norm().max(1.0), "{pixel:?} {found:?} {expected}");
            };
            for (axis, component) in point.direction().into_iter().enumerate() {
                assert!((component - seen.direction[axis]).abs() < 1e-15);
            }
            for k in 0..PARAMETER_COUNT {
                near(point.by_parameter[k], seen.by_parameter[k]);
            }
            let a = nalgebra::Vector3::new(0.3, -0.2, 0.9);
            near(point.pixels(a.into()), a.into());
            for (axis, column) in point.by_rotation(a.into()).into_iter().enumerate() {
                near(column, nalgebra::Vector3::ith(axis, 1.0).cross(&a).into());
            }
        }
    }
}
