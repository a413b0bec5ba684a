//! Bundle adjustment: camera and attitudes solved together, from the positions of single stars.
//!
//! Every star image counts for itself, weighted by the covariance of its measurement; an attitude is a rotation and nothing else (a free
//! translation would trade with the focal length); identifications are right or wrong with a probability that comes out of the fit.
//!
//! | file | what it holds |
//! |---|---|
//! | [`mod@solve_for`] | names → parameters of the model |
//! | [`problem`] | star images, and their linearisation |
//! | [`mod@reference`] | the reference model's derivatives in closed form |
//! | [`consensus`] | the start: focal length and attitudes, whatever is wrong |
//! | [`noise`] | weights, scale, share of wrong identifications |
//! | [`normal`] | normal equations, attitudes eliminated |
//! | [`adjust`] | the iteration |
//! | [`mapping`] | the map over the frame: uncertainty, coverage |
//! | [`memory`] | what earlier solutions know, in constant size |
//! | [`mod@update`] | new frames with what earlier solutions know |
//! | [`change`] | whether these are of the same camera |
//! | [`profile`] | standard errors of what is hardly determined, from the cost itself |
//! | [`held_out`] | cross-validation without solving anew |
//! | [`selection`] | which parameters the data support |
//! | [`worse`] | why a frame is worse than the others |
//! | [`summary`] | the result |
//!
//! Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000), for the elimination; Brown (1971) for self-calibration.

mod adjust;
mod change;
mod consensus;
mod held_out;
mod mapping;
mod memory;
mod noise;
mod normal;
mod problem;
mod profile;
mod reference;
mod selection;
mod solve_for;
mod summary;
mod update;
mod worse;

use nalgebra::{Matrix3, UnitQuaternion};
use rayon::prelude::*;

pub(super) use adjust::{Adjusted, Run, scales};
pub(super) use mapping::map_sigma_px;
pub(super) use memory::{CLASSES, NoiseMemory};
pub(super) use noise::Noise;
pub(super) use problem::{Attitudes, Exposure, MAX_LOCAL as MAX_FRAME_PARAMETERS, Prior, Problem, State, earth_from_icrs};
pub(super) use solve_for::{checked as check_name, solve_for};
pub(super) use update::{Known, Updated, inverse, update};

use selection::Alternative;

use super::select::Selection;
use super::{AttitudeModel, CalibrateError, CalibrateOptions, Calibration, LitCircle};
use crate::camera::{Model, PARAMETER_COUNT, PARAMETER_NAMES};
use crate::effects::Segment;
use crate::effects::ids;
use crate::identify::ControlPoints;

/// Images agree with an attitude within this share of the frame's diagonal, before the distortion is known.
const TOLERANCE: f64 = 0.006;
/// A frame in which less than this share of the images has weight is tried again with the improved camera.
const POOR_SHARE: f64 = 0.45;
/// A frame is believed if so many images agree,
const MIN_AGREEING: f64 = 5.5;
/// or such a share of them.
const SUPPORTED_SHARE: f64 = 0.5;
/// Below this share of images with weight the start is not believed, and the next one tried.
const CONVINCING_SHARE: f64 = 0.3;

/// The optimal rotation of a profile matrix Σ to·fromᵀ.
pub(crate) fn optimal_rotation(profile: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    consensus::optimal(profile)
}

/// A solved problem.
#[derive(Clone, Debug)]
pub(super) struct Solved {
    /// What was adjusted, the model at the solution.
    pub(super) problem: Problem,
    /// Where it ended.
    pub(super) adjusted: Adjusted,
    /// What to mind.
    pub(super) notes: Vec<String>,
    /// A larger model that the star images do not support and need not exclude.
    pub(super) alternative: Option<Alternative>,
}

/// Calibrates.
pub(super) fn calibrate(points: &ControlPoints, options: &CalibrateOptions, selection: &Selection) -> Result<Calibration, CalibrateError> {
    let started = std::time::Instant::now();
    let (solved, chosen) = if options.select_model || options.extend_model {
        let (solved, report) = selection::select(points, options, selection)?;
        (solved, Some(report))
    } else {
        (solve(points, options, selection)?, None)
    };
    let mut result = summary::summarise(points, options, selection, &solved)?;
    result.selection = chosen;
    result.seconds = started.elapsed().as_secs_f64();
    Ok(result)
}

/// Solves the parameters that the options name, from nothing but the ground values.
pub(super) fn solve(points: &ControlPoints, options: &CalibrateOptions, selection: &Selection) -> Result<Solved, CalibrateError> {
    let (problem, mut notes) = pose(points, options, selection)?;
    let solved = start(&problem, points, options, &mut notes)?;
    Ok(Solved { notes, ..solved })
}

/// Places of these parameters in the model; effects that it does not hold come into it, switched off.
pub(super) fn indices(model: &mut Model, names: &[String]) -> Option<Vec<usize>> {
    let first = model.reference_context();
    let missing: Vec<String> = {
        let known = model.parameters();
        names.iter().filter(|name| known.iter().all(|parameter| parameter.name != **name)).cloned().collect()
    };
    if !missing.is_empty() {
        solve_for(model, &missing, &first, &[first.observation]).ok()?;
    }
    let known = model.parameters();
    names.iter().map(|name| known.iter().position(|parameter| parameter.name == *name)).collect()
}

/// The problem that the options and the points pose.
pub(super) fn pose(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
) -> Result<(Problem, Vec<String>), CalibrateError> {
    let mut notes = Vec::new();
    let indices: Vec<(usize, Vec<usize>)> =
        selection.frames.iter().map(|frame| (frame.frame, frame.stars.iter().map(|star| star.point).collect())).collect();
    let exposures = Problem::exposures(points, indices.iter().map(|(frame, indices)| (*frame, indices.as_slice())));
    let not_solvable = |name: &str, reason: String| CalibrateError::NotSolvable { name: name.to_owned(), reason };
    let mut model = Model::new(points.nominal)
        .with_projection(&options.projection, &options.projection_parameters)
        .map_err(|error| not_solvable(&options.projection, error.to_string()))?;
    for term in points.sky.iter().chain(&options.terms) {
        model.set(&term.effect, &term.parameters).map_err(|error| not_solvable(&term.effect, error.to_string()))?;
    }
    let observations: Vec<_> = exposures.iter().map(|exposure| exposure.observation).collect();
    let first = exposures.first().and_then(|exposure| exposure.images.first().map(|image| image.context(&exposure.observation)));
    let first = first.ok_or(CalibrateError::TooFewPoints { offered: points.points.len(), usable: 0, frames: 0 })?;
    let free = solve_for(&mut model, &options.solve, &first, &observations)?;
    solve_for::images_tell(&model, &free, &exposures)?;
    let parameters = model.parameters();
    let priors = options
        .priors
        .iter()
        .map(|prior| {
            let place = free.iter().position(|index| parameters[*index].name == solve_for::full_name(&prior.name));
            let free = place.ok_or_else(|| not_solvable(&prior.name, "a prior is given for it, but it is not solved".to_owned()))?;
            if !(prior.sigma > 0.0 && prior.sigma.is_finite() && prior.value.is_finite()) {
                return Err(not_solvable(&prior.name, "its prior needs a finite value and a standard error above 0".to_owned()));
            }
            Ok(Prior { free, value: prior.value, sigma: prior.sigma })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let is_sky = |index: &usize| crate::effects::displacement(parameters[*index].effect).is_some_and(|e| e.segment() == Segment::Sky);
    let solves_sky = free.iter().any(is_sky);
    let attitudes = if options.attitudes == AttitudeModel::Free {
        Attitudes::Free
    } else if !points.fixed_mount {
        if rates_are_unknown(&exposures) { Attitudes::FreeWithRates } else { Attitudes::Free }
    } else if exposures.iter().all(|exposure| exposure.observation.earth_from_icrs.is_some()) {
        Attitudes::FixedToEarth
    } else {
        notes.push("the mount is said to be fixed, but not all frames have a time: each frame has an attitude of its own".to_owned());
        Attitudes::Free
    };
    let lit = LitCircle::of(points, &options.projection);
    Ok((Problem { model, free, priors, carried: None, exposures, attitudes, solves_sky, at_predicted: false, lit }, notes))
}

/// Whether the rows are exposed one after the other while nobody says how the camera turned.
fn rates_are_unknown(exposures: &[Exposure]) -> bool {
    exposures.iter().all(|exposure| {
        let rolling = exposure.observation.sensor.is_some_and(|sensor| sensor.line_time_s.is_some_and(|time| time != 0.0));
        rolling && exposure.observation.rate_rad_s.is_none()
    })
}

/// Finds a start, and adjusts from there; the next start where the first does not convince.
fn start(problem: &Problem, points: &ControlPoints, options: &CalibrateOptions, notes: &mut Vec<String>) -> Result<Solved, CalibrateError> {
    let f_is_free = problem.free.contains(&2) && problem.model.projection() == ids::PINHOLE;
    let mut factors = if f_is_free { consensus::focal_length_factors(problem, &problem.model) } else { Vec::new() };
    factors.push(1.0);
    let mut best: Option<Solved> = None;
    let mut none = CalibrateError::NoConsensus { images: problem.image_count(), frames: problem.exposures.len() };
    for factor in factors {
        let solved = match from_focal_length(problem, points, options, factor) {
            Ok(Some(solved)) => solved,
            Ok(None) => continue,
            Err(error) => {
                none = error;
                continue;
            }
        };
        let share = solved.adjusted.weight_sum / problem.image_count().max(1) as f64;
        let better = best.as_ref().is_none_or(|best| solved.adjusted.weight_sum > 1.05 * best.adjusted.weight_sum);
        if better {
            best = Some(solved);
        }
        if share > CONVINCING_SHARE {
            break;
        }
    }
    let solved = best.ok_or(none)?;
    let lost = solved.adjusted.state.attitudes.iter().filter(|attitude| attitude.is_none()).count();
    if lost > 0 && problem.attitudes != Attitudes::FixedToEarth {
        notes.push(format!("{lost} frames take no part: no three of their star images agree on an attitude"));
    }
    notes.extend(solved.notes.iter().cloned());
    Ok(solved)
}

/// Adjusts from a focal length that is `factor` times the ground value. `None` without a start; an error where the star images leave the
/// map open, so that no adjustment could end well.
fn from_focal_length(
    problem: &Problem,
    points: &ControlPoints,
    options: &CalibrateOptions,
    factor: f64,
) -> Result<Option<Solved>, CalibrateError> {
    let mut problem = problem.clone();
    let mut notes = Vec::new();
    let mut values = problem.model.values();
    values[2] *= factor;
    // The distortion is in px of the measured frame, so it stays.
    problem.model.set_values(&values);
    let camera = problem.model.camera();
    let diagonal_px = (camera.width_px as f64).hypot(camera.height_px as f64);
    let f = camera.focal_length_px;
    let mut tolerance_px = TOLERANCE * diagonal_px;
    let (mut attitudes, mut agreeing) = attitudes(&problem, tolerance_px / f);
    if 5 * agreeing < 2 * problem.image_count() {
        let wide = self::attitudes(&problem, 3.0 * tolerance_px / f);
        if 2 * wide.1 > 3 * agreeing {
            (attitudes, agreeing) = wide;
            tolerance_px *= 3.0;
        }
    }
    for (attitude, exposure) in attitudes.iter_mut().zip(&problem.exposures) {
        if attitude.is_none() {
            *attitude = points.attitudes.get(exposure.frame).copied().flatten().map(|attitude| attitude.camera_from_icrs);
        }
    }
    if agreeing == 0 && attitudes.iter().all(Option::is_none) {
        return Ok(None);
    }
    let mut state = State { values, rates: vec![[0.0; 3]; attitudes.len()], mount: UnitQuaternion::identity(), attitudes };
    if problem.attitudes == Attitudes::FixedToEarth && !fix_mount(&problem, &mut state, 3.0 * tolerance_px / f) {
        notes.push(
            "the mount is said to be fixed, but the attitudes of most frames do not fit one place on the turning Earth: each frame has an attitude of its own".to_owned(),
        );
        problem.attitudes = Attitudes::Free;
    }
    let mut scale = scales(&problem, &state);
    if scale.iter().any(|scale| !(scale.is_finite() && *scale > 0.0)) {
        // Said by the summary, which knows names; the parameter is held at its start meanwhile.
        notes.extend(drop_without_effect(&mut problem, &scale));
        scale = scales(&problem, &state);
    }
    if scale.is_empty() {
        return Ok(None);
    }
    summary::check_coverage(&problem, &state, &scale)?;
    let noise = Noise {
        floor_px2: (tolerance_px / 3.0).powi(2),
        wrong_share: 0.3,
        wrong_radius_px: 0.05 * diagonal_px,
        frame_factors: vec![1.0; problem.exposures.len()],
        focal_length_px: f,
        before: NoiseMemory::default(),
        unit_variance: 1.0,
    };
    let run = Run { epsilon_px: options.epsilon_px, max_turns: options.max_iterations, from_afar: true, hold_noise: false };
    let adjusted = problem.adjust(state, noise, &scale, &run, None);
    let adjusted = settled(&problem, adjusted, &run);
    problem.model.set_values(&adjusted.state.values);
    Ok(Some(Solved { problem, adjusted, notes, alternative: None }))
}

/// An adjustment once more, where frames find a better attitude with the camera as it is now known, and where frames are not supported.
fn settled(problem: &Problem, mut adjusted: Adjusted, run: &Run) -> Adjusted {
    if problem.attitudes == Attitudes::FixedToEarth {
        return adjusted;
    }
    for look in [try_poor_frames_again, drop_unsupported_frames] {
        if look(problem, &mut adjusted) {
            let turns = std::mem::take(&mut adjusted.turns);
            let run = Run { from_afar: false, ..*run };
            let scale = std::mem::take(&mut adjusted.scale);
            adjusted = problem.adjust(adjusted.state, adjusted.noise, &scale, &run, None);
            adjusted.turns.splice(0..0, turns);
        }
    }
    adjusted
}

/// An attitude has three parameters, so a few wrong images can agree on one by chance. A frame in which few images have weight, both in
/// number and in share, takes no part. Whether there was one.
fn drop_unsupported_frames(problem: &Problem, adjusted: &mut Adjusted) -> bool {
    let mut dropped = false;
    for (index, exposure) in problem.exposures.iter().enumerate() {
        let weight: f64 = adjusted.weights[index].iter().sum();
        if adjusted.state.attitudes[index].is_some() && weight < MIN_AGREEING && weight < SUPPORTED_SHARE * exposure.images.len() as f64 {
            adjusted.state.attitudes[index] = None;
            dropped = true;
        }
    }
    dropped
}

/// Takes parameters that move no star image out of the free ones, and says so.
pub(super) fn drop_without_effect(problem: &mut Problem, scale: &[f64]) -> Vec<String> {
    let parameters = problem.model.parameters();
    let has_effect = |k: usize| scale[k].is_finite() && scale[k] > 0.0;
    let notes = (0..problem.free.len())
        .filter(|k| !has_effect(*k))
        .map(|k| {
            format!(
                "{} moves no star image here (what it depends on does not vary, or is not known) and keeps its starting value",
                parameters[problem.free[k]].name
            )
        })
        .collect();
    let kept: Vec<usize> = (0..problem.free.len()).filter(|k| has_effect(*k)).collect();
    problem.priors =
        problem.priors.iter().filter_map(|prior| Some(Prior { free: kept.iter().position(|k| *k == prior.free)?, ..*prior })).collect();
    problem.free = kept.iter().map(|k| problem.free[*k]).collect();
    notes
}

/// For each frame the attitude that most of its images agree on, and how many images agree in all.
fn attitudes(problem: &Problem, tolerance_rad: f64) -> (Vec<Option<UnitQuaternion<f64>>>, usize) {
    let found: Vec<_> = problem
        .exposures
        .par_iter()
        .with_min_len(4)
        .map(|exposure| consensus::attitude(exposure, &consensus::rays(&problem.model, exposure), tolerance_rad))
        .collect();
    let agreeing = found.iter().flatten().map(|(_, agreeing)| agreeing).sum();
    (found.into_iter().map(|found| found.map(|(attitude, _)| attitude)).collect(), agreeing)
}

/// Frames in which few images have weight may have begun with a wrong attitude: with the camera as it is now known a better one is
/// looked for. Whether one was found.
fn try_poor_frames_again(problem: &Problem, adjusted: &mut Adjusted) -> bool {
    const SIGMAS: f64 = 8.0;
    let mut model = problem.model.clone();
    model.set_values(&adjusted.state.values);
    let mut found = false;
    for (index, exposure) in problem.exposures.iter().enumerate() {
        let weight: f64 = adjusted.weights[index].iter().sum();
        if weight > POOR_SHARE * exposure.images.len() as f64 {
            continue;
        }
        let typical_px2 = exposure.images.iter().map(|image| image.covariance_px2[0] + image.covariance_px2[2]).sum::<f64>()
            / (2.0 * exposure.images.len().max(1) as f64);
        let tolerance_px = (SIGMAS * (typical_px2 + adjusted.noise.floor_px2).sqrt()).max(0.5);
        let rays = consensus::rays(&model, exposure);
        let voted = consensus::attitude(exposure, &rays, tolerance_px / adjusted.state.values[2]);
        if let Some((attitude, _)) = voted.filter(|(_, agreeing)| *agreeing as f64 > weight + 0.5) {
            adjusted.state.attitudes[index] = Some(attitude);
            found = true;
        }
    }
    found
}

/// One attitude to the ground from those of the frames: that on which most agree. Whether most do.
fn fix_mount(problem: &Problem, state: &mut State, tolerance_rad: f64) -> bool {
    let earth: Vec<_> = problem.exposures.iter().map(|exposure| earth_from_icrs(&exposure.observation)).collect();
    let mounts: Vec<UnitQuaternion<f64>> =
        state.attitudes.iter().zip(&earth).filter_map(|(attitude, earth)| Some((*attitude)? * (*earth)?.inverse())).collect();
    let near = |a: &UnitQuaternion<f64>| mounts.iter().filter(|b| a.angle_to(b) < tolerance_rad).count();
    let Some(best) = mounts.iter().max_by_key(|mount| near(mount)) else { return false };
    if 2 * near(best) < mounts.len() {
        return false;
    }
    let mut profile = Matrix3::zeros();
    for mount in mounts.iter().filter(|mount| mount.angle_to(best) < tolerance_rad) {
        profile += mount.to_rotation_matrix().matrix();
    }
    let Some(mount) = consensus::optimal(&profile) else { return false };
    state.mount = mount;
    for (attitude, earth) in state.attitudes.iter_mut().zip(earth) {
        *attitude = earth.map(|earth| mount * earth);
    }
    true
}

/// Names of the free parameters.
pub(super) fn names(problem: &Problem) -> Vec<String> {
    let parameters = problem.model.parameters();
    problem.free.iter().map(|index| parameters[*index].name.clone()).collect()
}

/// Whether a parameter belongs to the reference model.
pub(super) fn is_reference(name: &str) -> bool {
    debug_assert_eq!(PARAMETER_NAMES.len(), PARAMETER_COUNT);
    PARAMETER_NAMES.contains(&name)
}
