//! The camera: from a direction in camera axes to a pixel and back, and the chain of displacements that leads there.
//!
//! The reference model has the six parameters of the published method: principal point x0, y0, focal length f and the
//! distortion k1, p1, p2, which is TAKEN AWAY from the measured point:
//!
//! ```text
//! x̄ = x − x0, ȳ = y − y0, r² = x̄² + ȳ²
//! Δx = k1·x̄·r² + p1·(3x̄² + ȳ²) + 2·p2·x̄·ȳ
//! Δy = k1·ȳ·r² + p2·(3ȳ² + x̄²) + 2·p1·x̄·ȳ
//! direction ∝ (x̄ − Δx, ȳ − Δy, f)
//! ```
//! Conversions to other conventions (OpenCV, FITS SIP, …) belong into files of their own beside this one.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::coordinates::{CameraAxes, Direction, PixelPoint};
use crate::dual::{Dual, Real};
use crate::effects::optics::{brown_conrady, pinhole};

mod chain;
mod model;
mod observer;
mod orbit;
mod sky_bodies;
mod term;

pub use chain::{Physics, PhysicsError, SkyChain};
pub use model::{Model, ModelError, ModelParameter, PixelRay};
pub use observer::{GroundSite, ObserverError};
pub use orbit::OrbitError;
pub use term::Term;
inner!(observer::observation);
inner!(orbit::{EARTH_RADIUS_KM, Orbit, OrbitState});
inner!(sky_bodies::circumstances);

/// The number of parameters of the reference model.
pub const PARAMETER_COUNT: usize = 6;
/// The names of the reference model's parameters, in the order in which they are stored and solved.
pub const PARAMETER_NAMES: [&str; PARAMETER_COUNT] = ["x0", "y0", "f", "k1", "p1", "p2"];
/// Their units.
pub const PARAMETER_UNITS: [&str; PARAMETER_COUNT] = ["px", "px", "px", "px^-2", "px^-1", "px^-1"];

/// A camera of the reference model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Camera {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Principal point (x0, y0).
    pub principal_point_px: [f64; 2],
    /// Focal length in pixels.
    pub focal_length_px: f64,
    /// Radial distortion, px⁻².
    pub k1: f64,
    /// Decentring distortion, px⁻¹.
    pub p1: f64,
    /// Decentring distortion, px⁻¹.
    pub p2: f64,
}

/// The measured pixel → direction in camera axes, for any kind of number. `parameters` in the order of [`PARAMETER_NAMES`].
pub fn direction_from_pixel<T: Real>(parameters: &[T; PARAMETER_COUNT], point: PixelPoint<T>) -> Direction<CameraAxes, T> {
    let zero = T::constant(0.0);
    Direction::along(pinhole::ray([zero, zero, parameters[2]], undistorted_px(parameters, point)))
}

/// The measured pixel → the ideal point relative to the principal point, px: the distortion is taken away.
pub fn undistorted_px<T: Real>(parameters: &[T; PARAMETER_COUNT], point: PixelPoint<T>) -> [T; 2] {
    let [x0, y0, _, k1, p1, p2] = *parameters;
    brown_conrady::ideal_from_measured([k1, p1, p2], [point.x_px - x0, point.y_px - y0])
}

/// Direction in camera axes → measured pixel, for any kind of number; `None` where the direction has no image (behind the
/// camera, or beyond the radius at which the distortion folds over).
///
/// The distortion is a function of the measured point, so it is inverted: Newton's method on plain numbers to the last bits
/// (relative 1e-12 and better), then one Newton step in `T`, which by the implicit function theorem carries the exact derivatives.
pub fn pixel_from_direction<T: Real>(parameters: &[T; PARAMETER_COUNT], direction: &Direction<CameraAxes, T>) -> Option<PixelPoint<T>> {
    let [x, y, z] = direction.xyz;
    if z.value() <= 0.0 {
        return None;
    }
    let f = parameters[2];
    let ideal = [x * f / z, y * f / z];
    let plain = parameters.map(Real::value);
    let target = ideal.map(Real::value);
    let (measured, inverse) = invert_distortion(&plain, target)?;
    let start = PixelPoint { x_px: T::constant(measured[0]) + parameters[0], y_px: T::constant(measured[1]) + parameters[1] };
    let reached = undistorted_px(parameters, start);
    let (ex, ey) = (ideal[0] - reached[0], ideal[1] - reached[1]);
    Some(PixelPoint {
        x_px: start.x_px + ex * inverse[0][0] + ey * inverse[0][1],
        y_px: start.y_px + ex * inverse[1][0] + ey * inverse[1][1],
    })
}

/// The measured point, relative to the principal point, whose undistorted point is `target`, and the inverse of the Jacobian
/// d(undistorted)/d(measured) there.
fn invert_distortion(parameters: &[f64; PARAMETER_COUNT], target: [f64; 2]) -> Option<([f64; 2], [[f64; 2]; 2])> {
    const ITERATIONS: usize = 50;
    let centred = [0.0, 0.0, parameters[2], parameters[3], parameters[4], parameters[5]];
    let lifted = centred.map(Dual::<2>::constant);
    // Starting from the target, Newton approaches the inner root from one side for either sign of k1.
    let mut point = target;
    let length = target[0].hypot(target[1]).max(1.0);
    let mut last = f64::INFINITY;
    for _ in 0..ITERATIONS {
        let [u, v] = undistorted_px(&lifted, PixelPoint { x_px: Dual::variable(point[0], 0), y_px: Dual::variable(point[1], 1) });
        let ([a, b], [c, d]) = (u.partials, v.partials);
        let determinant = a * d - b * c;
        if determinant.is_nan() || determinant <= 0.0 || a + d <= 0.0 {
            return None; // beyond the fold
        }
        let inverse = [[d / determinant, -b / determinant], [-c / determinant, a / determinant]];
        let error = [target[0] - u.value, target[1] - v.value];
        let size = error[0].hypot(error[1]);
        if size <= 4.0 * f64::EPSILON * length || (size < 1e-11 * length && size >= last) {
            return Some((point, inverse));
        }
        last = size;
        point[0] += inverse[0][0] * error[0] + inverse[0][1] * error[1];
        point[1] += inverse[1][0] * error[0] + inverse[1][1] * error[1];
    }
    None
}

impl Camera {
    /// A camera without distortion whose principal point is the middle of the frame.
    #[must_use]
    pub fn pinhole(width_px: usize, height_px: usize, focal_length_px: f64) -> Self {
        let mut camera = Self { width_px, height_px, principal_point_px: [0.0; 2], focal_length_px, k1: 0.0, p1: 0.0, p2: 0.0 };
        let middle = camera.middle();
        camera.principal_point_px = [middle.x_px, middle.y_px];
        camera
    }

    /// The middle of the frame.
    #[must_use]
    pub fn middle(&self) -> PixelPoint {
        PixelPoint { x_px: (self.width_px as f64 - 1.0) / 2.0, y_px: (self.height_px as f64 - 1.0) / 2.0 }
    }

    /// The parameters in the order of [`PARAMETER_NAMES`].
    #[must_use]
    pub fn parameters(&self) -> [f64; PARAMETER_COUNT] {
        let [x0, y0] = self.principal_point_px;
        [x0, y0, self.focal_length_px, self.k1, self.p1, self.p2]
    }

    /// The same frame with other parameters.
    #[must_use]
    pub fn with_parameters(&self, [x0, y0, f, k1, p1, p2]: [f64; PARAMETER_COUNT]) -> Self {
        Self { principal_point_px: [x0, y0], focal_length_px: f, k1, p1, p2, ..*self }
    }

    /// Measured pixel → direction in camera axes.
    #[must_use]
    pub fn direction(&self, point: PixelPoint) -> Direction<CameraAxes> {
        direction_from_pixel(&self.parameters(), point)
    }

    /// Direction in camera axes → measured pixel, or `None` where there is none (behind the camera, or beyond the radius at
    /// which the distortion folds over).
    ///
    /// ```
    /// use boresight::camera::Camera;
    /// use boresight::coordinates::PixelPoint;
    ///
    /// let camera = Camera {
    ///     width_px: 1024,
    ///     height_px: 768,
    ///     principal_point_px: [510.0, 380.0],
    ///     focal_length_px: 2000.0,
    ///     k1: 1e-9,
    ///     p1: 0.0,
    ///     p2: 0.0,
    /// };
    /// let seen = camera.direction(PixelPoint { x_px: 100.25, y_px: 700.5 });
    /// let back = camera.pixel(&seen).unwrap();
    /// assert!((back.x_px - 100.25).abs() < 1e-9 && (back.y_px - 700.5).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn pixel(&self, direction: &Direction<CameraAxes>) -> Option<PixelPoint> {
        pixel_from_direction(&self.parameters(), direction)
    }

    /// Whether a point lies on the frame: every pixel reaches half a pixel around its centre.
    #[must_use]
    pub fn contains(&self, point: PixelPoint) -> bool {
        (-0.5..self.width_px as f64 - 0.5).contains(&point.x_px) && (-0.5..self.height_px as f64 - 0.5).contains(&point.y_px)
    }
}
