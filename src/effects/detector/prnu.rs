//! # Unequal response of the pixels (PRNU)
//!
//! ## What it does
//!
//! Pixels answer to the same light with slightly different numbers of electrons: their areas and coatings differ. The pattern stays.
//!
//! ## Equation
//!
//! electrons ·= max(1 + ν·w, 0), w standard normal, one number a pixel, the same in every frame of a seed.
//!
//! ## Parameters
//!
//! `relative` (ν): standard deviation of the response, 0.002 to 0.02 for CCD and CMOS sensors.
//!
//! ## Signature
//!
//! Fluxes that scatter by about ν/√(4π)/σ, and centres that scatter by 0.002 px for 1 %, the same whenever a star
//! returns to the same pixel.
//!
//! ## Confused with
//!
//! Photon noise, unless the same pixel is seen again or a flat field is taken.
//!
//! ## Neglected
//!
//! Structure on larger scales (dust, tree rings, stitching), dependence on colour, and the response within a pixel.
//!
//! ## Source
//!
//! J. R. Janesick, Photon Transfer (SPIE, 2007), chapter 5; EMVA Standard 1288, release 4.0.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::lanes::vectorised;
use crate::effects::pixel::math::standard_normal;
use crate::effects::pixel::pattern::fixed_words;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, uniform_fields};
use crate::rng::StageKey;

/// Response of the pixels.
#[derive(Clone, Copy, Debug)]
pub struct Prnu;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct PrnuUniforms {
    relative: f32,
}

vectorised! {
    /// The twin.
    fn prnu(uniforms: PrnuUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        for (i, electrons) in (0..).zip(pixels) {
            let words = fixed_words(key, first_pixel.wrapping_add(i), 0);
            let response = 1.0 + uniforms.relative * standard_normal(words[0], words[1]);
            *electrons *= if response > 0.0 { response } else { 0.0 };
        }
    }
}

impl PixelEffect for Prnu {
    const ID: &'static str = "prnu";
    const STAGE: Stage = Stage::Light;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "relative", unit: "", typical: 0.01, range: (0.0, 1.0) }];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 3;
    const WGSL: &'static str = include_str!("../../../shaders/prnu.wgsl");
    const SOURCE: &'static str = page_source!("prnu.rs");
    type Uniforms = PrnuUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(PrnuUniforms { relative });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> PrnuUniforms {
        PrnuUniforms { relative: parameters[0] as f32 }
    }
    fn apply(uniforms: &PrnuUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        prnu(*uniforms, key, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pattern_has_its_width_and_stays() {
        let flat = |frame: u32| {
            let mut pixels = vec![1000.0_f32; 100_000];
            prnu(PrnuUniforms { relative: 0.02 }, StageKey { seed: 11, frame, stage: Prnu::RNG_STAGE }, 0, &mut pixels);
            pixels
        };
        let pattern = flat(0);
        assert_eq!(pattern, flat(9));
        let n = pattern.len() as f64;
        let mean = pattern.iter().map(|e| f64::from(*e)).sum::<f64>() / n;
        let sigma = (pattern.iter().map(|e| (f64::from(*e) - mean).powi(2)).sum::<f64>() / n).sqrt();
        assert!((mean - 1000.0).abs() < 4.5 * 20.0 / n.sqrt(), "{mean}");
        assert!((sigma / 20.0 - 1.0).abs() < 4.5 / (2.0 * n).sqrt(), "{sigma}");
    }
}
