//! # Rolling shutter
//!
//! ## What it does
//!
//! Rows are exposed one after the other. While the camera turns, each row sees the sky with another attitude.
//!
//! ## Equation
//!
//! A star's direction in camera axes moves as ḋ = −ω × d. A row y is exposed τ = s·t·(y − y_mid) after the middle row, y_mid
//! = (height − 1)/2; the direction at the time of the middle row is that seen at the measured pixel turned by |ω|·τ about ω.
//!
//! ## Parameters
//!
//! `line_time_us`: t, the time from one row to the next, µs, positive as in the manifest. The sign s of the direction of
//! reading is the manifest's too (`first_row`): +1 if row 0 is read first or nothing is known, −1 if the last row is. A negative t says
//! that the rows are read the other way round.
//!
//! ## Signature
//!
//! Shear and change of height with the rate across the boresight, a twist with the roll rate: 0.1°/s
//! over 1024 rows of 12 µs at f = 2900 px is 0.06 px. More than half of it hides in the attitude.
//!
//! ## Confused with
//!
//! Shear and pixel aspect, if the rate is the same in all frames; rates of both signs tell them apart.
//!
//! ## Neglected
//!
//! Changes of the rate within a frame. The blur of each row is motion smear, not this. The renderer follows the motion itself
//! row by row, with rates that change; at an even rate it puts the middle of each image where this does.
//!
//! ## Source
//!
//! J. Enright and T. Dzamba, Rolling Shutter Compensation for Star Trackers, AIAA (2012); Rodrigues' formula for the turn.

use crate::dual::{Real, constant, dot, normalize, rotate};
use crate::effects::{
    Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, Sensor, StarState,
};

/// Seconds in a microsecond.
const MICROSECOND_S: f64 = 1e-6;

/// Rolling shutter.
#[derive(Clone, Copy, Debug)]
pub struct RollingShutter;

impl Displacement for RollingShutter {
    const ID: &'static str = "rolling-shutter";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(12.0, "12 µs a row (Enright and Dzamba 2012)")),
        demo_sizes: &[("line_time_us", 400.0)],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Camera;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "line_time_us", unit: "us", typical: 12.0, range: (-1e4, 1e4) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let (Some(rate), Some(sensor)) = (context.observation.rate_rad_s, context.observation.sensor) else {
            return light;
        };
        let speed_rad_s = dot(rate, rate).sqrt();
        if speed_rad_s == 0.0 {
            return light;
        }
        let axis = constant::<T>(rate.map(|component| component / speed_rad_s));
        let [_, middle_row] = sensor.middle_px();
        let sign = if sensor.last_row_first || sensor.line_time_s.is_some_and(|seconds| seconds < 0.0) { -1.0 } else { 1.0 };
        let angle = parameters[0] * (light.pixel_px[1] - middle_row) * (sign * speed_rad_s * MICROSECOND_S);
        Light { direction: normalize(rotate(light.direction, axis, angle)), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        match (observation.rate_rad_s, observation.sensor) {
            (None, _) => Some("the rate at which the camera turned is not known"),
            (_, None) => Some("the size of the frame is not known"),
            _ => None,
        }
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(observation: &Observation) -> Option<Vec<f64>> {
        let line_time_s = observation.rate_rad_s.and(observation.sensor)?.line_time_s?;
        (line_time_s != 0.0).then(|| vec![line_time_s.abs() / MICROSECOND_S])
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // scipy 1.17.1, solve_ivp (rtol 1e-13) of ḋ = −ω × d from the row's time back to that of the middle row, ω = (1, −2, 1.5)°/s, 12
        // µs, row 163.5 of 768; and pyerfa 2.0.1.5, rv2m(ω · 12 µs · −220), of a sensor whose last row is read first, ω = (0.01, −0.02,
        // 0.015) rad/s.
        let before = [0.107_832_773_203_438_41, -0.215_665_546_406_876_82, 0.970_494_958_830_945_7];
        let top = [0.107_907_303_153_594_73, -0.215_628_284_651_205_76, 0.970_494_954_538_402_8];
        let bottom = [0.107_790_071_848_033_42, -0.215_686_898_141_448_34, 0.970_494_957_421_787];
        let fast = [0.017_453_292_519_943_295, -0.034_906_585_039_886_59, 0.026_179_938_779_914_945];
        [("scipy 1.17.1, solve_ivp", fast, 12e-6, top), ("pyerfa 2.0.1.5, rv2m", [0.01, -0.02, 0.015], -12e-6, bottom)]
            .into_iter()
            .map(|(source, rate, line_time_s, after)| {
                let sensor = Sensor { width_px: 1024, height_px: 768, line_time_s: Some(line_time_s), last_row_first: line_time_s < 0.0 };
                let observation = Observation { rate_rad_s: Some(rate), sensor: Some(sensor), ..Observation::default() };
                let light = |direction| Light { pixel_px: [600.0, 163.5], ..Light::from(direction) };
                let context = Context::new(StarState::default(), observation);
                ReferenceValue { source, context, parameters: vec![12.0], before: light(before), after: light(after), tolerance: 1e-12 }
            })
            .collect()
    }

    fn source() -> &'static str {
        page_source!("rolling_shutter.rs")
    }
}
