//! # Veiling glare
//!
//! ## What it does
//!
//! Light that is scattered by lens surfaces, edges and the detector itself lies as an even veil over the frame.
//!
//! ## Equation
//!
//! electrons = (1 − v)·electrons + v·S/(columns · rows), S the light of all stars that reach the frame. It acts before the background is
//! added: of an even background the veil gives back what it takes.
//!
//! ## Parameters
//!
//! `share` (v): the part of the light that goes into the veil, 0.005 (coated lens) to 0.1.
//!
//! ## Signature
//!
//! Stars too bright by v, and a background that follows the brightness of the stars in the field.
//!
//! ## Confused with
//!
//! The zero point and the sky background, if all frames hold the same light; a frame with a very bright star tells them apart.
//!
//! ## Neglected
//!
//! The veil's shape (brighter around the source, ghosts); light of sources outside the frame, which is stray light.
//!
//! ## Source
//!
//! ISO 9358:1994, veiling glare of image-forming systems, whose index this is for a field of stars.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, uniform_fields};
use crate::rng::StageKey;

/// An even veil of scattered star light.
#[derive(Clone, Copy, Debug)]
pub struct VeilingGlare;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct VeilingGlareUniforms {
    kept: f32,
    veil_e_per_px: f32,
}

/// The twin.
fn veiling_glare(uniforms: VeilingGlareUniforms, pixels: &mut [f32]) {
    for electrons in pixels {
        *electrons = *electrons * uniforms.kept + uniforms.veil_e_per_px;
    }
}

impl PixelEffect for VeilingGlare {
    const ID: &'static str = "veiling-glare";
    const STAGE: Stage = Stage::Light;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "share", unit: "", typical: 0.02, range: (0.0, 1.0) }];
    const WGSL: &'static str = include_str!("../../../shaders/veiling_glare.wgsl");
    const SOURCE: &'static str = page_source!("veiling_glare.rs");
    type Uniforms = VeilingGlareUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(VeilingGlareUniforms { kept, veil_e_per_px });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> VeilingGlareUniforms {
        let share = parameters[0];
        let pixels = (exposure.width_px * exposure.height_px) as f64;
        VeilingGlareUniforms { kept: (1.0 - share) as f32, veil_e_per_px: (share * exposure.star_light_e / pixels) as f32 }
    }
    fn apply(uniforms: &VeilingGlareUniforms, _key: StageKey, _first_pixel: u32, pixels: &mut [f32]) {
        veiling_glare(*uniforms, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0])
    }
    fn least_e(parameters: &[f64], exposure: &ExposureContext, least_e: f64) -> f64 {
        (1.0 - parameters[0]) * least_e + parameters[0] * exposure.star_light_e / (exposure.width_px * exposure.height_px) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_veil_holds_what_the_stars_lose() {
        let mut pixels: Vec<f32> = (0..400).map(|i| if i % 7 == 0 { 1000.0 } else { 3.0 }).collect();
        let before: f64 = pixels.iter().map(|e| f64::from(*e)).sum();
        let exposure = ExposureContext { width_px: 20, height_px: 20, star_light_e: before, ..ExposureContext::default() };
        veiling_glare(VeilingGlare::uniforms(&[0.05], &exposure), &mut pixels);
        let after: f64 = pixels.iter().map(|e| f64::from(*e)).sum();
        assert!((after / before - 1.0).abs() < 1e-6, "{after} of {before}");
        assert!((f64::from(pixels[0]) - 0.95 * 1000.0 - 0.05 * before / 400.0).abs() < 1e-3);
    }
}
