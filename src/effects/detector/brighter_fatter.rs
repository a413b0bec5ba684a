//! # Brighter and fatter
//!
//! ## What it does
//!
//! Charge already collected repels what still comes: the boundary between two pixels moves towards the one that holds more, and the
//! image of a bright star gets wider than that of a faint one.
//!
//! ## Equation
//!
//! Over the boundary between neighbours 0 and 1 flows ½(N₀ + N₁)·δ, δ = ½·s·Σ wᵢⱼ·(Nᵢⱼ − N′ᵢⱼ), from 0 to 1 where δ > 0. The sum goes over
//! pixels i columns behind the boundary and j beside it (0 ≤ i ≤ 2, |j| ≤ 2) and their mirror images N′ beyond it, the same along rows;
//! w = d·(d² + j² + h²)^(−3/2), d = i + ½, as a part of its value for i = j = 0. The factor ½ of δ is the mean over an exposure in which all charge
//! grows in proportion. That is the lateral field of a charge and its image in the gates, integrated over the way down of the electrons that
//! come. No charge is lost, none crosses the edge of the frame. |δ| stays below ¼ px.
//!
//! ## Parameters
//!
//! `shift_px_per_e` (s): displacement of a pixel's own boundary per electron that it holds, px, 10⁻⁷ to 10⁻⁶; `range_px` (h): height, in pixels,
//! above which the field acts; a small one makes the effect short, 0.3 to 2.
//!
//! ## Signature
//!
//! Widths that grow with the flux, by up to 2 % at full well; flats whose variance falls below the mean by the part
//! 4·s·N, which is missing from a gain measured by photon transfer. Hardly any displacement.
//!
//! ### Rendered
//!
//! An image of σ² = 0.9 px² with a peak of N electrons: σ² grows by the part 1.03·s·N by its moments, 1.09·s·N by the program's fit, in
//! proportion to the flux (cosine 0.9999); its centre moves by less than 10⁻⁵ px.
//!
//! ## Confused with
//!
//! Non-linear response (which makes cores flat too, but loses flux); charge diffusion, which does not follow the flux.
//!
//! ## Neglected
//!
//! Charge more than 2 pixels away; the difference between the barriers along and across the columns; second order in s (the field is
//! that of the final charge); dependence on the colour by the depth of conversion.
//!
//! ## Source
//!
//! P. Antilogus et al., JINST 9, C03048 (2014), for boundaries that follow the charge; A. Guyonnet et al., A&A 575, A41 (2015), eq. 11 to 16.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::pass::{NeighbourPass, PassHead, Source};
use crate::effects::pixel::{ExposureContext, Stage, uniform_fields};
use crate::effects::{ImageContext, ImageEffect, ImageResponse, Rendering};

/// Boundaries of pixels that follow the charge.
#[derive(Clone, Copy, Debug)]
pub struct BrighterFatter;

/// What the shader gets: w of 0, 1 and 2 columns behind the boundary, each for 0, 1 and 2 rows beside.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct BrighterFatterUniforms {
    half_shift_per_e: f32,
    w_00: f32,
    w_01: f32,
    w_02: f32,
    w_10: f32,
    w_11: f32,
    w_12: f32,
    w_20: f32,
    w_21: f32,
    w_22: f32,
}

/// The twin: what flows over a boundary. `at(i, j)` is the difference of the charges i pixels behind the boundary on both sides, in the
/// j-th of five lines across it of which the third is this one; `sum` is that of the two pixels.
#[inline]
fn brighter_fatter(uniforms: &BrighterFatterUniforms, sum: f32, at: impl Fn(usize, usize) -> f32) -> f32 {
    let on_axis = uniforms.w_00 * at(0, 2) + uniforms.w_10 * at(1, 2) + uniforms.w_20 * at(2, 2);
    let beside = |i: usize, j: usize| at(i, 2 - j) + at(i, 2 + j);
    let one_off = uniforms.w_01 * beside(0, 1) + uniforms.w_11 * beside(1, 1) + uniforms.w_21 * beside(2, 1);
    let two_off = uniforms.w_02 * beside(0, 2) + uniforms.w_12 * beside(1, 2) + uniforms.w_22 * beside(2, 2);
    let shift = uniforms.half_shift_per_e * (on_axis + one_off + two_off);
    let shift = if shift > -0.25 { shift } else { -0.25 };
    0.5 * sum * if shift < 0.25 { shift } else { 0.25 }
}

/// Pixels by which a row is continued on both sides.
const MARGIN_PX: usize = 3;

/// A row with its end pixels repeated on both sides.
fn with_margins(row: &[f32]) -> Vec<f32> {
    let ends = |electrons: Option<&f32>| std::iter::repeat_n(electrons.copied().unwrap_or(0.0), MARGIN_PX);
    ends(row.first()).chain(row.iter().copied()).chain(ends(row.last())).collect()
}

/// What flows over the boundary in the middle of six rows from above to below, in every column.
fn downwards(uniforms: &BrighterFatterUniforms, rows: &[Vec<f32>], flows: &mut [f32]) {
    let rows: [&[f32]; 6] = std::array::from_fn(|k| &rows[k][..flows.len() + 2 * MARGIN_PX]);
    for (x, flow) in flows.iter_mut().enumerate() {
        let at = |i: usize, j: usize| rows[2 - i][x + 1 + j] - rows[3 + i][x + 1 + j];
        *flow = brighter_fatter(uniforms, rows[2][x + MARGIN_PX] + rows[3][x + MARGIN_PX], at);
    }
}

/// What flows over the boundary before every column but the first from left to right, in the middle of five rows.
fn rightwards(uniforms: &BrighterFatterUniforms, rows: &[Vec<f32>], flows: &mut [f32]) {
    let rows: [&[f32]; 5] = std::array::from_fn(|k| &rows[k][..flows.len() + 2 * MARGIN_PX]);
    for (x, flow) in flows.iter_mut().enumerate().skip(1) {
        let at = |i: usize, j: usize| rows[j][x + 2 - i] - rows[j][x + MARGIN_PX + i];
        *flow = brighter_fatter(uniforms, rows[2][x + 2] + rows[2][x + MARGIN_PX], at);
    }
}

impl PassHead for BrighterFatter {
    const ID: &'static str = "brighter-fatter";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("shift_px_per_e", 2e-6)];
    const STAGE: Stage = Stage::Charge;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "shift_px_per_e", unit: "px/e-", typical: 5e-7, range: (0.0, 1e-4) },
        ParameterSpec { name: "range_px", unit: "px", typical: 0.7, range: (0.05, 10.0) },
    ];
    const CONSERVES_CHARGE: bool = true;
    const WGSL: &'static str = include_str!("../../../shaders/brighter_fatter.wgsl");
    const SOURCE: &'static str = page_source!("brighter_fatter.rs");
    type Uniforms = BrighterFatterUniforms;
    const FIELDS: &'static [(&'static str, usize)] =
        uniform_fields!(BrighterFatterUniforms { half_shift_per_e, w_00, w_01, w_02, w_10, w_11, w_12, w_20, w_21, w_22 });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> BrighterFatterUniforms {
        let field = |i: f64, j: f64| {
            let distance = i + 0.5;
            distance * (distance * distance + j * j + parameters[1] * parameters[1]).powf(-1.5)
        };
        let w = |i: f64, j: f64| (field(i, j) / field(0.0, 0.0)) as f32;
        BrighterFatterUniforms {
            half_shift_per_e: (0.5 * parameters[0]) as f32,
            w_00: 1.0,
            w_01: w(0.0, 1.0),
            w_02: w(0.0, 2.0),
            w_10: w(1.0, 0.0),
            w_11: w(1.0, 1.0),
            w_12: w(1.0, 2.0),
            w_20: w(2.0, 0.0),
            w_21: w(2.0, 1.0),
            w_22: w(2.0, 2.0),
        }
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0, 0.7])
    }
}

impl NeighbourPass for BrighterFatter {
    fn row(uniforms: &BrighterFatterUniforms, _: usize, source: &Source<'_>, y: usize, row: &mut [f32]) {
        let rows: Vec<Vec<f32>> = (-3..=3).map(|below| with_margins(source.row(y, below))).collect();
        let width = row.len();
        let (mut across, mut into, mut out) = (vec![0.0; width + 1], vec![0.0; width], vec![0.0; width]);
        rightwards(uniforms, &rows[1..6], &mut across[..width]);
        // Nothing crosses the edge of the frame.
        if y > 0 {
            downwards(uniforms, &rows[..6], &mut into);
        }
        if y + 1 < source.height {
            downwards(uniforms, &rows[1..], &mut out);
        }
        for (x, electrons) in row.iter_mut().enumerate() {
            *electrons = rows[3][x + MARGIN_PX] + (across[x] - across[x + 1]) + (into[x] - out[x]);
        }
    }
}

impl ImageEffect for BrighterFatter {
    fn id(&self) -> &'static str {
        <Self as PassHead>::ID
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("relative_width_at_full", "")]
    }
    fn follows(&self) -> &'static str {
        "flux"
    }
    fn sign(&self) -> Option<f64> {
        Some(1.0)
    }
    fn needs(&self) -> &'static str {
        "the peaks of the stars, and the counts at which a pixel is full"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.01, "widths grow by up to 2 % at full well (Antilogus et al. 2014)")
    }
    fn rendering(&self) -> Option<Rendering> {
        let parameters = &[("shift_px_per_e", [0.0, 1e-6])];
        Some(Rendering::Stage { effect: <Self as PassHead>::ID, parameters, step: None, by_colour: false })
    }
    /// σ grows in proportion to the peak.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        Some(vec![ImageResponse::width(image.sigma_px, image.sigma_px * image.fullness?)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::pixel::pass::{FrameBuffer, Neighbours};
    use crate::effects::pixel::{AnyPixelEffect, Work};

    fn passed(parameters: &[f64], width: usize, frame: &[f32]) -> Vec<f32> {
        let Work::Frame(_, pass) = Neighbours(BrighterFatter).work() else { unreachable!("it is a pass") };
        let uniforms = Neighbours(BrighterFatter).uniforms(parameters, &ExposureContext::default());
        let mut electrons = frame.to_vec();
        pass(&uniforms, &mut FrameBuffer { width, electrons: &mut electrons, scratch: &mut Vec::new() });
        electrons
    }

    /// What a pixel has more than a flat field N is pushed into the neighbours: of an excess e the pixel keeps e·(1 − 2sN), which is the published loss
    /// 4·s·N of a flat's variance; each neighbour gets ½·s·N·e over the boundary that they share.
    #[test]
    fn an_excess_is_shared_with_the_neighbours() {
        let (s, flat, excess) = (5e-7, 40_000.0_f32, 100.0_f32);
        let mut frame = vec![flat; 21 * 17];
        frame[8 * 21 + 10] += excess;
        let after = passed(&[s, 0.05], 21, &frame);
        let at = |x: usize, y: usize| f64::from(after[y * 21 + x] - flat) / f64::from(excess);
        let s_n = s * f64::from(flat);
        assert!((at(10, 8) - (1.0 - 2.0 * s_n)).abs() < 2e-4, "{} for {}", at(10, 8), 1.0 - 2.0 * s_n);
        // Of that the pixel's other boundaries pass on: the one behind it, which the excess is a pixel away from, and the two beside it.
        let w = |i: f64, j: f64| (i + 0.5) * ((i + 0.5).powi(2) + j * j + 0.0025).powf(-1.5) / (0.5 * 0.2525_f64.powf(-1.5));
        let expected = 0.5 * s_n * (1.0 - w(1.0, 0.0) - 2.0 * w(0.0, 1.0));
        assert!((at(11, 8) - expected).abs() < 2e-4, "{} for {expected}", at(11, 8));
        assert!((at(10, 7) - at(11, 8)).abs() < 1e-4 && (at(10, 9) - at(9, 8)).abs() < 1e-4);
        let (before, now): (f64, f64) = (frame.iter().map(|e| f64::from(*e)).sum(), after.iter().map(|e| f64::from(*e)).sum());
        assert!((now / before - 1.0).abs() < 1e-8, "{now} of {before}");
        assert_eq!(passed(&[s, 0.7], 21, &[flat; 21 * 17]), [flat; 21 * 17]);
    }
}
