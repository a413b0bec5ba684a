//! # Drift of the focal length
//!
//! ## What it does
//!
//! Mounts creep, glue cures and moisture leaves a structure in vacuum: the scale of the image changes with time.
//!
//! ## Equation
//!
//! f → f·(1 + a·(t − t̄) + b·(n − n̄)); the point before it = measured / (that factor), relative to the principal point. t̄,
//! n̄ = means of time and frame number over the recording.
//!
//! ## Parameters
//!
//! `relative_per_hour`: a. `relative_per_frame`: b, per frame number. Where the frames' times are known the effect's name
//! stands for a, elsewhere for b.
//!
//! ## Signature
//!
//! Residuals along the radius in proportion to it, of one sign in the first frames and the other in the
//! last: 1e-4 is 0.05 px at 512 px.
//!
//! ## Confused with
//!
//! The thermal focal length where the temperature follows the time; aberration with an unknown velocity.
//!
//! ## Neglected
//!
//! Steps, and anything that is not linear in time.
//!
//! ## Source
//!
//! A linear law, by definition. J. Enright, I. Jovanovic, B. Vaz, "On-orbit star tracker recalibration: a case study", IEEE Aerospace
//! Conference (2015), for calibrations that have changed since they were made.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Drift of the focal length.
#[derive(Clone, Copy, Debug)]
pub struct FocalLengthDrift;

impl Displacement for FocalLengthDrift {
    const ID: &'static str = "focal-length-drift";
    const FACTS: Facts =
        Facts { ordinary_size: Some(OrdinarySize::of(1e-4, "1e-4 over a night")), profile_covariates: &[("", "time")], ..Facts::NONE };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "relative_per_hour", unit: "h^-1", typical: 1e-4, range: (-1e-2, 1e-2) },
        ParameterSpec { name: "relative_per_frame", unit: "", typical: 1e-5, range: (-1e-3, 1e-3) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let hours = context.observation.time_offset_h.unwrap_or_default();
        let frames = context.observation.order_offset.unwrap_or_default();
        let growth = parameters[0] * hours + parameters[1] * frames + 1.0;
        Light { point_px: light.point_px.map(|coordinate| coordinate / growth), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        let has_any = observation.time_offset_h.is_some() || observation.order_offset.is_some();
        (!has_any).then_some("neither the time nor the order of the frames is known")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 2])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn default_free(observation: &Observation) -> Vec<usize> {
        if observation.time_offset_h.is_some() { vec![0] } else { vec![1] }
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // opencv-python-headless 5.0.0.93: projectPoints([[0.155, -0.11, 1]], 0, 0, diag(f, f, 1), None), f = 2000 · (1 + 1e-4 · 1.5 − 2e-5
        // · 3) for the measured point and 2000 for the one before.
        let observation = Observation { time_offset_h: Some(1.5), order_offset: Some(-3.0), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        vec![ReferenceValue::of_point(
            "OpenCV 5.0.0, projectPoints",
            context,
            vec![1e-4, 2e-5],
            2000.0,
            [512.0; 2],
            [[310.027_9, -220.019_8], [310.0, -220.0]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("focal_length_drift.rs")
    }
}
