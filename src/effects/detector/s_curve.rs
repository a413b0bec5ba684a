//! # S-curve of the measured centre
//!
//! ## What it does
//!
//! A star's centre computed from a few pixels is drawn towards the middle of its pixel, or pushed away from it, depending on
//! where within the pixel the star stands: the estimator does not know how the light is spread over the pixels.
//!
//! ## Equation
//!
//! Δ = (a·sin 2πx, b·sin 2πy), x and y the MEASURED column and row (a pixel's middle has a whole number); the ideal point is the
//! measured one minus Δ. For the centre of mass of a whole Gaussian image a = b = −(1/π)·e^(−2π²σ²); a window or a threshold makes it
//! larger and positive or negative.
//!
//! ## Parameters
//!
//! `x_px` (a), `y_px` (b): amplitude along the columns and along the rows, px. Positive: images are pushed away from the middle
//! of the pixel that they stand on.
//!
//! ## Signature
//!
//! Residuals that follow the fraction of the pixel and nothing else: 0.028 px for σ = 0.35 px, 0.0023 px for
//! 0.5 px, 0.12 px at most for the centre of mass of a window of 3 px with σ = 0.7 px. Nothing of it is taken up by other parameters (0.98
//! survives).
//!
//! ### Rendered
//!
//! A response 1 + a·cos 2πu within the pixel gives this form (cosine 0.997) with the amplitude (a/π)·e^(−2π²σ²)·(1/4 − 2π²σ²) by the
//! centre of mass, and by the program's fit: −0.0107·a px for σ = 0.5 px by both; −1.9·10⁻⁴·a and −5·10⁻⁵·a for σ = 0.7 px.
//!
//! ## Confused with
//!
//! The response within a pixel, which has the same form: flux that follows the fraction of the pixel tells them apart.
//!
//! ## Neglected
//!
//! Higher harmonics (sin 4πx); the dependence on the image's width, and so on place and colour. The argument is the measured
//! point where it should be the true one: a difference of πa² at most, 0.0013 px for a = 0.02 px. An adjustment takes the predicted point for
//! it: with noise of s px in the measured one the amplitude would be found too small by the factor e^(−2π²s²), 5 % at s = 0.05 px.
//!
//! ## Source
//!
//! B. F. Alexander, K. C. Ng, Optical Engineering 30, 1320 (1991); J. Anderson, I. R. King, PASP 112, 1360 (2000).

use std::f64::consts::TAU;

use crate::dual::Real;
use crate::effects::{
    CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Rendering, StarState,
};

/// A sine of the fraction of the pixel.
#[derive(Clone, Copy, Debug)]
pub struct SCurve;

impl CentroidShift for SCurve {
    const ID: &'static str = "s-curve";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.03, "0.002 to 0.12 px by window and image width (Alexander and Ng 1991)")),
        profile_covariates: &[("x", "pixel-phase-x"), ("y", "pixel-phase-y")],
        ..Facts::NONE
    };
    const WITHIN_PIXELS: bool = true;
    // An amplitude beyond 1/2π would give two true places for one measured.
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x_px", unit: "px", typical: 0.02, range: (-0.15, 0.15) },
        ParameterSpec { name: "y_px", unit: "px", typical: 0.02, range: (-0.15, 0.15) },
    ];

    fn unit_shift<T: Real>(parameter: usize, measured: &Light<T>, _: &Context) -> [T; 2] {
        let mut shift = [T::constant(0.0); 2];
        shift[parameter] = (measured.pixel_px[parameter] * TAU).sin();
        shift
    }

    fn rendering(parameter: usize) -> Option<Rendering> {
        Some(Rendering::WithinPixel { axis: parameter, cosine: [-0.1, 0.1] })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // scipy 1.17.1: Gaussians integrated over the pixels by differences of norm.cdf on 100 pixels, and their centre of mass. The
        // parameters are the cited −(1/π)·e^(−2π²σ²) for the width of each axis; the next harmonic and the difference between true and
        // measured argument stay below the tolerance at a quarter of a pixel, and for a wide image anywhere.
        let context = Context::new(StarState::default(), Observation::default());
        let source = "centre of mass of a Gaussian integrated over pixels, scipy 1.17.1";
        let case = |parameters: Vec<f64>, measured: [f64; 2], ideal: [f64; 2], tolerance: f64| {
            ReferenceValue::of_point(source, context, parameters, 2000.0, [0.0; 2], [measured, ideal], tolerance)
        };
        vec![
            // σ = 0.5 px along x, 0.55 px along y.
            case(
                vec![-0.002_289_247_572_440_189_8, -0.000_812_137_783_155_291_5],
                [10.247_710_752_427_56, 7.750_812_137_783_155],
                [10.25, 7.75],
                5e-7,
            ),
            // σ = 0.65 px along both.
            case(vec![-7.601_760_461_966_048e-5; 2], [10.099_955_317_973_09, 7.349_938_500_465_99], [10.1, 7.35], 4e-8),
        ]
    }

    fn source() -> &'static str {
        page_source!("s_curve.rs")
    }
}
