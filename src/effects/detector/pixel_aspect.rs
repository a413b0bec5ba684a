//! # Aspect of the pixels
//!
//! ## What it does
//!
//! The image has two scales: pixels that are not square, or optics that magnify differently along x and y.
//!
//! ## Equation
//!
//! At the MEASURED point (x̄, ȳ) relative to the principal point: Δ = ½ε·(x̄, −ȳ), and the ideal point is (x̄, ȳ) − Δ. The focal
//! length of the model stays the geometric mean of f_x and f_y.
//!
//! ## Parameters
//!
//! `epsilon` = f_x/f_y − 1, a pure number. 1e-4 displaces a star by 0.026 px at 512 px from the axis.
//!
//! ## Signature
//!
//! Residuals in x in proportion to x and in y to −y, the same in all frames. Lithography leaves 1e-5, optics
//! that are not rotationally symmetric up to 1e-3. Attitudes and focal length cannot take it up.
//!
//! ## Confused with
//!
//! The step at a seam of the sensor (cosine 0.78 of what is left of them), losses in the transfer of charge (0.75), the
//! bending of the field at the sensor's edges (0.40). The dependence on flux tells the second, stars on both sides of the seam the first.
//!
//! ## Neglected
//!
//! The second order, 3ε²/8 of x̄ and ε²/8 of ȳ: 2e-4 px at 512 px for ε = 1e-3.
//!
//! ## Source
//!
//! J. Weng, P. Cohen, M. Herniou, IEEE Trans. PAMI 14(10), 965 (1992).

use crate::dual::Real;
use crate::effects::{
    Context, Displacement, Facts, Light, ModelGroup, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState,
};

/// Different scales along x and y as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct PixelAspect;

impl Displacement for PixelAspect {
    const ID: &'static str = "pixel-aspect";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(1e-4, "1e-5 by lithography to 1e-3 by optics (Weng, Cohen and Herniou 1992)")),
        is_even_in_mirror: true,
        short_names: &[("aspect", Some("epsilon"))],
        model_groups: &[ModelGroup { names: &["aspect"], preference: 3, is_radial_term: false }],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "epsilon", unit: "", typical: 1e-4, range: (-0.05, 0.05) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let half = parameters[0] * 0.5;
        Light { point_px: [x - half * x, y + half * y], ..light }
    }

    fn unmet_requirement(_: &Observation) -> Option<&'static str> {
        None
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // opencv-python-headless 5.0.0.93: 2000 times undistortPoints([[[410, -330]]], diag(2000·√(1+ε), 2000/√(1+ε), 1), 0) with ε = 1e-4.
        // The exact ratio differs from the first order by 3ε²/8 of the coordinate, 2e-6 px.
        vec![ReferenceValue::of_point(
            "OpenCV, undistortPoints with two focal lengths",
            Context::new(StarState::default(), Observation::default()),
            vec![1e-4],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [409.979_501_537_371_96, -330.016_499_587_520_57]],
            3e-6,
        )]
    }

    fn source() -> &'static str {
        page_source!("pixel_aspect.rs")
    }
}
