//! # Shear: axes that are not perpendicular
//!
//! ## What it does
//!
//! Rows and columns of the image do not meet at a right angle: skew optics, or rows that are exposed one after another while
//! the camera turns.
//!
//! ## Equation
//!
//! At the MEASURED point (x̄, ȳ) relative to the principal point: Δ = ½ε·(ȳ, x̄), and the ideal point is (x̄, ȳ) − Δ.
//!
//! ## Parameters
//!
//! `shear_rad` (ε): the angle between the axes of x and y minus 90°, shared evenly by both. 1e-4 displaces a star by 0.026 px
//! at 512 px from the axis.
//!
//! ## Signature
//!
//! Residuals in x in proportion to y and in y to x, the same in all frames; at most some 1e-4 rad.
//! Attitudes and focal length cannot take it up.
//!
//! ## Confused with
//!
//! A rolling shutter while the camera turns at a constant rate: entirely if every frame has the same rate, little (cosine
//! 0.26) if the rates differ. The step at a seam of the sensor (0.77).
//!
//! ## Neglected
//!
//! The second order, ε²/8 of the radius: below 1e-6 px at 512 px for ε = 1e-4.
//!
//! ## Source
//!
//! J. Weng, P. Cohen, M. Herniou, IEEE Trans. PAMI 14(10), 965 (1992); the skew of a camera matrix: R. Hartley, A. Zisserman,
//! Multiple View Geometry (2004), section 6.2.4.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Axes that are not perpendicular, as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct Shear;

impl Displacement for Shear {
    const ID: &'static str = "shear";
    const FACTS: Facts =
        Facts { ordinary_size: Some(OrdinarySize::of(1e-4, "at most 1e-4 (Weng, Cohen and Herniou 1992)")), ..Facts::NONE };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "shear_rad", unit: "rad", typical: 1e-4, range: (-0.01, 0.01) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let half = parameters[0] * 0.5;
        Light { point_px: [x - half * y, y - half * x], ..light }
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
        // astropy 8.0.2: a linear WCS whose axes meet at 90° + ε exactly, PC = [[cos ε/2, -sin ε/2], [-sin ε/2, cos ε/2]] with
        // ε = 2e-4, wcs_pix2world at (410, -330) relative to the reference pixel. The exact axes differ from the first order by ε²/8 of the
        // coordinate, 2e-6 px.
        vec![ReferenceValue::of_point(
            "astropy.wcs, oblique axes as a PC matrix",
            Context::new(StarState::default(), Observation::default()),
            vec![2e-4],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [410.032_997_949_945, -330.040_998_349_931_67]],
            3e-6,
        )]
    }

    fn source() -> &'static str {
        page_source!("shear.rs")
    }
}
