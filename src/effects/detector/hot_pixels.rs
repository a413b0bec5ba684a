//! # Hot, blinking and dead pixels
//!
//! ## What it does
//!
//! Defects of the crystal give some pixels a dark current far above the others'; in some of these it is there in one frame and
//! gone in the next (random telegraph signal). Dead pixels answer to nothing.
//!
//! ## Equation
//!
//! A pixel is hot with probability h, and then electrons += E·t·2^((T − T₀)/K), E drawn from an exponential law of mean L; a part b of the hot
//! pixels does so in every frame with probability ½ only. A pixel is dead with probability d, and then holds nothing. Which pixels are which,
//! and E, stay from frame to frame of a seed.
//!
//! ## Parameters
//!
//! `hot_per_million` (h) and `dead_per_million` (d): share of the pixels, parts per million, 0 to 10⁴ after years in orbit;
//! `level_e_per_px_s` (L): mean rate of a hot pixel at T₀, electrons per second, 10 to 10⁴; `blinking_share` (b): 0 to 1;
//! `reference_temperature_c` (T₀) and `doubling_k` (K) as for the dark current.
//!
//! ## Signature
//!
//! False stars that stay on their pixel; centres drawn by h·δ/F px where a star meets one: 0.05 to 0.1 px for 50 e- beside
//! a star of 1000 e-.
//!
//! ## Confused with
//!
//! Faint stars, in one frame; cosmic rays, which do not come back.
//!
//! ## Neglected
//!
//! States that last from frame to frame, for which there is `random-telegraph`; levels with more than two states and switching within an exposure; clusters and columns of defects; annealing.
//!
//! ## Source
//!
//! G. R. Hopkinson, V. Goiffon, A. Mohammadzadeh, IEEE TNS 55, 2197 (2008), for telegraph signals; EMVA Standard 1288 for the rest.

use bytemuck::{Pod, Zeroable};

use super::dark_current::freed_e;
use crate::effects::ParameterSpec;
use crate::effects::pixel::defect_pixels::for_each_defect;
use crate::effects::pixel::math::{poly_ln, unit_interval};
use crate::effects::pixel::pattern::word_limit;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, uniform_fields};
use crate::rng::StageKey;

/// Pixels with a defect.
#[derive(Clone, Copy, Debug)]
pub struct HotPixels;

/// What the shader gets. A word below a limit has the probability limit/2³².
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct HotPixelsUniforms {
    hot_below: u32,
    dead_above: u32,
    blinks_below: u32,
    mean_e: f32,
}

/// The twin.
fn hot_pixels(uniforms: &HotPixelsUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
    let limits = [uniforms.hot_below, uniforms.dead_above];
    for_each_defect(limits, key, first_pixel, pixels, |index, words, electrons| {
        if words[0] < uniforms.hot_below {
            let is_off = words[2] < uniforms.blinks_below && key.words(index, 0)[0] & 1 == 1;
            *electrons += if is_off { 0.0 } else { -poly_ln(unit_interval(words[1])) * uniforms.mean_e };
        }
        if words[0] > uniforms.dead_above {
            *electrons = 0.0;
        }
    });
}

impl PixelEffect for HotPixels {
    const ID: &'static str = "hot-pixels";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("level_e_per_px_s", 3000.0)];
    const STAGE: Stage = Stage::Light;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "hot_per_million", unit: "1e-6", typical: 500.0, range: (0.0, 5e5) },
        ParameterSpec { name: "level_e_per_px_s", unit: "e-/px/s", typical: 500.0, range: (0.0, 1e9) },
        ParameterSpec { name: "blinking_share", unit: "", typical: 0.2, range: (0.0, 1.0) },
        ParameterSpec { name: "dead_per_million", unit: "1e-6", typical: 20.0, range: (0.0, 5e5) },
        ParameterSpec { name: "reference_temperature_c", unit: "°C", typical: 20.0, range: (-273.0, 200.0) },
        ParameterSpec { name: "doubling_k", unit: "K", typical: 6.5, range: (0.5, 100.0) },
    ];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 5;
    const WGSL: &'static str = include_str!("../../../shaders/hot_pixels.wgsl");
    const SOURCE: &'static str = page_source!("hot_pixels.rs");
    type Uniforms = HotPixelsUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(HotPixelsUniforms { hot_below, dead_above, blinks_below, mean_e });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> HotPixelsUniforms {
        HotPixelsUniforms {
            hot_below: word_limit(1e-6 * parameters[0]),
            dead_above: u32::MAX - word_limit(1e-6 * parameters[3]),
            blinks_below: word_limit(parameters[2]),
            mean_e: freed_e(exposure, parameters[1], [parameters[4], parameters[5]]),
        }
    }
    fn apply(uniforms: &HotPixelsUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        hot_pixels(uniforms, key, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0, 500.0, 0.0, 0.0, 20.0, 6.5])
    }
    fn least_e(parameters: &[f64], _exposure: &ExposureContext, least_e: f64) -> f64 {
        if parameters[3] > 0.0 { 0.0 } else { least_e }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is kept of a frame changes nothing in those behind it, with few defects or many.
    #[test]
    fn a_frame_is_the_same_before_and_after_others() {
        let frame = |seed: u64, hot_per_million: f64, first_pixel: u32| {
            let mut pixels = vec![7.0_f32; 100_000];
            let parameters = [hot_per_million, 100.0, 0.3, hot_per_million / 10.0, 20.0, 6.5];
            let uniforms = HotPixels::uniforms(&parameters, &ExposureContext { exposure_s: 1.0, ..ExposureContext::default() });
            hot_pixels(&uniforms, StageKey { seed, frame: 2, stage: HotPixels::RNG_STAGE }, first_pixel, &mut pixels);
            pixels
        };
        for (rate, other) in [(3000.0, 30.0), (30.0, 3000.0)] {
            let seed = 1_000_000 + rate as u64;
            let whole = frame(seed, rate, 0);
            assert!(whole.iter().any(|electrons| *electrons != 7.0));
            let _ = frame(seed, other, 0);
            assert_eq!(whole, frame(seed, rate, 0), "{rate}");
            // From elsewhere on, where blocks lie otherwise.
            assert_eq!(whole[777..], frame(seed, rate, 777)[..100_000 - 777], "{rate}");
        }
    }

    /// Numbers, levels and blinking, within 4.5 standard errors of their laws.
    #[test]
    fn defects_follow_their_laws() {
        let frame = |frame: u32| {
            let mut pixels = vec![7.0_f32; 1_000_000];
            let exposure = ExposureContext { exposure_s: 2.0, ..ExposureContext::default() };
            let uniforms = HotPixels::uniforms(&[20_000.0, 100.0, 0.3, 5_000.0, 20.0, 6.5], &exposure);
            hot_pixels(&uniforms, StageKey { seed: 4, frame, stage: HotPixels::RNG_STAGE }, 0, &mut pixels);
            pixels
        };
        let (one, other) = (frame(0), frame(1));
        let near = |seen: f64, expected: f64, sigma: f64, what: &str| {
            assert!((seen - expected).abs() < 4.5 * sigma, "{what}: {seen} for {expected}");
        };
        let dead = one.iter().filter(|e| **e == 0.0).count() as f64;
        near(dead, 5_000.0, 5_000.0_f64.sqrt(), "dead");
        // In one frame 85 % of the hot pixels are there, in both the 70 % that do not blink and a quarter of those that do.
        let levels: Vec<f64> = one.iter().filter(|e| **e > 7.0).map(|e| f64::from(*e) - 7.0).collect();
        near(levels.len() as f64, 17_000.0, 17_000.0_f64.sqrt(), "hot");
        near(levels.iter().sum::<f64>() / levels.len() as f64, 200.0, 200.0 / 17_000.0_f64.sqrt(), "level");
        let both: Vec<(f32, f32)> = one.iter().zip(&other).filter(|(a, b)| **a > 7.0 && **b > 7.0).map(|(a, b)| (*a, *b)).collect();
        near(both.len() as f64, 15_500.0, 15_500.0_f64.sqrt(), "in both frames");
        assert!(both.iter().all(|(a, b)| a == b), "a level changes");
    }
}
