//! The result of a calibration as far as all methods make it alike: what points, frames and parameters stand for, and what there is to mind.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::calibration::{AttitudeSigma, Calibration, FORMAT, FrameResult, LeftOutCount, MapSigma, ParameterEstimate, PointResult, Status};
use super::geometry::{attitude_sigma_rad, folds_over};
use super::options::{CalibrateOptions, Method};
use super::select::{CENTROID_FLOOR_PX, Selection};
use crate::coordinates::Attitude;
use crate::identify::{ControlPoint, ControlPoints};
use crate::statistics::median_in_place;
use crate::units::ARCSEC_RAD;

/// A star image with at most this weight is rejected.
pub(super) const REJECTED_WEIGHT: f64 = 0.5;
/// With fewer frames a calibration says so.
const ENOUGH_FRAMES: usize = 10;
/// Parameters with a correlation above this cannot be told apart well.
const STRONG_CORRELATION: f64 = 0.95;
/// A principal point less certain than this is said to be so, px.
const UNCERTAIN_CENTRE_PX: f64 = 3.0;

/// Residuals this many times larger than predicted are said to be so.
const TOO_LARGE_RESIDUALS: f64 = 3.0;

/// What a method found of the parameters, points and frames, in the form of a result; the rest is for the method to fill in.
pub(super) fn result(
    control_points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
    parameters: Vec<ParameterEstimate>,
    points: Vec<PointResult>,
    per_frame: Vec<FrameResult>,
) -> Calibration {
    Calibration {
        format: FORMAT.to_owned(),
        method: options.method,
        status: Status::NotConverged,
        physics: options.physics.clone(),
        model: parameters.iter().map(|parameter| parameter.name.clone()).collect(),
        parameters,
        camera: control_points.nominal,
        parity: 1,
        rms_px: None,
        rms_arcsec: None,
        held_out_rms_px: None,
        stars: 0,
        stars_offered: control_points.points.len(),
        distinct_stars: 0,
        frames: 0,
        pairs: 0,
        interstar_angle_rms_arcsec: None,
        attitude_sigma_arcsec: None,
        rejected: points.iter().filter(|point| point.left_out.is_none() && point.weight <= REJECTED_WEIGHT).copied().collect(),
        left_out: left_out(selection),
        warnings: Vec::new(),
        map_sigma_px: None,
        lit: None,
        systematics: Vec::new(),
        unit_weight_sigma_px: 0.0,
        predicted_sigma_px: 0.0,
        degrees_of_freedom: 0,
        covariance: Vec::new(),
        chain: None,
        left_open: None,
        combinations: Vec::new(),
        gauge: String::new(),
        noise: None,
        selection: None,
        reidentified: None,
        seconds: 0.0,
        iterations: Vec::new(),
        per_frame,
        points,
        options: options.clone(),
        control_points: control_points.clone(),
        provenance: None,
    }
}

/// The median of what a star's pairs say; 1 for a star without pairs.
pub(super) fn median_or_one(mut values: Vec<f64>) -> f64 {
    median_in_place(&mut values).unwrap_or(1.0)
}

/// The standard error of the map from those of its places.
pub(super) fn map_sigma(mut sigma_px: Vec<f64>) -> MapSigma {
    sigma_px.sort_by(f64::total_cmp);
    MapSigma { median: sigma_px[sigma_px.len() / 2], max: sigma_px[sigma_px.len() - 1] }
}

/// What became of every control point. `used`: of those that entered the index, weight and residual.
pub(super) fn point_results(
    control_points: &ControlPoints,
    selection: &Selection,
    used: impl Iterator<Item = (usize, f64, Option<[f64; 2]>)>,
) -> Vec<PointResult> {
    let blank = |point: &ControlPoint| PointResult {
        frame: point.frame,
        hip: point.hip,
        x_px: point.x_px,
        y_px: point.y_px,
        weight: 0.0,
        residual_px: None,
        left_out: None,
    };
    let mut results: Vec<PointResult> = control_points.points.iter().map(blank).collect();
    for &(index, reason) in &selection.left_out {
        results[index].left_out = Some(reason);
    }
    for (index, weight, residual_px) in used {
        results[index].weight = weight;
        results[index].residual_px = residual_px;
    }
    results
}

/// What became of a frame with these residuals of the star images used.
pub(super) fn frame_result(
    frame: usize,
    stars_offered: usize,
    residuals_px: &[[f64; 2]],
    camera_from_icrs: Option<Attitude>,
    variance_factor: f64,
) -> FrameResult {
    let square: f64 = residuals_px.iter().map(|[x, y]| x * x + y * y).sum();
    let stars = residuals_px.len();
    FrameResult {
        frame,
        camera_from_icrs,
        stars_offered,
        stars,
        rms_px: (stars > 0).then(|| (square / stars as f64).sqrt()),
        variance_factor,
    }
}

/// Standard errors of a frame's attitude across and about the boresight, the camera held; median over the frames.
pub(super) fn attitude_sigma<'a>(information: impl Iterator<Item = &'a Matrix3<f64>>, sigma_px: f64) -> Option<AttitudeSigma> {
    let all: Vec<[f64; 2]> = information.filter_map(|of_frame| attitude_sigma_rad(of_frame, sigma_px)).collect();
    let typical = |axis: usize| median_or_one(all.iter().map(|sigma| sigma[axis]).collect()) / ARCSEC_RAD;
    (!all.is_empty()).then(|| AttitudeSigma { across: typical(0), about: typical(1) })
}

fn left_out(selection: &Selection) -> Vec<LeftOutCount> {
    let mut counts = BTreeMap::new();
    for (_, reason) in &selection.left_out {
        *counts.entry(*reason).or_insert(0) += 1;
    }
    counts.into_iter().map(|(reason, points)| LeftOutCount { reason, points }).collect()
}

pub(super) fn general_warnings(result: &Calibration, lost: usize, coverage: Option<String>) -> Vec<String> {
    let mut warnings = Vec::new();
    if result.status == Status::NotConverged {
        warnings.push(format!(
            "not converged after {} iterations: the last step was {:.2e} px; the camera is where the iteration stood, its errors are not those stated",
            result.iterations.len(),
            result.iterations.last().map_or(f64::NAN, |iteration| iteration.step_px)
        ));
    }
    if result.frames < ENOUGH_FRAMES {
        let alone = if result.frames == 1 { ", and with a single one nothing can be held out" } else { "" };
        warnings.push(format!(
            "{} frames are fewer than the {ENOUGH_FRAMES} that the method asks for: what the model lacks may hide in the parameters{alone}",
            result.frames
        ));
    }
    for group in &result.left_out {
        warnings.push(format!("{} control points were left out: {}", group.points, group.reason.text()));
    }
    let entered = result.rejected.len() + result.points.iter().filter(|p| p.left_out.is_none() && p.weight > REJECTED_WEIGHT).count();
    if result.method != Method::Bundle && 10 * result.rejected.len() > 3 * entered {
        warnings.push(format!(
            "{} of {entered} star images were rejected: above about a quarter of wrong identifications weights on pairs are known to fail",
            result.rejected.len()
        ));
    }
    if lost > 0 {
        warnings.push(format!("{lost} frames have no attitude: too few of their star images are left; they stand in no rms"));
    }
    if folds_over(&result.camera) {
        warnings.push(
            "the solved distortion folds over inside the frame: two pixels see the same direction there, and the camera cannot be trusted"
                .to_owned(),
        );
    }
    let used_without_image = entered - result.rejected.len() - result.stars;
    if used_without_image > 0 && lost == 0 {
        warnings.push(format!(
            "the solved camera has no image of the stars of {used_without_image} of the star images used; they stand in no rms"
        ));
    }
    // A floor that the residuals themselves have told predicts nothing.
    let floor_px = result.noise.map_or(0.0, |noise| noise.floor_px);
    let stated_px = (result.predicted_sigma_px.powi(2) - floor_px * floor_px).max(0.0).sqrt();
    let predicted_px = stated_px.hypot(CENTROID_FLOOR_PX);
    if result.unit_weight_sigma_px > TOO_LARGE_RESIDUALS * predicted_px {
        warnings.push(format!(
            "the residuals ({:.3} px per axis) are {:.0} times what the measurements' own errors predict ({predicted_px:.3} px): identifications are wrong, or the model lacks something",
            result.unit_weight_sigma_px,
            result.unit_weight_sigma_px / predicted_px
        ));
    }
    warnings.extend(coverage);
    warnings
}

/// Parameters that the star images do not tell apart.
pub(super) fn degeneracy_warnings(result: &Calibration) -> Vec<String> {
    let sigma = |name: &str| result.parameters.iter().find(|p| p.name == name).map_or(0.0, |p| p.sigma);
    let map = result
        .map_sigma_px
        .map_or_else(String::new, |map| format!("; the mapping itself is known to {:.3} px (median over the frame)", map.median));
    let mut warnings = Vec::new();
    for (i, a) in result.model.iter().enumerate() {
        for b in &result.model[i + 1..] {
            let Some(correlation) = result.correlation(a, b).filter(|c| c.abs() > STRONG_CORRELATION) else { continue };
            warnings.push(match (a.as_str(), b.as_str()) {
                ("x0", "p1") | ("y0", "p2") => format!(
                    "{a} and {b} can hardly be told apart here (correlation {correlation:.4}): the centre's uncertainty is large, {a} ± {:.1} px{map}",
                    sigma(a)
                ),
                _ => format!("{a} and {b} can hardly be told apart here (correlation {correlation:.4}){map}"),
            });
        }
    }
    let centre = sigma("x0").max(sigma("y0"));
    if centre > UNCERTAIN_CENTRE_PX && !warnings.iter().any(|warning| warning.contains("centre's uncertainty")) {
        warnings.push(format!("the centre's uncertainty is large: x0 ± {:.1} px, y0 ± {:.1} px{map}", sigma("x0"), sigma("y0")));
    }
    warnings
}
