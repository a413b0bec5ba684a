//! The pixel → direction map of a calibration, and the difference of two maps once the best rotation is taken out.

use nalgebra::{Matrix3, SMatrix};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::geometry::frame_grid;
use super::pairs::Star;
use super::star_level::fit_attitude;
use super::{CalibrateError, Calibration};
use crate::camera::{Camera, PARAMETER_COUNT, PARAMETER_NAMES, PARAMETER_UNITS};
use crate::coordinates::PixelPoint;

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
    let camera = &calibration.camera;
    let point = |stored: PixelPoint| {
        let pixel = PixelPoint { x_px: calibration.stored_column_px(stored.x_px), ..stored };
        MapPoint { x_px: stored.x_px, y_px: stored.y_px, direction: camera.direction(pixel).xyz }
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
    let stars: Vec<Star> = frame_grid(true_camera, COMPARISON_GRID)
        .into_iter()
        .enumerate()
        .map(|(point, pixel)| Star { point, pixel, direction: estimated_camera.direction(pixel).xyz })
        .collect();
    let residuals = fit_attitude(true_camera, &stars, &vec![true; stars.len()])?.residuals_px;
    let square: Vec<f64> = residuals.iter().map(|r| r.map(|[x, y]| x * x + y * y)).collect::<Option<_>>()?;
    Some(MappingError {
        rms_px: (square.iter().sum::<f64>() / square.len() as f64).sqrt(),
        max_px: square.iter().copied().fold(0.0, f64::max).sqrt(),
    })
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
    let error = mapping_error_px(&a.camera, &b.camera).ok_or(CalibrateError::NotComparable)?;
    let sum = SMatrix::<f64, PARAMETER_COUNT, PARAMETER_COUNT>::from_fn(|k, l| a.covariance[k][l] + b.covariance[k][l]);
    let (from, to) = (a.camera.parameters(), b.camera.parameters());
    let solved: Vec<usize> = (0..PARAMETER_COUNT).filter(|k| sum[(*k, *k)] > 0.0).collect();
    let parameters = solved
        .iter()
        .map(|&k| ParameterDifference {
            name: PARAMETER_NAMES[k].to_owned(),
            difference: to[k] - from[k],
            sigma: sum[(k, k)].sqrt(),
            unit: PARAMETER_UNITS[k].to_owned(),
        })
        .collect::<Vec<_>>();
    // In units of the standard errors: the parameters' own units span twelve decades.
    let correlation = nalgebra::DMatrix::from_fn(solved.len(), solved.len(), |k, l| {
        sum[(solved[k], solved[l])] / (parameters[k].sigma * parameters[l].sigma)
    });
    let pulls = nalgebra::DVector::from_iterator(solved.len(), parameters.iter().map(|p| p.difference / p.sigma));
    let chi_squared = correlation.cholesky().map(|factor| pulls.dot(&factor.solve(&pulls))).filter(|value| value.is_finite());
    let dof = solved.len();
    let residual_dof = a.degrees_of_freedom.min(b.degrees_of_freedom) as f64;
    let p_value = chi_squared.and_then(|value| {
        let fisher = FisherSnedecor::new(dof as f64, residual_dof).ok()?;
        Some(fisher.sf(value / dof as f64))
    });
    let mut warnings = Vec::new();
    for k in (0..PARAMETER_COUNT).filter(|k| (a.covariance[*k][*k] > 0.0) != (b.covariance[*k][*k] > 0.0)) {
        warnings.push(format!(
            "{} was solved in one calibration only and held in the other; its value there counts as exact",
            PARAMETER_NAMES[k]
        ));
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
