//! # Lossy compression
//!
//! ## What it does
//!
//! The camera keeps its frames as JPEG does: blocks of 8 × 8 pixels are turned into frequencies, and these are rounded, the
//! high ones more coarsely. Faint stars and the grain of the noise go, edges of blocks come.
//!
//! ## Equation
//!
//! c = orthonormal cosine transform of the counts of a block; c ← q·K·⌊c/(q·K) + ½⌋, K the standard's table of luminance; the transform back is
//! rounded to counts and held within 0 … 65535. Blocks are counted from the frame's first pixel; the last ones, cut by its edge, are transformed at their
//! own size with the table's first rows and columns.
//!
//! ## Parameters
//!
//! `table_scale_dn` (q): counts per unit of the table. 1 is quality 50 for 8 bits (2: quality 25; 0.2: quality 90); a converter of more bits
//! that is stretched to 8 has as many times more.
//!
//! ## Signature
//!
//! Noise that is too smooth and correlated within blocks, a comb in the histogram of the frequencies, positions that
//! follow the phase in a block of 8 px, no faint stars.
//!
//! ## Confused with
//!
//! Noise that is smaller than said; a detection limit.
//!
//! ## Neglected
//!
//! Colour and its coarser sampling; the curve (gamma) that 8-bit pictures go through; quantisation chosen block by block, as in video.
//!
//! ## Source
//!
//! ITU-T T.81 (1992), annex A.3.3 (transform) and table K.1; G. K. Wallace, Comm. ACM 34, 30 (1991).

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::math::{cos_turn, floor};
use crate::effects::pixel::pass::{NeighbourPass, PassHead, Source};
use crate::effects::pixel::{ExposureContext, Role, Stage, uniform_fields};

/// Rounding of the frequencies of blocks.
#[derive(Clone, Copy, Debug)]
pub struct Jpeg;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct JpegUniforms {
    table_scale_dn: f32,
}

/// The highest count of a frame.
const MAX_COUNTS: f32 = 65_535.0;

/// Side of a block, px.
const BLOCK_PX: usize = 8;

/// Table K.1 of the standard, row by row of vertical frequency.
const LUMINANCE: [f32; BLOCK_PX * BLOCK_PX] = [
    16.0, 11.0, 10.0, 16.0, 24.0, 40.0, 51.0, 61.0, //
    12.0, 12.0, 14.0, 19.0, 26.0, 58.0, 60.0, 55.0, //
    14.0, 13.0, 16.0, 24.0, 40.0, 57.0, 69.0, 56.0, //
    14.0, 17.0, 22.0, 29.0, 51.0, 87.0, 80.0, 62.0, //
    18.0, 22.0, 37.0, 56.0, 68.0, 109.0, 103.0, 77.0, //
    24.0, 35.0, 55.0, 64.0, 81.0, 104.0, 113.0, 92.0, //
    49.0, 64.0, 78.0, 87.0, 103.0, 121.0, 120.0, 101.0, //
    72.0, 92.0, 95.0, 98.0, 112.0, 100.0, 103.0, 99.0,
];

/// Element of the orthonormal cosine transform of `size` numbers: frequency `k` at place `i`.
fn basis(size: usize, k: usize, i: usize) -> f32 {
    // A quarter of a turn of `size` parts; the part lost to whole numbers is 1e-9 of a turn.
    let turn = (((2 * i + 1) * k) as u32).wrapping_mul(0x4000_0000 / size as u32);
    let scale = if k == 0 { 1.0 } else { 2.0 };
    (scale / size as f32).sqrt() * cos_turn(turn)
}

/// All elements for a block cut to `size`.
fn table(size: usize) -> [[f32; BLOCK_PX]; BLOCK_PX] {
    std::array::from_fn(|k| std::array::from_fn(|i| if k < size && i < size { basis(size, k, i) } else { 0.0 }))
}

/// A number to the nearest multiple of `step`.
fn jpeg(coefficient: f32, step: f32) -> f32 {
    step * floor(coefficient / step + 0.5)
}

impl PassHead for Jpeg {
    const ID: &'static str = "jpeg";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("table_scale_dn", 2.0)];
    const STAGE: Stage = Stage::Digital;
    const ROLE: Role = Role::Cuts;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "table_scale_dn", unit: "DN", typical: 1.0, range: (1e-3, 1e4) }];
    const CONSERVES_CHARGE: bool = false;
    const WGSL: &'static str = include_str!("../../../shaders/jpeg.wgsl");
    const SOURCE: &'static str = page_source!("jpeg.rs");
    type Uniforms = JpegUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(JpegUniforms { table_scale_dn });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> JpegUniforms {
        JpegUniforms { table_scale_dn: parameters[0] as f32 }
    }
    fn identity() -> Option<Vec<f64>> {
        None // it hands on whole counts
    }
}

impl NeighbourPass for Jpeg {
    /// Rows to frequencies, columns to frequencies and rounding, columns back, rows back.
    const SWEEPS: usize = 4;

    fn row(uniforms: &JpegUniforms, sweep: usize, source: &Source<'_>, y: usize, row: &mut [f32]) {
        let is_row = sweep == 0 || sweep == 3;
        let first_y = y - y % BLOCK_PX;
        let of_rows = table((source.height - first_y).min(BLOCK_PX));
        let rows: [&[f32]; BLOCK_PX] = std::array::from_fn(|k| source.row(first_y + k, 0));
        let (whole, last) = (table(BLOCK_PX), table((row.len() - 1) % BLOCK_PX + 1));
        let width = row.len();
        for (x, value) in row.iter_mut().enumerate() {
            let first_x = x - x % BLOCK_PX;
            let along_row = if width - first_x >= BLOCK_PX { &whole } else { &last };
            let (basis, at) = if is_row { (along_row, x - first_x) } else { (&of_rows, y - first_y) };
            let mut sum = 0.0;
            for k in 0..BLOCK_PX {
                let other = if is_row { rows[y - first_y][(first_x + k).min(width - 1)] } else { rows[k][x] };
                sum += other * if sweep < 2 { basis[at][k] } else { basis[k][at] };
            }
            *value = match sweep {
                1 => jpeg(sum, uniforms.table_scale_dn * LUMINANCE[(y - first_y) * BLOCK_PX + x - first_x]),
                3 => {
                    let count = floor(sum + 0.5);
                    let count = if count > 0.0 { count } else { 0.0 };
                    if count < MAX_COUNTS { count } else { MAX_COUNTS }
                }
                _ => sum,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::pixel::pass::{FrameBuffer, Neighbours};
    use crate::effects::pixel::{AnyPixelEffect, Work};

    fn compressed(scale: f64, width: usize, frame: &[f32]) -> Vec<f32> {
        let Work::Frame(_, pass) = Neighbours(Jpeg).work() else { unreachable!("it is a pass") };
        let uniforms = Neighbours(Jpeg).uniforms(&[scale], &ExposureContext::default());
        let mut counts = frame.to_vec();
        pass(&uniforms, &mut FrameBuffer { width, electrons: &mut counts, scratch: &mut Vec::new() });
        counts
    }

    #[test]
    fn the_transform_is_orthonormal_at_every_size() {
        for size in 1..=BLOCK_PX {
            let table = table(size);
            for a in 0..size {
                for b in 0..size {
                    let product: f32 = (0..size).map(|i| table[a][i] * table[b][i]).sum();
                    assert!((product - if a == b { 1.0 } else { 0.0 }).abs() < 1e-6, "{size}: {a}, {b}");
                }
            }
        }
    }

    /// Without loss where the steps are fine; with coarse ones every frequency is a whole multiple of its step, but for the rounding to counts. An
    /// even field moves by less than half a step of its mean, which is two counts for sixteen units.
    #[test]
    fn frequencies_are_rounded_and_nothing_else() {
        let frame: Vec<f32> = (0..19 * 21).map(|i| (10_000 + (i * 7919) % 400) as f32).collect();
        assert_eq!(compressed(1e-3, 19, &frame), frame);
        let even = compressed(1.0, 16, &[101.0; 256]);
        assert!(even.iter().all(|count| *count == even[0] && (*count - 101.0).abs() <= 1.0), "{}", even[0]);
        let coarse = compressed(3.0, 8, &frame[..64]);
        assert_ne!(coarse, frame[..64]);
        let table = table(BLOCK_PX);
        for v in 0..BLOCK_PX {
            for u in 0..BLOCK_PX {
                let sum: f32 = (0..64).map(|i| coarse[i] * table[v][i / 8] * table[u][i % 8]).sum();
                let step = 3.0 * LUMINANCE[v * 8 + u];
                assert!((sum - (sum / step).round() * step).abs() < 2.5, "frequency {u}, {v}: {sum} in steps of {step}");
            }
        }
    }
}
