//! What follows telemetry counts from the mean over the frames of a recording. A sample is one frame, so nothing would follow: it is refused.

use toml::Table;

use crate::effects::displacement;
use crate::scene::Scene;

/// Ends of the names of parameters that count from such a mean, and what they follow.
const FOLLOWERS: [(&str, &str); 4] =
    [("_per_kelvin", "temperature"), ("_per_hour", "time"), ("_per_hpa", "pressure"), ("_per_frame", "number of the frame")];

/// Why an effect of a scene would do nothing in samples of one frame; `None`: all do something. `tables` are those of the scene.
pub(super) fn idle_effect(scene: &Scene, tables: &Table) -> Option<String> {
    let terms = tables.get("psf").and_then(|psf| psf.get("vary")).and_then(toml::Value::as_array).into_iter().flatten();
    let mut powers = terms.filter_map(|term| term.get("temperature")?.as_integer());
    if powers.any(|power| power > 0) {
        return Some(
            "psf.vary follows the temperature, counted from its mean over a recording, and does nothing in samples of one frame; leave the term out, and draw \
             the parameter itself"
                .to_owned(),
        );
    }
    for (id, parameters) in scene.model.terms() {
        let Some(effect) = displacement(id) else { continue };
        for (spec, _) in effect.parameters().iter().zip(parameters).filter(|(_, value)| **value != 0.0) {
            if let Some((_, what)) = FOLLOWERS.iter().find(|(end, _)| spec.name.ends_with(end)) {
                return Some(format!(
                    "the effect {id} follows the {what} with {}, counted from its mean over a recording, and does nothing in samples of one frame; leave it out, \
                     and draw per frame what it would change, as camera.focal_length_px",
                    spec.name
                ));
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};

    #[test]
    fn what_follows_a_mean_over_a_recording_is_refused() {
        let cold = SCENE.replace("exposure_s = 1.0", "exposure_s = 1.0\ntemperature_c = 5.0\ntime_utc = \"2026-01-01T00:00:00Z\"");
        assert!(plan_of(&recipe(""), &cold).is_ok());
        for (id, parameter, what) in [
            ("thermal-focal-length", "relative_per_kelvin", "temperature"),
            ("focal-length-drift", "relative_per_hour", "time"),
            ("focal-length-drift", "relative_per_frame", "number of the frame"),
        ] {
            let scene = format!("{cold}[[effects]]\nid = \"{id}\"\nparameters = {{ {parameter} = 1e-5 }}\n");
            let refused = plan_of(&recipe(""), &scene).unwrap_err();
            assert!(refused.contains(&format!("the effect {id} follows the {what} with {parameter}")), "{refused}");
        }
        let psf = "[psf]\nkind = \"gaussian\"\nparameters = { sigma_px = 1.0 }\n\
                   [[psf.vary]]\nparameter = \"sigma_px\"\ncoefficient = 0.1\ntemperature = 1\n";
        let refused = plan_of(&recipe(""), &format!("{cold}{psf}")).unwrap_err();
        assert!(refused.contains("psf.vary follows the temperature"), "{refused}");
    }
}
