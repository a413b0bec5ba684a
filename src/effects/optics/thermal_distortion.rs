//! # Distortion that follows the temperature
//!
//! ## What it does
//!
//! When the distances between the lenses of an objective change with the temperature, its distortion changes too.
//!
//! ## Equation
//!
//! Δ = κ·(T − T̄)·(r/f)²·(x̄, ȳ) at the measured point; the point before it = measured − Δ. r = distance from the principal
//! point, T̄ = mean over the recording's frames.
//!
//! ## Parameters
//!
//! `k1_norm_per_kelvin`: κ, the change per kelvin of k1 for a radius in units of f (k1 in px⁻² times f²).
//!
//! ## Signature
//!
//! Residuals along the radius that grow as its cube, of one sign in warm frames and the other in cold
//! ones: 0.5 to 2 % of the distortion, 0.004 px/K at the edge.
//!
//! ## Confused with
//!
//! The thermal focal length (cosine 0.92; stars in the corners tell them apart); a drift of k1 with time.
//!
//! ## Neglected
//!
//! Higher terms in the radius and in the temperature.
//!
//! ## Source
//!
//! The radial term of D. C. Brown, Photogrammetric Engineering 32(3), 444 (1966), with a coefficient linear in the temperature.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Distortion that follows the temperature.
#[derive(Clone, Copy, Debug)]
pub struct ThermalDistortion;

impl Displacement for ThermalDistortion {
    const ID: &'static str = "thermal-distortion";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::largest_px(0.02, "0.5 to 2 % of the distortion (Wang et al. 2015)")),
        profile_covariates: &[("", "temperature")],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "k1_norm_per_kelvin", unit: "K^-1", typical: 2.5e-4, range: (-1.0, 1.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let f = light.focal_length_px;
        let strength = parameters[0] * context.observation.temperature_offset_k.unwrap_or_default();
        let kept = -strength * ((x * x + y * y) / (f * f)) + 1.0;
        Light { point_px: [x * kept, y * kept], ..light }
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
        // OpenCV adds the distortion to the ideal point: its point distorted with −κ·ΔT must be the one before. opencv-python-headless
        // 5.0.0.93: projectPoints([[310/2000, -220/2000, 1]], 0, 0, diag(2000, 2000, 1), [2e-4 · 4, 0, 0, 0]).
        let observation = Observation { temperature_offset_k: Some(4.0), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        vec![ReferenceValue::of_point(
            "OpenCV 5.0.0, projectPoints",
            context,
            vec![-2e-4],
            2000.0,
            [512.0; 2],
            [[310.0, -220.0], [310.008_959, -220.006_358]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("thermal_distortion.rs")
    }
}
