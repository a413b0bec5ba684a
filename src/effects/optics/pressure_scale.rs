//! # Scale that follows the air pressure
//!
//! ## What it does
//!
//! A lens is designed against air. As the pressure falls (a balloon, a launch) the index of the air between and before the
//! lenses falls with it, and the focal length changes.
//!
//! ## Equation
//!
//! f → f·(1 + κ·(P − P̄)); the point before it = measured / (1 + κ·(P − P̄)), relative to the principal point. P̄ = mean over
//! the recording's frames.
//!
//! ## Parameters
//!
//! `relative_per_hpa`: κ. Air's index minus one is 2.7e-7 per hPa; κ is of that size, with the sign and factor of the lens.
//!
//! ## Signature
//!
//! Residuals along the radius in proportion to it, with the pressure: up to 0.14 px at 512 px between
//! ground and vacuum.
//!
//! ## Confused with
//!
//! The focal length, completely, if the pressure is the same in all frames; thermal focal length and drift where
//! pressure follows temperature or time.
//!
//! ## Neglected
//!
//! The change of the distortion; the temperature's share of the air's density.
//!
//! ## Source
//!
//! B. Edlén, Metrologia 2, 71 (1966) for the index of air; the law is linear by definition.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Scale that follows the air pressure.
#[derive(Clone, Copy, Debug)]
pub struct PressureScale;

impl Displacement for PressureScale {
    const ID: &'static str = "pressure-scale";
    const FACTS: Facts =
        Facts {
            ordinary_size: Some(OrdinarySize::of(2.7e-7, "n − 1 of air")), profile_covariates: &[("", "pressure_hpa")], ..Facts::NONE
        };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "relative_per_hpa", unit: "hPa^-1", typical: 2.7e-7, range: (-1e-4, 1e-4) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let growth = parameters[0] * context.observation.pressure_offset_hpa.unwrap_or_default() + 1.0;
        Light { point_px: light.point_px.map(|coordinate| coordinate / growth), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.pressure_offset_hpa.is_none().then_some("the air pressure of the frames is not known (telemetry pressure_hpa)")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // opencv-python-headless 5.0.0.93: projectPoints([[0.155, -0.11, 1]], 0, 0, diag(f, f, 1), None), f = 2000 · (1 − 2.7e-7 · 20)
        // for the measured point and 2000 for the one before.
        let observation = Observation { pressure_offset_hpa: Some(-20.0), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        vec![ReferenceValue::of_point(
            "OpenCV 5.0.0, projectPoints",
            context,
            vec![2.7e-7],
            2000.0,
            [512.0; 2],
            [[309.998_326, -219.998_812], [310.0, -220.0]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("pressure_scale.rs")
    }
}
