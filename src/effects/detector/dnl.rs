//! # Unequal steps of the converter (DNL)
//!
//! ## What it does
//!
//! The levels at which an analogue-to-digital converter goes from one count to the next are not evenly spaced: some counts are rare, some
//! frequent. The pattern is the converter's own and stays.
//!
//! ## Equation
//!
//! v = electrons/gain + bias. The edge between the counts k − 1 and k lies at k − ½ + e_k, e_k normal with the standard deviation D/√2 and
//! held within ±0.45, so that the width of a count has the standard deviation D. What is handed to the converter is (k − bias)·gain, which it turns
//! into k.
//!
//! ## Parameters
//!
//! `dnl_dn` (D): standard deviation of the width of a count, 0.05 to 0.5; `gain_e_per_dn` and `bias_dn`: those of the
//! converter.
//!
//! ## Signature
//!
//! A histogram of the background that is not smooth; up to 1/√12 DN of noise more. No displacement that can be
//! seen where the noise is larger than a count.
//!
//! ## Confused with
//!
//! Compression, whose gaps in the histogram are periodic.
//!
//! ## Neglected
//!
//! The larger errors at carries of a binary converter (every 2ᵏ counts); several converters that take turns; the integral of the errors.
//!
//! ## Source
//!
//! IEEE Standard 1241-2010, for the definition.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::math::{floor, standard_normal};
use crate::effects::pixel::pattern::fixed_words;
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, uniform_fields};
use crate::rng::StageKey;

/// Counts of unequal width.
#[derive(Clone, Copy, Debug)]
pub struct Dnl;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct DnlUniforms {
    edge_sigma_dn: f32,
    dn_per_e: f32,
    e_per_dn: f32,
    bias_dn: f32,
}

/// Where the edge below a count lies beside its place.
fn edge(uniforms: &DnlUniforms, key: StageKey, count: f32) -> f32 {
    let words = fixed_words(key, count as u32, 0);
    (uniforms.edge_sigma_dn * standard_normal(words[0], words[1])).clamp(-0.45, 0.45)
}

/// The twin.
fn dnl(uniforms: &DnlUniforms, key: StageKey, pixels: &mut [f32]) {
    for electrons in pixels {
        let exact = *electrons * uniforms.dn_per_e + uniforms.bias_dn + 0.5;
        let exact = if exact > 0.0 { exact } else { 0.0 };
        let count = floor(exact);
        let above = exact - count;
        // An edge is never further than 0.45 from its place, so one of the two at most is in question.
        let down = if above < 0.45 && above < edge(uniforms, key, count) { 1.0 } else { 0.0 };
        let up = if above >= 0.55 && above - 1.0 >= edge(uniforms, key, count + 1.0) { 1.0 } else { 0.0 };
        *electrons = (count - down + up - uniforms.bias_dn) * uniforms.e_per_dn;
    }
}

impl PixelEffect for Dnl {
    const ID: &'static str = "dnl";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("dnl_dn", 0.8), ("gain_e_per_dn", 1.0)];
    const STAGE: Stage = Stage::Readout;
    const ROLE: Role = Role::Cuts;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "dnl_dn", unit: "DN", typical: 0.2, range: (0.0, 1.0) },
        ParameterSpec { name: "gain_e_per_dn", unit: "e-/DN", typical: 2.0, range: (1e-6, 1e6) },
        ParameterSpec { name: "bias_dn", unit: "DN", typical: 200.0, range: (0.0, 65_535.0) },
    ];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 7;
    const WGSL: &'static str = include_str!("../../../shaders/dnl.wgsl");
    const SOURCE: &'static str = page_source!("dnl.rs");
    type Uniforms = DnlUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(DnlUniforms { edge_sigma_dn, dn_per_e, e_per_dn, bias_dn });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> DnlUniforms {
        DnlUniforms {
            edge_sigma_dn: (parameters[0] * std::f64::consts::FRAC_1_SQRT_2) as f32,
            dn_per_e: (1.0 / parameters[1]) as f32,
            e_per_dn: parameters[1] as f32,
            bias_dn: parameters[2] as f32,
        }
    }
    fn apply(uniforms: &DnlUniforms, key: StageKey, _first_pixel: u32, pixels: &mut [f32]) {
        dnl(uniforms, key, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        None // it hands on whole counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp counts how wide each count is.
    #[test]
    fn widths_of_counts_scatter_as_asked_and_never_skip() {
        let widths = |dnl_dn: f64| {
            let uniforms = Dnl::uniforms(&[dnl_dn, 2.0, 100.0], &ExposureContext::default());
            // 4000 counts, 64 steps to each.
            let mut ramp: Vec<f32> = (0..4000 * 64).map(|i| (i as f32 / 64.0 - 0.5) * 2.0).collect();
            dnl(&uniforms, StageKey { seed: 1, frame: 3, stage: Dnl::RNG_STAGE }, &mut ramp);
            assert!(ramp.windows(2).all(|pair| pair[1] >= pair[0] && pair[1] - pair[0] <= 2.0));
            let mut widths = vec![0_u32; 4000];
            for electrons in ramp {
                assert_eq!(electrons % 2.0, 0.0);
                if let Some(width) = widths.get_mut((electrons / 2.0) as usize) {
                    *width += 1;
                }
            }
            widths[1..3999].iter().map(|steps| f64::from(*steps) / 64.0).collect::<Vec<_>>()
        };
        assert!(widths(0.0).iter().all(|width| *width == 1.0));
        let uneven = widths(0.2);
        let n = uneven.len() as f64;
        let mean = uneven.iter().sum::<f64>() / n;
        let sigma = (uneven.iter().map(|width| (width - mean).powi(2)).sum::<f64>() / n).sqrt();
        assert!((mean - 1.0).abs() < 1e-3 && (sigma / 0.2 - 1.0).abs() < 0.06, "{mean} {sigma}");
    }
}
