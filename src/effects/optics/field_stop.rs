//! # Field stop
//!
//! ## What it does
//!
//! A round opening near an image of the sky (the edge of an image intensifier, an eyepiece, a fisheye's image circle) ends the
//! field: outside of it no light arrives.
//!
//! ## Equation
//!
//! electrons ·= min(max((R − r)/w + ½, 0), 1), r the distance from the stop's centre: a blurred edge of width w.
//!
//! ## Parameters
//!
//! `radius_px` (R): radius of the stop's image, px; `edge_px` (w): width over which the light falls from all to nothing, px, 0.01
//! to 10⁴; `centre_x_px`, `centre_y_px`: the centre's offset from the middle of the frame, to the right and downwards, px.
//!
//! ## Signature
//!
//! Stars predicted where none can be seen; cut images at the edge with centres drawn inwards.
//!
//! ## Confused with
//!
//! Vignetting, which falls slowly; a wrong limit of brightness, if only bright stars are looked for.
//!
//! ## Neglected
//!
//! Light scattered at the edge; a stop that is no circle; that the edge's blur is the convolution of the stop with the pupil's
//! defocused image, not a straight ramp.
//!
//! ## Source
//!
//! W. J. Smith, Modern Optical Engineering (2008), chapter 9.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, by_radius2, uniform_fields};
use crate::rng::StageKey;

/// A round end of the field.
#[derive(Clone, Copy, Debug)]
pub struct FieldStop;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct FieldStopUniforms {
    centre_x_px: f32,
    centre_y_px: f32,
    outer_px: f32,
    per_px: f32,
    width: u32,
}

/// The twin.
fn field_stop(uniforms: &FieldStopUniforms, first_pixel: u32, pixels: &mut [f32]) {
    let centre_px = [uniforms.centre_x_px, uniforms.centre_y_px];
    by_radius2(uniforms.width, centre_px, first_pixel, pixels, |radius2_px2, electrons| {
        let share = (uniforms.outer_px - radius2_px2.sqrt()) * uniforms.per_px;
        let share = if share > 0.0 { share } else { 0.0 };
        *electrons *= if share < 1.0 { share } else { 1.0 };
    });
}

impl PixelEffect for FieldStop {
    const ID: &'static str = "field-stop";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("radius_px", 110.0)];
    const STAGE: Stage = Stage::Light;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "radius_px", unit: "px", typical: 180.0, range: (0.0, 1e6) },
        ParameterSpec { name: "edge_px", unit: "px", typical: 6.0, range: (0.01, 1e4) },
        ParameterSpec { name: "centre_x_px", unit: "px", typical: 3.0, range: (-1e5, 1e5) },
        ParameterSpec { name: "centre_y_px", unit: "px", typical: -2.0, range: (-1e5, 1e5) },
    ];
    const WGSL: &'static str = include_str!("../../../shaders/field_stop.wgsl");
    const SOURCE: &'static str = page_source!("field_stop.rs");
    type Uniforms = FieldStopUniforms;
    const FIELDS: &'static [(&'static str, usize)] =
        uniform_fields!(FieldStopUniforms { centre_x_px, centre_y_px, outer_px, per_px, width });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> FieldStopUniforms {
        let middle = exposure.middle_px();
        FieldStopUniforms {
            centre_x_px: (middle[0] + parameters[2]) as f32,
            centre_y_px: (middle[1] + parameters[3]) as f32,
            outer_px: (parameters[0] + 0.5 * parameters[1]) as f32,
            per_px: (1.0 / parameters[1]) as f32,
            width: exposure.width_px as u32,
        }
    }
    fn apply(uniforms: &FieldStopUniforms, _key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        field_stop(uniforms, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![1e6, 1.0, 0.0, 0.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_opening_has_the_area_of_its_circle() {
        let exposure = ExposureContext { width_px: 300, height_px: 280, ..ExposureContext::default() };
        let mut pixels = vec![1.0_f32; 300 * 280];
        field_stop(&FieldStop::uniforms(&[100.0, 8.0, 12.0, -5.0], &exposure), 0, &mut pixels);
        let area: f64 = pixels.iter().map(|light| f64::from(*light)).sum();
        // A ramp of width w about R: the integral of its share over the plane is π·(R² + w²/12).
        let expected = std::f64::consts::PI * (1e4 + 64.0 / 12.0);
        assert!((area / expected - 1.0).abs() < 1e-4, "{area} for {expected}");
        let centre: f64 = pixels.iter().enumerate().map(|(i, light)| (i % 300) as f64 * f64::from(*light)).sum::<f64>() / area;
        assert!((centre - 161.5).abs() < 1e-3, "{centre}");
    }
}
