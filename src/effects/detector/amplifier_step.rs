//! # Two halves with an amplifier each
//!
//! **What it is.** The upper and the lower half of the sensor are read to opposite sides, each through an amplifier of its own. Lag of charge
//! and non-linearity then move faint stars one way in one half, and another way in the other.
//!
//! **Equation.** Δy = b·(m − 5)·H(y), H = 0 in the upper half and 1 in the lower one, smoothed over about one pixel as in `sensor-step`:
//! H = 1/(1 + e^(−u/w)), u the MEASURED row less (height − 1)/2, w = 0.25 px. m is the star's magnitude, the measured one where the image has
//! one, else V of the catalogue. The ideal point is the measured one minus Δ. What both halves share is a magnitude equation. A star of
//! unknown magnitude is not moved.
//!
//! **Parameter.** `px_per_mag` (b): displacement along the columns of a star one magnitude fainter in the lower half against the upper one, px.
//!
//! **What it leaves when left out.** Residuals along y that jump at the middle row and grow with the magnitude: of the order of 0.01 px per
//! magnitude. 55 frames show that much.
//!
//! **Confused with.** The magnitude equation (cosine 0.70), losses in the transfer of charge (0.67): the jump tells them apart, if stars stand
//! near it on both sides. A step of background and flux at the same row points to this one.
//!
//! **Neglected.** The displacement grows with the way to the register, and is not the same over a half; halves to the left and right; four
//! amplifiers; displacement along x.
//!
//! **Source.** J. R. Janesick, Scientific Charge-Coupled Devices (2001), for split readout; R. Massey et al., MNRAS 401, 371 (2010), for
//! the lag.

use super::sensor_step::logistic;
use crate::dual::Real;
use crate::effects::{CentroidShift, Context, Light, Observation, ParameterSpec, ReferenceValue, StarState};

/// A shift along the columns in proportion to the magnitude, in the lower half of the frame.
#[derive(Clone, Copy, Debug)]
pub struct AmplifierStep;

/// Scale w of the transition, px.
const TRANSITION_PX: f64 = 0.25;

impl CentroidShift for AmplifierStep {
    const ID: &'static str = "amplifier-step";
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
        include_str!("amplifier_step.rs")
    }
}
