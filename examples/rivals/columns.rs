//! How the predicted pixel of a star answers to the camera and to a small rotation: dual numbers through the camera's own body.

use boresight::camera::{Camera, PARAMETER_COUNT, direction_from_pixel};
use boresight::coordinates::PixelPoint;
use boresight::dual::{Jet, Real};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

pub(crate) type Matrix6 = SMatrix<f64, PARAMETER_COUNT, PARAMETER_COUNT>;
pub(crate) type Vector6 = SVector<f64, PARAMETER_COUNT>;

/// A measured pixel at a camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Columns {
    /// Its direction, camera axes.
    pub(crate) direction: Vector3<f64>,
    /// d(direction)/d(parameter).
    pub(crate) by_parameter: SMatrix<f64, 3, PARAMETER_COUNT>,
    /// d(predicted pixel)/d(parameter), px per unit.
    pub(crate) camera: SMatrix<f64, 2, PARAMETER_COUNT>,
    /// d(predicted pixel)/d(rotation φ of the star's direction, d → d + φ × d), px/rad.
    pub(crate) rotation: SMatrix<f64, 2, 3>,
}

impl Columns {
    /// `None` where the map is flat.
    pub(crate) fn at(camera: &Camera, pixel: PixelPoint) -> Option<Self> {
        let parameters = camera.parameters();
        let variables = std::array::from_fn(|k| Jet::variable(parameters[k], k));
        let point = PixelPoint { x_px: Jet::variable(pixel.x_px, PARAMETER_COUNT), y_px: Jet::variable(pixel.y_px, PARAMETER_COUNT + 1) };
        let jets = direction_from_pixel(&variables, point).xyz;
        let direction = Vector3::from(jets.map(Real::value));
        let by_parameter = SMatrix::<f64, 3, PARAMETER_COUNT>::from_fn(|axis, k| jets[axis].partials[k]);
        let by_pixel = SMatrix::<f64, 3, 2>::from_fn(|axis, k| jets[axis].partials[PARAMETER_COUNT + k]);
        // All columns are tangential, so the least-squares inverse is the exact one.
        let inverse = (by_pixel.transpose() * by_pixel).try_inverse()? * by_pixel.transpose();
        let by_rotation = -direction.cross_matrix();
        Some(Self { direction, by_parameter, camera: -(inverse * by_parameter), rotation: inverse * by_rotation })
    }
}

/// Normal matrices of star images that share one attitude.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameNormal {
    /// ΣCᵀC.
    pub(crate) camera: Matrix6,
    /// ΣCᵀD.
    pub(crate) cross: SMatrix<f64, PARAMETER_COUNT, 3>,
    /// ΣDᵀD.
    pub(crate) rotation: Matrix3<f64>,
}

impl FrameNormal {
    pub(crate) fn new() -> Self {
        Self { camera: Matrix6::zeros(), cross: SMatrix::zeros(), rotation: Matrix3::zeros() }
    }

    pub(crate) fn add(&mut self, columns: &Columns) {
        self.camera += columns.camera.transpose() * columns.camera;
        self.cross += columns.camera.transpose() * columns.rotation;
        self.rotation += columns.rotation.transpose() * columns.rotation;
    }

    /// The rotation that follows a change of the camera, (ΣDᵀD)⁻¹ΣDᵀC; `None` if the stars leave the attitude open.
    pub(crate) fn gain(&self) -> Option<SMatrix<f64, 3, PARAMETER_COUNT>> {
        Some(self.rotation.cholesky()?.solve(&self.cross.transpose()))
    }
}

/// The inverse of a normal matrix, by way of a unit diagonal (k1 is about 1e-9, f about 1e3); parameters that are not `free` get zeros.
pub(crate) fn inverse(normal: &Matrix6, free: [bool; PARAMETER_COUNT]) -> Option<Matrix6> {
    let root: Vector6 = Vector6::from_fn(|k, _| if free[k] { normal[(k, k)].sqrt() } else { 1.0 });
    if root.iter().any(|value| !value.is_finite() || *value <= 0.0) {
        return None;
    }
    let equilibrated = Matrix6::from_fn(|k, l| match (free[k] && free[l], k == l) {
        (true, _) => normal[(k, l)] / (root[k] * root[l]),
        (false, true) => 1.0,
        (false, false) => 0.0,
    });
    let inverse = equilibrated.cholesky()?.inverse();
    Some(Matrix6::from_fn(|k, l| if free[k] && free[l] { inverse[(k, l)] / (root[k] * root[l]) } else { 0.0 }))
}
