//! Result of a solution on pairs of stars: residuals of the stars, covariance, held-out frames, warnings.

use std::collections::BTreeSet;

use super::calibration::{Calibration, FrameResult, ParameterEstimate};
use super::coverage::Coverage;
use super::geometry::Scaling;
use super::pairs::{FrameStars, PairStar, Pairs};
use super::result::{
    REJECTED_WEIGHT, attitude_sigma, degeneracy_warnings, frame_result, general_warnings, map_sigma, median_or_one, point_results, result,
};
use super::select::{MIN_STARS, Selection, predicted_sigma_px};
use super::star_level::{FrameFit, ResidualSums, fit_frames};
use super::uncertainty::{covariances, map_sigma_px};
use super::variable_weights::PairSolution;
use super::{CalibrateError, CalibrateOptions, held_out};
use crate::camera::{Camera, PARAMETER_COUNT, PARAMETER_NAMES, PARAMETER_UNITS};
use crate::identify::{ControlPoint, ControlPoints};
use crate::parallel;
use crate::units::ARCSEC_RAD;
use nalgebra::Vector3;

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
    let map_sigma_px = map_sigma_px(camera, scaling, &covariances.pairs).map(map_sigma);

    let mut warnings = of_the_iteration(by_quartile, solution);
    let held_out_rms_px = if options.held_out {
        held_out::rms_px(frames, &used, &control_points.nominal, scaling, options).unwrap_or_else(|error| {
            warnings.push(format!("no held-out rms: without one part of the frames, {error}"));
            None
        })
    } else {
        None
    };
    let of_points = selection.frames.iter().zip(&star_weights).zip(&fits).flat_map(|((frame, weights), fit)| {
        let residual = |k: usize| fit.as_ref().and_then(|fit| fit.residuals_px[k]);
        frame.stars.iter().enumerate().map(move |(k, star)| (star.point, weights[k], residual(k)))
    });
    let points = point_results(control_points, selection, of_points);
    let per_frame = frames.iter().zip(&fits).zip(&used).map(|((frame, fit), used)| of_frame(frame, fit.as_ref(), used)).collect();
    let used_points = || {
        frames.iter().zip(&used).flat_map(|(frame, used)| {
            frame.stars.iter().zip(used).filter(|(_, used)| **used).map(|(star, _)| &control_points.points[star.point])
        })
    };
    let distinct = distinct(used_points());
    let predicted: f64 = used_points().map(|point| predicted_sigma_px(point, camera.focal_length_px).powi(2)).sum();
    let parameters = places.iter().map(|&k| estimate(k, camera, full[k][k], joint[k][k])).collect();
    let result = Calibration {
        status: solution.status,
        camera: *camera,
        rms_px: sums.rms_px(),
        rms_arcsec: rms_arcsec(camera, frames, &fits, &used),
        held_out_rms_px,
        stars: sums.stars,
        distinct_stars: distinct,
        frames: frames.len(),
        pairs: pairs.count(),
        interstar_angle_rms_arcsec: interstar_angle_rms_arcsec(&pairs, &used),
        attitude_sigma_arcsec: attitude_sigma(fits.iter().flatten().map(|fit| &fit.rotation_normal), variance.sqrt()),
        map_sigma_px,
        unit_weight_sigma_px: variance.sqrt(),
        predicted_sigma_px: (predicted / used_points().count().max(1) as f64).sqrt(),
        degrees_of_freedom: dof,
        covariance,
        gauge: "attitudes are not among the unknowns: angles between stars do not see them".to_owned(),
        iterations: solution.iterations.clone(),
        ..result(control_points, options, selection, parameters, points, per_frame)
    };
    let lost = fits.iter().filter(|fit| fit.is_none()).count();
    warnings.extend(general_warnings(&result, lost, coverage.warning("the frame", "rms over the frame")));
    warnings.extend(degeneracy_warnings(&result));
    Ok(Calibration { warnings, ..result })
}

/// A parameter with its variances, for itself and with all of them.
fn estimate(k: usize, camera: &Camera, variance: f64, joint: f64) -> ParameterEstimate {
    ParameterEstimate {
        name: PARAMETER_NAMES[k].to_owned(),
        value: camera.parameters()[k],
        sigma: variance.max(0.0).sqrt(),
        sigma_joint: joint.max(0.0).sqrt(),
        unit: PARAMETER_UNITS[k].to_owned(),
    }
}

/// How many stars the points are of. A star of a list that gives directions and no numbers is known by its direction.
fn distinct<'a>(points: impl Iterator<Item = &'a ControlPoint>) -> usize {
    let name = |point: &ControlPoint| (point.hip, if point.hip == 0 { point.direction.xyz.map(f64::to_bits) } else { [0; 3] });
    points.map(name).collect::<BTreeSet<(u32, [u64; 3])>>().len()
}

/// What to mind of the iteration. `by_quartile`: in so many frames the upper quartile of the pairs' weights decided.
fn of_the_iteration(by_quartile: usize, solution: &PairSolution) -> Vec<String> {
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
    warnings
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
        let sums: Vec<f64> = parallel::map_numbers(stars.len(), |i| of_star(&stars, i));
        sum += sums.iter().sum::<f64>();
        count += stars.len() * stars.len().saturating_sub(1) / 2;
    }
    (count > 0).then(|| (sum / count as f64).sqrt() / ARCSEC_RAD)
}

fn angle_rad(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let (a, b) = (Vector3::from(*a), Vector3::from(*b));
    a.cross(&b).norm().atan2(a.dot(&b))
}

fn of_frame(frame: &FrameStars, fit: Option<&FrameFit>, used: &[bool]) -> FrameResult {
    let own: Vec<[f64; 2]> = fit
        .map(|fit| fit.residuals_px.iter().zip(used).filter(|(_, used)| **used).filter_map(|(residual, _)| *residual).collect())
        .unwrap_or_default();
    frame_result(frame.frame, frame.stars.len(), &own, fit.map(|fit| fit.attitude), 1.0)
}
