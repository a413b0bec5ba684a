//! `[[effects]]` of a scene: any displacement, any pixel effect and any light of the sky of the registries with parameters of its own, beside what
//! `sky.physics` has at its known size and what `[detector]` and `[sky]` say of the everyday ones.

use std::sync::Arc;

use super::sky_light::GlowSetting;
use super::{DetectorTable, EffectTable, Exposure, Exposures, PsfTable, SceneError, SkyTable};
use crate::camera::{Model, SkyChain, Term};
use crate::effects::detector::adc::full_scale_dn;
use crate::effects::ids;
use crate::effects::pixel::{AnyPixelEffect, pixel_effect};
use crate::effects::sky::glow::{SKY_GLOWS, SkyGlow, sky_glow};
use crate::effects::{Context, Effect, Observation, ParameterSpec, Segment, StarState, displacement, effects, id_of};
use crate::imaging::EffectSetting;

/// What the tables put in force.
#[derive(Debug, Default)]
pub(super) struct InForce {
    /// What moves the stars' images.
    pub(super) terms: Vec<Term>,
    /// What works on pixels.
    pub(super) pixels: Vec<EffectSetting>,
    /// What lights the sky between the stars.
    pub(super) glows: Vec<GlowSetting>,
}

/// Reads the tables: each effect once, its parameters in the order of the effect.
pub(super) fn in_force(path: &str, tables: &[EffectTable], detector: &DetectorTable) -> Result<InForce, SceneError> {
    let mut found = InForce::default();
    for (index, table) in tables.iter().enumerate() {
        let wrong = |what: String| SceneError::Parse { path: path.to_owned(), message: format!("effects[{index}]: {what}") };
        let twice = |id: &str| wrong(format!("{id} is listed twice; keep one of the two"));
        if let Some(effect) = on_pixels(table) {
            let setting = setting(effect, table, detector).map_err(wrong)?;
            if found.pixels.iter().any(|other| other.id == setting.id) {
                return Err(twice(effect.id()));
            }
            found.pixels.push(setting);
        } else if let Some(glow) = sky_glow(&id_of(&table.id)) {
            let setting = GlowSetting { index, glow, parameters: glow_parameters(glow, table).map_err(wrong)? };
            if found.glows.iter().any(|other| other.glow.id() == glow.id()) {
                return Err(twice(glow.id()));
            }
            found.glows.push(setting);
        } else {
            let term = term(table).map_err(wrong)?;
            if found.terms.iter().any(|other| other.effect == term.effect) {
                return Err(twice(&term.effect));
            }
            found.terms.push(term);
        }
    }
    Ok(found)
}

/// The pixel effect that a table means: a cause may have a face on pixels beside its displacement.
fn on_pixels(table: &EffectTable) -> Option<&'static dyn AnyPixelEffect> {
    crate::effects::effect(&table.id)?.on_pixels(table.parameters.keys().map(String::as_str))
}

/// Refuses an effect that would do nothing in an exposure, because the exposure does not have what it follows.
pub(super) fn check_telemetry(path: &str, tables: &[EffectTable], terms: &[Term], exposures: &Exposures) -> Result<(), SceneError> {
    for term in terms {
        let Some(effect) = displacement(&term.effect) else { continue };
        let index = tables.iter().position(|table| id_of(&table.id) == term.effect).unwrap_or_default();
        for (number, exposure) in exposures.kinds().enumerate() {
            let known = exposure.sky.observation();
            let follows = |unit: &str| {
                let used = effect.parameters().iter().zip(&term.parameters).filter(|(_, value)| **value != 0.0);
                used.map(|(spec, _)| spec.name).any(|name| name.ends_with(unit))
            };
            let missing = effect.unmet_requirement(known).or_else(|| {
                let no_temperature = known.temperature_offset_k.is_none() && follows("_per_kelvin");
                let no_time = known.time_offset_h.is_none() && follows("px_per_hour");
                // An amplitude is that of the size which the exposure lets expect.
                let no_size = follows("amplitude") && effect.predicted(known).is_none();
                no_temperature
                    .then_some("the temperature of the frames is not known")
                    .or(no_time.then_some("the time of the frames is not known"))
                    .or(no_size.then_some(effect.facts().unknown_size))
            });
            if let Some(reason) = missing {
                let id = &term.effect;
                let message = format!(
                    "effects[{index}]: {id} does nothing in exposure {number}: {reason}; say it in the scene (time_utc, temperature_c, pressure_hpa of each of [[frames]], [site]), or leave the effect out"
                );
                return Err(SceneError::Parse { path: path.to_owned(), message });
            }
        }
    }
    Ok(())
}

/// Refuses an image of a star that follows the temperature where an exposure has none.
pub(super) fn check_psf_telemetry(path: &str, psf: Option<&PsfTable>, exposures: &Exposures) -> Result<(), SceneError> {
    let terms = psf.map_or(&[][..], |psf| &psf.vary);
    let Some(index) = terms.iter().position(|term| term.temperature > 0 && term.coefficient != 0.0) else { return Ok(()) };
    let has_none = |exposure: Arc<Exposure>| exposure.sky.observation().temperature_offset_k.is_none();
    match exposures.kinds().position(has_none) {
        None => Ok(()),
        Some(number) => {
            let message = format!(
                "psf.vary[{index}]: the term follows the temperature and does nothing in exposure {number}: the temperature of the frames is not known; say temperature_c of each of [[frames]], or leave the term out"
            );
            Err(SceneError::Parse { path: path.to_owned(), message })
        }
    }
}

/// The parameters of a pixel effect: those that are given; else, where `[detector]` has a key of that name, its value; else the value at which
/// the effect does nothing, or where there is none the typical one.
fn setting(effect: &dyn AnyPixelEffect, table: &EffectTable, detector: &DetectorTable) -> Result<EffectSetting, String> {
    let (id, specs) = (effect.id().to_owned(), effect.parameters());
    let nothing = effect.identity();
    let of_detector = |name: &str| match name {
        "gain_e_per_dn" => Some(detector.gain_e_per_dn),
        "bias_dn" => Some(detector.bias_dn),
        "full_well_e" => Some(detector.full_well_e),
        "saturation_dn" => Some(detector.top_dn()),
        "bits" => Some(f64::from(detector.bits)),
        "read_noise_e" => Some(detector.read_noise_e),
        _ => None,
    };
    let mut parameters: Vec<(String, f64)> = Vec::with_capacity(specs.len());
    for (place, spec) in specs.iter().enumerate() {
        let default = || nothing.as_ref().and_then(|values| values.get(place).copied());
        let value = of_detector(spec.name).or_else(default).unwrap_or(spec.typical);
        parameters.push((spec.name.to_owned(), value));
    }
    for (name, value) in &table.parameters {
        let place = place_of(&id, specs, name, *value)?;
        parameters[place].1 = *value;
    }
    let of = |name: &str| parameters.iter().find(|(other, _)| other == name).map(|(_, value)| *value);
    if let (Some(top), Some(bits)) = (of("saturation_dn"), of("bits"))
        && top > full_scale_dn(bits)
    {
        return Err(format!("{id}.saturation_dn = {top} lies beyond {}, the end of {bits} bits", full_scale_dn(bits)));
    }
    // Whoever lists an effect wants it; one that is switched to nothing on purpose has its parameter written.
    let is_idle = || nothing.as_ref().is_some_and(|values| !values.is_empty() && parameters.iter().map(|(_, value)| value).eq(values));
    if table.parameters.is_empty() && is_idle() {
        let names: Vec<&str> = specs.iter().map(|spec| spec.name).collect();
        return Err(format!("{id} does nothing without parameters; give some of {}", names.join(", ")));
    }
    Ok(EffectSetting { id: effect.id().to_owned(), parameters })
}

/// The parameters of a light of the sky: those that are given, else the typical ones.
fn glow_parameters(glow: &dyn SkyGlow, table: &EffectTable) -> Result<Vec<f64>, String> {
    let mut parameters: Vec<f64> = glow.parameters().iter().map(|spec| spec.typical).collect();
    for (name, value) in &table.parameters {
        parameters[place_of(glow.id(), glow.parameters(), name, *value)?] = *value;
    }
    Ok(parameters)
}

/// Where a parameter stands among those of its effect, if its value is allowed.
fn place_of(id: &str, specs: &[ParameterSpec], name: &str, value: f64) -> Result<usize, String> {
    let Some(place) = specs.iter().position(|spec| spec.name == name) else {
        let of_pixels = pixel_effect(id).map_or(&[][..], |effect| effect.parameters());
        let mut names: Vec<&str> = specs.iter().chain(of_pixels).map(|spec| spec.name).collect();
        names.dedup();
        let has = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        return Err(format!("{id} has no parameter {name}; it has {has}"));
    };
    let (low, high) = specs[place].range;
    if (low..=high).contains(&value) { Ok(place) } else { Err(format!("{id}.{name} = {value} must lie between {low} and {high}")) }
}

/// The pixel effects of a scene: those that every camera has, by the numbers of `[detector]` and `[sky]`, and those that are listed, which take
/// the place of the former. What does nothing is left out.
#[must_use]
pub(super) fn of_camera(detector: &DetectorTable, sky: &SkyTable, listed: &[EffectSetting]) -> Vec<EffectSetting> {
    let adc = [
        ("gain_e_per_dn", detector.gain_e_per_dn),
        ("bias_dn", detector.bias_dn),
        ("full_well_e", detector.full_well_e),
        ("saturation_dn", detector.top_dn()),
        ("bits", f64::from(detector.bits)),
    ];
    let mut effects = vec![
        EffectSetting::new(ids::BACKGROUND, &[("background_e_per_px_s", sky.even_e_per_px_s())]),
        EffectSetting::new(ids::PHOTON_NOISE, &[]),
        EffectSetting::new(ids::READ_NOISE, &[("read_noise_e", detector.read_noise_e)]),
        EffectSetting::new(ids::ADC, &adc),
    ];
    effects.retain(|usual| listed.iter().all(|other| other.id != usual.id));
    let does_nothing = |setting: &EffectSetting| {
        let nothing = pixel_effect(&setting.id).and_then(AnyPixelEffect::identity);
        nothing.is_some_and(|values| !values.is_empty() && setting.parameters.iter().map(|(_, value)| *value).eq(values))
    };
    effects.extend(listed.iter().filter(|setting| !does_nothing(setting)).cloned());
    effects
}

fn term(table: &EffectTable) -> Result<Term, String> {
    let id = id_of(&table.id);
    let id = id.as_str();
    let Some(effect) = displacement(id) else {
        let known = effects().map(|effect| effect.id()).chain(SKY_GLOWS.iter().map(|glow| glow.id()));
        let nearest = known.min_by_key(|known| strsim::damerau_levenshtein(id, known));
        return Err(format!("there is no effect {id}; did you mean {}?", nearest.unwrap_or_default()));
    };
    let nothing = Context::new(StarState::default(), Observation::default());
    let Some(mut parameters) = effect.identity(&nothing).filter(|_| !effect.facts().is_of_every_camera) else {
        return Err(format!("{id} is part of [camera] and cannot be added to it; leave it out"));
    };
    if table.parameters.is_empty() && !parameters.is_empty() {
        let mut names: Vec<&str> = crate::effects::effect(id).iter().flat_map(Effect::parameters).map(|spec| spec.name).collect();
        names.dedup();
        return Err(format!("{id} does nothing without parameters; give some of {}", names.join(", ")));
    }
    for (name, value) in &table.parameters {
        let place = place_of(id, effect.parameters(), name, *value)?;
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
