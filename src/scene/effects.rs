//! `[[effects]]` of a scene: any displacement of the registry with parameters of its own, beside what `sky.physics` has at its known size.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::SceneError;
use crate::camera::{Model, SkyChain, Term};
use crate::effects::{Context, DISPLACEMENTS, Observation, Segment, StarState, displacement};

/// `[[effects]]`: an effect in force.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectTable {
    /// Its id; `boresight effects` lists them.
    pub id: String,
    /// Its parameters by name; those that are left out have the value at which they do nothing.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
}

/// Reads the tables: each effect once, its parameters in the order of the effect.
pub(super) fn terms(path: &str, tables: &[EffectTable]) -> Result<Vec<Term>, SceneError> {
    let mut terms: Vec<Term> = Vec::new();
    for (index, table) in tables.iter().enumerate() {
        let wrong = |what: String| SceneError::Parse { path: path.to_owned(), message: format!("effects[{index}]: {what}") };
        let term = term(table).map_err(wrong)?;
        if terms.iter().any(|other| other.effect == term.effect) {
            return Err(wrong(format!("{} is listed twice; keep one of the two", term.effect)));
        }
        terms.push(term);
    }
    Ok(terms)
}

fn term(table: &EffectTable) -> Result<Term, String> {
    let id = table.id.as_str();
    let Some(effect) = displacement(id) else {
        let nearest = DISPLACEMENTS.iter().map(|effect| effect.id()).min_by_key(|known| strsim::damerau_levenshtein(id, known));
        return Err(format!("there is no displacement {id}; did you mean {}?", nearest.unwrap_or_default()));
    };
    let nothing = Context::new(StarState::default(), Observation::default());
    let Some(mut parameters) = effect.identity(&nothing).filter(|_| id != "brown-conrady") else {
        return Err(format!("{id} is part of [camera] and cannot be added to it; leave it out"));
    };
    let specs = effect.parameters();
    for (name, value) in &table.parameters {
        let Some(place) = specs.iter().position(|spec| spec.name == name) else {
            let names: Vec<&str> = specs.iter().map(|spec| spec.name).collect();
            return Err(format!("{id} has no parameter {name}; it has {}", names.join(", ")));
        };
        let (low, high) = specs[place].range;
        if !(low..=high).contains(value) {
            return Err(format!("{id}.{name} = {value} must lie between {low} and {high}"));
        }
        parameters[place] = *value;
    }
    Ok(Term { effect: id.to_owned(), parameters })
}

/// The camera's model with the terms behind the lens.
pub(super) fn behind_the_lens(path: &str, model: &mut Model, terms: &[Term]) -> Result<(), SceneError> {
    for term in terms.iter().filter(|term| !acts_on_the_sky(term)) {
        let wrong = |error| SceneError::Parse { path: path.to_owned(), message: format!("effects: {error}") };
        model.set(&term.effect, &term.parameters).map_err(wrong)?;
    }
    Ok(())
}

/// The chain of an exposure with the terms that act on the light before the camera, in the place of what the chain has of them.
pub(super) fn on_the_sky(known: &SkyChain, terms: &[Term]) -> SkyChain {
    let own = terms.iter().filter(|term| acts_on_the_sky(term));
    let mut effects: Vec<(&str, Vec<f64>)> = own.map(|term| (term.effect.as_str(), term.parameters.clone())).collect();
    for (id, parameters) in known.effects() {
        if effects.iter().all(|(other, _)| *other != id) {
            effects.push((id, parameters.to_vec()));
        }
    }
    SkyChain::with_parameters(*known.observation(), &effects)
}

fn acts_on_the_sky(term: &Term) -> bool {
    displacement(&term.effect).is_some_and(|effect| effect.segment() == Segment::Sky)
}
