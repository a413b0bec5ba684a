//! # Sky background
//!
//! ## What it does
//!
//! The light of the sky between the stars (airglow, zodiacal light, unresolved stars, scattered light), even over the frame.
//!
//! ## Equation
//!
//! electrons += rate · exposure time.
//!
//! ## Parameters
//!
//! `background_e_per_px_s`: electrons per pixel and second.
//!
//! ## Signature
//!
//! Nothing in the places of the stars; its photon noise is the noise floor of long exposures.
//!
//! ## Confused with
//!
//! The bias and the dark current, from which only exposures of several lengths tell it.
//!
//! ## Neglected
//!
//! Gradients and structure (stray light, the Milky Way, vignetting), which are effects of their own.
//!
//! ## Source
//!
//! Ch. Leinert et al., "The 1997 reference of diffuse night sky brightness", A&AS 127, 1 (1998).

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::lanes::vectorised;
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, uniform_fields};
use crate::rng::StageKey;

/// Sky background.
#[derive(Clone, Copy, Debug)]
pub struct Background;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct BackgroundUniforms {
    electrons_per_px: f32,
}

vectorised! {
    /// The twin.
    fn background(uniforms: BackgroundUniforms, pixels: &mut [f32]) {
        for electrons in pixels {
            *electrons += uniforms.electrons_per_px;
        }
    }
}

impl PixelEffect for Background {
    const ID: &'static str = "background";
    const STAGE: Stage = Stage::Light;
    const ROLE: Role = Role::Adds;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "background_e_per_px_s", unit: "e-/px/s", typical: 50.0, range: (0.0, 1e9) }];
    const WGSL: &'static str = include_str!("../../../shaders/background.wgsl");
    const SOURCE: &'static str = page_source!("background.rs");
    type Uniforms = BackgroundUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(BackgroundUniforms { electrons_per_px });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> BackgroundUniforms {
        BackgroundUniforms { electrons_per_px: (parameters[0] * exposure.exposure_s) as f32 }
    }
    fn apply(uniforms: &BackgroundUniforms, _key: StageKey, _first_pixel: u32, pixels: &mut [f32]) {
        background(*uniforms, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0])
    }
    fn least_e(parameters: &[f64], exposure: &ExposureContext, least_e: f64) -> f64 {
        least_e + parameters[0] * exposure.exposure_s
    }
}
