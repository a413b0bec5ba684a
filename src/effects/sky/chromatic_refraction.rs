//! # Chromatic refraction
//!
//! ## What it does
//!
//! Air bends blue light more than red: of two stars at the same place the blue one is lifted higher, and the camera, which
//! sees all colours at once, puts them apart by a few tenths of an arcsecond.
//!
//! ## Equation
//!
//! R → R − ρ·c·tan z, c = (B − V) − 0.6, z = zenith distance; refraction itself is that of a star with c = 0.
//!
//! ## Parameters
//!
//! `arcsec_per_mag_at_45deg`: ρ, arcsec per magnitude of B − V at z = 45°. It depends on the passband (0.2 to 0.6 without
//! a filter) and must be fitted.
//!
//! ## Signature
//!
//! Red stars stand too low and blue ones too high, by ρ·c·tan z along the vertical.
//!
//! ## Confused with
//!
//! The dispersion of a wedge in front of the lens, if the camera is always held the same way; lateral colour.
//!
//! ## Neglected
//!
//! Stars whose colour is not known count as c = 0. Below 3° altitude tan z is held at its value there. What is quadratic in
//! the colour.
//!
//! ## Source
//!
//! A. V. Filippenko, PASP 94, 715 (1982); the linear law in B − V as in astrometric practice for broad bands.

use crate::dual::{Real, add, constant, dot, normalize, scale};
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};
use crate::units::ARCSEC_RAD;

/// Sine of the lowest altitude at which the law is evaluated (3°), as for refraction.
const LOWEST_SINE: f64 = 0.05;

/// Chromatic refraction.
#[derive(Clone, Copy, Debug)]
pub struct ChromaticRefraction;

impl Displacement for ChromaticRefraction {
    const ID: &'static str = "chromatic-refraction";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.4, "0.2 to 0.6 arcsec/mag without a filter (Filippenko 1982)")),
        profile_covariates: &[("", "colour")],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "arcsec_per_mag_at_45deg", unit: "arcsec/mag", typical: 0.4, range: (-100.0, 100.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let Some(zenith) = context.observation.zenith else {
            return light;
        };
        let lift = parameters[0] * (-ARCSEC_RAD * context.star.colour_offset());
        let up = constant::<T>(zenith);
        let vertical = dot(light.direction, up);
        let sine = if vertical.value() > LOWEST_SINE { vertical } else { T::constant(LOWEST_SINE) };
        // The part of the zenith across the light has the length sin z, so that divided by cos z it is tan z along the vertical.
        let across = add(up, scale(light.direction, -vertical));
        Light { direction: normalize(add(light.direction, scale(across, lift / sine))), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.zenith.is_none().then_some("the site or the time of the frames is not known, so the zenith is not")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The equation has no package of its own: pyerfa 2.0.1.5, rv2m of the axis zenith × star and the angle −0.4″ · 0.3 · tan z for a
        // star at (95°, 5°) of B − V = 0.9 and a zenith at (50°, 40°).
        let star = StarState { colour: Some(0.9), ..StarState::default() };
        let zenith = [0.492_403_876_506_104_07, 0.586_824_088_833_465_2, 0.642_787_609_686_539_3];
        let observation = Observation { zenith: Some(zenith), ..Observation::default() };
        let before = [-0.086_824_088_833_465_23, 0.992_403_876_506_104_1, 0.087_155_742_747_658_17];
        let after = [-0.086_824_620_291_504_98, 0.992_403_880_694_015_1, 0.087_155_165_622_556_83];
        let source = "the published equation, evaluated with pyerfa 2.0.1.5 (rv2m)";
        vec![ReferenceValue::of_direction(source, Context::new(star, observation), vec![0.4], before, after, 1e-14)]
    }

    fn source() -> &'static str {
        page_source!("chromatic_refraction.rs")
    }
}
