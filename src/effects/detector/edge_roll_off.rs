//! # Bending of the field at the edges of the sensor
//!
//! ## What it does
//!
//! The electric field near the edge of a thick sensor is not perpendicular to its surface, so the charge of the last rows and
//! columns is collected by pixels other than those it was set free above.
//!
//! ## Equation
//!
//! For each of the four edges Δ = −A·e^(−d/ℓ)·n̂, d the MEASURED pixel's distance from the edge of the frame, n̂ the edge's normal
//! outwards; the ideal point is the measured one minus the sum of the four. Positive A: images are drawn inwards. Outside the frame, where
//! nothing is measured, d counts as zero.
//!
//! ## Parameters
//!
//! `amplitude_px` (A): displacement at the edge, px. `length_px` (ℓ): the distance in which it falls to 1/e, px. Asked for by
//! its id alone the effect fits the amplitude with ℓ = 15 px.
//!
//! ## Signature
//!
//! Residuals across the edge in the last 20 to 40 px, the same in all frames, 0.1 to 1 px, together with a
//! change of the flux, since the pixels there collect from another area.
//!
//! ## Confused with
//!
//! The aspect of the pixels (cosine 0.40): if the stars within 40 px of the edges are left out, this effect goes and that
//! one stays.
//!
//! ## Neglected
//!
//! The change of flux; a different strength of each edge; the corners, where the two edges simply add.
//!
//! ## Source
//!
//! A. Bradshaw et al., arXiv:1507.02683 (2015); A. A. Plazas, G. M. Bernstein, E. S. Sheldon, PASP 126, 750
//! (2014).

use crate::dual::Real;
use crate::effects::{
    Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Searched, Segment, StarState,
};

/// The displacement near the edges as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct EdgeRollOff;

/// Length where nothing else is known, px.
const TYPICAL_LENGTH_PX: f64 = 15.0;

/// e^(−d/ℓ), with d not below zero.
fn decay<T: Real>(distance_px: T, length_px: T) -> T {
    if distance_px.value() > 0.0 { (-distance_px / length_px).exp() } else { T::constant(1.0) }
}

impl Displacement for EdgeRollOff {
    const ID: &'static str = "edge-roll-off";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.2, "0.1 to 1 px in the last 20 px (Bradshaw et al. 2015)")),
        profile_covariates: &[("", "edge-distance")],
        demo_sizes: &[("length_px", 20.0)],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "amplitude_px", unit: "px", typical: 0.2, range: (-5.0, 5.0) },
        ParameterSpec { name: "length_px", unit: "px", typical: TYPICAL_LENGTH_PX, range: (1.0, 200.0) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let [amplitude, length] = [parameters[0], parameters[1]];
        let Some(sensor) = context.observation.sensor.filter(|_| length.value() > 0.0) else {
            return light;
        };
        let size = [sensor.width_px as f64, sensor.height_px as f64];
        let mut point_px = light.point_px;
        for axis in 0..2 {
            // The frame reaches from −½ to its size − ½.
            let (near, far) = (light.pixel_px[axis] + 0.5, -light.pixel_px[axis] + (size[axis] - 0.5));
            point_px[axis] = point_px[axis] - amplitude * (decay(near, length) - decay(far, length));
        }
        Light { point_px, ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.sensor.is_none().then_some("the size of the frame is not known")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0, TYPICAL_LENGTH_PX])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn default_free(_: &Observation) -> Vec<usize> {
        vec![0]
    }

    fn searched(_: &Observation) -> Option<Searched> {
        Some(Searched { parameter: 1, values: vec![8.0, 15.0, 30.0], then_fitted: true })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The published equation for the four edges of a frame of 1024 by 768 px, evaluated with 30 digits by mpmath 1.4.1 at the pixel
        // (1015.25, 9.5), A = 0.4 px, ℓ = 12 px: near the right edge and the upper one, which draw the image to the left and down.
        vec![ReferenceValue::of_point(
            "the published exponential, mpmath 1.4.1",
            Context::new(StarState::default(), Observation::of_sensor(1024, 768)),
            vec![0.4, 12.0],
            2000.0,
            [512.0, 384.0],
            [[503.25, -374.5], [503.451_132_631_188_4, -374.673_839_283_402_83]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("edge_roll_off.rs")
    }
}
