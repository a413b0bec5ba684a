//! # Drift of the boresight
//!
//! ## What it does
//!
//! The detector moves behind the lens as the camera warms or ages, so that the whole image shifts by a few hundredths of a
//! pixel to a pixel.
//!
//! ## Equation
//!
//! Δ = b·(T − T̄) + h·(t − t̄), the same for all stars of a frame; the point before it = measured − Δ. T̄, t̄ = means over
//! the recording's frames.
//!
//! ## Parameters
//!
//! `x_px_per_kelvin`, `y_px_per_kelvin`: b. `x_px_per_hour`, `y_px_per_hour`: h. Where temperatures are known the effect's
//! name stands for b, elsewhere for h.
//!
//! ## Signature
//!
//! About 1 % of its size: a shift of the image is a turn of the camera but for terms quadratic in the
//! field. It shows where the attitude is known from elsewhere or is one for all frames.
//!
//! ## Confused with
//!
//! The attitude, nearly completely; b with h where the temperature follows the time.
//!
//! ## Neglected
//!
//! Anything but a linear law.
//!
//! ## Source
//!
//! ECSS-E-ST-60-20C (2008), "bias" of a star sensor; the law is linear by definition.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Drift of the boresight.
#[derive(Clone, Copy, Debug)]
pub struct BoresightDrift;

impl Displacement for BoresightDrift {
    const ID: &'static str = "boresight-drift";
    const FACTS: Facts = Facts { ordinary_size: Some(OrdinarySize::largest_px(0.2, "4 to 70 arcsec (Lai et al. 2016)")), ..Facts::NONE };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x_px_per_kelvin", unit: "px/K", typical: 0.05, range: (-1e3, 1e3) },
        ParameterSpec { name: "y_px_per_kelvin", unit: "px/K", typical: 0.05, range: (-1e3, 1e3) },
        ParameterSpec { name: "x_px_per_hour", unit: "px/h", typical: 0.05, range: (-1e4, 1e4) },
        ParameterSpec { name: "y_px_per_hour", unit: "px/h", typical: 0.05, range: (-1e4, 1e4) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let kelvins = context.observation.temperature_offset_k.unwrap_or_default();
        let hours = context.observation.time_offset_h.unwrap_or_default();
        let shift = |axis: usize| parameters[axis] * kelvins + parameters[2 + axis] * hours;
        let [x, y] = light.point_px;
        Light { point_px: [x - shift(0), y - shift(1)], ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        let has_any = observation.temperature_offset_k.is_some() || observation.time_offset_h.is_some();
        (!has_any).then_some("neither the temperature nor the time of the frames is known")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 4])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn default_free(observation: &Observation) -> Vec<usize> {
        if observation.temperature_offset_k.is_some() { vec![0, 1] } else { vec![2, 3] }
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // opencv-python-headless 5.0.0.93: projectPoints([[0.155, -0.11, 1]], 0, 0, [[2000, 0, cx], [0, 2000, cy], [0, 0, 1]], None)
        // with cx = 0.05 · 4 + 0.2 · 1.5, cy = −0.03 · 4 + 0.1 · 1.5 is the measured point, with cx = cy = 0 the one before.
        let observation = Observation { temperature_offset_k: Some(4.0), time_offset_h: Some(1.5), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        vec![ReferenceValue::of_point(
            "OpenCV 5.0.0, projectPoints",
            context,
            vec![0.05, -0.03, 0.2, 0.1],
            2000.0,
            [512.0; 2],
            [[310.5, -219.97], [310.0, -220.0]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("boresight_drift.rs")
    }
}
