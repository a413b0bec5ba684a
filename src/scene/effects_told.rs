//! What is told of a scene's effects: lights of the sky by name, and what does nothing.

use std::collections::BTreeMap;

use super::Scene;
use super::sky_light::GlowSetting;
use crate::effects::{Observation, displacement};

/// Ends of the names of parameters that follow something, what they follow, and how far an exposure is from the mean of it.
type Followed = (&'static str, &'static str, fn(&Observation) -> Option<f64>);

/// All that effects behind the lens follow.
const FOLLOWED: [Followed; 3] = [
    ("_per_kelvin", "temperature", |known| known.temperature_offset_k),
    ("_per_hour", "time", |known| known.time_offset_h),
    ("_per_hpa", "pressure", |known| known.pressure_offset_hpa),
];

impl Scene {
    /// What lights the sky between the stars unevenly, with its parameters by name.
    pub fn glows(&self) -> impl Iterator<Item = (&'static str, BTreeMap<String, f64>)> + '_ {
        let named = |setting: &GlowSetting| {
            let names = setting.glow.parameters().iter().map(|spec| spec.name.to_owned());
            (setting.glow.id(), names.zip(setting.parameters.iter().copied()).collect())
        };
        self.sky_light.glows.iter().map(named)
    }

    /// Effects that follow what is measured beside the frames, counted from its mean over the exposures, and do nothing since it is the same in all of
    /// them: a sentence for each.
    #[must_use]
    pub fn idle_effects(&self) -> Vec<String> {
        let mut told = Vec::new();
        for (id, parameters) in self.model.terms() {
            let Some(effect) = displacement(id) else { continue };
            for (spec, _) in effect.parameters().iter().zip(parameters).filter(|(_, value)| **value != 0.0) {
                let Some((_, what, of)) = FOLLOWED.iter().find(|(end, ..)| spec.name.ends_with(end)) else { continue };
                if self.exposures.kinds().all(|exposure| of(exposure.sky.observation()).is_none_or(|offset| offset == 0.0)) {
                    let name = spec.name;
                    told.push(format!(
                        "{id}.{name} counts from the mean {what} of the exposures and does nothing: the {what} is the same in all of them"
                    ));
                }
            }
        }
        told
    }
}
