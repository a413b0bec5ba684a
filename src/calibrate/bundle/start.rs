//! From nothing but the ground values to a solution: starts are tried until one convinces, and what it takes for wrong is looked at again.

use nalgebra::UnitQuaternion;

use super::consensus::{self, TOLERANCE, attitudes, fix_mount};
use super::determined::check_coverage;
use super::{Adjusted, Attitudes, Noise, NoiseMemory, Problem, Run, Solved, State, drop_without_effect, pose, scales};
use crate::calibrate::select::Selection;
use crate::calibrate::{CalibrateError, CalibrateOptions};
use crate::effects::ids;
use crate::identify::ControlPoints;

/// A frame in which less than this share of the images has weight is tried again with the improved camera.
const POOR_SHARE: f64 = 0.45;
/// A frame is believed if so many images agree,
const MIN_AGREEING: f64 = 5.5;
/// or such a share of them.
const SUPPORTED_SHARE: f64 = 0.5;
/// Below this share of images with weight the start is not believed, and the next one tried.
const CONVINCING_SHARE: f64 = 0.3;

/// Solves the parameters that the options name, from nothing but the ground values.
pub(in crate::calibrate) fn solve(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
) -> Result<Solved, CalibrateError> {
    let (problem, mut notes) = pose(points, options, selection)?;
    let solved = start(&problem, points, options, &mut notes)?;
    Ok(Solved { notes, ..solved })
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
        let wide = consensus::attitudes(&problem, 3.0 * tolerance_px / f);
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
    check_coverage(&problem, &state, &scale)?;
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
pub(super) fn settled(problem: &Problem, mut adjusted: Adjusted, run: &Run) -> Adjusted {
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
