//! # Stellar aberration
//!
//! ## What it does
//!
//! The camera moves, so light comes in from a direction tilted towards its velocity: 20.5″ from the Earth's orbit,
//! 5″ more in a low orbit, 0.3″ from the Earth's rotation.
//!
//! ## Equation
//!
//! β = (a·v + w)/c, γ⁻¹ = √(1 − β²): u′ = γ⁻¹·u + (1 + u·β/(1 + γ⁻¹))·β, normalised (exact in special relativity).
//!
//! ## Parameters
//!
//! `amplitude`: a, 1 = the velocity v that is known (from the recording, or of the Earth at the recording's time).
//! `velocity_x_km_s`, `velocity_y_km_s`, `velocity_z_km_s`: w, a velocity that is added, barycentric, ICRS axes. Where v is known the
//! effect's name stands for the amplitude, elsewhere for the three components; one velocity then holds for all frames.
//!
//! ### Sizes
//!
//! Where no velocity is known the camera is at the Earth: 30.29 km/s of the Earth at its perihelion (NASA Earth Fact Sheet; the
//! Sun's own about the barycentre is 0.02 km/s), 7.8 km/s of a low orbit, and as the margin 11.2 km/s in its place, beyond which nothing stays
//! at the Earth. A velocity above 42 km/s is no aberration.
//!
//! ## Signature
//!
//! Common to a whole frame it is absorbed by the attitude; what is left is a change of scale by
//! (v/c)·cos θ (1e-4, θ = angle between boresight and velocity) and a quadratic field: 12 % of it.
//!
//! ## Confused with
//!
//! The amplitude with the component of w along v. A focal length that changes from frame to frame, as long as pointings
//! lie close together.
//!
//! ## Neglected
//!
//! The potential of the Sun (0.4 µas).
//!
//! ## Source
//!
//! Explanatory Supplement to the Astronomical Almanac, 3rd ed. (2013), equation 7.40; SOFA routine `ab`.

use crate::dual::{Real, add, constant, dot, normalize, scale};
use crate::effects::{
    Context, Displacement, Facts, Light, Natural, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState,
};
use crate::units::SPEED_OF_LIGHT_KM_S;

/// Stellar aberration.
#[derive(Clone, Copy, Debug)]
pub struct StellarAberration;

impl Displacement for StellarAberration {
    const ID: &'static str = "stellar-aberration";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(1.0, "the Earth's velocity, 29.8 km/s")),
        profile_covariates: &[("", "velocity")],
        // Along each axis of a velocity that nobody knows, km/s: 29.8/√3.
        ordinary_component: Some(17.2),
        short_names: &[("velocity", None)],
        unknown_size: "neither the velocity of the camera nor the time of the frames is known",
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "amplitude", unit: "", typical: 1.0, range: (-100.0, 100.0) },
        ParameterSpec { name: "velocity_x_km_s", unit: "km/s", typical: 17.0, range: (-1e4, 1e4) },
        ParameterSpec { name: "velocity_y_km_s", unit: "km/s", typical: 17.0, range: (-1e4, 1e4) },
        ParameterSpec { name: "velocity_z_km_s", unit: "km/s", typical: 17.0, range: (-1e4, 1e4) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let known = context.observation.velocity_km_s.unwrap_or_default().map(|component| component / SPEED_OF_LIGHT_KM_S);
        let free = [1, 2, 3].map(|index| parameters[index] / SPEED_OF_LIGHT_KM_S);
        let beta = add(scale(constant(known), parameters[0]), free);
        let inverse_gamma = (T::constant(1.0) - dot(beta, beta)).sqrt();
        let along = dot(light.direction, beta);
        let factor = along / (inverse_gamma + 1.0) + 1.0;
        Light { direction: normalize(add(scale(light.direction, inverse_gamma), scale(beta, factor))), ..light }
    }

    fn unmet_requirement(_: &Observation) -> Option<&'static str> {
        None // where no velocity is known, one can be fitted
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 4])
    }

    fn predicted(observation: &Observation) -> Option<Vec<f64>> {
        observation.velocity_km_s.map(|_| vec![1.0, 0.0, 0.0, 0.0])
    }

    fn default_free(observation: &Observation) -> Vec<usize> {
        if observation.velocity_km_s.is_some() { vec![0] } else { vec![1, 2, 3] }
    }

    fn plausible_range() -> Option<Natural> {
        // The Earth's speed at its perihelion and the speed of escape from its surface.
        Some(Natural { what: "the velocity", parameters: &[1, 2, 3], range: (0.0, 42.0) })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: ab(u, velocity / c, s = 1e30 au (no Sun), bm1), u = s2c(83.633 deg, 22.0145 deg), velocity = the known
        // one, the free one (3, -7, 1.5) km/s, and their sum.
        let before = [0.102_810_969_017_083_31, 0.921_370_696_114_030_9, 0.374_841_226_377_401_7];
        let moving = Observation { velocity_km_s: Some([-12.1, 24.9, 10.7]), ..Observation::default() };
        [
            (moving, vec![1.0, 0.0, 0.0, 0.0], [0.102_761_793_115_334_11, 0.921_374_739_463_527_2, 0.374_844_772_344_818_1]),
            (
                Observation::default(),
                vec![0.0, 3.0, -7.0, 1.5],
                [0.102_822_889_264_873_53, 0.921_364_492_399_026_5, 0.374_853_205_387_799_5],
            ),
            (moving, vec![1.0, 3.0, -7.0, 1.5], [0.102_773_712_453_003_24, 0.921_368_536_576_177_1, 0.374_856_751_087_800_75]),
        ]
        .into_iter()
        .map(|(observation, parameters, after)| {
            let context = Context::new(StarState::default(), observation);
            ReferenceValue::of_direction("pyerfa 2.0.1.5, ab", context, parameters, before, after, 1e-14)
        })
        .collect()
    }

    fn source() -> &'static str {
        page_source!("stellar_aberration.rs")
    }
}
