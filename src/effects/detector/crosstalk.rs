//! # Crosstalk between two outputs
//!
//! ## What it does
//!
//! The left and the right half of the frame are read to their own sides at the same time; a bright pixel in one half leaves a faint copy in the
//! pixel that the other amplifier reads at that moment, its mirror image.
//!
//! ## Equation
//!
//! electrons(x, y) = N(x, y) + c·N(width − 1 − x, y). A column in the very middle has no partner.
//!
//! ## Parameters
//!
//! `relative` (c): brightness of the copy, 10⁻⁴ to 10⁻³, of either sign.
//!
//! ## Signature
//!
//! Detections without a star at the mirror images of bright ones, holes where c is negative.
//!
//! ## Confused with
//!
//! A ghost of the optics, which is reflected at the axis (x and y both) and out of focus.
//!
//! ## Neglected
//!
//! More than two outputs; c that depends on the level or on the direction; delays of the copy by a pixel.
//!
//! ## Source
//!
//! P. O'Connor, JINST 10, C05010 (2015), crosstalk in multi-output CCDs; Freyhammer et al., Exp. Astron. 12, 147 (2001).

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::pass::{NeighbourPass, PassHead, Source};
use crate::effects::pixel::{ExposureContext, Stage, uniform_fields};

/// Copies of bright pixels in the other half.
#[derive(Clone, Copy, Debug)]
pub struct Crosstalk;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct CrosstalkUniforms {
    relative: f32,
}

/// The twin.
fn crosstalk(uniforms: CrosstalkUniforms, source: &[f32], row: &mut [f32]) {
    let middle = if source.len() % 2 == 1 { source.len() / 2 } else { source.len() };
    for (x, ((electrons, own), other)) in row.iter_mut().zip(source).zip(source.iter().rev()).enumerate() {
        *electrons = own + if x == middle { 0.0 } else { uniforms.relative * other };
    }
}

impl PassHead for Crosstalk {
    const ID: &'static str = "crosstalk";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("relative", 0.005)];
    const STAGE: Stage = Stage::Readout;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "relative", unit: "", typical: 5e-4, range: (-0.5, 0.5) }];
    const CONSERVES_CHARGE: bool = false;
    const WGSL: &'static str = include_str!("../../../shaders/crosstalk.wgsl");
    const SOURCE: &'static str = page_source!("crosstalk.rs");
    type Uniforms = CrosstalkUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(CrosstalkUniforms { relative });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> CrosstalkUniforms {
        CrosstalkUniforms { relative: parameters[0] as f32 }
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0])
    }
}

impl NeighbourPass for Crosstalk {
    fn row(uniforms: &CrosstalkUniforms, _: usize, source: &Source<'_>, y: usize, row: &mut [f32]) {
        crosstalk(*uniforms, source.row(y, 0), row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_copy_lies_at_the_mirror_image() {
        let uniforms = CrosstalkUniforms { relative: 0.01 };
        let mut row = [0.0; 5];
        crosstalk(uniforms, &[1000.0, 0.0, 300.0, 0.0, 50.0], &mut row);
        assert_eq!(row, [1000.5, 0.0, 300.0, 0.0, 60.0]);
        let mut row = [0.0; 4];
        crosstalk(uniforms, &[0.0, 200.0, 100.0, 0.0], &mut row);
        assert_eq!(row, [0.0, 201.0, 102.0, 0.0]);
    }
}
