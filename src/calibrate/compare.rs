//! Comparison of two calibrations: are they of the same, unchanged camera, and if not, where in the field has it changed?

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::lit::lit_grid;
use super::map::{COMPARISON_GRID, as_stored, map_difference_over};
use super::{CalibrateError, Calibration, LitCircle, MappingError, map_sigma};
use crate::camera::{Camera, Model};
use crate::coordinates::PixelPoint;
use crate::effects::{Segment, displacement};

/// The name of the file format.
pub const FORMAT: &str = "boresight-compare/1";

/// Every so many points of the comparison's grid, the difference stands in files.
const COARSE_STEP: usize = 4;

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

    fn solves(&self, name: &str) -> bool {
        self.names.iter().any(|known| known == name)
    }

    /// Its value: solved, or held, or zero where the effect is not in force, which is what an absent effect of the camera means.
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

/// The difference of one parameter, in the columns of the images as stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
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

/// What has become of the map at one pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapChange {
    /// Column, in the images as stored.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
    /// By how many columns the image of a star here lies farther on in the second camera than in the first, after the best rotation.
    pub dx_px: f64,
    /// By how many rows.
    pub dy_px: f64,
    /// Standard error (2-D) of this difference, the two calibrations being independent; absent where a calibration tells none.
    pub sigma_px: Option<f64>,
}

impl MapChange {
    /// Length of the difference over its standard error; `None` without one.
    #[must_use]
    pub fn significance(&self) -> Option<f64> {
        self.sigma_px.filter(|sigma| *sigma > 0.0).map(|sigma| self.dx_px.hypot(self.dy_px) / sigma)
    }
}

/// Two calibrations side by side.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct Comparison {
    /// [`FORMAT`].
    pub format: String,
    /// 2-D rms difference of the maps over the frame (over what of it both lenses light), after the best rotation.
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
    /// What of the frame was compared, that of each calibration; empty where that is all of it.
    #[serde(default)]
    pub lit: Vec<LitCircle>,
    /// The difference of the maps on a coarse grid from edge to edge, row by row.
    #[serde(default)]
    pub difference_map: Vec<MapChange>,
    /// What to mind, one sentence each.
    pub warnings: Vec<String>,
}

/// How the map has changed from the first calibration to the second, on `side` × `side` pixels of the images as stored, row by row, after
/// the best rotation over them; pixels that one of the two lenses does not light are left out.
pub fn map_change(a: &Calibration, b: &Calibration, side: usize) -> Result<Vec<MapChange>, CalibrateError> {
    check_frames(a, b)?;
    let (first, second) = (a.full_chain(), b.full_chain());
    let mut grid = lit_grid(first.camera(), a.lit.as_ref(), side);
    grid.retain(|pixel| b.lit.is_none_or(|lit| lit.contains(*pixel)));
    let difference = map_difference_over(&first, &second, &grid).ok_or(CalibrateError::NotComparable)?;
    // `map_difference` says where the FIRST camera images what the second sees at a pixel: the star has moved the other way.
    let mut change: Vec<MapChange> = difference
        .into_iter()
        .map(|(pixel, [x, y])| MapChange { x_px: pixel.x_px, y_px: pixel.y_px, dx_px: -x, dy_px: -y, sigma_px: None })
        .collect();
    let stored = |point: &mut MapChange| {
        point.x_px = a.stored_column_px(point.x_px);
        point.dx_px = -point.dx_px;
    };
    as_stored(a, &mut change, |point| point.y_px, stored);
    if let (Some(first), Some(second)) = (map_sigma(a, side), map_sigma(b, side)) {
        // Each on what its own lens lights.
        let by_place = |sigma: Vec<(PixelPoint, f64)>| -> BTreeMap<[usize; 2], f64> {
            sigma.into_iter().map(|(pixel, sigma)| (place(&a.camera, side, pixel), sigma)).collect()
        };
        let (first, second) = (by_place(first), by_place(second));
        for point in &mut change {
            let place = place(&a.camera, side, PixelPoint { x_px: point.x_px, y_px: point.y_px });
            let both = first.get(&place).zip(second.get(&place)).map(|(first, second)| first.hypot(*second));
            point.sigma_px = both.filter(|sigma| sigma.is_finite());
        }
    }
    Ok(change)
}

/// Column and row of a pixel in the grid of `side` × `side` over the frame.
fn place(camera: &Camera, side: usize, pixel: PixelPoint) -> [usize; 2] {
    let along = |px: f64, length: usize| (px / (length as f64 - 1.0).max(1.0) * (side as f64 - 1.0)).round().max(0.0) as usize;
    [along(pixel.x_px, camera.width_px), along(pixel.y_px, camera.height_px)]
}

/// Refuses frames that have nothing to do with each other.
fn check_frames(a: &Calibration, b: &Calibration) -> Result<(), CalibrateError> {
    let size = |calibration: &Calibration| [calibration.camera.width_px, calibration.camera.height_px];
    if a.parity != b.parity {
        return Err(CalibrateError::NotComparable);
    }
    if size(a) != size(b) {
        return Err(CalibrateError::DifferentFrames { first: size(a), second: size(b) });
    }
    Ok(())
}

/// Whether a parameter is one of the sky and not of the camera.
fn is_of_sky(name: &str) -> bool {
    name.split_once('.').and_then(|(effect, _)| displacement(effect)).is_some_and(|effect| effect.segment() == Segment::Sky)
}

/// Compares two calibrations of the same camera; the differences are `b` minus `a`.
///
/// The p-value treats the two as independent (different frames). χ²/dof is held against Fisher's F, because the variances were estimated
/// from the calibrations' own residuals; its second number of degrees of freedom is that of Satterthwaite and Welch for a sum of two
/// estimated variances (Biometrics Bulletin 2, 110, 1946), each calibration with its share of the sum's covariance.
///
/// A parameter that only one of the two has solved has in the other the value at which it is held, as exact, or zero where its effect is not
/// in force. Parameters of the sky (a velocity, an epoch) are listed but do not enter: they say nothing of the camera. With two different
/// projections the parameters do not mean the same, and there is no p-value.
pub fn compare(a: &Calibration, b: &Calibration) -> Result<Comparison, CalibrateError> {
    let change = map_change(a, b, COMPARISON_GRID)?;
    let pairs: Vec<_> = change.iter().map(|p| (PixelPoint { x_px: p.x_px, y_px: p.y_px }, [p.dx_px, p.dy_px])).collect();
    let error = MappingError::of(&pairs);
    let (from, to) = (Solved::of(a), Solved::of(b));
    let both = |name: &str| from.solves(name) && to.solves(name);
    let union = from.names.iter().chain(to.names.iter().filter(|name| !from.solves(name)));
    let listed: Vec<&String> = union.filter(|name| both(name) || !is_of_sky(name)).collect();
    let mirror = |name: &str| if a.parity < 0 && matches!(name, "x0" | "p1") { -1.0 } else { 1.0 };
    let parameters: Vec<ParameterDifference> = listed
        .iter()
        .map(|name| ParameterDifference {
            name: (*name).clone(),
            difference: mirror(name) * (to.value(name) - from.value(name)),
            sigma: (from.covariance(name, name) + to.covariance(name, name)).max(0.0).sqrt(),
            unit: from.unit(name).or_else(|| to.unit(name)).unwrap_or_default(),
        })
        .collect();
    let mut warnings = Vec::new();
    let projections = [from.chain.projection(), to.chain.projection()];
    let same_projection = projections[0] == projections[1];
    if same_projection {
        let alone: Vec<&str> = listed.iter().filter(|name| !both(name)).map(|name| name.as_str()).collect();
        if !alone.is_empty() {
            warnings.push(format!(
                "solved in one calibration only: {}; the value held in the other counts as exact there, so a difference may be one of the \
                 models and not of the camera",
                alone.join(", ")
            ));
        }
    } else {
        warnings.push(format!(
            "the first calibration has the projection {}, the second {}: parameters of the same name do not mean the same, so there is no \
             p-value; the difference of the maps holds all the same",
            projections[0], projections[1]
        ));
    }
    for name in listed.iter().filter(|name| is_of_sky(name)) {
        warnings.push(format!("{name} is a parameter of the sky and does not enter the test of the camera"));
    }
    let tested: Vec<usize> = (0..listed.len()).filter(|k| !is_of_sky(listed[*k])).collect();
    let found = same_projection.then(|| tested_change(&from, &to, &tested.iter().map(|k| &parameters[*k]).collect::<Vec<_>>(), mirror));
    let (chi_squared, p_value) = found.flatten().map_or((None, None), |(chi_squared, p_value)| (Some(chi_squared), p_value));
    if let (Some(chi_squared), true) = (chi_squared, shares_points(a, b)) {
        warnings.push(format!(
            "the two calibrations share star images, so they are not independent and χ² = {chi_squared:.1} is too small for a fair test"
        ));
    }
    let is_coarse = |point: &&MapChange| {
        let place = place(&a.camera, COMPARISON_GRID, PixelPoint { x_px: point.x_px, y_px: point.y_px });
        place.iter().all(|index| index % COARSE_STEP == 0)
    };
    let difference_map = change.iter().filter(is_coarse).copied().collect();
    // Each as its frames are stored.
    let mut lit: Vec<LitCircle> = [a, b].into_iter().filter_map(|calibration| calibration.with_stored_columns().lit).collect();
    lit.dedup();
    warnings.extend(lit.iter().map(|lit| format!("compared over {} alone", lit.in_words())));
    Ok(Comparison {
        format: FORMAT.to_owned(),
        rms_px: error.rms_px,
        max_px: error.max_px,
        p_value,
        chi_squared,
        degrees_of_freedom: tested.len(),
        parameters,
        lit,
        difference_map,
        warnings,
    })
}

/// χ² of these differences and, where the degrees of freedom allow one, its p-value.
fn tested_change(
    from: &Solved,
    to: &Solved,
    parameters: &[&ParameterDifference],
    mirror: impl Fn(&str) -> f64,
) -> Option<(f64, Option<f64>)> {
    let n = parameters.len();
    if n == 0 {
        return None;
    }
    // In units of the standard errors: the parameters' own units span twelve decades.
    let share = |of: &Solved| {
        DMatrix::from_fn(n, n, |k, l| {
            let (a, b) = (parameters[k], parameters[l]);
            of.covariance(&a.name, &b.name) * mirror(&a.name) * mirror(&b.name) / (a.sigma * b.sigma)
        })
    };
    let (first, second) = (share(from), share(to));
    let factor = (&first + &second).cholesky()?;
    let pulls = DVector::from_iterator(n, parameters.iter().map(|p| p.difference / p.sigma));
    let chi_squared = Some(pulls.dot(&factor.solve(&pulls))).filter(|value| value.is_finite())?;
    let part = |covariance: &DMatrix<f64>| factor.solve(covariance).trace() / n as f64;
    let (dof_a, dof_b) = (from.calibration.degrees_of_freedom as f64, to.calibration.degrees_of_freedom as f64);
    let residual_dof = 1.0 / (part(&first).powi(2) / dof_a + part(&second).powi(2) / dof_b);
    let fisher = FisherSnedecor::new(n as f64, residual_dof).ok();
    Some((chi_squared, fisher.map(|fisher| fisher.sf(chi_squared / n as f64))))
}

/// Whether a star image with the very same measured position and direction stands in both.
fn shares_points(a: &Calibration, b: &Calibration) -> bool {
    let key = |point: &crate::identify::ControlPoint| (point.hip, point.x_px.to_bits(), point.y_px.to_bits());
    let known: std::collections::BTreeSet<_> = a.control_points.points.iter().map(key).collect();
    b.control_points.points.iter().any(|point| known.contains(&key(point)))
}
