//! Result of a bundle adjustment: residuals, covariance, poorly determined combinations, held-out frames, warnings.

use super::adjust::Turn;
use super::determined::{combinations, covariance, coverage, weakest};
use super::solved::left_open;
use super::{Attitudes, Solved, held_out, indices, mapping, names, profile, worse};
use crate::calibrate::calibration::{Calibration, FrameResult, Iteration, LeftOpen, NoiseFound, ParameterEstimate, Status};
use crate::calibrate::geometry::GRID;
use crate::calibrate::lit::lit_grid;
use crate::calibrate::result::{
    REJECTED_WEIGHT, attitude_sigma, degeneracy_warnings, frame_result, general_warnings, map_sigma, point_results, result,
};
use crate::calibrate::select::Selection;
use crate::calibrate::{CalibrateError, CalibrateOptions};
use crate::coordinates::{Apparent, Attitude, Direction, PixelPoint};
use crate::identify::ControlPoints;
use crate::parallel;
use crate::units::ARCSEC_RAD;
use nalgebra::{DMatrix, Vector3};

/// A residual above this (px) is found by inverting the distortion, not by the linearisation.
const FAR_PX: f64 = 10.0;
/// With more pairs of stars than these, the angles between stars are looked at for a part of the stars.
const MAX_PAIRS: usize = 2_000_000;

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
    let coverage = coverage(problem, &adjusted.state, &adjusted.weights, &adjusted.scale, &map).checked()?;
    let unit = adjusted.chi_squared / (2.0 * adjusted.weight_sum - lost as f64).max(1.0);
    let scaled = covariance * unit;
    let scale = &adjusted.scale;
    let linear = DMatrix::from_fn(free, free, |i, j| scaled[(i, j)] / (scale[i] * scale[j]));
    let combinations = combinations(&map, &linear, &model_names);
    let wider = profile::wider(solved, &linear, unit, &weakest(&combinations, &model_names));
    let own = profile::widened(&linear, &wider);
    let open = left_open(&model_names, solved.alternative.as_ref());
    let dense = open.as_ref().map_or(own.clone(), |(_, all)| all.view((0, 0), (free, free)).into_owned());
    let in_units = rows(&dense);
    let sigma = open.as_ref().and_then(|(names, all)| {
        let mut model = problem.model.clone();
        let free = indices(&mut model, names)?;
        mapping::map_sigma_px(&model, &model.values(), &free, all, &grid)
    });
    let sigma = sigma.unwrap_or_else(|| mapping::sigma_px(&map, &dense));
    let residuals = residuals(solved);
    let of_images = problem.exposures.iter().enumerate().flat_map(|(exposure, of)| {
        let (weights, residuals) = (&adjusted.weights[exposure], &residuals[exposure]);
        of.images.iter().enumerate().map(move |(index, image)| (image.point, weights[index], residuals[index]))
    });
    let of_points = point_results(points, selection, of_images);
    let Sums { square, stars, angles, predicted, distinct } = sums(points, solved, &residuals);
    let typical = |sum: f64| (stars > 0).then(|| (sum / stars as f64).sqrt());
    let estimates = estimates(solved, &in_units);
    let mut result = Calibration {
        status: if adjusted.converged { Status::Converged } else { Status::NotConverged },
        camera: *problem.model.camera(),
        chain: Some(problem.model.clone()),
        rms_px: typical(square),
        rms_arcsec: typical(angles).map(|rms| rms / ARCSEC_RAD),
        held_out_rms_px: options.held_out.then(|| held_out::rms_px(solved)).flatten(),
        stars,
        distinct_stars: distinct,
        frames: active,
        interstar_angle_rms_arcsec: interstar_angle_rms_arcsec(solved),
        attitude_sigma_arcsec: attitude_sigma(adjusted.attitude_information.iter().flatten(), unit.sqrt()),
        map_sigma_px: Some(map_sigma(sigma.into_iter().map(|(_, sigma)| sigma).collect())),
        lit: problem.lit,
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
        iterations: adjusted.turns.iter().map(iteration).collect(),
        ..result(points, options, selection, estimates, of_points, frame_results(solved, &residuals))
    };
    let weak = coverage.warning(&problem.lit.map_or_else(|| "the frame".to_owned(), |lit| lit.in_words()), "rms");
    result.warnings = warnings(points, solved, &result, weak, &wider);
    Ok(result)
}

/// Sums over the star images used.
struct Sums {
    /// Of squared residuals, px².
    square: f64,
    /// How many there are.
    stars: usize,
    /// Of squared residuals as angles, rad².
    angles: f64,
    /// Of the squared residuals that the errors let expect, px².
    predicted: f64,
    /// How many different stars they are of.
    distinct: usize,
}

fn sums(points: &ControlPoints, solved: &Solved, residuals: &[Vec<Option<[f64; 2]>>]) -> Sums {
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let state = &adjusted.state;
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
    distinct.sort_unstable();
    distinct.dedup();
    Sums { square, stars, angles, predicted, distinct: distinct.len() }
}

/// The parameters solved, with the standard errors of a covariance in their units.
fn estimates(solved: &Solved, covariance: &[Vec<f64>]) -> Vec<ParameterEstimate> {
    let (problem, state) = (&solved.problem, &solved.adjusted.state);
    let parameters = problem.model.parameters();
    let estimate = |(k, index): (usize, &usize)| {
        let sigma = covariance[k][k].max(0.0).sqrt();
        ParameterEstimate {
            name: parameters[*index].name.clone(),
            value: state.values[*index],
            sigma,
            sigma_joint: sigma,
            unit: parameters[*index].unit.to_owned(),
        }
    };
    problem.free.iter().enumerate().map(estimate).collect()
}

fn iteration(turn: &Turn) -> Iteration {
    Iteration {
        step_px: turn.step_px,
        pair_sigma_rad: 0.0,
        pairs_down_weighted: 0,
        star_sigma_px: turn.sigma_px,
        stars_down_weighted: turn.down_weighted,
    }
}

/// What is to be minded of a result. `weak`: of the parts of the frame without stars.
fn warnings(points: &ControlPoints, solved: &Solved, result: &Calibration, weak: Option<String>, wider: &[profile::Wider]) -> Vec<String> {
    let model_names = names(&solved.problem);
    let mut warnings = solved.notes.clone();
    let without = result.per_frame.iter().filter(|frame| frame.camera_from_icrs.is_none()).count();
    warnings.extend(general_warnings(result, without, weak));
    warnings.extend(degeneracy_warnings(result));
    warnings.extend(result.combinations.iter().filter_map(|combination| combination.sentence.clone()));
    warnings.extend(wider.iter().map(|wider| {
        format!(
            "{} is hardly determined here: the cost rises so slowly away from the solution that its standard error, and those of what goes \
             with it, are {:.1} times those of the linearisation",
            model_names[wider.free], wider.factor
        )
    }));
    warnings.extend(worse::sentences(solved, points));
    warnings
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
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
    parallel::map_numbers(problem.exposures.len(), of)
}

fn frame_results(solved: &Solved, residuals: &[Vec<Option<[f64; 2]>>]) -> Vec<FrameResult> {
    let (problem, adjusted) = (&solved.problem, &solved.adjusted);
    let of = |exposure: usize| {
        let used = residuals[exposure].iter().zip(&adjusted.weights[exposure]).filter(|(_, weight)| **weight > REJECTED_WEIGHT);
        let own: Vec<[f64; 2]> = used.filter_map(|(residual, _)| *residual).collect();
        let attitude = problem.attitude(&adjusted.state, exposure).filter(|_| own.len() > 1);
        let offered = problem.exposures[exposure].images.len();
        frame_result(problem.exposures[exposure].frame, offered, &own, attitude.map(Attitude::new), adjusted.noise.frame_factors[exposure])
    };
    (0..problem.exposures.len()).map(of).collect()
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
    let parts: Vec<(f64, usize)> = parallel::map_numbers(problem.exposures.len(), of);
    let (sum, count) = parts.into_iter().fold((0.0, 0), |(sum, count), (square, pairs)| (sum + square, count + pairs));
    (count > 0).then(|| (sum / count as f64).sqrt() / ARCSEC_RAD)
}
