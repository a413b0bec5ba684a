//! The pixel → direction map of a calibration, and the difference of two maps once the best rotation is taken out.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::geometry::frame_grid;
use super::{CalibrateError, Calibration, bundle};
use crate::camera::{Camera, Model};
use crate::coordinates::{Direction, PixelPoint};

/// Points along each side of the grid on which maps are compared.
const COMPARISON_GRID: usize = 33;

/// The pixel → direction map on a grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Map {
    /// `boresight-map/1`.
    pub format: String,
    /// The points, row by row.
    pub points: Vec<MapPoint>,
}

/// A pixel and its direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapPoint {
    /// Column.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
    /// Unit vector in camera axes.
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
    Map { format: "boresight-map/1".to_owned(), points: frame_grid(camera, side).into_iter().map(point).collect() }
}

/// How far two maps differ over the frame after the best rotation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
    const STEPS: usize = 20;
    const SMALL_STEP_RAD: f64 = 1e-13;
    let size = |model: &Model| (model.camera().width_px, model.camera().height_px);
    if size(first) != size(second) {
        return None;
    }
    let (context, other) = (first.reference_context(), second.reference_context());
    let values = first.values();
    let places: Vec<(PixelPoint, Vector3<f64>, Vector3<f64>)> = frame_grid(first.camera(), side)
        .into_iter()
        .map(|pixel| Some((pixel, first.direction(pixel, &context)?.xyz.into(), second.direction(pixel, &other)?.xyz.into())))
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
    fn of(difference: &[(PixelPoint, [f64; 2])]) -> Self {
        let square = difference.iter().map(|(_, [x, y])| x * x + y * y);
        Self { rms_px: (square.clone().sum::<f64>() / difference.len().max(1) as f64).sqrt(), max_px: square.fold(0.0, f64::max).sqrt() }
    }
}

/// The parameters that a calibration has solved.
struct Solved<'a> {
    names: Vec<String>,
    calibration: &'a Calibration,
    chain: Model,
}

impl<'a> Solved<'a> {
    fn of(calibration: &'a Calibration) -> Self {
        let names = calibration.parameters.iter().map(|parameter| parameter.name.clone()).collect();
        Self { names, calibration, chain: calibration.full_chain() }
    }

    /// Its value: solved, or held.
    fn value(&self, name: &str) -> f64 {
        let solved = self.calibration.parameters.iter().find(|parameter| parameter.name == name).map(|parameter| parameter.value);
        let held = || self.chain.parameters().iter().zip(self.chain.values()).find(|(p, _)| p.name == name).map(|(_, value)| value);
        solved.or_else(held).unwrap_or(0.0)
    }

    fn unit(&self, name: &str) -> Option<String> {
        self.calibration.parameters.iter().find(|parameter| parameter.name == name).map(|parameter| parameter.unit.clone())
    }

    fn covariance(&self, a: &str, b: &str) -> f64 {
        let place = |name: &str| self.names.iter().position(|known| known == name);
        place(a).zip(place(b)).map_or(0.0, |(k, l)| self.calibration.covariance[k][l])
    }
}

/// The difference of one parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterDifference {
    /// Its name.
    pub name: String,
    /// Second minus first.
    pub difference: f64,
    /// Standard error of the difference, the two being independent.
    pub sigma: f64,
    /// Unit of both.
    pub unit: String,
}

/// Two calibrations side by side.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// `boresight-compare/1`.
    pub format: String,
    /// 2-D rms difference of the maps over the frame, after the best rotation.
    pub rms_px: f64,
    /// Largest difference.
    pub max_px: f64,
    /// Probability of a difference this large between two calibrations of the same unchanged camera; absent where the
    /// covariances do not tell.
    pub p_value: Option<f64>,
    /// dᵀ(C_a + C_b)⁻¹d of the parameters' difference d. No rotation enters: attitudes are not among the parameters.
    pub chi_squared: Option<f64>,
    /// Its degrees of freedom.
    pub degrees_of_freedom: usize,
    /// The parameters' differences.
    pub parameters: Vec<ParameterDifference>,
    /// What to mind, one sentence each.
    pub warnings: Vec<String>,
}

/// Compares two calibrations of the same camera; the differences are `b` minus `a`.
///
/// The p-value treats the two as independent (different frames). χ²/dof is held against Fisher's F with the smaller of the two
/// calibrations' degrees of freedom, because their variances were estimated from their own residuals.
pub fn compare(a: &Calibration, b: &Calibration) -> Result<Comparison, CalibrateError> {
    let size = |calibration: &Calibration| [calibration.camera.width_px, calibration.camera.height_px];
    if a.parity != b.parity {
        return Err(CalibrateError::NotComparable);
    }
    if size(a) != size(b) {
        return Err(CalibrateError::DifferentFrames { first: size(a), second: size(b) });
    }
    let difference = map_difference(&a.full_chain(), &b.full_chain(), COMPARISON_GRID).ok_or(CalibrateError::NotComparable)?;
    let error = MappingError::of(&difference);
    let (from, to) = (Solved::of(a), Solved::of(b));
    let solved: Vec<&String> = from.names.iter().chain(to.names.iter().filter(|name| !from.names.contains(name))).collect();
    let sum = nalgebra::DMatrix::from_fn(solved.len(), solved.len(), |k, l| {
        from.covariance(solved[k], solved[l]) + to.covariance(solved[k], solved[l])
    });
    let parameters = solved
        .iter()
        .enumerate()
        .map(|(k, name)| ParameterDifference {
            name: (*name).clone(),
            difference: to.value(name) - from.value(name),
            sigma: sum[(k, k)].sqrt(),
            unit: from.unit(name).or_else(|| to.unit(name)).unwrap_or_default(),
        })
        .collect::<Vec<_>>();
    // In units of the standard errors: the parameters' own units span twelve decades.
    let correlation =
        nalgebra::DMatrix::from_fn(solved.len(), solved.len(), |k, l| sum[(k, l)] / (parameters[k].sigma * parameters[l].sigma));
    let pulls = nalgebra::DVector::from_iterator(solved.len(), parameters.iter().map(|p| p.difference / p.sigma));
    let chi_squared = correlation.cholesky().map(|factor| pulls.dot(&factor.solve(&pulls))).filter(|value| value.is_finite());
    let dof = solved.len();
    let residual_dof = a.degrees_of_freedom.min(b.degrees_of_freedom) as f64;
    let p_value = chi_squared.and_then(|value| {
        let fisher = FisherSnedecor::new(dof as f64, residual_dof).ok()?;
        Some(fisher.sf(value / dof as f64))
    });
    let mut warnings = Vec::new();
    for name in solved.iter().filter(|name| from.names.contains(name) != to.names.contains(name)) {
        warnings.push(format!("{name} was solved in one calibration only and held in the other; its value there counts as exact"));
    }
    if let (Some(chi_squared), true) = (chi_squared, shares_points(a, b)) {
        warnings.push(format!(
            "the two calibrations share star images, so they are not independent and χ² = {chi_squared:.1} is too small for a fair test"
        ));
    }
    Ok(Comparison {
        format: "boresight-compare/1".to_owned(),
        rms_px: error.rms_px,
        max_px: error.max_px,
        p_value,
        chi_squared,
        degrees_of_freedom: dof,
        parameters,
        warnings,
    })
}

/// Whether a star image with the very same measured position and direction stands in both.
fn shares_points(a: &Calibration, b: &Calibration) -> bool {
    let key = |point: &crate::identify::ControlPoint| (point.hip, point.x_px.to_bits(), point.y_px.to_bits());
    let known: std::collections::BTreeSet<_> = a.control_points.points.iter().map(key).collect();
    b.control_points.points.iter().any(|point| known.contains(&key(point)))
}

/// Standard errors across (per axis) and about the boresight, rad, of an attitude with this normal matrix and position error.
pub(super) fn attitude_sigma_rad(rotation_normal: &Matrix3<f64>, sigma_px: f64) -> Option<[f64; 2]> {
    let covariance = rotation_normal.try_inverse()?;
    let across = sigma_px * f64::midpoint(covariance[(0, 0)], covariance[(1, 1)]).max(0.0).sqrt();
    Some([across, sigma_px * covariance[(2, 2)].max(0.0).sqrt()])
}
