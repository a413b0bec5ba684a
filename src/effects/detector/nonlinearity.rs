//! # Non-linear response
//!
//! ## What it does
//!
//! The amplifier at the pixel gives less voltage for the last electrons than for the first: the capacity that it charges, and its own
//! gain, change with the level.
//!
//! ## Equation
//!
//! electrons = N·(1 − α·min(max(N/W, 0), 1)).
//!
//! ## Parameters
//!
//! `relative_at_full` (α): part of the signal that a full pixel lacks, 0.005 to 0.05; negative where the response rises;
//! `full_well_e` (W): electrons of a full pixel.
//!
//! ## Signature
//!
//! Fluxes of bright stars too small, images of bright stars too flat in their core; variance against mean bends.
//!
//! ## Confused with
//!
//! Brighter-fatter, which widens images but keeps their flux; a term of colour in the catalogue's magnitudes.
//!
//! ## Neglected
//!
//! Higher orders, and a dependence on the pixel; the response below some ten electrons (deferred charge).
//!
//! ## Source
//!
//! J. R. Janesick, Photon Transfer (SPIE, 2007), chapter 7.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, uniform_fields};
use crate::effects::{ImageContext, ImageEffect, ImageResponse, Rendering};
use crate::rng::StageKey;

/// A response that bends.
#[derive(Clone, Copy, Debug)]
pub struct Nonlinearity;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct NonlinearityUniforms {
    relative_at_full: f32,
    per_full_well: f32,
}

/// The twin.
fn nonlinearity(uniforms: NonlinearityUniforms, pixels: &mut [f32]) {
    for electrons in pixels {
        let filling = *electrons * uniforms.per_full_well;
        let filling = if filling > 0.0 { filling } else { 0.0 };
        let filling = if filling < 1.0 { filling } else { 1.0 };
        *electrons *= 1.0 - uniforms.relative_at_full * filling;
    }
}

impl PixelEffect for Nonlinearity {
    const ID: &'static str = "nonlinearity";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("full_well_e", 4e4)];
    const STAGE: Stage = Stage::Readout;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "relative_at_full", unit: "", typical: 0.02, range: (-0.5, 0.5) },
        ParameterSpec { name: "full_well_e", unit: "e-", typical: 1e5, range: (1.0, 1e12) },
    ];
    const WGSL: &'static str = include_str!("../../../shaders/nonlinearity.wgsl");
    const SOURCE: &'static str = page_source!("nonlinearity.rs");
    type Uniforms = NonlinearityUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(NonlinearityUniforms { relative_at_full, per_full_well });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> NonlinearityUniforms {
        NonlinearityUniforms { relative_at_full: parameters[0] as f32, per_full_well: (1.0 / parameters[1]) as f32 }
    }
    fn apply(uniforms: &NonlinearityUniforms, _key: StageKey, _first_pixel: u32, pixels: &mut [f32]) {
        nonlinearity(*uniforms, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0, 1e5])
    }
}

impl ImageEffect for Nonlinearity {
    fn id(&self) -> &'static str {
        <Self as PixelEffect>::ID
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("relative_at_full", "")]
    }
    fn follows(&self) -> &'static str {
        "flux"
    }
    fn needs(&self) -> &'static str {
        "the peaks of the stars, and the counts at which a pixel is full"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.02, "0.5 to 5 % (Janesick 2007, chapter 7)")
    }
    fn rendering(&self) -> Option<Rendering> {
        // The loss goes with α/W: a well that nothing fills cuts nothing.
        let parameters = &[("relative_at_full", [-0.5, 0.5]), ("full_well_e", [1e7; 2])];
        Some(Rendering::Stage { effect: <Self as PixelEffect>::ID, parameters, step: None, by_colour: false })
    }
    /// Of S(1 − α(S + 2B)/W), S a Gaussian of peak P and variance σ², by the sums of `pixel_statistics/star_images.rs`. Under a weight of variance k·σ² a
    /// Gaussian has k/(k + 1) of its σ² as variance and of 2πσ²P as light, its square k/(2k + 1). So it loses αP(k + 1)/(2k + 1)/W of its light under the
    /// wider weight (k = 1.8²: 0.567), and under the weight of the shape (k = 1) the variance grows by 2/3·(1/2 − 1/3)·αP/W of σ², which is four
    /// times as much of the image before the weight: 4/9.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let peak = image.fullness?;
        let square = 4.0 / 9.0 * peak * image.sigma_px * image.sigma_px;
        let wider = ImageResponse { second_px2: [square, 0.0, square], ..ImageResponse::default() };
        Some(vec![ImageResponse::loss(0.567 * peak + 2.0 * image.background_fullness).and(wider)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_pixel_lacks_its_share() {
        let mut pixels = [-20.0, 0.0, 25_000.0, 50_000.0, 100_000.0];
        nonlinearity(Nonlinearity::uniforms(&[0.04, 5e4], &ExposureContext::default()), &mut pixels);
        for (seen, expected) in pixels.iter().zip([-20.0, 0.0, 24_500.0, 48_000.0, 96_000.0_f32]) {
            assert!((seen - expected).abs() < 0.01, "{seen} for {expected}");
        }
    }
}
