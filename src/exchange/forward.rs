//! Forward distortion models, as OpenCV, ROS, mrcal and tetra3rs have them: distortion is ADDED to the ideal point; ours is subtracted at the
//! measured one.
//!
//! ```text
//! a = X/Z, b = Y/Z, r² = a² + b²
//! g  = (1 + k1·r² + k2·r⁴ + k3·r⁶) / (1 + k4·r² + k5·r⁴ + k6·r⁶)
//! x″ = a·g + 2·p1·a·b + p2·(r² + 2a²) + s1·r² + s2·r⁴
//! y″ = b·g + p1·(r² + 2b²) + 2·p2·a·b + s3·r² + s4·r⁴
//! column = fx·x″ + cx, row = fy·y″ + cy        (0, 0) = the centre of the first pixel
//! ```
//! Wide-angle ("fisheye", "equidistant"): θ from the boresight, θd = θ·(1 + k1·θ² + k2·θ⁴ + k3·θ⁶ + k4·θ⁸), x″ = θd·cos φ, y″ = θd·sin φ.
//!
//! Source: OpenCV 4 documentation, camera calibration and 3D reconstruction, and fisheye camera model. The inverse of a polynomial is none,
//! so a conversion is a fit, and its residual is part of the result.

use nalgebra::{DMatrix, DVector};

use super::ExchangeError;
use super::fit::{self, FIT_SIDE, GOOD_PX, Linearised, Pair, Residual};
use crate::camera::Model;
use crate::dual::{Dual, Real};

/// f, ε = fx/fy − 1, cx, cy, and at most twelve coefficients.
const VALUES: usize = 16;
/// The index of the first coefficient.
const FIRST: usize = 4;

/// Which of the two families.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 on the plane.
    Plane,
    /// k1, k2, k3, k4 on the angle.
    Angle,
}

/// A camera of one of the two.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Forward {
    pub(super) kind: Kind,
    /// fx and fy, px.
    pub(super) focal_px: [f64; 2],
    /// cx and cy.
    pub(super) centre_px: [f64; 2],
    /// As many as the file has: 4, 5, 8 or 12 on the plane, 4 on the angle.
    pub(super) coefficients: Vec<f64>,
}

/// What a fit may use.
pub(super) struct Room {
    pub(super) kind: Kind,
    /// The numbers of coefficients that the format knows, rising.
    pub(super) counts: &'static [usize],
    /// Whether fx and fy may differ.
    pub(super) two_focal_lengths: bool,
}

fn project<T: Real>(kind: Kind, values: &[T; VALUES], [x, y, z]: [T; 3]) -> [T; 2] {
    let [f, epsilon, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = *values;
    let (u, v) = match kind {
        Kind::Plane => {
            let (a, b) = (x / z, y / z);
            let r2 = a * a + b * b;
            let r4 = r2 * r2;
            let g = (r2 * (k1 + r2 * (k2 + r2 * k3)) + 1.0) / (r2 * (k4 + r2 * (k5 + r2 * k6)) + 1.0);
            let u = a * g + p1 * a * b * 2.0 + p2 * (r2 + a * a * 2.0) + s1 * r2 + s2 * r4;
            (u, b * g + p1 * (r2 + b * b * 2.0) + p2 * a * b * 2.0 + s3 * r2 + s4 * r4)
        }
        Kind::Angle => {
            let square = x * x + y * y;
            if square.value() < 1e-24 {
                (x / z, y / z)
            } else {
                let across = square.sqrt();
                let theta = across.atan2(z);
                let t2 = theta * theta;
                // The angle's coefficients lie in the places k1, k2, p1, p2.
                let scale = theta * (t2 * (k1 + t2 * (k2 + t2 * (p1 + t2 * p2))) + 1.0) / across;
                (x * scale, y * scale)
            }
        }
    };
    [f * (epsilon + 1.0) * u + cx, f * v + cy]
}

impl Forward {
    fn values(&self) -> [f64; VALUES] {
        let [fx, fy] = self.focal_px;
        let mut values = [0.0; VALUES];
        values[..FIRST].copy_from_slice(&[fy, fx / fy - 1.0, self.centre_px[0], self.centre_px[1]]);
        values[FIRST..FIRST + self.coefficients.len()].copy_from_slice(&self.coefficients);
        values
    }

    fn from_values(kind: Kind, values: &[f64; VALUES], count: usize) -> Self {
        let [f, epsilon, cx, cy, ..] = *values;
        let fx = if epsilon == 0.0 { f } else { f * (1.0 + epsilon) };
        Self { kind, focal_px: [fx, f], centre_px: [cx, cy], coefficients: values[FIRST..FIRST + count].to_vec() }
    }

    /// Direction → pixel; `None` where there is none.
    pub(super) fn pixel(&self, direction: [f64; 3]) -> Option<[f64; 2]> {
        (self.kind == Kind::Angle || direction[2] > 0.0).then(|| project(self.kind, &self.values(), direction))
    }

    /// Pixel → direction (a unit vector) by Newton's method from the point without distortion; `None` beyond a fold.
    pub(super) fn direction(&self, pixel_px: [f64; 2]) -> Option<[f64; 3]> {
        const STEPS: usize = 60;
        let values = self.values().map(Dual::<2>::constant);
        let mut at: [f64; 2] = std::array::from_fn(|k| (pixel_px[k] - self.centre_px[k]) / self.focal_px[k]);
        let mut last = f64::INFINITY;
        for _ in 0..STEPS {
            let variables = [Dual::variable(at[0], 0), Dual::variable(at[1], 1)];
            let [u, v] = project(self.kind, &values, ray(self.kind, variables));
            let ([a, b], [c, d]) = (u.partials, v.partials);
            let determinant = a * d - b * c;
            if determinant.is_nan() || determinant <= 0.0 || a + d <= 0.0 {
                return None;
            }
            let error = [pixel_px[0] - u.value, pixel_px[1] - v.value];
            let size = error[0].hypot(error[1]);
            let length = pixel_px[0].hypot(pixel_px[1]).max(1.0);
            if size <= 4.0 * f64::EPSILON * length || (size < 1e-10 * length && size >= last) {
                let [x, y, z] = ray(self.kind, at);
                let norm = (x * x + y * y + z * z).sqrt();
                return Some([x / norm, y / norm, z / norm]);
            }
            last = size;
            at[0] += (d * error[0] - b * error[1]) / determinant;
            at[1] += (a * error[1] - c * error[0]) / determinant;
        }
        None
    }

    /// The correspondences of this camera over the frame.
    pub(super) fn pairs(&self, size_px: [usize; 2], what: &str) -> Result<Vec<Pair>, ExchangeError> {
        let pair = |pixel_px: [f64; 2]| {
            let folds = || ExchangeError::Folds { what: what.to_owned(), x_px: pixel_px[0], y_px: pixel_px[1] };
            Ok(Pair { pixel_px, direction: self.direction(pixel_px).ok_or_else(folds)? })
        };
        fit::frame_points(size_px, FIT_SIDE, 0.0).into_iter().map(pair).collect()
    }
}

/// The ray at these coordinates: on the plane z = 1, or at the angle hypot(a, b) from the boresight.
fn ray<T: Real>(kind: Kind, [a, b]: [T; 2]) -> [T; 3] {
    let one = T::constant(1.0);
    let theta2 = a * a + b * b;
    match kind {
        Kind::Angle if theta2.value() > 1e-24 => {
            let theta = theta2.sqrt();
            let sine = theta.sin() / theta;
            [a * sine, b * sine, theta.cos()]
        }
        _ => [a, b, one],
    }
}

/// The forward model nearest to a camera: with as few coefficients as bring the residual below [`GOOD_PX`]; focal length and principal
/// point stay those of the camera as long as they can.
pub(super) fn forward_of(model: &Model, room: &Room) -> Result<(Forward, Residual), ExchangeError> {
    let camera = model.camera();
    let size = [camera.width_px, camera.height_px];
    let pairs = fit::pairs(model, FIT_SIDE)?;
    if room.kind == Kind::Plane && pairs.iter().any(|pair| pair.direction[2] <= 1e-6) {
        return Err(ExchangeError::NoRoom {
            format: "a model on the plane",
            reason: "part of its frame looks 90° or more from the boresight; take a format with a wide-angle model (opencv, ros)"
                .to_owned(),
        });
    }
    let within = |pair: &&Pair| (0..2).all(|k| (-0.5..=size[k] as f64 - 0.5).contains(&pair.pixel_px[k]));
    let inside: Vec<Pair> = pairs.iter().filter(within).copied().collect();
    let f = camera.focal_length_px;
    let mut start = [0.0; VALUES];
    start[..FIRST].copy_from_slice(&[f, 0.0, camera.principal_point_px[0], camera.principal_point_px[1]]);
    if room.kind == Kind::Plane {
        start[FIRST..FIRST + 4].copy_from_slice(&[camera.k1 * f * f, 0.0, camera.p2 * f, camera.p1 * f]);
    }
    let has_focal_terms = !model.is_reference_behind_the_lens();
    let mut best: Option<(Forward, Residual)> = None;
    for &count in room.counts {
        // What is fitted beyond the frame too behaves there, but may cost a little inside.
        for (free_centre, pairs) in [(false, &pairs), (true, &pairs), (true, &inside)] {
            let mut free: Vec<usize> = (FIRST..FIRST + count).collect();
            if free_centre {
                free.extend([0, 2, 3]);
            }
            if has_focal_terms && room.two_focal_lengths {
                free.push(1);
            }
            let Ok(values) = fit_values(room.kind, pairs, start, &free) else { continue };
            let found = Forward::from_values(room.kind, &values, count);
            let residual = fit::residual(size, fit::directions(model), |xyz| found.pixel(xyz));
            if best.as_ref().is_none_or(|(_, known)| residual.max_px < known.max_px) {
                best = Some((found, residual));
            }
            if residual.max_px < GOOD_PX {
                return best.ok_or(ExchangeError::NoFit { what: "the forward model" });
            }
        }
    }
    best.ok_or(ExchangeError::NoFit { what: "the forward model" })
}

/// Numerator and denominator can grow together without end and put a pole just outside the frame: what the coefficients of the denominator and of
/// the thin prism move at the corner counts as a residual with this weight.
const BOUND: f64 = 1e-5;

fn fit_values(kind: Kind, pairs: &[Pair], start: [f64; VALUES], free: &[usize]) -> Result<[f64; VALUES], ExchangeError> {
    let whole = |own: &[f64]| {
        let mut values = start;
        for (index, value) in free.iter().zip(own) {
            values[*index] = *value;
        }
        values
    };
    let corner =
        pairs.iter().map(|pair| (pair.direction[0] / pair.direction[2]).hypot(pair.direction[1] / pair.direction[2])).fold(0.0, f64::max);
    let bound = |index: usize| {
        let power = match index {
            9 => 3,
            10 => 5,
            11 => 7,
            12 | 14 => 2,
            13 | 15 => 4,
            _ => return 0.0,
        };
        BOUND * (pairs.len() as f64).sqrt() * start[0] * corner.powi(power)
    };
    let found = fit::least_squares(free.iter().map(|index| start[*index]).collect(), "the forward model", |own| {
        let mut variables = whole(own).map(Dual::<VALUES>::constant);
        for &index in free {
            variables[index] = Dual::variable(variables[index].value, index);
        }
        let rows = 2 * pairs.len();
        let mut residuals = DVector::zeros(rows + free.len());
        let mut columns = DMatrix::zeros(rows + free.len(), free.len());
        for (column, &index) in free.iter().enumerate() {
            residuals[rows + column] = bound(index) * own[column];
            columns[(rows + column, column)] = bound(index);
        }
        for (k, pair) in pairs.iter().enumerate() {
            let there = project(kind, &variables, pair.direction.map(Dual::constant));
            for axis in 0..2 {
                residuals[2 * k + axis] = there[axis].value - pair.pixel_px[axis];
                for (column, &index) in free.iter().enumerate() {
                    columns[(2 * k + axis, column)] = there[axis].partials[index];
                }
            }
        }
        residuals.iter().all(|value: &f64| value.is_finite()).then_some(Linearised { residuals, columns })
    })?;
    Ok(whole(&found))
}
