//! # Parallax
//!
//! ## What it does
//!
//! The camera is not at the barycentre of the solar system, so near stars stand elsewhere.
//!
//! ## Equation
//!
//! u′ = u − a·ϖ·r, normalised; ϖ = parallax (rad), r = barycentric position of the camera in au, a = amplitude.
//!
//! ## Parameters
//!
//! `amplitude`: 1 = the full effect.
//!
//! ## Signature
//!
//! At most 0.75″ (α Centauri), below 0.1″ for nearly all stars: an ellipse within the year, one
//! constant displacement within a night.
//!
//! ## Confused with
//!
//! Proper motion, in a single night.
//!
//! ## Neglected
//!
//! Nothing at the level of 1 µas; the position of the camera is that of the Earth's centre where no site is known (4e-5 au).
//!
//! ## Source
//!
//! ESA SP-1200 (1997), vol. 1, section 1.2.8; SOFA routine `pmpx`.

use crate::dual::{Real, add, constant, normalize, scale};
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};
use crate::units::ARCSEC_RAD;

/// Parallax.
#[derive(Clone, Copy, Debug)]
pub struct Parallax;

impl Displacement for Parallax {
    const ID: &'static str = "parallax";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(1.0, "the catalogue's parallaxes")),
        profile_covariates: &[("", "parallax")],
        covariate: Some("parallax"),
        demo_sizes: &[("amplitude", 100.0)],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Sky;
    const PER_STAR: bool = true;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "amplitude", unit: "", typical: 1.0, range: (-1000.0, 1000.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let shift = context.observation.position_au.unwrap_or_default().map(|component| -component * context.star.parallax_rad);
        Light { direction: normalize(add(light.direction, scale(constant(shift), parameters[0]))), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation
            .position_au
            .is_none()
            .then_some("the time of the frames is not known, so the camera's place on the Earth's orbit is not")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(observation: &Observation) -> Option<Vec<f64>> {
        observation.position_au.map(|_| vec![1.0])
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: pmpx(219.9 deg, -60.8 deg, 0, 0, px = 0.74212, rv = 0, 0 yr, pob).
        let before = [-0.374_268_929_467_726_2, -0.312_937_398_611_995_1, -0.872_922_077_269_809_6];
        let star = StarState { direction: before, parallax_rad: 0.742_12 * ARCSEC_RAD, ..StarState::default() };
        let position = [-0.974_170_437_669_016_3, -0.211_520_082_035_387_97, -0.091_758_311_406_827_72];
        let observation = Observation { position_au: Some(position), ..Observation::default() };
        let after = [-0.374_266_112_451_725_36, -0.312_937_212_804_454_9, -0.872_923_351_682_409_5];
        vec![ReferenceValue::of_direction("pyerfa 2.0.1.5, pmpx", Context::new(star, observation), vec![1.0], before, after, 1e-14)]
    }

    fn source() -> &'static str {
        page_source!("parallax.rs")
    }
}
