//! The problem that options and points pose, and its parameters by name.

use super::{Attitudes, Exposure, Prior, Problem, solve_for};
use crate::calibrate::select::Selection;
use crate::calibrate::{AttitudeModel, CalibrateError, CalibrateOptions, LitCircle};
use crate::camera::{Model, PARAMETER_COUNT, PARAMETER_NAMES};
use crate::effects::Segment;
use crate::identify::ControlPoints;

/// Places of these parameters in the model; effects that it does not hold come into it, switched off.
pub(in crate::calibrate) fn indices(model: &mut Model, names: &[String]) -> Option<Vec<usize>> {
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

/// Takes parameters that move no star image out of the free ones, and says so.
pub(in crate::calibrate) fn drop_without_effect(problem: &mut Problem, scale: &[f64]) -> Vec<String> {
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

/// Names of the free parameters.
pub(in crate::calibrate) fn names(problem: &Problem) -> Vec<String> {
    let parameters = problem.model.parameters();
    problem.free.iter().map(|index| parameters[*index].name.clone()).collect()
}

/// Whether a parameter belongs to the reference model.
pub(super) fn is_reference(name: &str) -> bool {
    debug_assert_eq!(PARAMETER_NAMES.len(), PARAMETER_COUNT);
    PARAMETER_NAMES.contains(&name)
}
