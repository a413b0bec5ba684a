//! The pixel → direction map of a calibration and its uncertainty, and the difference of two maps once the best rotation is taken out.

use nalgebra::{DMatrix, Matrix3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::geometry::frame_grid;
use super::lit::lit_grid;
use super::{Calibration, bundle};
use crate::camera::{Camera, Model};
use crate::coordinates::{Direction, PixelPoint};

/// The name of the file format.
pub const FORMAT: &str = "boresight-map/1";

/// Points along each side of the grid on which maps are compared.
pub(super) const COMPARISON_GRID: usize = 33;

/// The pixel → direction map on a grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Map {
    /// [`FORMAT`].
    pub format: String,
    /// The points, row by row.
    pub points: Vec<MapPoint>,
}

/// A pixel and its direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct MapPoint {
    /// Column.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
    /// Unit vector in camera axes; its components have no value in files where the lens has no light for the pixel.
    #[schemars(with = "[Option<f64>; 3]")]
    pub direction: [f64; 3],
}

/// The map of a calibration on `side` × `side` pixels, evenly from the centre of the first pixel to the centre of the last
/// one; with `side` = 1 the middle of the frame.
#[must_use]
pub fn map(calibration: &Calibration, side: usize) -> Map {
    let (chain, camera) = (calibration.full_chain(), &calibration.camera);
    let context = chain.reference_context();
    let point = |stored: PixelPoint| {
        let pixel = PixelPoint { x_px: calibration.stored_column_px(stored.x_px), ..stored };
        let direction = chain.direction(pixel, &context).map_or([f64::NAN; 3], |direction| direction.xyz);
        MapPoint { x_px: stored.x_px, y_px: stored.y_px, direction }
    };
    Map { format: FORMAT.to_owned(), points: frame_grid(camera, side).into_iter().map(point).collect() }
}

/// Standard error (2-D, px) of the map of a calibration on `side` × `side` pixels of the images as stored, row by row as in [`map`], the
/// best rotation over the frame taken out; of methods that know the reference model alone, with that model. Pixels that the lens does not
/// light ([`Calibration::lit`]) or that see nothing are left out. Parameters that the calibration left out for want of support are in it
/// ([`Calibration::left_open`]).
///
/// `None` if the calibration has no covariance of its parameters, or its camera no usable map (the distortion folds over in the frame).
#[must_use]
pub fn map_sigma(calibration: &Calibration, side: usize) -> Option<Vec<(PixelPoint, f64)>> {
    let mut chain = calibration.full_chain();
    let solved: Vec<String> = calibration.parameters.iter().map(|solved| solved.name.clone()).collect();
    let (names, rows) = match &calibration.left_open {
        Some(open) => (&open.parameters, &open.covariance),
        None => (&solved, &calibration.covariance),
    };
    let free = bundle::indices(&mut chain, names)?;
    let n = free.len();
    let square = rows.len() == n && rows.iter().all(|row| row.len() == n);
    if side == 0 || !square {
        return None;
    }
    let covariance = DMatrix::from_fn(n, n, |k, l| rows[k][l]);
    let grid = lit_grid(chain.camera(), calibration.lit.as_ref(), side);
    let mut sigma = bundle::map_sigma_px(&chain, &chain.values(), &free, &covariance, &grid)?;
    as_stored(calibration, &mut sigma, |(pixel, _)| pixel.y_px, |(pixel, _)| pixel.x_px = calibration.stored_column_px(pixel.x_px));
    Some(sigma)
}

/// Takes a grid of the un-mirrored image to the images as stored: `turn` changes the columns of a point, and the rows (points of the same
/// `row`) begin on the left again.
pub(super) fn as_stored<T>(calibration: &Calibration, grid: &mut [T], row: impl Fn(&T) -> f64, turn: impl Fn(&mut T)) {
    if calibration.parity < 0 {
        grid.iter_mut().for_each(turn);
        grid.chunk_by_mut(|a, b| row(a).to_bits() == row(b).to_bits()).for_each(<[T]>::reverse);
    }
}

/// How far two maps differ over the frame after the best rotation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct MappingError {
    /// 2-D rms over the frame.
    pub rms_px: f64,
    /// Largest.
    pub max_px: f64,
}

/// The error of an estimated camera's map: for each pixel of a grid from edge to edge, where the true camera would have put
/// the direction that the estimated camera gives it, minus the pixel, after the best rotation between the two.
///
/// `None` if the two cameras have frames of different size, or the true camera has no image of a direction that the estimate gives.
#[must_use]
pub fn mapping_error_px(true_camera: &Camera, estimated_camera: &Camera) -> Option<MappingError> {
    if (true_camera.width_px, true_camera.height_px) != (estimated_camera.width_px, estimated_camera.height_px) {
        return None;
    }
    mapping_error_of_models_px(&Model::new(*true_camera), &Model::new(*estimated_camera))
}

/// The same for cameras with every effect that stands behind the lens: a star of the reference colour, telemetry at its mean.
#[must_use]
pub fn mapping_error_of_models_px(truth: &Model, estimate: &Model) -> Option<MappingError> {
    map_difference(truth, estimate, COMPARISON_GRID).map(|difference| MappingError::of(&difference))
}

/// For each pixel of a grid from edge to edge: where the first camera would have put the direction that the second gives it, minus the
/// pixel, after the best rotation. `None` if the frames differ, or the first camera has no image of a direction.
#[must_use]
pub fn map_difference(first: &Model, second: &Model, side: usize) -> Option<Vec<(PixelPoint, [f64; 2])>> {
    map_difference_over(first, second, &frame_grid(first.camera(), side))
}

/// The same over the pixels given.
pub(super) fn map_difference_over(first: &Model, second: &Model, grid: &[PixelPoint]) -> Option<Vec<(PixelPoint, [f64; 2])>> {
    const STEPS: usize = 20;
    const SMALL_STEP_RAD: f64 = 1e-13;
    let size = |model: &Model| (model.camera().width_px, model.camera().height_px);
    if size(first) != size(second) {
        return None;
    }
    let (context, other) = (first.reference_context(), second.reference_context());
    let values = first.values();
    let places: Vec<(PixelPoint, Vector3<f64>, Vector3<f64>)> = grid
        .iter()
        .map(|pixel| Some((*pixel, first.direction(*pixel, &context)?.xyz.into(), second.direction(*pixel, &other)?.xyz.into())))
        .collect::<Option<_>>()?;
    let mut profile = Matrix3::zeros();
    for (_, to, from) in &places {
        profile += to * from.transpose();
    }
    let mut rotation = bundle::optimal_rotation(&profile)?;
    // What is least in pixels is not quite what is least in angle.
    let mut difference = Vec::new();
    for _ in 0..STEPS {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        difference.clear();
        for (pixel, _, from) in &places {
            let turned = rotation * from;
            let image = first.pixel(&Direction::along([turned.x, turned.y, turned.z]), &context)?;
            let off = nalgebra::Vector2::new(image.x_px - pixel.x_px, image.y_px - pixel.y_px);
            let seen = first.seen(&values, &[], [image.x_px, image.y_px], &context)?;
            let by_pixel = nalgebra::SMatrix::<f64, 3, 2>::from_fn(|i, j| seen.by_pixel[i][j]);
            let inverse = (by_pixel.transpose() * by_pixel).try_inverse()? * by_pixel.transpose();
            let [x, y, z] = seen.direction;
            let columns = inverse * Matrix3::new(0.0, z, -y, -z, 0.0, x, y, -x, 0.0);
            normal += columns.transpose() * columns;
            right -= columns.transpose() * off;
            difference.push((*pixel, [off.x, off.y]));
        }
        let step = normal.cholesky()?.solve(&right);
        rotation = nalgebra::UnitQuaternion::from_scaled_axis(step) * rotation;
        if step.norm() < SMALL_STEP_RAD {
            break;
        }
    }
    Some(difference)
}

impl MappingError {
    pub(super) fn of(difference: &[(PixelPoint, [f64; 2])]) -> Self {
        let square = difference.iter().map(|(_, [x, y])| x * x + y * y);
        Self { rms_px: (square.clone().sum::<f64>() / difference.len().max(1) as f64).sqrt(), max_px: square.fold(0.0, f64::max).sqrt() }
    }
}
