//! # Blooming
//!
//! ## What it does
//!
//! What a pixel cannot hold spills over the barriers of its column into the pixels above and below, until these are full too:
//! a bright star draws a line along its column. Drains beside the pixels (anti-blooming) take a part of it away.
//!
//! ## Equation
//!
//! A pixel with N > W electrons keeps W. Of the excess the share d is drained; one half of the rest flows up, the other down,
//! each filling the pixels that it meets up to W. What reaches the end of the column has left the frame.
//!
//! ## Parameters
//!
//! `full_well_e` (W): electrons that a pixel holds, 10⁴ to 10⁶; `drained` (d): share of the excess that anti-blooming takes
//! away, 0 to 1.
//!
//! ## Signature
//!
//! Full stars without their lines: centres biased along the columns, neighbours in the same column lost.
//!
//! ## Confused with
//!
//! Smear of a frame transfer without a shutter, which draws lines of all stars over the whole column, and faint ones.
//!
//! ## Neglected
//!
//! Full wells that differ from pixel to pixel; barriers that differ above and below; spilling over channel stops into the next
//! column; that a pixel close to its full well spills with a probability. Where two lines meet, the one from above fills the pixels between them
//! first, so that the excess then reaches further up.
//!
//! ## Source
//!
//! J. R. Janesick, Scientific Charge-Coupled Devices (SPIE, 2001), chapter 4; the halves up and down are also those of the bleed
//! trails of LSST's imSim.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::pass::{Along, Carry, LinePass, PassHead, Sweep};
use crate::effects::pixel::{ExposureContext, Role, Stage, uniform_fields};

/// Excess charge along the columns.
#[derive(Clone, Copy, Debug)]
pub struct Blooming;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct BloomingUniforms {
    full_well_e: f32,
    half_kept: f32,
}

/// The twin: `share` of the excess goes on with the carry, and `stays` of it waits here for the sweep back.
fn blooming(full_well_e: f32, share: f32, stays: f32, electrons: f32, carry: &mut Carry) -> f32 {
    let held = if electrons < full_well_e { electrons } else { full_well_e };
    let excess = electrons - held;
    let room = full_well_e - held;
    let filled = if carry[0] < room { carry[0] } else { room };
    carry[0] = carry[0] - filled + share * excess;
    held + filled + stays * excess
}

impl PassHead for Blooming {
    const ID: &'static str = "blooming";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("full_well_e", 8000.0)];
    const STAGE: Stage = Stage::Charge;
    const ROLE: Role = Role::Cuts;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "full_well_e", unit: "e-", typical: 1e5, range: (1.0, 1e12) },
        ParameterSpec { name: "drained", unit: "", typical: 0.0, range: (0.0, 1.0) },
    ];
    const CONSERVES_CHARGE: bool = true;
    const WGSL: &'static str = include_str!("../../../shaders/blooming.wgsl");
    const SOURCE: &'static str = page_source!("blooming.rs");
    type Uniforms = BloomingUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(BloomingUniforms { full_well_e, half_kept });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> BloomingUniforms {
        BloomingUniforms { full_well_e: parameters[0] as f32, half_kept: (0.5 * (1.0 - parameters[1])) as f32 }
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![1e12, 0.0])
    }
}

impl LinePass for Blooming {
    const SWEEPS: &'static [Sweep] = &[Sweep { along: Along::Columns, backward: false }, Sweep { along: Along::Columns, backward: true }];

    #[inline]
    fn step(uniforms: &BloomingUniforms, sweep: usize, _: [usize; 2], electrons: f32, carry: &mut Carry) -> f32 {
        let half = uniforms.half_kept;
        let (share, stays) = if sweep == 0 { (half, half) } else { (1.0, 0.0) };
        blooming(uniforms.full_well_e, share, stays, electrons, carry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bloomed(parameters: &[f64], column: &[f32]) -> Vec<f32> {
        let uniforms = Blooming::uniforms(parameters, &ExposureContext::default());
        let mut column = column.to_vec();
        for sweep in 0..2 {
            let mut carry = Carry::default();
            for turn in 0..column.len() {
                let y = if Blooming::SWEEPS[sweep].backward { column.len() - 1 - turn } else { turn };
                column[y] = Blooming::step(&uniforms, sweep, [0, y], column[y], &mut carry);
            }
        }
        column
    }

    #[test]
    fn the_excess_fills_equal_ways_up_and_down() {
        let mut column = vec![40.0_f32; 21];
        column[10] = 100.0 + 7.0 * 60.0; // fills three and a half pixels each way
        let after = bloomed(&[100.0, 0.0], &column);
        let mut expected = vec![40.0_f32; 21];
        expected[7..14].fill(100.0);
        (expected[6], expected[14]) = (70.0, 70.0);
        assert_eq!(after, expected);
    }

    #[test]
    fn drains_and_edges_take_their_share_and_full_neighbours_are_passed() {
        // Two full pixels with one between them: 30 drained of 40 each, 5 + 5 go on.
        let after = bloomed(&[100.0, 0.75], &[0.0, 140.0, 93.0, 140.0, 0.0]);
        assert_eq!(after, [5.0 + 3.0, 100.0, 100.0, 100.0, 5.0]);
        // At the edge: what flows up leaves.
        assert_eq!(bloomed(&[100.0, 0.0], &[150.0, 0.0, 0.0]), [100.0, 25.0, 0.0]);
        assert_eq!(bloomed(&[100.0, 0.0], &[3.0, 99.5, 100.0]), [3.0, 99.5, 100.0]);
    }
}
