//! # Full well and analogue-to-digital converter
//!
//! ## What it does
//!
//! A pixel holds no more than its full well; the converter turns electrons into whole counts and stops at its top.
//!
//! ## Equation
//!
//! counts = ⌊min(electrons, full well)/gain + bias + ½⌋, held within 0 … top, top = min(`saturation_dn`, 2^bits − 1).
//!
//! ## Parameters
//!
//! `gain_e_per_dn`: electrons per count; `bias_dn`: the count of an empty pixel; `full_well_e`: electrons that a pixel holds;
//! `bits`: of the converter, 8 to 16, which end at 2^bits − 1; `saturation_dn`: its highest count, where that lies below the end of the bits.
//!
//! ## Signature
//!
//! Cut-off tops of bright stars move centroids and lose flux; rounding adds 1/12 count² of variance.
//!
//! ## Confused with
//!
//! Another gain (the slope of variance against mean), a non-linear response near the top.
//!
//! ## Neglected
//!
//! Blooming of what the full well does not hold; unequal steps of the converter. The read noise of a full pixel is cut with it, so
//! that every saturated pixel has the same count.
//!
//! ## Source
//!
//! J. R. Janesick, Photon Transfer (SPIE, 2007), chapters 2 and 5.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::lanes::vectorised;
use crate::effects::pixel::math::floor_positive;
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, uniform_fields};
use crate::rng::StageKey;

/// Full well and converter.
#[derive(Clone, Copy, Debug)]
pub struct Adc;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct AdcUniforms {
    dn_per_e: f32,
    bias_and_half_dn: f32,
    full_well_e: f32,
    top_dn: f32,
}

/// The highest count that so many bits hold.
#[must_use]
pub fn full_scale_dn(bits: f64) -> f64 {
    bits.floor().exp2() - 1.0
}

/// The count of a full pixel, from the effect's parameters: the converter's top, or below it that of the full well.
#[must_use]
pub fn full_pixel_dn(parameters: &[f64]) -> f32 {
    let mut pixel = [f32::MAX];
    adc(&Adc::uniforms(parameters, &ExposureContext::default()), &mut pixel);
    pixel[0]
}

vectorised! {
    /// The twin.
    fn adc(uniforms: &AdcUniforms, pixels: &mut [f32]) {
        for pixel in pixels {
            let held = if *pixel < uniforms.full_well_e { *pixel } else { uniforms.full_well_e };
            let exact = held * uniforms.dn_per_e + uniforms.bias_and_half_dn;
            let low = if exact > 0.0 { exact } else { 0.0 };
            *pixel = floor_positive(if low < uniforms.top_dn { low } else { uniforms.top_dn });
        }
    }
}

impl PixelEffect for Adc {
    const ID: &'static str = "adc";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("saturation_dn", 4095.0), ("gain_e_per_dn", 1.0), ("full_well_e", 1e6)];
    const STAGE: Stage = Stage::Digital;
    const ROLE: Role = Role::Cuts;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "gain_e_per_dn", unit: "e-/DN", typical: 2.0, range: (1e-6, 1e6) },
        ParameterSpec { name: "bias_dn", unit: "DN", typical: 200.0, range: (0.0, 65_535.0) },
        ParameterSpec { name: "full_well_e", unit: "e-", typical: 1e5, range: (1.0, 1e12) },
        ParameterSpec { name: "saturation_dn", unit: "DN", typical: 65_535.0, range: (1.0, 65_535.0) },
        ParameterSpec { name: "bits", unit: "", typical: 16.0, range: (8.0, 16.0) },
    ];
    const WGSL: &'static str = include_str!("../../../shaders/adc.wgsl");
    const SOURCE: &'static str = page_source!("adc.rs");
    type Uniforms = AdcUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(AdcUniforms { dn_per_e, bias_and_half_dn, full_well_e, top_dn });

    fn uniforms(parameters: &[f64], _exposure: &ExposureContext) -> AdcUniforms {
        AdcUniforms {
            dn_per_e: (1.0 / parameters[0]) as f32,
            bias_and_half_dn: (parameters[1] + 0.5) as f32,
            full_well_e: parameters[2] as f32,
            top_dn: parameters[3].min(full_scale_dn(parameters[4])).floor() as f32,
        }
    }
    fn apply(uniforms: &AdcUniforms, _key: StageKey, _first_pixel: u32, pixels: &mut [f32]) {
        adc(uniforms, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        None // a count is not an electron
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn converted(parameters: &[f64], electrons: f32) -> f32 {
        let mut pixel = [electrons];
        adc(&Adc::uniforms(parameters, &ExposureContext::default()), &mut pixel);
        pixel[0]
    }

    #[test]
    fn rounds_and_stops() {
        let parameters = [2.0, 100.0, 5000.0, 4095.0, 16.0];
        for (electrons, counts) in [(0.0, 100.0), (0.9, 100.0), (1.0, 101.0), (200.0, 200.0), (-3.0, 99.0), (-1e9, 0.0), (1e9, 2600.0)] {
            assert_eq!(converted(&parameters, electrons), counts, "{electrons} electrons");
        }
        assert_eq!(full_pixel_dn(&parameters), 2600.0);
        assert_eq!(full_pixel_dn(&[2.0, 100.0, 1e12, 4095.0, 16.0]), 4095.0);
        for (bits, top) in [(8.0, 255.0), (10.0, 1023.0), (12.0, 4095.0), (14.0, 16_383.0), (16.0, 65_535.0)] {
            assert_eq!(full_pixel_dn(&[2.0, 100.0, 1e12, 65_535.0, bits]), top, "{bits} bits");
        }
        assert_eq!(converted(&parameters, f32::NAN), 2600.0);
    }
}
