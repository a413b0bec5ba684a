//! # Magnitude equation
//!
//! ## What it does
//!
//! The measured centre of a star's image depends on how bright the star is, by whatever cause: an image that is not symmetric
//! and cut off at a threshold, charge that lags behind, guiding. The name is that of the photographic plates on which it was first seen.
//!
//! ## Equation
//!
//! Δ = (m − 5)·(a, b), m the star's magnitude, the measured one where the image has one, else V of the catalogue; the ideal
//! point is the measured one minus Δ. Which magnitude counts as zero is of no account, since a shift of all stars goes into the attitude; 5
//! keeps the two nearly apart. A star of unknown magnitude is not moved.
//!
//! ## Parameters
//!
//! `x_px_per_mag` (a), `y_px_per_mag` (b): displacement of a star one magnitude fainter, px.
//!
//! ## Signature
//!
//! Residuals in one direction, the same all over the frame, in proportion to the magnitude: of the order of
//! 0.01 px per magnitude. Hardly any of it is taken up by other parameters (0.93 survives).
//!
//! ## Confused with
//!
//! All that has a cause of its own: stray light (cosine 0.92), a step between amplifiers (0.70), overshoot (0.70), losses
//! in the transfer of charge (0.56). Unless the gradient of the background, the row or the form of the images decides, the cause is open.
//!
//! ## Neglected
//!
//! Terms in (m − 5)²; the dependence on place (see coma) and colour; variable stars, where the magnitude is the catalogue's.
//!
//! ## Source
//!
//! H. Eichhorn, Astronomy of Star Positions (1974), for plates; J. Anderson et al., A&A 454, 1029 (2006), for CCDs.

use crate::dual::Real;
use crate::effects::{CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, StarState};

/// A shift in proportion to the magnitude.
#[derive(Clone, Copy, Debug)]
pub struct MagnitudeEquation;

impl CentroidShift for MagnitudeEquation {
    const ID: &'static str = "magnitude-equation";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.01, "0.01 px/mag (Anderson and King 2000)")),
        profile_covariates: &[("", "magnitude")],
        ..Facts::NONE
    };
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x_px_per_mag", unit: "px/mag", typical: 0.01, range: (-5.0, 5.0) },
        ParameterSpec { name: "y_px_per_mag", unit: "px/mag", typical: 0.01, range: (-5.0, 5.0) },
    ];

    fn unit_shift<T: Real>(parameter: usize, _: &Light<T>, context: &Context) -> [T; 2] {
        let mut shift = [T::constant(0.0); 2];
        shift[parameter] = T::constant(context.magnitude_offset());
        shift
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The page's equation with 30 digits by mpmath 1.4.1: m = 7.25, (a, b) = (0.013, −0.021) px/mag.
        let star = StarState { magnitude: 7.25, ..StarState::default() };
        vec![ReferenceValue::of_point(
            "the page's equation, mpmath 1.4.1",
            Context::new(star, Observation::default()),
            vec![0.013, -0.021],
            2000.0,
            [512.0; 2],
            [[100.0, -50.0], [99.970_75, -49.952_75]],
            1e-12,
        )]
    }

    fn source() -> &'static str {
        page_source!("magnitude_equation.rs")
    }
}
