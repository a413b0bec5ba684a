//! # Settling of the video signal
//!
//! ## What it does
//!
//! The amplifier's signal has not settled when a pixel is sampled: a part of a bright pixel is found in the next one of the
//! row, and the images of bright stars are drawn along the direction of readout, or back, where the signal overshoots.
//!
//! ## Equation
//!
//! Δx = a·F/10 000, F the electrons of the star, measured where the image has them, else as many as a magnitude of 5 stands for
//! 10 000; the ideal point is the measured one minus Δ. A star of unknown brightness is not moved.
//!
//! ### In the pixels
//!
//! Along every row electrons = (1 − k)·N + k·m, m the memory of the pixels before: m becomes m + (N − m)·(1 − e^(−1/τ)) with every
//! pixel and begins with the first pixel's own value, so that an even field stays even. k < 0 is an overshoot.
//! Such a tail moves stars of every brightness by the same, k/(1 − e^(−1/τ)) px by the centre of mass, of which the
//! program's fit sees 0.58 to 0.81 for 10³ to 10⁵ electrons: beside the equation above its cosine is 1 at one brightness and 0.64 for all of these
//! stars, 0.72 by the fit. What grows with the flux is settling that depends on the signal.
//!
//! ## Parameters
//!
//! `x_px` (a): displacement along the row of a star of 10 000 electrons (of magnitude 5 where electrons are not measured), px.
//! Positive: a tail to the right. In the pixels: `tail_relative` (k), part of a pixel that is found after it, ±0.01; `tail_px` (τ), length of the
//! memory in pixels, 0.1 to 100.
//!
//! ## Signature
//!
//! Residuals along the rows that grow with the flux, the same all over the frame: 0.003 to 0.03 px for bright
//! stars. The attitude takes up the mean.
//!
//! ## Confused with
//!
//! The magnitude equation (cosine 0.70), which goes with the logarithm: stars over several magnitudes tell them apart, and
//! the tail on one side of the images tells the cause.
//!
//! ## Neglected
//!
//! A part of constant share, which would move all stars by the same and goes into the attitude; saturation of the effect, so
//! that a few very bright stars may say more than they know; dependence on the peak rather than on the flux, and so on the image's width.
//!
//! ## Source
//!
//! J. R. Janesick, Scientific Charge-Coupled Devices (2001), on the bandwidth of the video chain. The proportion to the flux is an
//! engineer's approximation.

use bytemuck::{Pod, Zeroable};

use crate::dual::Real;
use crate::effects::pixel::pass::{Along, Carry, LinePass, PassHead, Sweep};
use crate::effects::pixel::{ExposureContext, Stage, uniform_fields};
use crate::effects::{
    CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Rendering, StarImage, StarState,
};

/// A shift along the rows in proportion to the flux.
#[derive(Clone, Copy, Debug)]
pub struct Overshoot;

impl CentroidShift for Overshoot {
    const ID: &'static str = "overshoot";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.01, "0.003 to 0.03 px (Janesick 2001)")),
        profile_covariates: &[("", "flux")],
        ..Facts::NONE
    };
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "x_px", unit: "px", typical: 0.01, range: (-1.0, 1.0) }];

    fn unit_shift<T: Real>(_: usize, _: &Light<T>, context: &Context) -> [T; 2] {
        [context.relative_flux().unwrap_or(0.0), 0.0].map(T::constant)
    }

    fn rendering(_: usize) -> Option<Rendering> {
        let parameters = &[("tail_relative", [-0.01, 0.01])];
        Some(Rendering::Stage { effect: "overshoot", parameters, step: None, by_colour: false })
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
        page_source!("overshoot.rs")
    }
}

/// A signal that has not settled, in the pixels.
#[derive(Clone, Copy, Debug)]
pub struct Settling;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct OvershootUniforms {
    tail_relative: f32,
    forgets: f32,
}

/// The twin. The carry is the memory, and whether there is one.
fn overshoot(uniforms: OvershootUniforms, electrons: f32, carry: &mut Carry) -> f32 {
    let memory = if carry[1] > 0.0 { carry[0] } else { electrons };
    *carry = [memory + (electrons - memory) * uniforms.forgets, 1.0, 0.0, 0.0];
    electrons + uniforms.tail_relative * (memory - electrons)
}

impl PassHead for Settling {
    const ID: &'static str = "overshoot";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("tail_relative", 0.03), ("tail_px", 2.0)];
    const STAGE: Stage = Stage::Readout;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "tail_relative", unit: "", typical: 0.004, range: (-0.5, 0.5) },
        ParameterSpec { name: "tail_px", unit: "px", typical: 0.8, range: (0.01, 1e4) },
    ];
    const CONSERVES_CHARGE: bool = true;
    const WGSL: &'static str = include_str!("../../../shaders/overshoot.wgsl");
    const SOURCE: &'static str = page_source!("overshoot.rs");
    type Uniforms = OvershootUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(OvershootUniforms { tail_relative, forgets });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> OvershootUniforms {
        OvershootUniforms { tail_relative: parameters[0] as f32, forgets: -(-1.0 / parameters[1]).exp_m1() as f32 }
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0, 0.8])
    }
}

impl LinePass for Settling {
    const SWEEPS: &'static [Sweep] = &[Sweep { along: Along::Rows, backward: false }];

    #[inline]
    fn step(uniforms: &OvershootUniforms, _: usize, _: [usize; 2], electrons: f32, carry: &mut Carry) -> f32 {
        overshoot(*uniforms, electrons, carry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pixel over an even field leaves a tail k·(1 − e^(−1/τ))·e^(−n/τ) of itself, n pixels after the next.
    #[test]
    fn a_bright_pixel_leaves_an_exponential_tail() {
        let (k, tau) = (0.02_f64, 2.5_f64);
        let uniforms = Settling::uniforms(&[k, tau], &ExposureContext::default());
        let mut row = [500.0_f32; 40];
        row[10] += 80_000.0;
        let mut carry = Carry::default();
        for electrons in &mut row {
            *electrons = overshoot(uniforms, *electrons, &mut carry);
        }
        assert!(row[..10].iter().all(|electrons| *electrons == 500.0));
        assert!((f64::from(row[10]) - 500.0 - 80_000.0 * (1.0 - k)).abs() < 0.02);
        for n in 0..20 {
            let expected = 80_000.0 * k * -(-1.0 / tau).exp_m1() * (-f64::from(n) / tau).exp();
            let seen = f64::from(row[11 + n as usize]) - 500.0;
            assert!((seen - expected).abs() < 1e-3 + 1e-5 * expected, "{n}: {seen} for {expected}");
        }
    }
}
