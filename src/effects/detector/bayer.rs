//! # Bayer pattern
//!
//! ## What it does
//!
//! Over the pixels of a colour sensor lie filters in red, green and blue, two by two. Measured in the raw frame, a red star
//! is bright on the red pixels, and its centre is drawn towards them.
//!
//! ## Equation
//!
//! With c = B − V − 0.6 and ε = q·c a pixel of even column and even row (red) counts 1 + ε, one of odd column and odd row (blue)
//! 1 − ε, the others (green) 1. That is a ripple of ε/2 along each axis, so Δ = −½·A₂·ε·(sin πx, sin πy), x and y the MEASURED column and
//! row, A₂ = 0.211 as in `even-odd`; the ideal point is the measured one minus Δ. A star of unknown colour counts as one with c = 0.
//!
//! ### In the pixels
//!
//! electrons ·= r at even columns of even rows, b at odd columns of odd rows, whatever the light's colour.
//!
//! ## Parameters
//!
//! `relative_per_mag` (q): by how much more than green ones red pixels count, per magnitude of B − V. Negative where the blue
//! pixels stand at even columns and rows. In the pixels: `red_relative` (r) and `blue_relative` (b), response of these pixels to the light of
//! the sky, stars and background alike, against green ones; 0.3 to 1.
//!
//! ## Signature
//!
//! Residuals that follow column and row modulo 2 in proportion to the colour: 0.03 px along each axis for
//! ε = 0.3 with the centre of mass at σ = 0.7 px, three to four times that with an unweighted fit.
//!
//! ## Confused with
//!
//! Even and odd columns: the same for stars of all colours. Lateral colour and a wedge go with the colour, but are smooth.
//!
//! ## Neglected
//!
//! The part that stars of all colours share (a filter of another transmission for the Sun's colour too), which is `even-odd`
//! along the columns; patterns with green at even columns and rows; the dependence of A₂ on the image's width and the estimator; terms in ε²
//! and in c²; in the pixels, that stars of different colours share their light differently among the filters, for which there is `colour-filters`; mirrored images of an even number of columns, where the pattern begins with another filter.
//!
//! ## Source
//!
//! B. E. Bayer, US patent 3,971,065 (1976), for the pattern. A₂ is Poisson's sum of the image's moments at the frequency of the
//! pattern.

use bytemuck::{Pod, Zeroable};

use crate::dual::Real;
use crate::effects::centroid::ripple_shift;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, by_rows, uniform_fields};
use crate::effects::{
    CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Rendering, StarState,
};
use crate::rng::StageKey;

/// A ripple of the response along both axes, in proportion to the colour.
#[derive(Clone, Copy, Debug)]
pub struct Bayer;

impl CentroidShift for Bayer {
    const ID: &'static str = "bayer";
    const FACTS: Facts =
        Facts { ordinary_size: Some(OrdinarySize::of(0.3, "0.3 to 0.5 between the filters of a colour camera")), ..Facts::NONE };
    const WITHIN_PIXELS: bool = true;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "relative_per_mag", unit: "1/mag", typical: 0.2, range: (-1.0, 1.0) }];

    fn unit_shift<T: Real>(_: usize, measured: &Light<T>, context: &Context) -> [T; 2] {
        measured.pixel_px.map(|pixel| ripple_shift(pixel) * (context.star.colour_offset() / 2.0))
    }

    fn rendering(_: usize) -> Option<Rendering> {
        let parameters = &[("red_relative", [0.98, 1.02]), ("blue_relative", [1.02, 0.98])];
        Some(Rendering::Stage { effect: "bayer", parameters, step: Some(0.04), by_colour: true })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // scipy 1.17.1: a Gaussian of σ = 0.7 px at (10.5, 7.5), integrated over the pixels by differences of norm.cdf, times the pattern's
        // 1.003, 1 and 0.997, and its centre of mass: q = 0.01 per magnitude and B − V = 0.9.
        let context = Context::new(StarState { colour: Some(0.9), ..StarState::default() }, Observation::default());
        vec![ReferenceValue::of_point(
            "centre of mass of a Gaussian on a Bayer pattern, scipy 1.17.1",
            context,
            vec![0.01],
            2000.0,
            [0.0; 2],
            [[10.499_683_897_754_789, 7.500_316_102_245_214], [10.5, 7.5]],
            1e-7,
        )]
    }

    fn source() -> &'static str {
        page_source!("bayer.rs")
    }
}

/// The filters' transmission for all light alike, in the pixels.
#[derive(Clone, Copy, Debug)]
pub struct BayerMosaic;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct BayerUniforms {
    red: f32,
    blue: f32,
    width: u32,
}

/// The twin.
fn bayer(uniforms: &BayerUniforms, first_pixel: u32, pixels: &mut [f32]) {
    by_rows(uniforms.width, first_pixel, pixels, |x, y, row| {
        let filter = if y % 2 == 0 { uniforms.red } else { uniforms.blue };
        // Red ones stand at even columns of even rows, blue ones at odd columns of odd rows.
        for electrons in row.iter_mut().skip((x % 2 != y % 2).into()).step_by(2) {
            *electrons *= filter;
        }
    });
}

impl PixelEffect for BayerMosaic {
    const ID: &'static str = "bayer";
    const STAGE: Stage = Stage::Light;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "red_relative", unit: "", typical: 0.6, range: (0.0, 10.0) },
        ParameterSpec { name: "blue_relative", unit: "", typical: 0.5, range: (0.0, 10.0) },
    ];
    const WGSL: &'static str = include_str!("../../../shaders/bayer.wgsl");
    const SOURCE: &'static str = page_source!("bayer.rs");
    type Uniforms = BayerUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(BayerUniforms { red, blue, width });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> BayerUniforms {
        BayerUniforms { red: parameters[0] as f32, blue: parameters[1] as f32, width: exposure.width_px as u32 }
    }
    fn apply(uniforms: &BayerUniforms, _key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        bayer(uniforms, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![1.0; 2])
    }
    fn least_e(parameters: &[f64], _exposure: &ExposureContext, least_e: f64) -> f64 {
        parameters[0].min(parameters[1]).min(1.0) * least_e
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filters_stand_two_by_two() {
        let exposure = ExposureContext { width_px: 3, height_px: 3, ..ExposureContext::default() };
        let uniforms = BayerMosaic::uniforms(&[0.5, 0.25], &exposure);
        let mut pixels = [8.0; 9];
        bayer(&uniforms, 0, &mut pixels);
        assert_eq!(pixels, [4.0, 8.0, 4.0, 8.0, 2.0, 8.0, 4.0, 8.0, 4.0]);
        let mut part = [8.0; 6];
        bayer(&uniforms, 2, &mut part);
        assert_eq!(part, pixels[2..8]);
    }
}
