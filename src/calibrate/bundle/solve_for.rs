//! Free parameters of a solution: from names, as on the command line and in files, to places in the model.

use std::borrow::Cow;

use super::problem::Exposure;
use crate::calibrate::CalibrateError;
use crate::camera::{Model, PARAMETER_NAMES};
use crate::effects::{AnyDisplacement, Context, DISPLACEMENTS, Observation, Segment, displacement};

/// Whether an effect has parameters of its own to solve for: those of the reference model are x0, y0, f, k1, p1, p2.
fn has_own_parameters(effect: &dyn AnyDisplacement) -> bool {
    !effect.facts().is_of_every_camera
}

/// Puts the effects that the names ask for into the model, and gives the indices of the parameters to solve, in the model's order.
///
/// A name is a parameter of the reference model, an effect (those of its parameters that it says), `effect.parameter`, or a parameter's
/// own name if no other effect has one of that name. Effects begin switched off; `first` is a star and an exposure to say what that means.
pub(in crate::calibrate) fn solve_for(
    model: &mut Model,
    names: &[String],
    first: &Context,
    observations: &[Observation],
) -> Result<Vec<usize>, CalibrateError> {
    let mut wanted: Vec<(&'static str, usize)> = Vec::new();
    for given in names {
        if let Some(index) = PARAMETER_NAMES.iter().position(|name| name == given) {
            wanted.push(("", index));
            continue;
        }
        let (effect, parameters) = find(&full_name(given), observations).ok_or_else(|| unknown(given))?;
        let lacks = observations.iter().find_map(|observation| effect.unmet_requirement(observation));
        if let Some(reason) = lacks {
            return Err(CalibrateError::NotSolvable { name: given.clone(), reason: reason.to_owned() });
        }
        if effect.segment() == Segment::Projection {
            if effect.id() != model.projection() {
                return Err(CalibrateError::NotSolvable {
                    name: given.clone(),
                    reason: format!("the projection is {}, not {}", model.projection(), effect.id()),
                });
            }
            wanted.extend(parameters.iter().filter(|index| **index >= 3).map(|index| (effect.id(), *index)));
            continue;
        }
        if model.terms().all(|(id, _)| id != effect.id()) {
            let off = effect.identity(first).unwrap_or_else(|| vec![0.0; effect.parameters().len()]);
            let refuse = |error: crate::camera::ModelError| CalibrateError::NotSolvable { name: given.clone(), reason: error.to_string() };
            model.set(effect.id(), &off).map_err(refuse)?;
        }
        wanted.extend(parameters.into_iter().map(|index| (effect.id(), index)));
    }
    let all = model.parameters();
    let free: Vec<usize> = (0..all.len())
        .filter(|index| wanted.iter().any(|(effect, own)| all[*index].effect == *effect && all[*index].index == *own))
        .collect();
    if free.is_empty() {
        return Err(CalibrateError::BadOption { name: "solve", value: "nothing".to_owned(), allowed: "parameters or effects" });
    }
    if free.len() > super::normal::MAX_PARAMETERS {
        return Err(CalibrateError::BadOption {
            name: "solve",
            value: format!("{} parameters", free.len()),
            allowed: "at most 40 parameters",
        });
    }
    Ok(free)
}

/// Refuses a parameter that no star image tells anything of, whatever the exposures know.
pub(in crate::calibrate) fn images_tell(model: &Model, free: &[usize], exposures: &[Exposure]) -> Result<(), CalibrateError> {
    let parameters = model.parameters();
    for parameter in free.iter().map(|index| &parameters[*index]) {
        let Some(effect) = displacement(parameter.effect) else { continue };
        let mut images = exposures.iter().flat_map(|of| of.images.iter().map(|image| image.context(&of.observation)));
        let Some(reason) = images.next().and_then(|context| effect.unmet_in_context(&context)) else { continue };
        if images.all(|context| effect.unmet_in_context(&context).is_some()) {
            return Err(CalibrateError::NotSolvable { name: parameter.effect.to_owned(), reason: reason.to_owned() });
        }
    }
    Ok(())
}

/// The effect that a name means and the indices of its parameters.
fn find(name: &str, observations: &[Observation]) -> Option<(&'static dyn AnyDisplacement, Vec<usize>)> {
    let observation = observations.first().copied().unwrap_or_default();
    let allowed = |effect: &'static dyn AnyDisplacement| has_own_parameters(effect).then_some(effect);
    if let Some(effect) = displacement(name).and_then(allowed) {
        let fitted = if effect.segment() == Segment::Projection {
            (0..effect.parameters().len()).collect()
        } else {
            effect.default_free(&observation)
        };
        return Some((effect, fitted));
    }
    if let Some((id, parameter)) = name.split_once('.') {
        let effect = displacement(id).and_then(allowed)?;
        let index = effect.parameters().iter().position(|spec| spec.name == parameter)?;
        return Some((effect, vec![index]));
    }
    let named = |effect: &&'static dyn AnyDisplacement| effect.parameters().iter().position(|spec| spec.name == name);
    let mut found = DISPLACEMENTS.iter().filter_map(|effect| allowed(*effect)).filter_map(|effect| Some((effect, named(&effect)?)));
    match (found.next(), found.next()) {
        (Some((effect, index)), None) => Some((effect, vec![index])),
        _ => None,
    }
}

/// Says what would have been understood, the most similar first.
fn unknown(given: &str) -> CalibrateError {
    let mut known: Vec<String> = PARAMETER_NAMES.iter().map(ToString::to_string).collect();
    known.extend(short_names().map(|(short, ..)| short.to_owned()));
    for effect in DISPLACEMENTS.iter().filter(|effect| has_own_parameters(**effect)) {
        known.push(effect.id().to_owned());
        known.extend(effect.parameters().iter().map(|spec| format!("{}.{}", effect.id(), spec.name)));
    }
    let nearest = known.iter().min_by_key(|name| strsim::damerau_levenshtein(given, name)).cloned().unwrap_or_default();
    CalibrateError::UnknownParameter { given: given.to_owned(), nearest }
}

/// The short names of all effects, the effect of each and the parameter that it means; without one, the whole effect.
fn short_names() -> impl Iterator<Item = (&'static str, &'static str, Option<&'static str>)> {
    DISPLACEMENTS.iter().flat_map(|effect| effect.facts().short_names.iter().map(|(short, parameter)| (*short, effect.id(), *parameter)))
}

/// The full name of a parameter that may be given by its short one.
pub(in crate::calibrate) fn full_name(name: &str) -> Cow<'_, str> {
    match short_names().find(|(short, ..)| *short == name) {
        None => name.into(),
        Some((_, effect, None)) => effect.into(),
        Some((_, effect, Some(parameter))) => format!("{effect}.{parameter}").into(),
    }
}

/// Whether the parameter is among what the names ask for.
pub(in crate::calibrate) fn names_it(names: &[String], parameter: &str) -> bool {
    let parameter = full_name(parameter);
    names.iter().map(|name| full_name(name)).any(|name| name == parameter || parameter.split('.').next() == Some(&*name))
}

/// Refuses a name that means no parameter, with the nearest that does.
pub(in crate::calibrate) fn checked(name: &str) -> Result<(), CalibrateError> {
    if PARAMETER_NAMES.contains(&name) || is_solvable(name) { Ok(()) } else { Err(unknown(name)) }
}

/// Whether this build can solve for the name.
pub(in crate::calibrate) fn is_solvable(name: &str) -> bool {
    find(&full_name(name), &[]).is_some()
}
