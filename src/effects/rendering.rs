//! What a renderer changes to show a shift of measured centres: the forward model that belongs to an effect's formula.
//!
//! The formula of an effect on the measured centre is somebody's approximation for somebody's estimator. Where stars can be rendered as the
//! recording has them, a little more and a little less of what is named here, and measured by the estimator in use, the difference is the
//! column of the parameter, with no formula in it.

/// What is rendered a little more and a little less of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rendering {
    /// A stage that works on pixels.
    Stage {
        /// Its id in the registry of pixel effects.
        effect: &'static str,
        /// Parameters that differ from the stage's typical ones: name, value for less, value for more.
        parameters: &'static [(&'static str, [f64; 2])],
        /// What the change from less to more is in units of the effect's own parameter, where stage and formula speak of the same quantity.
        step: Option<f64>,
        /// Whether it acts on a star's light in proportion to B − V − 0.6, as rendered at one magnitude, and not on the sky's.
        by_colour: bool,
    },
    /// The response within a pixel, 1 + a·cos 2πu, u from the pixel's middle along one axis (0: x, 1: y).
    WithinPixel {
        /// The axis.
        axis: usize,
        /// a for less, and for more.
        cosine: [f64; 2],
    },
    /// Coma of the third order that grows with the distance from the middle of the frame.
    Coma {
        /// Zernike coefficient (rms, waves) at the edge of the frame, for less and for more.
        waves: [f64; 2],
    },
    /// A background that rises across the image the way the measured one does, by so much along its steepest way.
    Slope,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::DISPLACEMENTS;
    use crate::effects::pixel::pixel_effect;

    /// Whoever has a formula and a stage of the same name says how the one is rendered by the other, in that stage's own parameters and within
    /// their ranges.
    #[test]
    fn what_has_a_stage_is_rendered_by_it() {
        // A gain alone moves only stars that stand on the line: its page says that other effects are the cause.
        const OF_ANOTHER_CAUSE: &str = "amplifier-step";
        let mut stages = 0;
        for effect in DISPLACEMENTS {
            let rendering = effect.rendering(0);
            let has_stage = pixel_effect(effect.id()).is_some();
            assert!(!has_stage || rendering.is_some() || effect.id() == OF_ANOTHER_CAUSE, "{} is not rendered by its stage", effect.id());
            for parameter in 1..effect.parameters().len() {
                assert_eq!(effect.rendering(parameter).is_some(), rendering.is_some(), "{}", effect.id());
            }
            let Some(Rendering::Stage { effect: stage, parameters, .. }) = rendering else { continue };
            let specs = pixel_effect(stage).unwrap_or_else(|| panic!("{}: no stage {stage}", effect.id())).parameters();
            for (name, values) in parameters {
                let spec = specs.iter().find(|spec| spec.name == *name).unwrap_or_else(|| panic!("{stage} has no parameter {name}"));
                assert!(values.iter().all(|value| (spec.range.0..=spec.range.1).contains(value)), "{stage}.{name}: {values:?}");
            }
            assert!(parameters.iter().any(|(_, [less, more])| less != more), "{stage}: nothing changes");
            stages += 1;
        }
        assert!(stages >= 4, "{stages}");
    }
}
