//! # The rest of the quadratic distortions
//!
//! ## What it does
//!
//! A stress or a mounting of threefold symmetry bends an element into a trefoil. Of the six quadratic vector fields on a
//! plane a rotation of the camera takes two, the decentring terms p1 and p2 take two, and these are the last two.
//!
//! ## Equation
//!
//! With ξ = x̄/h, η = ȳ/h, (x̄, ȳ) the MEASURED point relative to the principal point and h half the frame's width:
//! Δ = a·(ξ² − η², −2ξη) + b·(2ξη, ξ² − η²), that is (a + ib)·(ξ − iη)² in complex numbers; the ideal point is (x̄, ȳ) − Δ.
//!
//! ## Parameters
//!
//! `a_px`, `b_px`: the displacement at half the frame's width from the principal point, px.
//!
//! ## Signature
//!
//! A static field that turns against the radius three times while the azimuth turns once, without
//! divergence and without curl, 0.01 to 0.1 px. Hardly any of it is taken up by the other parameters (0.87 survives).
//!
//! ## Confused with
//!
//! Nearly nothing; the rotation of one half of a sensor against the other comes nearest (cosine 0.32).
//!
//! ## Neglected
//!
//! Its change with temperature; fields of higher order that a stress brings with it.
//!
//! ## Source
//!
//! J. Weng, P. Cohen, M. Herniou, IEEE Trans. PAMI 14(10), 965 (1992), for distortions beyond Brown's. The count of fields: a
//! polynomial of second order has 2 · 3 coefficients.

use crate::dual::Real;
use crate::effects::{
    Context, Displacement, Facts, Light, ModelGroup, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState,
};

/// The two harmonic quadratic fields as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct QuadraticRest;

impl Displacement for QuadraticRest {
    const ID: &'static str = "quadratic-rest";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.05, "0.01 to 0.1 px (Weng, Cohen and Herniou 1992)")),
        model_groups: &[ModelGroup { names: &["quadratic-rest"], preference: 4, is_radial_term: false }],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "a_px", unit: "px", typical: 0.05, range: (-10.0, 10.0) },
        ParameterSpec { name: "b_px", unit: "px", typical: 0.05, range: (-10.0, 10.0) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let Some(sensor) = context.observation.sensor else {
            return light;
        };
        let [a, b] = [parameters[0], parameters[1]];
        let [x, y] = light.point_px;
        let (xi, eta) = (x / sensor.half_width_px(), y / sensor.half_width_px());
        let (even, odd) = (xi * xi - eta * eta, xi * eta * 2.0);
        Light { point_px: [x - (a * even + b * odd), y - (b * even - a * odd)], ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.sensor.is_none().then_some("the size of the frame is not known")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 2])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The SIP convention of FITS adds polynomials to the measured pixel, and so does this model. astropy 8.0.2, Sip.pix2foc at
        // (410, -330) relative to the reference pixel with A_2_0 = -a/512², A_0_2 = a/512², A_1_1 = -2b/512², B_1_1 = 2a/512²,
        // B_2_0 = -b/512², B_0_2 = b/512², where a = 0.2 and b = -0.3.
        vec![ReferenceValue::of_point(
            "astropy.wcs, Sip.pix2foc",
            Context::new(StarState::default(), Observation::of_sensor(1024, 768)),
            vec![0.2, -0.3],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [409.645_156_860_351_56, -330.138_702_392_578_1]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("quadratic_rest.rs")
    }
}
