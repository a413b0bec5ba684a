//! # Focal length that follows the temperature
//!
//! ## What it does
//!
//! Mount and glass expand, and the glass changes its index: the scale of the image follows the temperature.
//!
//! ## Equation
//!
//! f → f·(1 + α·(T − T̄)); the point before it = measured / (1 + α·(T − T̄)), relative to the principal point. T̄ = mean over
//! the recording's frames.
//!
//! ## Parameters
//!
//! `relative_per_kelvin`: α = expansion of the mount minus that of the lens, 1e-6 to 3e-5 per kelvin.
//!
//! ## Signature
//!
//! Residuals along the radius in proportion to it, of one sign in warm frames and the other in cold ones:
//! 2e-5/K and 5 K are 0.05 px at 512 px.
//!
//! ## Confused with
//!
//! A drift of the focal length with time where the temperature follows the time; thermal distortion (cosine 0.92);
//! aberration with an unknown velocity.
//!
//! ## Neglected
//!
//! Terms quadratic in the temperature; the lag of the glass behind the sensor of temperature.
//!
//! ## Source
//!
//! Linear expansion, by definition; as in the camera models of NASA's GIANT (focal length as a polynomial of temperature);
//! S. Wang, Y. Geng, R. Jin, Sensors 15, 31428 (2015), for star sensors in orbit.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Focal length that follows the temperature.
#[derive(Clone, Copy, Debug)]
pub struct ThermalFocalLength;

impl Displacement for ThermalFocalLength {
    const ID: &'static str = "thermal-focal-length";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(2e-5, "1e-6 to 3e-5 per K (GIANT; Wang et al. 2015)")),
        profile_covariates: &[("", "temperature")],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "relative_per_kelvin", unit: "K^-1", typical: 2e-5, range: (-1e-2, 1e-2) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let growth = parameters[0] * context.observation.temperature_offset_k.unwrap_or_default() + 1.0;
        Light { point_px: light.point_px.map(|coordinate| coordinate / growth), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.temperature_offset_k.is_none().then_some("the temperature of the frames is not known")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // opencv-python-headless 5.0.0.93: projectPoints([[0.155, -0.11, 1]], 0, 0, diag(f, f, 1), None), f = 2000 · (1 + 2e-5 · 4)
        // for the measured point and 2000 for the one before.
        let observation = Observation { temperature_offset_k: Some(4.0), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        vec![ReferenceValue::of_point(
            "OpenCV 5.0.0, projectPoints",
            context,
            vec![2e-5],
            2000.0,
            [512.0; 2],
            [[310.024_8, -220.017_6], [310.0, -220.0]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("thermal_focal_length.rs")
    }
}
