//! # Spiral distortion
//!
//! ## What it does
//!
//! A tangential displacement that grows with the radius: fibre-optic tapers and image intensifiers twist the image, and so
//! does an assembly that is not mirror-symmetric. A lens of centred surfaces cannot do it.
//!
//! ## Equation
//!
//! At the MEASURED point (x̄, ȳ) relative to the principal point, R² = (x̄² + ȳ²)/f²: Δ = k_t·R²·(−ȳ, x̄), and the ideal point
//! is (x̄, ȳ) − Δ.
//!
//! ## Parameters
//!
//! `spiral_norm` (k_t): a pure number, since the radius counts in focal lengths. 0.003 displaces a star by 0.05 px at 512 px
//! from the axis with f = 2900 px. Positive: from +x towards +y, clockwise as the frame is seen with y down.
//!
//! ## Signature
//!
//! Residuals across the radius, the same all around and in all frames, that change sign between the axis
//! and the corner: a field of pure curl. 0 to 0.1 px. The rolls of the frames take up its mean rotation.
//!
//! ## Confused with
//!
//! The roll of every frame, and nothing else: no other static field looks the same all around and has a curl.
//!
//! ## Neglected
//!
//! The fifth power of the radius.
//!
//! ## Source
//!
//! J. Weng, P. Cohen, M. Herniou, IEEE Trans. PAMI 14(10), 965 (1992), for tangential distortions; the equation is the lowest
//! rotationally symmetric field without divergence that is not a rotation.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Spiral distortion as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct Spiral;

impl Displacement for Spiral {
    const ID: &'static str = "spiral";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::largest_px(0.05, "up to 0.1 px (Brown 1966)")),
        profile_covariates: &[("", "field-radius")],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "spiral_norm", unit: "", typical: 3e-3, range: (-10.0, 10.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let turn = parameters[0] * (x * x + y * y) / (light.focal_length_px * light.focal_length_px);
        Light { point_px: [x + turn * y, y - turn * x], ..light }
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
        // The SIP convention of FITS adds polynomials to the measured pixel, and so does this model. astropy 8.0.2, Sip.pix2foc at
        // (410, -330) relative to the reference pixel with A_2_1 = A_0_3 = k/2000², B_3_0 = B_1_2 = -k/2000², where k = 0.02.
        vec![ReferenceValue::of_point(
            "astropy.wcs, Sip.pix2foc",
            Context::new(StarState::default(), Observation::default()),
            vec![0.02],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [409.542_95, -330.567_85]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("spiral.rs")
    }
}
