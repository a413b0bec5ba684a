//! # Two halves with an amplifier each
//!
//! ## What it does
//!
//! The halves of the sensor, upper and lower or left and right, are read to opposite sides, each through an amplifier of its own; its quarters where there
//! are four. Lag of charge and non-linearity then move faint stars one way in the upper half, and another way in the lower one.
//!
//! ## Equation
//!
//! Δy = b·(m − 5)·H(y), H = 0 in the upper half and 1 in the lower one, smoothed over about one pixel as in `sensor-step`:
//! H = 1/(1 + e^(−u/w)), u the MEASURED row less (height − 1)/2, w = 0.25 px. m is the star's magnitude, the measured one where the image has
//! one, else V of the catalogue. The ideal point is the measured one minus Δ. What both halves share is a magnitude equation. A star of
//! unknown magnitude is not moved.
//!
//! ### In the pixels
//!
//! electrons = N·(1 + g) + o in the rows below the middle, N above; of that (1 + h) as much and p more in the columns right of the middle. The lag of charge
//! and the non-linearity are effects of their own: rendered, a gain alone moves only stars whose light lies on both sides of the line.
//!
//! ## Parameters
//!
//! `px_per_mag` (b): displacement along the columns of a star one magnitude fainter in the lower half against the upper one, px.
//! In the pixels: `gain_relative` (g) and `offset_e` (o), gain and offset of the lower half against the upper one, `gain_right_relative` (h) and
//! `offset_right_e` (p) those of the right half against the left one, of the order of 0.01 and of a few electrons.
//!
//! ## Signature
//!
//! Residuals along y that jump at the middle row and grow with the magnitude: of the order of 0.01 px per
//! magnitude. 55 frames show that much.
//!
//! ## Confused with
//!
//! The magnitude equation (cosine 0.70), losses in the transfer of charge (0.67): the jump tells them apart, if stars stand
//! near it on both sides. A step of background and flux at the same row points to this one.
//!
//! ## Neglected
//!
//! The displacement grows with the way to the register, and is not the same over a half; displacement along x; four amplifiers of which one alone differs.
//!
//! ## Source
//!
//! J. R. Janesick, Scientific Charge-Coupled Devices (2001), for split readout; R. Massey et al., MNRAS 401, 371 (2010), for
//! the lag.

use bytemuck::{Pod, Zeroable};

use super::sensor_step::logistic;
use crate::dual::Real;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, by_rows, uniform_fields};
use crate::effects::{CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, StarState};
use crate::effects::{ImageContext, ImageEffect, ImageResponse};
use crate::rng::StageKey;

/// A shift along the columns in proportion to the magnitude, in the lower half of the frame.
#[derive(Clone, Copy, Debug)]
pub struct AmplifierStep;

/// Scale w of the transition, px.
const TRANSITION_PX: f64 = 0.25;

impl CentroidShift for AmplifierStep {
    const ID: &'static str = "amplifier-step";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.01, "0.01 px/mag (Janesick 2001)")),
        profile_covariates: &[("", "magnitude")],
        ..Facts::NONE
    };
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "px_per_mag", unit: "px/mag", typical: 0.01, range: (-1.0, 1.0) }];

    fn unit_shift<T: Real>(_: usize, measured: &Light<T>, context: &Context) -> [T; 2] {
        let zero = T::constant(0.0);
        let Some(sensor) = context.observation.sensor else { return [zero; 2] };
        let below = measured.pixel_px[1] - sensor.middle_px()[1];
        [zero, logistic(below / TRANSITION_PX) * context.magnitude_offset()]
    }

    fn missing(observation: &Observation) -> Option<&'static str> {
        observation.sensor.is_none().then_some("the size of the frame is not known")
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The page's equation with 30 digits by mpmath 1.4.1: b = 0.012 px/mag, m = 7.25, 768 rows.
        let context = Context::new(StarState { magnitude: 7.25, ..StarState::default() }, Observation::of_sensor(1024, 768));
        let case = |row: f64, shift: f64| {
            let points = [[10.0, row - 384.0], [10.0, row - 384.0 - shift]];
            ReferenceValue::of_point("the page's equation, mpmath 1.4.1", context, vec![0.012], 2000.0, [512.0, 384.0], points, 1e-12)
        };
        vec![case(383.8, 0.020_750_169_154_473_476), case(383.4, 0.010_835_433_176_963_796), case(700.0, 0.027)]
    }

    fn source() -> &'static str {
        page_source!("amplifier_step.rs")
    }
}

/// Gains and offsets of the lower and of the right half, in the pixels.
#[derive(Clone, Copy, Debug)]
pub struct AmplifierHalves;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct AmplifierStepUniforms {
    gain: f32,
    offset_e: f32,
    first_row_below: u32,
    gain_right: f32,
    offset_right_e: f32,
    first_column_right: u32,
    width: u32,
}

/// The twin.
fn amplifier_step(uniforms: &AmplifierStepUniforms, first_pixel: u32, pixels: &mut [f32]) {
    by_rows(uniforms.width, first_pixel, pixels, |x, y, row| {
        if y >= uniforms.first_row_below {
            for electrons in &mut *row {
                *electrons = *electrons * uniforms.gain + uniforms.offset_e;
            }
        }
        let first = uniforms.first_column_right.saturating_sub(x) as usize;
        for electrons in row.iter_mut().skip(first) {
            *electrons = *electrons * uniforms.gain_right + uniforms.offset_right_e;
        }
    });
}

impl PixelEffect for AmplifierHalves {
    const ID: &'static str = "amplifier-step";
    const STAGE: Stage = Stage::Readout;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "gain_relative", unit: "", typical: 0.01, range: (-0.9, 9.0) },
        ParameterSpec { name: "offset_e", unit: "e-", typical: 5.0, range: (-1e6, 1e6) },
        ParameterSpec { name: "gain_right_relative", unit: "", typical: 0.01, range: (-0.9, 9.0) },
        ParameterSpec { name: "offset_right_e", unit: "e-", typical: 5.0, range: (-1e6, 1e6) },
    ];
    const WGSL: &'static str = include_str!("../../../shaders/amplifier_step.wgsl");
    const SOURCE: &'static str = page_source!("amplifier_step.rs");
    type Uniforms = AmplifierStepUniforms;
    const FIELDS: &'static [(&'static str, usize)] =
        uniform_fields!(AmplifierStepUniforms { gain, offset_e, first_row_below, gain_right, offset_right_e, first_column_right, width });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> AmplifierStepUniforms {
        AmplifierStepUniforms {
            gain: (1.0 + parameters[0]) as f32,
            offset_e: parameters[1] as f32,
            first_row_below: exposure.height_px.div_ceil(2) as u32,
            gain_right: (1.0 + parameters[2]) as f32,
            offset_right_e: parameters[3] as f32,
            first_column_right: exposure.width_px.div_ceil(2) as u32,
            width: exposure.width_px as u32,
        }
    }
    fn apply(uniforms: &AmplifierStepUniforms, _key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        amplifier_step(uniforms, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0; 4])
    }
}

/// The step of the page's equation from the one that magnitudes and logarithms of the sky are linear in: 1 + g is e^s. Value and standard error.
pub(crate) fn relative_step([step, sigma]: [f64; 2]) -> [f64; 2] {
    [step.exp_m1(), step.exp() * sigma]
}

/// Whether a parameter is a ratio of the gains of two halves.
pub(crate) fn is_gain_step(name: &str) -> bool {
    matches!(name, "gain_relative" | "gain_right_relative")
}

impl ImageEffect for AmplifierStep {
    fn id(&self) -> &'static str {
        <Self as CentroidShift>::ID
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("gain_relative", ""), ("gain_right_relative", "")]
    }
    fn follows(&self) -> &'static str {
        "row"
    }
    /// Two amplifiers are more usual than four.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0], &[1]]
    }
    fn part_follows(&self, part: &[usize]) -> &'static str {
        if part == [1] { "column-half" } else { self.follows() }
    }
    fn needs(&self) -> &'static str {
        "stars in both halves"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.01, "gains of amplifiers differ by of the order of a percent (Janesick 2001)")
    }
    /// The lower half has more counts, and the right one.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        Some([1, 0].map(|axis| ImageResponse::loss(if image.at[axis] > 0.0 { -1.0 } else { 0.0 })).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_in_magnitudes_is_a_ratio_of_gains() {
        // Of a gain that is a tenth more, and of one that is a tenth less.
        for gain in [1.1_f64, 0.9] {
            let [value, sigma] = relative_step([gain.ln(), 0.01]);
            assert!((value - (gain - 1.0)).abs() < 1e-15 && (sigma - 0.01 * gain).abs() < 1e-15, "{value} ± {sigma}");
        }
    }

    #[test]
    fn the_lower_half_begins_below_the_middle() {
        for (height, expected) in [(4, [10.0, 10.0, 23.0, 23.0]), (3, [10.0, 10.0, 23.0, 10.0])] {
            let exposure = ExposureContext { width_px: 1, height_px: height, ..ExposureContext::default() };
            let mut pixels = [10.0; 4];
            amplifier_step(&AmplifierHalves::uniforms(&[1.0, 3.0, 0.0, 0.0], &exposure), 0, &mut pixels[..height]);
            assert_eq!(pixels, expected);
        }
    }

    /// Wherever among the pixels a share of them begins.
    #[test]
    fn the_right_half_begins_right_of_the_middle() {
        let exposure = ExposureContext { width_px: 5, height_px: 2, ..ExposureContext::default() };
        let uniforms = AmplifierHalves::uniforms(&[0.5, 0.0, 1.0, 3.0], &exposure);
        let expected = [10.0, 10.0, 10.0, 23.0, 23.0, 15.0, 15.0, 15.0, 33.0, 33.0];
        for first in 0..10 {
            let mut pixels = [10.0; 10];
            amplifier_step(&uniforms, first as u32, &mut pixels[first..]);
            assert_eq!(pixels[first..], expected[first..]);
        }
    }
}
