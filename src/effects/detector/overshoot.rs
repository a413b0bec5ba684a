//! # Settling of the video signal
//!
//! **What it is.** The amplifier's signal has not settled when a pixel is sampled: a part of a bright pixel is found in the next one of the
//! row, and the images of bright stars are drawn along the direction of readout, or back, where the signal overshoots.
//!
//! **Equation.** Δx = a·F/10 000, F the electrons of the star, measured where the image has them, else as many as a magnitude of 5 stands for
//! 10 000; the ideal point is the measured one minus Δ. A star of unknown brightness is not moved.
//!
//! **Parameter.** `x_px` (a): displacement along the row of a star of 10 000 electrons (of magnitude 5 where electrons are not measured), px.
//! Positive: a tail to the right.
//!
//! **What it leaves when left out.** Residuals along the rows that grow with the flux, the same all over the frame: 0.003 to 0.03 px for bright
//! stars. The attitude takes up the mean.
//!
//! **Confused with.** The magnitude equation (cosine 0.70), which goes with the logarithm: stars over several magnitudes tell them apart, and
//! the tail on one side of the images tells the cause.
//!
//! **Neglected.** A part of constant share, which would move all stars by the same and goes into the attitude; saturation of the effect, so
//! that a few very bright stars may say more than they know; dependence on the peak rather than on the flux, and so on the image's width.
//!
//! **Source.** J. R. Janesick, Scientific Charge-Coupled Devices (2001), on the bandwidth of the video chain. The proportion to the flux is an
//! engineer's approximation.

use crate::dual::Real;
use crate::effects::{CentroidShift, Context, Light, Observation, ParameterSpec, ReferenceValue, StarImage, StarState};

/// A shift along the rows in proportion to the flux.
#[derive(Clone, Copy, Debug)]
pub struct Overshoot;

impl CentroidShift for Overshoot {
    const ID: &'static str = "overshoot";
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "x_px", unit: "px", typical: 0.01, range: (-1.0, 1.0) }];

    fn unit_shift<T: Real>(_: usize, _: &Light<T>, context: &Context) -> [T; 2] {
        [context.relative_flux().unwrap_or(0.0), 0.0].map(T::constant)
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The page's equation with 30 digits by mpmath 1.4.1: a = 0.02 px, a star of 35 000 electrons, and one of magnitude 2.5.
        let case = |magnitude: f64, flux_e: Option<f64>, ideal: f64| {
            let context = Context::new(StarState { magnitude, ..StarState::default() }, Observation::default());
            let context = context.with_image(StarImage { flux_e, ..StarImage::default() });
            let source = "the page's equation, mpmath 1.4.1";
            ReferenceValue::of_point(source, context, vec![0.02], 2000.0, [512.0; 2], [[100.0, -50.0], [ideal, -50.0]], 1e-12)
        };
        vec![case(6.0, Some(35_000.0), 99.93), case(2.5, None, 99.8)]
    }

    fn source() -> &'static str {
        include_str!("overshoot.rs")
    }
}
