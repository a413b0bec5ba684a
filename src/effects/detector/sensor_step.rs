//! # Step at a seam of the sensor
//!
//! ## What it does
//!
//! A sensor is put together from two chips, or exposed in two fields by the lithograph, or a mirror folds half of the field:
//! one part of the frame is displaced against the other.
//!
//! ## Equation
//!
//! Δ = (a_x, a_y)·H(column), H = 0 left of the seam and 1 from column `line_px` on; the ideal point is the measured one minus
//! Δ. A step has no derivative with respect to its place, so it is smoothed over about one pixel: with u = x − (line_px − ½), the measured
//! pixel's distance from the border between the two columns, H = 1/(1 + e^(−u/w)) = ½ + ½·tanh(u/2w), w = 0.25 px. H grows from 0.1 to
//! 0.9 within 1.1 px, which is also what a star's image does that lies on both chips.
//!
//! ## Parameters
//!
//! `x_px`, `y_px`: displacement of the columns from `line_px` on, px. `line_px`: the first of them. Asked for by its id alone
//! the effect fits the displacement; the line keeps its value, and is fitted only if it is asked for and known to about a pixel.
//!
//! ## Signature
//!
//! Residuals that jump at a line, the same in all frames: 0.01 to 1 px. Attitude and the other parameters
//! take up what is common, so both halves keep part of it with opposite signs and slopes.
//!
//! ## Confused with
//!
//! The aspect of the pixels (cosine 0.78), shear (0.77), losses in the transfer of charge (0.58). Stars on both sides of the
//! seam, and a search over the place of the line, tell them apart.
//!
//! ## Neglected
//!
//! Rotation and scale of one chip against the other; a seam along the rows; more than one seam. A step of more than 1 px along
//! x folds at the seam: stars within a pixel of it then have no unique place.
//!
//! ## Source
//!
//! G. M. Bernstein et al., PASP 129, 074503 (2017): the chips of DECam move by up to 10 µm; J. Anderson, I. R. King, PASP 115,
//! 113 (2003), for seams of one chip.

use crate::dual::Real;
use crate::effects::{
    Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Searched, Segment, StarState,
};

/// A step along a column as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct SensorStep;

/// Scale w of the transition, px.
const TRANSITION_PX: f64 = 0.25;
/// The seam where nothing says where it is: the middle of a common sensor, columns.
const TYPICAL_LINE_PX: f64 = 512.0;
/// Places that a search tries first: fewer would lose a tenth of the trace of a seam halfway between two.
const SEAMS: usize = 31;

/// 1/(1 + e^−z). The exponential is only ever taken of what is not positive, so that it and its derivative stay finite far from the seam.
pub(super) fn logistic<T: Real>(z: T) -> T {
    if z.value() > 0.0 {
        T::constant(1.0) / ((-z).exp() + 1.0)
    } else {
        let power = z.exp();
        power / (power + 1.0)
    }
}

impl Displacement for SensorStep {
    const ID: &'static str = "sensor-step";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.05, "0.01 to 1 px (Bernstein et al. 2017)")),
        demo_sizes: &[("line_px", 100.0)],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x_px", unit: "px", typical: 0.1, range: (-10.0, 10.0) },
        ParameterSpec { name: "y_px", unit: "px", typical: 0.1, range: (-10.0, 10.0) },
        ParameterSpec { name: "line_px", unit: "px", typical: TYPICAL_LINE_PX, range: (0.0, 1e5) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let from_seam = light.pixel_px[0] - parameters[2] + 0.5;
        let share = logistic(from_seam / TRANSITION_PX);
        Light { point_px: [x - parameters[0] * share, y - parameters[1] * share], ..light }
    }

    fn unmet_requirement(_: &Observation) -> Option<&'static str> {
        None
    }

    /// No displacement, at a seam in the middle of the frame.
    fn identity(context: &Context) -> Option<Vec<f64>> {
        let line_px = context.observation.sensor.map_or(TYPICAL_LINE_PX, |sensor| sensor.half_width_px().round());
        Some(vec![0.0, 0.0, line_px])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn default_free(_: &Observation) -> Vec<usize> {
        vec![0, 1]
    }

    fn searched(observation: &Observation) -> Option<Searched> {
        let width = observation.sensor?.width_px as f64;
        let values = (1..=SEAMS).map(|k| (width * k as f64 / (SEAMS + 1) as f64).round()).collect();
        Some(Searched { parameter: 2, values, then_fitted: false })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The step of the cited papers, smoothed: (1 + tanh(u/2w))/2 of the page's equation, evaluated with 30 digits by mpmath 1.4.1 for
        // line_px = 600 at columns 599.9 and 600.7. Far from the seam the step itself is the reference.
        let case = |column: f64, share_of: [f64; 2]| {
            let context = Context::new(StarState::default(), Observation::of_sensor(1024, 768));
            let measured = [column - 512.0, -100.0];
            let ideal = [measured[0] - share_of[0], measured[1] - share_of[1]];
            let points = [measured, ideal];
            let source = "the published step, smoothed by tanh, mpmath 1.4.1";
            ReferenceValue::of_point(source, context, vec![0.2, -0.3, 600.0], 2000.0, [512.0; 2], points, 1e-10)
        };
        vec![
            case(599.9, [0.166_403_677_026_784_9, -0.249_605_515_540_177_37]),
            case(600.7, [0.198_367_485_769_368, -0.297_551_228_654_052]),
            case(900.0, [0.2, -0.3]),
        ]
    }

    fn source() -> &'static str {
        page_source!("sensor_step.rs")
    }
}
