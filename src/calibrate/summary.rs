//! Result of a solution on pairs of stars: residuals of the stars, covariance, held-out frames, warnings.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use rayon::prelude::*;

use super::calibration::{AttitudeSigma, Calibration, FORMAT, FrameResult, LeftOutCount, MapSigma, ParameterEstimate, PointResult, Status};
use super::geometry::{Scaling, folds_over};
use super::map::attitude_sigma_rad;
use super::pairs::{FrameStars, PairStar, Pairs};
use super::select::{CENTROID_FLOOR_PX, MIN_STARS, Selection, predicted_sigma_px};
use super::star_level::{FrameFit, ResidualSums, fit_frames};
use super::uncertainty::{Coverage, covariances, map_sigma_px};
use super::variable_weights::PairSolution;
use super::{CalibrateError, CalibrateOptions, Method, held_out};
use crate::camera::{Camera, PARAMETER_COUNT, PARAMETER_NAMES, PARAMETER_UNITS};
use crate::identify::ControlPoints;
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

/// Makes the result.
pub(super) fn summarise(
    control_points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
    scaling: &Scaling,
    coverage: &Coverage,
    solution: &PairSolution,
) -> Result<Calibration, CalibrateError> {
    let (frames, camera) = (&selection.frames, &solution.camera);
    let pairs = Pairs::at(frames, camera, scaling);
    let by_frame: Vec<(Vec<f64>, bool)> = pairs.weights_by_star(&solution.weights).into_iter().map(star_weights).collect();
    let by_quartile = by_frame.iter().filter(|(_, quartile)| *quartile).count();
    let star_weights: Vec<Vec<f64>> = by_frame.into_iter().map(|(weights, _)| weights).collect();
    let used: Vec<Vec<bool>> = star_weights.iter().map(|stars| stars.iter().map(|w| *w > REJECTED_WEIGHT).collect()).collect();
    let fits = fit_frames(camera, frames, &used);
    let sums = ResidualSums::of(&fits, &used);
    let parameters = scaling.free_count();
    let dof = sums.degrees_of_freedom(parameters).ok_or(CalibrateError::NoDegreesOfFreedom {
        stars: sums.stars,
        frames: sums.frames,
        parameters,
    })?;
    let variance = sums.square_px2 / dof as f64;
    let covariances = covariances(&pairs, &solution.weights, &used, variance, scaling)
        .ok_or(CalibrateError::Singular { combination: options.solve.join(", ") })?;
    let full = scaling.covariance_in_units(&covariances.pairs);
    let places: Vec<usize> = (0..PARAMETER_COUNT).filter(|k| scaling.free[*k]).collect();
    let covariance: Vec<Vec<f64>> = places.iter().map(|k| places.iter().map(|l| full[*k][*l]).collect()).collect();
    let joint = scaling.covariance_in_units(&covariances.joint);
    let map_sigma = map_sigma_px(camera, scaling, &covariances.pairs).map(|mut sigma| {
        sigma.sort_by(f64::total_cmp);
        MapSigma { median: sigma[sigma.len() / 2], max: sigma[sigma.len() - 1] }
    });

    let mut warnings = Vec::new();
    if by_quartile > 0 {
        warnings.push(format!(
            "in {by_quartile} frames the median of the pairs' weights keeps fewer than three stars, so their upper quartile decides there: more than half of the identifications may be wrong"
        ));
    }
    if solution.in_stages {
        warnings.push(
            "the iteration as published ran away, so f and k1 were solved first and all parameters from there: the rest is determined weakly".to_owned(),
        );
    }
    let held_out_rms_px = if options.held_out {
        held_out::rms_px(frames, &used, &control_points.nominal, scaling, options).unwrap_or_else(|error| {
            warnings.push(format!("no held-out rms: without one part of the frames, {error}"));
            None
        })
    } else {
        None
    };
    let points = point_results(control_points, selection, &star_weights, &fits);
    let rejected: Vec<PointResult> = points.iter().filter(|p| p.left_out.is_none() && p.weight <= REJECTED_WEIGHT).copied().collect();
    let left_out = left_out(selection);
    let per_frame = frames.iter().zip(&fits).zip(&used).map(|((frame, fit), used)| frame_result(frame, fit.as_ref(), used)).collect();
    let used_points = || {
        frames.iter().zip(&used).flat_map(|(frame, used)| {
            frame.stars.iter().zip(used).filter(|(_, used)| **used).map(|(star, _)| &control_points.points[star.point])
        })
    };
    // A star of a list that gives directions and no numbers is known by its direction.
    let distinct: BTreeSet<(u32, [u64; 3])> =
        used_points().map(|point| (point.hip, if point.hip == 0 { point.direction.xyz.map(f64::to_bits) } else { [0; 3] })).collect();
    let predicted: f64 = used_points().map(|point| predicted_sigma_px(point, camera.focal_length_px).powi(2)).sum();
    let solved = (0..PARAMETER_COUNT).filter(|k| scaling.free[*k]);
    let result = Calibration {
        format: FORMAT.to_owned(),
        method: options.method,
        status: solution.status,
        physics: options.physics.clone(),
        model: solved.clone().map(|k| PARAMETER_NAMES[k].to_owned()).collect(),
        parameters: solved
            .map(|k| ParameterEstimate {
                name: PARAMETER_NAMES[k].to_owned(),
                value: camera.parameters()[k],
                sigma: full[k][k].max(0.0).sqrt(),
                sigma_joint: joint[k][k].max(0.0).sqrt(),
                unit: PARAMETER_UNITS[k].to_owned(),
            })
            .collect(),
        camera: *camera,
        parity: 1,
        rms_px: sums.rms_px(),
        rms_arcsec: rms_arcsec(camera, frames, &fits, &used),
        held_out_rms_px,
        stars: sums.stars,
        stars_offered: control_points.points.len(),
        distinct_stars: distinct.len(),
        frames: frames.len(),
        pairs: pairs.count(),
        interstar_angle_rms_arcsec: interstar_angle_rms_arcsec(&pairs, &used),
        attitude_sigma_arcsec: attitude_sigma(&fits, variance.sqrt()),
        rejected,
        left_out,
        warnings: Vec::new(),
        map_sigma_px: map_sigma,
        lit: None,
        systematics: Vec::new(),
        unit_weight_sigma_px: variance.sqrt(),
        predicted_sigma_px: (predicted / used_points().count().max(1) as f64).sqrt(),
        degrees_of_freedom: dof,
        covariance,
        chain: None,
        left_open: None,
        combinations: Vec::new(),
        gauge: "attitudes are not among the unknowns: angles between stars do not see them".to_owned(),
        noise: None,
        selection: None,
        reidentified: None,
        seconds: 0.0,
        iterations: solution.iterations.clone(),
        per_frame,
        points,
        options: options.clone(),
        control_points: control_points.clone(),
        provenance: None,
    };
    let lost = fits.iter().filter(|fit| fit.is_none()).count();
    warnings.extend(general_warnings(&result, lost, coverage.warning()));
    warnings.extend(degeneracy_warnings(&result));
    Ok(Calibration { warnings, ..result })
}

/// The weights of one frame's stars from the weights of their pairs: the median. Where more than half of a frame's stars are
/// wrong, more than half of a right star's pairs are wrong too, and the median would reject them all; if it leaves fewer than
/// three, the upper quartile is taken instead (true), which right stars pass down to a share of a quarter. A wrong star agrees
/// with another one only by chance.
fn star_weights(pair_weights: Vec<Vec<f64>>) -> (Vec<f64>, bool) {
    let medians: Vec<f64> = pair_weights.iter().cloned().map(median_or_one).collect();
    if medians.iter().filter(|weight| **weight > REJECTED_WEIGHT).count() >= MIN_STARS {
        return (medians, false);
    }
    let upper_quartile = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(3 * values.len() / 4).copied().unwrap_or(1.0)
    };
    (pair_weights.into_iter().map(upper_quartile).collect(), true)
}

/// The median of what a star's pairs say; 1 for a star without pairs.
pub(super) fn median_or_one(mut values: Vec<f64>) -> f64 {
    median_in_place(&mut values).unwrap_or(1.0)
}

fn point_results(
    control_points: &ControlPoints,
    selection: &Selection,
    star_weights: &[Vec<f64>],
    fits: &[Option<FrameFit>],
) -> Vec<PointResult> {
    let blank = |point: &crate::identify::ControlPoint| PointResult {
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
    for ((frame, weights), fit) in selection.frames.iter().zip(star_weights).zip(fits) {
        for (k, star) in frame.stars.iter().enumerate() {
            results[star.point].weight = weights[k];
            results[star.point].residual_px = fit.as_ref().and_then(|fit| fit.residuals_px[k]);
        }
    }
    results
}

pub(super) fn left_out(selection: &Selection) -> Vec<LeftOutCount> {
    let mut counts = BTreeMap::new();
    for (_, reason) in &selection.left_out {
        *counts.entry(*reason).or_insert(0) += 1;
    }
    counts.into_iter().map(|(reason, points)| LeftOutCount { reason, points }).collect()
}

fn frame_result(frame: &FrameStars, fit: Option<&FrameFit>, used: &[bool]) -> FrameResult {
    let own: Vec<[f64; 2]> = fit
        .map(|fit| fit.residuals_px.iter().zip(used).filter(|(_, used)| **used).filter_map(|(residual, _)| *residual).collect())
        .unwrap_or_default();
    let square: f64 = own.iter().map(|[x, y]| x * x + y * y).sum();
    FrameResult {
        frame: frame.frame,
        camera_from_icrs: fit.map(|fit| fit.attitude),
        stars_offered: frame.stars.len(),
        stars: own.len(),
        rms_px: (!own.is_empty()).then(|| (square / own.len() as f64).sqrt()),
        variance_factor: 1.0,
    }
}

/// Angle between the measured direction and the turned catalogue direction, rms.
fn rms_arcsec(camera: &Camera, frames: &[FrameStars], fits: &[Option<FrameFit>], used: &[Vec<bool>]) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_usize);
    for ((frame, fit), used) in frames.iter().zip(fits).zip(used) {
        let Some(fit) = fit else { continue };
        for ((star, residual), _) in frame.stars.iter().zip(&fit.residuals_px).zip(used).filter(|(_, used)| **used) {
            if residual.is_some() {
                let turned = fit.attitude.camera_from_icrs * Vector3::from(star.direction);
                let angle = angle_rad(&camera.direction(star.pixel).xyz, turned.as_ref());
                sum += angle * angle;
                count += 1;
            }
        }
    }
    (count > 0).then(|| (sum / count as f64).sqrt() / ARCSEC_RAD)
}

fn interstar_angle_rms_arcsec(pairs: &Pairs, used: &[Vec<bool>]) -> Option<f64> {
    // A sum for each star, added in order: the same at any number of threads.
    let of_star = |stars: &[&PairStar], i: usize| -> f64 {
        let a = stars[i];
        let difference = |b: &&PairStar| angle_rad(&a.local.direction, &b.local.direction) - angle_rad(&a.v, &b.v);
        stars[i + 1..].iter().map(difference).map(|difference| difference * difference).sum()
    };
    let (mut sum, mut count) = (0.0, 0_usize);
    for (frame, used) in used.iter().enumerate() {
        let stars: Vec<_> = pairs.stars(frame).iter().zip(used).filter(|(_, used)| **used).map(|(star, _)| star).collect();
        let sums: Vec<f64> = (0..stars.len()).into_par_iter().map(|i| of_star(&stars, i)).collect();
        sum += sums.iter().sum::<f64>();
        count += stars.len() * stars.len().saturating_sub(1) / 2;
    }
    (count > 0).then(|| (sum / count as f64).sqrt() / ARCSEC_RAD)
}

fn angle_rad(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let (a, b) = (Vector3::from(*a), Vector3::from(*b));
    a.cross(&b).norm().atan2(a.dot(&b))
}

fn attitude_sigma(fits: &[Option<FrameFit>], sigma_px: f64) -> Option<AttitudeSigma> {
    let all: Vec<[f64; 2]> = fits.iter().flatten().filter_map(|fit| attitude_sigma_rad(&fit.rotation_normal, sigma_px)).collect();
    let typical = |axis: usize| median_or_one(all.iter().map(|sigma| sigma[axis]).collect()) / ARCSEC_RAD;
    (!all.is_empty()).then(|| AttitudeSigma { across: typical(0), about: typical(1) })
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
    // A floor that was estimated from the residuals themselves predicts nothing.
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
