//! # Light deflection by the Sun
//!
//! ## What it does
//!
//! The Sun's gravity bends light that passes it: every star stands a little further from the Sun than it would without,
//! 1.75″ at the Sun's edge, 10 mas at 45° from it.
//!
//! ## Equation
//!
//! u′ = u + a·(2GM/c²)/E · (ê − u(u·ê)) / (1 + u·ê), normalised; ê = unit vector from the Sun to the camera, E = distance in
//! au. The displacement is a·4.07 mas/E·√((1 + cos ψ)/(1 − cos ψ)), ψ = angle between star and Sun. It acts before aberration.
//!
//! ## Parameters
//!
//! `amplitude`: 1 = the full effect (general relativity; ½ would be Newton's light).
//!
//! ## Signature
//!
//! A few milliarcseconds away from the Sun: far below the noise of any star camera that does not look
//! beside the Sun.
//!
//! ## Confused with
//!
//! Parallax in its direction (both act along the line to the Sun), but it does not depend on the star's distance.
//!
//! ## Neglected
//!
//! Planets (16 mas at Jupiter's edge, 0.6 mas at the Earth's horizon), the Sun's quadrupole. Within 4.9′ of the Sun's middle
//! the denominator is held, as in SOFA.
//!
//! ## Source
//!
//! Explanatory Supplement to the Astronomical Almanac, 3rd ed. (2013), section 7.2.4; SOFA routines `ld` and `ldsun`.

use crate::dual::{Real, add, constant, dot, normalize, scale};
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Schwarzschild radius of the Sun, au (SOFA's value).
const SCHWARZSCHILD_RADIUS_AU: f64 = 1.974_125_743_36e-8;
/// Smallest denominator at 1 au, as in SOFA.
const DEFLECTION_LIMIT: f64 = 1e-6;

/// Light deflection.
#[derive(Clone, Copy, Debug)]
pub struct LightDeflection;

impl Displacement for LightDeflection {
    const ID: &'static str = "light-deflection";
    const FACTS: Facts =
        Facts { ordinary_size: Some(OrdinarySize::of(1.0, "general relativity")), demo_sizes: &[("amplitude", 1000.0)], ..Facts::NONE };
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "amplitude", unit: "", typical: 1.0, range: (-1e4, 1e4) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let Some(from_sun) = context.observation.sun_au else {
            return light;
        };
        let distance_au = dot(from_sun, from_sun).sqrt();
        let away = constant::<T>(from_sun.map(|component| component / distance_au));
        let along = dot(light.direction, away);
        let limit = DEFLECTION_LIMIT / (distance_au * distance_au).max(1.0);
        let denominator = along + 1.0;
        let denominator = if denominator.value() > limit { denominator } else { T::constant(limit) };
        let strength = parameters[0] * (SCHWARZSCHILD_RADIUS_AU / distance_au) / denominator;
        let across = add(away, scale(light.direction, -along));
        Light { direction: normalize(add(light.direction, scale(across, strength))), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.sun_au.is_none().then_some("the time of the frames is not known, so the direction of the Sun is not")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(observation: &Observation) -> Option<Vec<f64>> {
        observation.sun_au.map(|_| vec![1.0])
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: ldsun(p, e / em, em), e = (-0.9, -0.35, -0.15) au, em = |e|; p at 1.7° from the Sun and at 137°.
        let observation = Observation { sun_au: Some([-0.9, -0.35, -0.15]), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        [
            (
                [0.925_416_578_398_323_4, 0.336_824_088_833_465_15, 0.173_648_177_666_930_33],
                [0.925_416_764_092_386_8, 0.336_823_103_897_430_86, 0.173_649_098_527_832_06],
            ),
            (
                [-0.663_413_948_168_938_4, 0.383_022_221_559_488_95, -0.642_787_609_686_539_3],
                [-0.663_413_955_121_354_1, 0.383_022_214_141_564_7, -0.642_787_606_931_197_2],
            ),
        ]
        .into_iter()
        .map(|(before, after)| ReferenceValue::of_direction("pyerfa 2.0.1.5, ldsun", context, vec![1.0], before, after, 2e-12))
        .collect()
    }

    fn source() -> &'static str {
        page_source!("light_deflection.rs")
    }
}
