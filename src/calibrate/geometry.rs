//! Design columns of a star image: its derivatives with respect to camera and attitude, in one linearisation that every solver here uses.
//!
//! All columns are scaled to pixels of mapping over the frame ([`Scaling`]): a unit step in any parameter moves the mapping
//! by 1 px rms, so that k1 (about 1e-9 px⁻²) and f (about 1e3 px) can stand in one matrix.

use nalgebra::{Matrix3, SMatrix, SVector};

use crate::camera::{Camera, PARAMETER_COUNT, direction_from_pixel};
use crate::coordinates::PixelPoint;
use crate::dual::{Jet, Real};

/// A square matrix over the camera's parameters.
pub(super) type Matrix6 = SMatrix<f64, PARAMETER_COUNT, PARAMETER_COUNT>;
/// A vector over the camera's parameters.
pub(super) type Vector6 = SVector<f64, PARAMETER_COUNT>;
/// Columns of a star image with respect to the camera's scaled parameters.
pub(super) type CameraColumns = SMatrix<f64, 2, PARAMETER_COUNT>;
/// Columns of a star image with respect to a small rotation in camera axes, px/rad.
pub(super) type RotationColumns = SMatrix<f64, 2, 3>;

/// Points along each side of the grid that stands for the frame.
pub(super) const GRID: usize = 25;

/// A measured pixel as a direction, with its derivatives.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalDirection {
    /// Unit vector in camera axes.
    pub(super) direction: [f64; 3],
    /// d(direction)/d(scaled parameter), component by parameter; zero for parameters that are held.
    pub(super) by_parameter: [[f64; PARAMETER_COUNT]; 3],
    /// d(direction)/d(column, row), 1/px.
    pub(super) by_pixel: [[f64; 2]; 3],
}

/// Units in which the parameters are solved, and which of them are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scaling {
    /// Pixels of mapping (rms over the frame) that one unit of the parameter makes.
    pub(super) px_per_unit: [f64; PARAMETER_COUNT],
    /// Which parameters are solved; the others keep their ground values.
    pub(super) free: [bool; PARAMETER_COUNT],
}

impl Scaling {
    /// The scaling of a camera.
    pub(super) fn of(camera: &Camera, free: [bool; PARAMETER_COUNT]) -> Self {
        let unscaled = Self { px_per_unit: [1.0; PARAMETER_COUNT], free: [true; PARAMETER_COUNT] };
        let grid = frame_grid(camera, GRID);
        let mut square = [0.0; PARAMETER_COUNT];
        for point in &grid {
            let local = unscaled.local_direction(camera, *point);
            for (k, sum) in square.iter_mut().enumerate() {
                *sum += local.by_parameter.iter().map(|row| row[k] * row[k]).sum::<f64>();
            }
        }
        let px_per_unit = square.map(|sum| camera.focal_length_px * (sum / grid.len() as f64).sqrt());
        Self { px_per_unit, free }
    }

    /// The number of parameters that are solved.
    pub(super) fn free_count(&self) -> usize {
        self.free.iter().filter(|free| **free).count()
    }

    /// The camera after a step in scaled parameters.
    pub(super) fn moved(&self, camera: &Camera, step: &Vector6) -> Camera {
        let mut parameters = camera.parameters();
        for (k, value) in parameters.iter_mut().enumerate() {
            if self.free[k] {
                *value += step[k] / self.px_per_unit[k];
            }
        }
        camera.with_parameters(parameters)
    }

    /// Gives parameters that are held an equation of their own (step = 0), so that the matrix can be inverted.
    pub(super) fn pin_held(&self, normal: &mut Matrix6) {
        for (k, free) in self.free.iter().enumerate() {
            if !free {
                normal[(k, k)] = 1.0;
            }
        }
    }

    /// A covariance of scaled parameters in the parameters' own units; zero for parameters that are held.
    pub(super) fn covariance_in_units(&self, scaled: &Matrix6) -> [[f64; PARAMETER_COUNT]; PARAMETER_COUNT] {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                if self.free[i] && self.free[j] { scaled[(i, j)] / (self.px_per_unit[i] * self.px_per_unit[j]) } else { 0.0 }
            })
        })
    }

    /// The direction of a measured pixel and its derivatives, all from the camera's one body.
    pub(super) fn local_direction(&self, camera: &Camera, point: PixelPoint) -> LocalDirection {
        let parameters = camera.parameters();
        let variables = std::array::from_fn(|k| Jet::variable(parameters[k], k));
        let pixel = PixelPoint { x_px: Jet::variable(point.x_px, PARAMETER_COUNT), y_px: Jet::variable(point.y_px, PARAMETER_COUNT + 1) };
        let jets = direction_from_pixel(&variables, pixel).xyz;
        LocalDirection {
            direction: jets.map(Real::value),
            by_parameter: jets.map(|jet| std::array::from_fn(|k| if self.free[k] { jet.partials[k] / self.px_per_unit[k] } else { 0.0 })),
            by_pixel: jets.map(|jet| [jet.partials[PARAMETER_COUNT], jet.partials[PARAMETER_COUNT + 1]]),
        }
    }
}

impl LocalDirection {
    /// How the PREDICTED pixel of a star seen here moves with the camera's scaled parameters and with a small rotation φ of
    /// its direction (d → d + φ × d). From direction(X, pixel) = R·v:
    /// ∂d/∂pixel · δpixel = φ × d − ∂d/∂X · δX.
    ///
    /// `None` where the pixel → direction map is flat (the distortion folds over just here).
    pub(super) fn pixel_columns(&self) -> Option<(CameraColumns, RotationColumns)> {
        let by_pixel = SMatrix::<f64, 3, 2>::from_fn(|i, j| self.by_pixel[i][j]);
        let gram = by_pixel.transpose() * by_pixel;
        // Both columns are tangential, so the least-squares inverse is the exact one.
        let inverse = gram.try_inverse()? * by_pixel.transpose();
        let by_parameter = SMatrix::<f64, 3, PARAMETER_COUNT>::from_fn(|i, k| self.by_parameter[i][k]);
        let [x, y, z] = self.direction;
        let by_rotation = Matrix3::new(0.0, z, -y, -z, 0.0, x, y, -x, 0.0);
        let (camera, rotation) = (-(inverse * by_parameter), inverse * by_rotation);
        (camera.iter().all(|c| c.is_finite()) && rotation.iter().all(|c| c.is_finite())).then_some((camera, rotation))
    }
}

/// `side` × `side` pixels, evenly from edge to edge: centre of the first pixel to centre of the last one. Row by row.
pub(super) fn frame_grid(camera: &Camera, side: usize) -> Vec<PixelPoint> {
    let along = |index: usize, length: usize| {
        let last = length as f64 - 1.0;
        if side > 1 { last * index as f64 / (side as f64 - 1.0) } else { last / 2.0 }
    };
    (0..side)
        .flat_map(|row| {
            (0..side).map(move |column| PixelPoint { x_px: along(column, camera.width_px), y_px: along(row, camera.height_px) })
        })
        .collect()
}

/// Whether the distortion folds over inside the frame: some pixel of the grid is not the image of its own direction.
pub(super) fn folds_over(camera: &Camera) -> bool {
    const SAME_PX: f64 = 1e-6;
    !frame_grid(camera, GRID).into_iter().all(|point| {
        camera.pixel(&camera.direction(point)).is_some_and(|image| (image.x_px - point.x_px).hypot(image.y_px - point.y_px) < SAME_PX)
    })
}

/// The normal matrices of star images that share one attitude: camera × camera, camera × rotation, rotation × rotation.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameNormal {
    /// ΣCᵀC.
    pub(super) camera: Matrix6,
    /// ΣCᵀD.
    pub(super) cross: SMatrix<f64, PARAMETER_COUNT, 3>,
    /// ΣDᵀD.
    pub(super) rotation: Matrix3<f64>,
    /// How many star images are in it.
    pub(super) stars: usize,
}

impl FrameNormal {
    /// Of the given star images.
    pub(super) fn of<'a>(locals: impl IntoIterator<Item = &'a LocalDirection>) -> Self {
        let mut normal = Self { camera: Matrix6::zeros(), cross: SMatrix::zeros(), rotation: Matrix3::zeros(), stars: 0 };
        for (c, d) in locals.into_iter().filter_map(LocalDirection::pixel_columns) {
            normal.camera += c.transpose() * c;
            normal.cross += c.transpose() * d;
            normal.rotation += d.transpose() * d;
            normal.stars += 1;
        }
        normal
    }

    /// The camera's normal matrix with the attitude eliminated (Schur complement), and the matrix that takes a change of the
    /// camera to the rotation that follows it. `None` if the stars leave the attitude open.
    pub(super) fn without_attitude(&self) -> Option<(Matrix6, SMatrix<f64, 3, PARAMETER_COUNT>)> {
        let gain = self.rotation.cholesky()?.solve(&self.cross.transpose());
        Some((self.camera - self.cross * gain, gain))
    }
}

/// How the map over the frame answers to the scaled parameters once the best rotation is taken out: a column block for each
/// point of the grid. `None` if the camera has no usable map there.
pub(super) fn rotation_free_map(camera: &Camera, scaling: &Scaling) -> Option<Vec<CameraColumns>> {
    let locals: Vec<_> = frame_grid(camera, GRID).into_iter().map(|point| scaling.local_direction(camera, point)).collect();
    let (_, gain) = FrameNormal::of(&locals).without_attitude()?;
    locals.iter().map(|local| local.pixel_columns().map(|(c, d)| c - d * gain)).collect()
}

/// Standard errors across (per axis) and about the boresight, rad, of an attitude with this normal matrix and position error.
pub(super) fn attitude_sigma_rad(rotation_normal: &Matrix3<f64>, sigma_px: f64) -> Option<[f64; 2]> {
    let covariance = rotation_normal.try_inverse()?;
    let across = sigma_px * f64::midpoint(covariance[(0, 0)], covariance[(1, 1)]).max(0.0).sqrt();
    Some([across, sigma_px * covariance[(2, 2)].max(0.0).sqrt()])
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::coordinates::{CameraAxes, Direction};

    const CAMERA: Camera = Camera {
        width_px: 1024,
        height_px: 768,
        principal_point_px: [520.0, 390.0],
        focal_length_px: 1500.0,
        k1: 2e-8,
        p1: 3e-7,
        p2: -2e-7,
    };

    #[test]
    fn pixel_columns_agree_with_central_differences() {
        let scaling = Scaling::of(&CAMERA, [true; PARAMETER_COUNT]);
        for point in frame_grid(&CAMERA, 5) {
            let direction = CAMERA.direction(point);
            let (by_camera, by_rotation) = scaling.local_direction(&CAMERA, point).pixel_columns().unwrap();
            let compare = |high: PixelPoint, low: PixelPoint, width: f64, column: [f64; 2]| {
                let difference = [(high.x_px - low.x_px) / width, (high.y_px - low.y_px) / width];
                let error = (difference[0] - column[0]).hypot(difference[1] - column[1]);
                assert!(error < 1e-6 * (1.0 + column[0].hypot(column[1])), "{point:?}: {difference:?} {column:?}");
            };
            for k in 0..PARAMETER_COUNT {
                let image = |sign: f64| {
                    let mut step = Vector6::zeros();
                    step[k] = 0.01 * sign;
                    scaling.moved(&CAMERA, &step).pixel(&direction).unwrap()
                };
                compare(image(1.0), image(-1.0), 0.02, [by_camera[(0, k)], by_camera[(1, k)]]);
            }
            for axis in 0..3 {
                let image = |sign: f64| {
                    let mut angle = Vector3::zeros();
                    angle[axis] = 1e-6 * sign;
                    let turned = UnitQuaternion::from_scaled_axis(angle) * Vector3::from(direction.xyz);
                    CAMERA.pixel(&Direction::<CameraAxes>::along(turned.into())).unwrap()
                };
                compare(image(1.0), image(-1.0), 2e-6, [by_rotation[(0, axis)], by_rotation[(1, axis)]]);
            }
        }
    }

    #[test]
    fn a_scaled_unit_moves_the_map_by_one_pixel() {
        let camera = Camera::pinhole(1024, 1024, 2800.0);
        let scaling = Scaling::of(&camera, [true; PARAMETER_COUNT]);
        for k in 0..PARAMETER_COUNT {
            let mut step = Vector6::zeros();
            step[k] = 1e-3;
            let moved = scaling.moved(&camera, &step);
            let grid = frame_grid(&camera, GRID);
            let square: f64 =
                grid.iter().map(|point| (camera.direction(*point).angle_rad(&moved.direction(*point)) * 2800.0).powi(2)).sum();
            let rms = (square / grid.len() as f64).sqrt();
            assert!((rms / 1e-3 - 1.0).abs() < 1e-3, "{k}: {rms}");
        }
    }

    #[test]
    fn a_fold_is_seen() {
        let camera = Camera::pinhole(1024, 1024, 2800.0);
        assert!(!folds_over(&camera) && !folds_over(&CAMERA));
        // d(r − k1·r³)/dr = 0 at r = 1/√(3·k1) = 577 px, inside the corner.
        assert!(folds_over(&Camera { k1: 1e-6, ..camera }));
    }
}
