//! # Stellar aberration
//!
//! **What it is.** The camera moves, so light comes in from a direction tilted towards its velocity: 20.5″ from the Earth's orbit,
//! 5″ more in a low orbit, 0.3″ from the Earth's rotation.
//!
//! **Equation.** β = a·v/c, γ⁻¹ = √(1 − β²): u′ = γ⁻¹·u + (1 + u·β/(1 + γ⁻¹))·β, normalised (exact in special relativity).
//!
//! **Parameter.** `amplitude`: 1 = the velocity that is known (from the recording, or of the Earth at the recording's time).
//!
//! **What it leaves when left out.** Common to a whole frame it is absorbed by the attitude; what is left is a change of scale by
//! (v/c)·cos θ (1e-4, θ = angle between boresight and velocity) and a quadratic field: 12 % of it.
//!
//! **Confused with.** A focal length that changes from frame to frame, as long as pointings lie close together.
//!
//! **Neglected.** The potential of the Sun (0.4 µas).
//!
//! **Source.** Explanatory Supplement to the Astronomical Almanac, 3rd ed. (2013), equation 7.40; SOFA routine `ab`.

use crate::dual::{Real, add, constant, dot, normalize, scale};
use crate::effects::{Context, Displacement, Light, Observation, ParameterSpec, ReferenceValue, Segment, StarState};
use crate::units::SPEED_OF_LIGHT_KM_S;

/// Stellar aberration.
#[derive(Clone, Copy, Debug)]
pub struct StellarAberration;

impl Displacement for StellarAberration {
    const ID: &'static str = "stellar-aberration";
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "amplitude", unit: "", typical: 1.0, range: (-100.0, 100.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let known = context.observation.velocity_km_s.unwrap_or_default().map(|component| component / SPEED_OF_LIGHT_KM_S);
        let beta = scale(constant(known), parameters[0]);
        let inverse_gamma = (T::constant(1.0) - dot(beta, beta)).sqrt();
        let along = dot(light.direction, beta);
        let factor = along / (inverse_gamma + 1.0) + 1.0;
        Light { direction: normalize(add(scale(light.direction, inverse_gamma), scale(beta, factor))), ..light }
    }

    fn missing(observation: &Observation) -> Option<&'static str> {
        observation.velocity_km_s.is_none().then_some("neither the velocity of the camera nor the time of the frames is known")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn known(observation: &Observation) -> Option<Vec<f64>> {
        observation.velocity_km_s.map(|_| vec![1.0])
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: ab(u, v / c, s = 1e30 au (no Sun), bm1), u = s2c(83.633 deg, 22.0145 deg).
        let observation = Observation { velocity_km_s: Some([-12.1, 24.9, 10.7]), ..Observation::default() };
        let before = [0.102_810_969_017_083_31, 0.921_370_696_114_030_9, 0.374_841_226_377_401_7];
        let after = [0.102_761_793_115_334_11, 0.921_374_739_463_527_2, 0.374_844_772_344_818_1];
        let context = Context::new(StarState::default(), observation);
        vec![ReferenceValue::of_direction("pyerfa 2.0.1.5, ab", context, vec![1.0], before, after, 1e-14)]
    }

    fn source() -> &'static str {
        include_str!("stellar_aberration.rs")
    }
}
