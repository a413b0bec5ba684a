//! # Dark current
//!
//! ## What it does
//!
//! Heat frees electrons in the silicon; they fill the pixels as light does, and vary from pixel to pixel (DSNU).
//!
//! ## Equation
//!
//! electrons += D·t·2^((T − T₀)/K)·e^(s·w − s²/2), t the exposure time, T the temperature told for the frame (T₀ where none is), w
//! standard normal, one number a pixel, the same in every frame of a seed. The pattern's mean is 1. Photon noise acts on the sum.
//!
//! ## Parameters
//!
//! `dark_e_per_px_s` (D): mean rate at T₀, electrons per pixel and second, 10⁻³ (cooled) to 100; `reference_temperature_c` (T₀);
//! `doubling_k` (K): rise of temperature that doubles the rate, 5 to 10 K; `dsnu_relative` (s): standard deviation of the rate's logarithm from
//! pixel to pixel, 0 to 1.
//!
//! ## Signature
//!
//! A background that rises with exposure time and temperature, and a grain in it that does not change.
//!
//! ## Confused with
//!
//! The sky background: exposures with a closed shutter, or at two temperatures, tell them apart.
//!
//! ## Neglected
//!
//! The curve of the Arrhenius law (its doubling grows by a quarter from −20 to 20 °C); glow of the amplifier; hot pixels, which are an
//! effect of their own; that a frame's rows wait for their readout for different times.
//!
//! ## Source
//!
//! J. R. Janesick, Scientific Charge-Coupled Devices (SPIE, 2001), chapter 7; EMVA Standard 1288, release 4.0, section 7.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::math::standard_normal;
use crate::effects::pixel::pattern::{exponential, fixed_words};
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, uniform_fields};
use crate::rng::StageKey;

/// Dark current.
#[derive(Clone, Copy, Debug)]
pub struct DarkCurrent;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct DarkCurrentUniforms {
    mean_e: f32,
    log_sigma: f32,
    log_mean: f32,
}

/// Electrons that heat frees over the exposure, at the temperature of its frame, at a rate that is given for `reference_temperature_c`.
pub(super) fn freed_e(exposure: &ExposureContext, rate_e_per_s: f64, [reference_temperature_c, doubling_k]: [f64; 2]) -> f32 {
    let temperature_c = exposure.temperature_c.unwrap_or(reference_temperature_c);
    let growth = ((temperature_c - reference_temperature_c) / doubling_k).exp2();
    (rate_e_per_s * exposure.exposure_s * growth) as f32
}

/// The twin.
fn dark_current(uniforms: &DarkCurrentUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
    for (i, electrons) in (0..).zip(pixels) {
        let words = fixed_words(key, first_pixel.wrapping_add(i), 0);
        *electrons += uniforms.mean_e * exponential(uniforms.log_mean + uniforms.log_sigma * standard_normal(words[0], words[1]));
    }
}

impl PixelEffect for DarkCurrent {
    const ID: &'static str = "dark-current";
    const STAGE: Stage = Stage::Light;
    const ROLE: Role = Role::Adds;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "dark_e_per_px_s", unit: "e-/px/s", typical: 5.0, range: (0.0, 1e9) },
        ParameterSpec { name: "reference_temperature_c", unit: "°C", typical: 20.0, range: (-273.0, 200.0) },
        ParameterSpec { name: "doubling_k", unit: "K", typical: 6.5, range: (0.5, 100.0) },
        ParameterSpec { name: "dsnu_relative", unit: "", typical: 0.3, range: (0.0, 3.0) },
    ];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 4;
    const WGSL: &'static str = include_str!("../../../shaders/dark_current.wgsl");
    const SOURCE: &'static str = page_source!("dark_current.rs");
    type Uniforms = DarkCurrentUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(DarkCurrentUniforms { mean_e, log_sigma, log_mean });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> DarkCurrentUniforms {
        DarkCurrentUniforms {
            mean_e: freed_e(exposure, parameters[0], [parameters[1], parameters[2]]),
            log_sigma: parameters[3] as f32,
            log_mean: (-0.5 * parameters[3] * parameters[3]) as f32,
        }
    }
    fn apply(uniforms: &DarkCurrentUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        dark_current(uniforms, key, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0, 20.0, 6.5, 0.0])
    }
    fn least_e(_parameters: &[f64], _exposure: &ExposureContext, least_e: f64) -> f64 {
        least_e
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dark(parameters: &[f64], exposure: &ExposureContext) -> Vec<f64> {
        let mut pixels = vec![0.0_f32; 200_000];
        let key = StageKey { seed: 2, frame: exposure.frame_index, stage: DarkCurrent::RNG_STAGE };
        dark_current(&DarkCurrent::uniforms(parameters, exposure), key, 0, &mut pixels);
        pixels.iter().map(|e| f64::from(*e)).collect()
    }

    #[test]
    fn the_rate_doubles_and_the_grain_is_log_normal() {
        let exposure = ExposureContext { exposure_s: 4.0, ..ExposureContext::default() };
        let warmer = ExposureContext { temperature_c: Some(33.0), frame_index: 5, ..exposure };
        let even = [5.0, 20.0, 6.5, 0.0];
        assert!(dark(&even, &exposure).iter().all(|e| (e - 20.0).abs() < 1e-4));
        assert!(dark(&even, &warmer).iter().all(|e| (e - 80.0).abs() < 1e-3));
        let s = 0.4_f64;
        let (cold, warm) = (dark(&[5.0, 20.0, 6.5, s], &exposure), dark(&[5.0, 20.0, 6.5, s], &warmer));
        assert!(cold.iter().zip(&warm).all(|(a, b)| (b / a - 4.0).abs() < 1e-5), "the pattern does not stay");
        let n = cold.len() as f64;
        let mean = cold.iter().sum::<f64>() / n;
        let relative = cold.iter().map(|e| (e / mean - 1.0).powi(2)).sum::<f64>() / n;
        let expected = (s * s).exp_m1();
        assert!((mean / 20.0 - 1.0).abs() < 4.5 * (expected / n).sqrt(), "{mean}");
        assert!((relative / expected - 1.0).abs() < 0.03, "{relative} for {expected}");
    }
}
