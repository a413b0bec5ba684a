//! # Read noise
//!
//! ## What it does
//!
//! The amplifier adds a normal error to every pixel that is read.
//!
//! ## Equation
//!
//! electrons += σ · w, w standard normal and independent from pixel to pixel.
//!
//! ## Parameters
//!
//! `read_noise_e`: σ in electrons.
//!
//! ## Signature
//!
//! Faint stars that are measured too well: it is the noise floor of short exposures.
//!
//! ## Confused with
//!
//! A wrong gain and the noise of the background; the intercept of variance against mean tells it.
//!
//! ## Neglected
//!
//! The random telegraph signal of CMOS pixels, noise of whole rows or columns, and the spread of σ from pixel to pixel.
//! Draws end at 6.7 σ.
//!
//! ## Source
//!
//! J. R. Janesick, Photon Transfer (SPIE, 2007), chapter 3; G. E. P. Box, M. E. Muller, Ann. Math. Stat. 29, 610 (1958).

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::lanes::{vectorised, with_normals};
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, uniform_fields};
use crate::rng::StageKey;

/// Read noise.
#[derive(Clone, Copy, Debug)]
pub struct ReadNoise;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ReadNoiseUniforms {
    sigma_e: f32,
}

vectorised! {
    /// The twin.
    fn read_noise(uniforms: ReadNoiseUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        with_normals(key, first_pixel, pixels, |run, normals| {
            for (electrons, w) in run.iter_mut().zip(normals) {
                *electrons += uniforms.sigma_e * w;
            }
        });
    }
}

impl PixelEffect for ReadNoise {
    const ID: &'static str = "read-noise";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("read_noise_e", 5.0)];
    const STAGE: Stage = Stage::Readout;
    const ROLE: Role = Role::Noise;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "read_noise_e", unit: "e-", typical: 5.0, range: (0.0, 1e6) }];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 2;
    const WGSL: &'static str = include_str!("../../../shaders/read_noise.wgsl");
    const SOURCE: &'static str = page_source!("read_noise.rs");
    type Uniforms = ReadNoiseUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(ReadNoiseUniforms { sigma_e });

    fn uniforms(parameters: &[f64], _exposure: &ExposureContext) -> ReadNoiseUniforms {
        ReadNoiseUniforms { sigma_e: parameters[0] as f32 }
    }
    fn apply(uniforms: &ReadNoiseUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        read_noise(*uniforms, key, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(frame: u32, stage: u32) -> Vec<f64> {
        let mut pixels = vec![0.0; 400_000];
        read_noise(ReadNoiseUniforms { sigma_e: 1.0 }, StageKey { seed: 5, frame, stage }, 0, &mut pixels);
        pixels.iter().map(|w| f64::from(*w)).collect()
    }

    /// Moments up to the fourth, and the shares beyond 1, 2, 3 and 4 σ, within 4.5 standard errors of the normal law's.
    #[test]
    fn draws_are_standard_normal() {
        let draws = drawn(0, ReadNoise::RNG_STAGE);
        let n = draws.len() as f64;
        for (power, moment, variance) in [(1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)] {
            let seen = draws.iter().map(|w| w.powi(power)).sum::<f64>() / n;
            assert!((seen - moment).abs() < 4.5 * (f64::sqrt(variance / n)), "moment {power}: {seen} for {moment}");
        }
        for (limit, share) in [(1.0, 0.158_655_254), (2.0, 0.022_750_132), (3.0, 0.001_349_898), (4.0, 3.167_124e-5)] {
            for side in [1.0, -1.0] {
                let seen = draws.iter().filter(|w| side * **w > limit).count() as f64;
                assert!((seen - n * share).abs() < 4.5 * (n * share).sqrt(), "{seen} of {n} draws beyond {limit}");
            }
        }
    }

    /// Neighbouring pixels, rows, frames and stages are uncorrelated.
    #[test]
    fn draws_are_independent() {
        let draws = drawn(0, 2);
        let correlation = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>() / (a.len().min(b.len()) as f64).sqrt();
        // Squares too: the two numbers of a pair share a radius.
        let squares = |w: &[f64]| w.iter().map(|x| (x * x - 1.0) / 2.0_f64.sqrt()).collect::<Vec<_>>();
        let squared = squares(&draws);
        for lag in (1..=64).chain([255, 256, 257, 1023, 1024, 1025, 2048, 4096, 65_536]) {
            assert!(correlation(&draws, &draws[lag..]).abs() < 4.5, "pixels {lag} apart");
            assert!(correlation(&squared, &squared[lag..]).abs() < 4.5, "squares of pixels {lag} apart");
        }
        for (what, other) in [("frames", drawn(1, 2)), ("stages", drawn(0, 1)), ("far frames", drawn(1 << 20, 2))] {
            assert!(correlation(&draws, &other).abs() < 4.5, "{what}");
            assert!(correlation(&squared, &squares(&other)).abs() < 4.5, "squares of {what}");
        }
    }
}
