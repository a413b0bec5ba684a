//! Result of a bundle adjustment: residuals, covariance, poorly determined combinations, held-out frames, warnings.

use nalgebra::{DMatrix, Vector3};
use rayon::prelude::*;

use super::{Attitudes, Problem, Solved, State, held_out, mapping, names, profile, selection, worse};
use crate::calibrate::calibration::{
    AttitudeSigma, Calibration, Combination, FORMAT, FrameResult, Iteration, LeftOpen, MapSigma, NoiseFound, ParameterEstimate,
    PointResult, Status,
};
use crate::calibrate::geometry::GRID;
use crate::calibrate::lit::lit_grid;
use crate::calibrate::map::attitude_sigma_rad;
use crate::calibrate::select::Selection;
use crate::calibrate::summary::{REJECTED_WEIGHT, degeneracy_warnings, general_warnings, left_out, median_or_one};
use crate::calibrate::{CalibrateError, CalibrateOptions};
use crate::coordinates::{Apparent, Attitude, Direction, PixelPoint};
use crate::identify::ControlPoints;
use crate::units::ARCSEC_RAD;

/// Below this share of a map change that the star images see, the map is not determined.
const BLIND_SHARE: f64 = 0.01;
/// Below this share the map is determined badly enough to be said.
const WEAK_SHARE: f64 = 0.15;
/// A residual above this (px) is found by inverting the distortion, not by the linearisation.
const FAR_PX: f64 = 10.0;
/// With more pairs of stars than these, the angles between stars are looked at for a part of the stars.
const MAX_PAIRS: usize = 2_000_000;
/// Of a combination with a singular value below this the standard error is taken from the cost itself.
const HARDLY: f64 = 0.1;
/// A combination with a singular value below this is put into words.
const BADLY: f64 = 0.2;

/// Makes the result.
pub(super) fn summarise(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
    solved: &Solved,
) -> Result<Calibration, CalibrateError> {
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let free = problem.free.len();
    let model_names = names(problem);
    let active = adjusted.weights.iter().filter(|weights| weights.iter().any(|weight| *weight > 0.0)).count();
    let used: usize = adjusted.weights.iter().flatten().filter(|weight| **weight > REJECTED_WEIGHT).count();
    let lost = problem.shared_count() + 3.0_f64.min(problem.local_count() as f64) as usize * active;
    let dof = (2 * used).checked_sub(lost).filter(|dof| *dof > 0);
    let dof = dof.ok_or(CalibrateError::NoDegreesOfFreedom { stars: used, frames: active, parameters: free })?;
    let covariance = covariance(&adjusted.information, &model_names)?;
    let grid = lit_grid(problem.model.camera(), problem.lit.as_ref(), GRID);
    let map =
        mapping::rotation_free_map(&problem.model, &adjusted.state.values, &problem.free, &grid).ok_or(CalibrateError::NominalFolds)?;
    let (share, direction) = mapping::coverage(problem, &adjusted.state, &adjusted.weights, &adjusted.scale, &map);
    if share.is_nan() || share < BLIND_SHARE {
        return Err(CalibrateError::Uncovered { combination: in_words(&direction, &model_names), share });
    }
    let unit = adjusted.chi_squared / (2.0 * adjusted.weight_sum - lost as f64).max(1.0);
    let scaled = covariance * unit;
    let scale = &adjusted.scale;
    let linear = DMatrix::from_fn(free, free, |i, j| scaled[(i, j)] / (scale[i] * scale[j]));
    let combinations = combinations(&map, &linear, &model_names);
    let wider = profile::wider(solved, &linear, unit, &weakest(&combinations, &model_names));
    let own = profile::widened(&linear, &wider);
    let open = selection::left_open(&model_names, solved.alternative.as_ref());
    let dense = open.as_ref().map_or(own.clone(), |(_, all)| all.view((0, 0), (free, free)).into_owned());
    let rows = |matrix: &DMatrix<f64>| -> Vec<Vec<f64>> { matrix.row_iter().map(|row| row.iter().copied().collect()).collect() };
    let in_units = rows(&dense);
    let state = &adjusted.state;
    let sigma = open.as_ref().and_then(|(names, all)| {
        let mut model = problem.model.clone();
        let free = super::indices(&mut model, names)?;
        mapping::map_sigma_px(&model, &model.values(), &free, all, &grid)
    });
    let sigma = sigma.unwrap_or_else(|| mapping::sigma_px(&map, &dense));
    let mut sigma: Vec<f64> = sigma.into_iter().map(|(_, sigma)| sigma).collect();
    sigma.sort_by(f64::total_cmp);
    let map_sigma = MapSigma { median: sigma[sigma.len() / 2], max: sigma[sigma.len() - 1] };
    let residuals = residuals(solved);
    let points_results = point_results(points, selection, solved, &residuals);
    let rejected: Vec<PointResult> =
        points_results.iter().filter(|point| point.left_out.is_none() && point.weight <= REJECTED_WEIGHT).copied().collect();
    let (mut square, mut stars, mut angles, mut predicted) = (0.0, 0_usize, 0.0, 0.0);
    let mut distinct = Vec::new();
    for (exposure, weights) in adjusted.weights.iter().enumerate() {
        let f = state.values[2];
        for (index, image) in problem.exposures[exposure].images.iter().enumerate().filter(|(index, _)| weights[*index] > REJECTED_WEIGHT) {
            let Some([x, y]) = residuals[exposure][index] else { continue };
            square += x * x + y * y;
            stars += 1;
            let [xx, _, yy] = adjusted.noise.covariance_px2(exposure, image);
            predicted += xx + yy;
            // A pixel is 1/s of f⁻¹ rad across at a field angle: s² = 1 + tan².
            let point = [image.pixel[0] - state.values[0], image.pixel[1] - state.values[1]];
            let s2 = 1.0 + (point[0] * point[0] + point[1] * point[1]) / (f * f);
            let radial = (x * point[0] + y * point[1]).powi(2) / (point[0] * point[0] + point[1] * point[1]).max(1e-12);
            angles += ((x * x + y * y - radial) / s2 + radial / (s2 * s2)) / (f * f);
            let control = &points.points[image.point];
            distinct.push((control.hip, if control.hip == 0 { control.star.direction.map(f64::to_bits) } else { [0; 3] }));
        }
    }
    distinct.par_sort_unstable();
    distinct.dedup();
    let typical = |sum: f64| (stars > 0).then(|| (sum / stars as f64).sqrt());
    let parameters = problem.model.parameters();
    let estimates = problem.free.iter().enumerate().map(|(k, index)| {
        let sigma = in_units[k][k].max(0.0).sqrt();
        ParameterEstimate {
            name: parameters[*index].name.clone(),
            value: state.values[*index],
            sigma,
            sigma_joint: sigma,
            unit: parameters[*index].unit.to_owned(),
        }
    });
    let turn = |turn: &super::adjust::Turn| Iteration {
        step_px: turn.step_px,
        pair_sigma_rad: 0.0,
        pairs_down_weighted: 0,
        star_sigma_px: turn.sigma_px,
        stars_down_weighted: turn.down_weighted,
    };
    let mut result = Calibration {
        format: FORMAT.to_owned(),
        method: options.method,
        status: if adjusted.converged { Status::Converged } else { Status::NotConverged },
        physics: options.physics.clone(),
        model: model_names.clone(),
        parameters: estimates.collect(),
        camera: *problem.model.camera(),
        chain: Some(problem.model.clone()),
        parity: 1,
        rms_px: typical(square),
        rms_arcsec: typical(angles).map(|rms| rms / ARCSEC_RAD),
        held_out_rms_px: options.held_out.then(|| held_out::rms_px(solved)).flatten(),
        stars,
        stars_offered: points.points.len(),
        distinct_stars: distinct.len(),
        frames: active,
        pairs: 0,
        interstar_angle_rms_arcsec: interstar_angle_rms_arcsec(solved),
        attitude_sigma_arcsec: attitude_sigma(solved, unit),
        rejected,
        left_out: left_out(selection),
        warnings: Vec::new(),
        map_sigma_px: Some(map_sigma),
        lit: problem.lit,
        systematics: Vec::new(),
        unit_weight_sigma_px: (square / dof as f64).sqrt(),
        predicted_sigma_px: typical(predicted).unwrap_or(0.0) / std::f64::consts::SQRT_2,
        degrees_of_freedom: dof,
        covariance: in_units,
        left_open: open.as_ref().map(|(names, all)| LeftOpen { parameters: names.clone(), covariance: rows(all) }),
        combinations,
        gauge: gauge(problem.attitudes),
        noise: Some(NoiseFound {
            floor_px: adjusted.noise.floor_px2.sqrt(),
            wrong_share: adjusted.noise.wrong_share,
            unit_weight_variance: unit,
            predicted_rms_px: (predicted / stars.max(1) as f64).sqrt(),
        }),
        selection: None,
        reidentified: None,
        seconds: 0.0,
        iterations: adjusted.turns.iter().map(turn).collect(),
        per_frame: frame_results(solved, &residuals),
        points: points_results,
        options: options.clone(),
        control_points: points.clone(),
        provenance: None,
    };
    let weak = (share < WEAK_SHARE).then(|| {
        format!(
            "the star images cover {} badly: a change of the mapping by 1 px (rms) in {} moves them by only {share:.3} px; \
             the mapping is uncertain where no stars are",
            problem.lit.map_or_else(|| "the frame".to_owned(), |lit| lit.in_words()),
            in_words(&direction, &model_names)
        )
    });
    let mut warnings = solved.notes.clone();
    let without = result.per_frame.iter().filter(|frame| frame.camera_from_icrs.is_none()).count();
    warnings.extend(general_warnings(&result, without, weak));
    warnings.extend(degeneracy_warnings(&result));
    warnings.extend(result.combinations.iter().filter_map(|combination| combination.sentence.clone()));
    warnings.extend(wider.iter().map(|wider| {
        format!(
            "{} is hardly determined here: the cost rises so slowly away from the solution that its standard error, and those of what goes \
             with it, are {:.1} times those of the linearisation",
            model_names[wider.free], wider.factor
        )
    }));
    warnings.extend(worse::sentences(solved, points));
    result.warnings = warnings;
    Ok(result)
}

/// Whether the star images, all of them right, would determine the map.
pub(super) fn check_coverage(problem: &Problem, state: &State, scale: &[f64]) -> Result<(), CalibrateError> {
    let grid = lit_grid(problem.model.camera(), problem.lit.as_ref(), GRID);
    let Some(map) = mapping::rotation_free_map(&problem.model, &state.values, &problem.free, &grid) else { return Ok(()) };
    let weights: Vec<Vec<f64>> = problem.exposures.iter().map(|exposure| vec![1.0; exposure.images.len()]).collect();
    let (share, direction) = mapping::coverage(problem, state, &weights, scale, &map);
    if share < BLIND_SHARE {
        return Err(CalibrateError::Uncovered { combination: in_words(&direction, &names(problem)), share });
    }
    Ok(())
}

/// In which sense the parameters are what they are.
fn gauge(attitudes: Attitudes) -> String {
    match attitudes {
        Attitudes::Free => {
            "one free rotation for each frame and no translation; a rotation common to all frames is no parameter of the camera"
        }
        Attitudes::FreeWithRates => {
            "one free rotation and three free rates for each frame (the rows are exposed one after the other); no translation"
        }
        Attitudes::FixedToEarth => "one free rotation of the mount to the ground for all frames together; the Earth turns",
    }
    .to_owned()
}

/// Whether a solution is one: converged, determined, and its map too.
pub(super) fn check_solved(solved: &Solved) -> Result<(), CalibrateError> {
    let Solved { problem, adjusted, .. } = solved;
    let names = names(problem);
    covariance(&adjusted.information, &names)?;
    if !adjusted.converged {
        return Err(CalibrateError::Singular { combination: names.join(", ") });
    }
    let grid = lit_grid(problem.model.camera(), problem.lit.as_ref(), GRID);
    let values = &adjusted.state.values;
    let map = mapping::rotation_free_map(&problem.model, values, &problem.free, &grid).ok_or(CalibrateError::NominalFolds)?;
    let (share, direction) = mapping::coverage(problem, &adjusted.state, &adjusted.weights, &adjusted.scale, &map);
    if share.is_nan() || share < BLIND_SHARE {
        return Err(CalibrateError::Uncovered { combination: in_words(&direction, &names), share });
    }
    Ok(())
}

/// The covariance of the scaled free parameters for unit weight.
pub(super) fn covariance(information: &DMatrix<f64>, names: &[String]) -> Result<DMatrix<f64>, CalibrateError> {
    let n = information.nrows();
    let root: Vec<f64> = (0..n).map(|k| information[(k, k)].max(0.0).sqrt()).collect();
    if let Some(k) = (0..n).find(|k| !(root[*k] > 0.0 && root[*k].is_finite())) {
        return Err(CalibrateError::Singular { combination: names.get(k).map_or("the mount's attitude", String::as_str).to_owned() });
    }
    let equilibrated = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (root[i] * root[j]));
    let eigen = equilibrated.clone().symmetric_eigen();
    let (weakest, smallest) = eigen.eigenvalues.argmin();
    if smallest.is_nan() || smallest <= super::adjust::OPEN * eigen.eigenvalues.max() {
        let direction: Vec<f64> = eigen.eigenvectors.column(weakest).iter().copied().take(names.len()).collect();
        return Err(CalibrateError::Singular { combination: in_words(&direction, names) });
    }
    let inverse = equilibrated.try_inverse().ok_or_else(|| CalibrateError::Singular { combination: names.join(", ") })?;
    let free = names.len();
    Ok(DMatrix::from_fn(free, free, |i, j| inverse[(i, j)] / (root[i] * root[j])))
}

/// A direction in parameter space in words: its large components, the largest first.
fn in_words(direction: &[f64], names: &[String]) -> String {
    let largest = direction.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let mut parts: Vec<(f64, &String)> =
        direction.iter().zip(names).filter(|(v, _)| v.abs() > 0.2 * largest).map(|(v, name)| (v.abs(), name)).collect();
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    parts.into_iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>().join(", ")
}

/// The table of singular values: combinations of parameters from the worst to the best determined. `covariance` in the parameters' own
/// units.
fn combinations(map: &[mapping::MapColumns], covariance: &DMatrix<f64>, names: &[String]) -> Vec<Combination> {
    const SMALL_SHARE: f64 = 0.1;
    let n = names.len();
    let root: Vec<f64> = (0..n).map(|k| covariance[(k, k)].max(0.0).sqrt()).collect();
    let correlation = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (root[i] * root[j]));
    let Some(information) = correlation.try_inverse() else { return Vec::new() };
    // Each column of length one: what is left are the angles between them.
    let length: Vec<f64> = (0..n).map(|k| information[(k, k)].max(0.0).sqrt()).collect();
    let eigen = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (length[i] * length[j])).symmetric_eigen();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let of = |k: usize| {
        let singular_value = eigen.eigenvalues[k].max(0.0).sqrt();
        let shares = eigen.eigenvectors.column(k);
        let step: Vec<f64> = (0..n).map(|i| shares[i] / singular_value.max(f64::MIN_POSITIVE) * root[i] / length[i]).collect();
        let square: f64 = map
            .iter()
            .flat_map(|place| &place.columns)
            .map(|column| column.iter().zip(&step).map(|(column, step)| column * step).sum::<f64>().powi(2))
            .sum();
        let sigma_px = (square / map.len().max(1) as f64).sqrt();
        let mut parameters: Vec<(String, f64)> = names
            .iter()
            .zip(shares.iter())
            .filter(|(_, share)| share.abs() >= SMALL_SHARE)
            .map(|(name, share)| (name.clone(), *share))
            .collect();
        parameters.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        let sentence = (parameters.len() > 1 && singular_value < BADLY).then(|| {
            let list: Vec<&str> = parameters.iter().map(|(name, _)| name.as_str()).collect();
            let (last, rest) = list.split_last().map_or(("", &[][..]), |(last, rest)| (*last, rest));
            format!(
                "{} and {last} cannot be told apart well here (singular value {singular_value:.3}); what stays open between them moves the map by {sigma_px:.4} px",
                rest.join(", ")
            )
        });
        Combination { singular_value, sigma_px, parameters, sentence }
    };
    order.into_iter().map(of).collect()
}

/// Of each combination that is hardly determined the parameter that has most of it, none twice; one of an effect before those of the
/// reference model.
fn weakest(combinations: &[Combination], names: &[String]) -> Vec<usize> {
    let mut chosen = Vec::new();
    for combination in combinations.iter().filter(|combination| combination.singular_value < HARDLY) {
        let place = |of_reference: bool| {
            let of_kind = combination.parameters.iter().filter(|(name, _)| super::is_reference(name) == of_reference);
            of_kind.filter_map(|(name, _)| names.iter().position(|other| other == name)).find(|place| !chosen.contains(place))
        };
        let found = place(false).or_else(|| place(true));
        chosen.extend(found);
    }
    chosen
}

/// Measured minus predicted position of every image; by inverting the distortion where it is large.
fn residuals(solved: &Solved) -> Vec<Vec<Option<[f64; 2]>>> {
    let (problem, state) = (&solved.problem, &solved.adjusted.state);
    let of = |exposure: usize| {
        let images = &problem.exposures[exposure].images;
        let mut found = vec![None; images.len()];
        problem.linearise(state, exposure, |index, row| found[index] = Some(row.residual));
        let Some(attitude) = problem.attitude(state, exposure) else { return found };
        for (found, image) in found.iter_mut().zip(images).filter(|(found, _)| found.is_none_or(|[x, y]| x.hypot(y) > FAR_PX)) {
            let context = image.context(&problem.exposures[exposure].observation);
            let apparent =
                if problem.solves_sky { problem.model.apparent(&context) } else { Direction::<Apparent>::from_unit(image.apparent) };
            let predicted = problem.model.pixel(&Attitude::new(attitude).camera_from_apparent(&apparent), &context);
            *found = predicted.map(|PixelPoint { x_px, y_px }| [image.pixel[0] - x_px, image.pixel[1] - y_px]);
        }
        found
    };
    (0..problem.exposures.len()).into_par_iter().with_min_len(8).map(of).collect()
}

fn point_results(points: &ControlPoints, selection: &Selection, solved: &Solved, residuals: &[Vec<Option<[f64; 2]>>]) -> Vec<PointResult> {
    let blank = |point: &crate::identify::ControlPoint| PointResult {
        frame: point.frame,
        hip: point.hip,
        x_px: point.x_px,
        y_px: point.y_px,
        weight: 0.0,
        residual_px: None,
        left_out: None,
    };
    let mut results: Vec<PointResult> = points.points.iter().map(blank).collect();
    for &(index, reason) in &selection.left_out {
        results[index].left_out = Some(reason);
    }
    for (exposure, of) in solved.problem.exposures.iter().enumerate() {
        for (index, image) in of.images.iter().enumerate() {
            results[image.point].weight = solved.adjusted.weights[exposure][index];
            results[image.point].residual_px = residuals[exposure][index];
        }
    }
    results
}

fn frame_results(solved: &Solved, residuals: &[Vec<Option<[f64; 2]>>]) -> Vec<FrameResult> {
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let of = |exposure: usize| {
        let used = residuals[exposure].iter().zip(&adjusted.weights[exposure]).filter(|(_, weight)| **weight > REJECTED_WEIGHT);
        let own: Vec<[f64; 2]> = used.filter_map(|(residual, _)| *residual).collect();
        let square: f64 = own.iter().map(|[x, y]| x * x + y * y).sum();
        let attitude = problem.attitude(&adjusted.state, exposure).filter(|_| own.len() > 1);
        FrameResult {
            frame: problem.exposures[exposure].frame,
            camera_from_icrs: attitude.map(Attitude::new),
            stars_offered: problem.exposures[exposure].images.len(),
            stars: own.len(),
            rms_px: (!own.is_empty()).then(|| (square / own.len() as f64).sqrt()),
            variance_factor: adjusted.noise.frame_factors[exposure],
        }
    };
    (0..problem.exposures.len()).map(of).collect()
}

/// Standard errors of a frame's attitude across and about the boresight, the camera held; median over the frames.
fn attitude_sigma(solved: &Solved, unit: f64) -> Option<AttitudeSigma> {
    let of = |information: &nalgebra::Matrix3<f64>| attitude_sigma_rad(information, unit.sqrt());
    let all: Vec<[f64; 2]> = solved.adjusted.attitude_information.iter().flatten().filter_map(of).collect();
    let typical = |axis: usize| median_or_one(all.iter().map(|sigma| sigma[axis]).collect()) / ARCSEC_RAD;
    (!all.is_empty()).then(|| AttitudeSigma { across: typical(0), about: typical(1) })
}

/// The angle between two directions less that between two others.
fn angle_difference_rad(seen: [Vector3<f64>; 2], apparent: [Vector3<f64>; 2]) -> f64 {
    // Below this the sine's series to its third power is exact.
    const SMALL_RAD: f64 = 1e-3;
    let parts = |[a, b]: [Vector3<f64>; 2]| (a.cross(&b).norm(), a.dot(&b));
    let ((sin, cos), (sin_other, cos_other)) = (parts(seen), parts(apparent));
    let (sine, cosine) = (sin * cos_other - cos * sin_other, cos * cos_other + sin * sin_other);
    if sine.abs() < SMALL_RAD && cosine > 0.0 { sine + sine.powi(3) / 6.0 } else { sine.atan2(cosine) }
}

/// rms difference of angles between stars, measured and catalogue, over the pairs of star images used.
fn interstar_angle_rms_arcsec(solved: &Solved) -> Option<f64> {
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let pairs: usize = problem.exposures.iter().map(|exposure| exposure.images.len().pow(2) / 2).sum();
    let every = (pairs as f64 / MAX_PAIRS as f64).sqrt().ceil().max(1.0) as usize;
    let of = |exposure: usize| {
        let weights = &adjusted.weights[exposure];
        let images = &problem.exposures[exposure].images;
        let observation = problem.exposures[exposure].observation;
        let stars: Vec<(Vector3<f64>, Vector3<f64>)> = (0..images.len())
            .filter(|index| weights[*index] > REJECTED_WEIGHT)
            .step_by(every)
            .filter_map(|index| {
                let image = &images[index];
                let context = image.context(&observation);
                let pixel = PixelPoint { x_px: image.pixel[0], y_px: image.pixel[1] };
                let seen = problem.model.direction(pixel, &context)?;
                let apparent = if problem.solves_sky { problem.model.apparent(&context).xyz } else { image.apparent };
                Some((Vector3::from(seen.xyz), Vector3::from(apparent)))
            })
            .collect();
        let (mut sum, mut count) = (0.0, 0_usize);
        for (i, a) in stars.iter().enumerate() {
            for b in &stars[i + 1..] {
                let difference = angle_difference_rad([a.0, b.0], [a.1, b.1]);
                sum += difference * difference;
                count += 1;
            }
        }
        (sum, count)
    };
    let parts: Vec<(f64, usize)> = (0..problem.exposures.len()).into_par_iter().with_min_len(4).map(of).collect();
    let (sum, count) = parts.into_iter().fold((0.0, 0), |(sum, count), (square, pairs)| (sum + square, count + pairs));
    (count > 0).then(|| (sum / count as f64).sqrt() / ARCSEC_RAD)
}
