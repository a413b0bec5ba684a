//! # Even and odd columns
//!
//! ## What it does
//!
//! Even and odd columns are read through amplifiers of different gain (or are two fields of an interlaced sensor): every second
//! column counts too much, and the centre of a star's image is drawn towards the columns that do.
//!
//! ## Equation
//!
//! Columns 0, 2, 4 … count 1 + ε times what they hold, columns 1, 3, 5 … 1 − ε. For the centre of mass of a Gaussian image of
//! σ = 0.7 px Δx = −A₂·ε·sin πx, x the MEASURED column, A₂ = 4·e^(−π²σ²/2)·(σ² + 1/π²) = 0.211; the ideal point is the measured one minus
//! Δ. Halfway from column 0 to column 1 a positive ε draws the image back to column 0.
//!
//! ### In the pixels
//!
//! electrons ·= 1 + ε in columns 0, 2, 4 …, 1 − ε in columns 1, 3, 5 …
//!
//! ## Parameters
//!
//! `relative` (ε): half the difference of the gains of even and odd columns, relative to their mean. In the pixels:
//! `gain_relative`, the same number.
//!
//! ## Signature
//!
//! Residuals along x that follow the column modulo 2: 0.006 px for ε = 3 % with the centre of mass at
//! σ = 0.7 px, 0.02 px with an unweighted fit, whose A₂ is about 0.8.
//!
//! ## Confused with
//!
//! The S-curve has half the period: no confusion, if the stars stand on even and odd columns alike. A filter pattern
//! (Bayer) has this form times the colour. The background's spectrum has a line at two pixels if this is the cause.
//!
//! ## Neglected
//!
//! The dependence of A₂ on the width of the image and on the estimator, so that ε is no more than an order of magnitude where
//! these are others (an adjustment takes the predicted point for the measured one, so that noise does not make ε smaller); a term
//! in ε²; offsets, which the background takes; rows. In an image stored mirrored, of an even number of columns, ε
//! has the other sign, since columns are counted from the other side.
//!
//! ## Source
//!
//! J. R. Janesick, Scientific Charge-Coupled Devices (2001), for readouts with several amplifiers. A₂ is Poisson's sum of the
//! image's moments at the frequency of the columns.

use bytemuck::{Pod, Zeroable};

use crate::dual::Real;
use crate::effects::centroid::ripple_shift;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, by_rows, uniform_fields};
use crate::effects::{
    CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Rendering, StarState,
};
use crate::rng::StageKey;

/// A ripple of the gain from column to column.
#[derive(Clone, Copy, Debug)]
pub struct EvenOdd;

impl CentroidShift for EvenOdd {
    const ID: &'static str = "even-odd";
    const FACTS: Facts = Facts { ordinary_size: Some(OrdinarySize::of(0.01, "0.1 to 3 % (Janesick 2007)")), ..Facts::NONE };
    const WITHIN_PIXELS: bool = true;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "relative", unit: "", typical: 0.03, range: (-0.5, 0.5) }];

    fn unit_shift<T: Real>(_: usize, measured: &Light<T>, _: &Context) -> [T; 2] {
        [ripple_shift(measured.pixel_px[0]), T::constant(0.0)]
    }

    fn rendering(_: usize) -> Option<Rendering> {
        let parameters = &[("gain_relative", [-0.01, 0.01])];
        Some(Rendering::Stage { effect: "even-odd", parameters, step: Some(0.02), by_colour: false })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // scipy 1.17.1: a Gaussian of σ = 0.7 px integrated over the pixels by differences of norm.cdf, times 1.01 and 0.99, and its centre of
        // mass. Halfway between two columns the term in ε² and the S-curve vanish; what is left is 2e-5 of the shift.
        let context = Context::new(StarState::default(), Observation::default());
        let case = |measured: f64, ideal: f64| {
            let source = "centre of mass of a Gaussian on pixels of two gains, scipy 1.17.1";
            ReferenceValue::of_point(source, context, vec![0.01], 2000.0, [0.0; 2], [[measured, 3.2], [ideal, 3.2]], 1e-6)
        };
        vec![case(10.497_892_651_698_578, 10.5), case(11.502_107_348_301_42, 11.5)]
    }

    fn source() -> &'static str {
        page_source!("even_odd.rs")
    }
}

/// Gain of even and odd columns, in the pixels.
#[derive(Clone, Copy, Debug)]
pub struct EvenOddGain;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct EvenOddUniforms {
    even: f32,
    odd: f32,
    width: u32,
}

/// The twin.
fn even_odd(uniforms: &EvenOddUniforms, first_pixel: u32, pixels: &mut [f32]) {
    by_rows(uniforms.width, first_pixel, pixels, |x, _, row| {
        let (first, second) = if x % 2 == 0 { (uniforms.even, uniforms.odd) } else { (uniforms.odd, uniforms.even) };
        for pair in row.chunks_mut(2) {
            pair[0] *= first;
            if let Some(electrons) = pair.get_mut(1) {
                *electrons *= second;
            }
        }
    });
}

impl PixelEffect for EvenOddGain {
    const ID: &'static str = "even-odd";
    const STAGE: Stage = Stage::Readout;
    const PARAMETERS: &'static [ParameterSpec] = &[ParameterSpec { name: "gain_relative", unit: "", typical: 0.01, range: (-0.5, 0.5) }];
    const WGSL: &'static str = include_str!("../../../shaders/even_odd.wgsl");
    const SOURCE: &'static str = page_source!("even_odd.rs");
    type Uniforms = EvenOddUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(EvenOddUniforms { even, odd, width });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> EvenOddUniforms {
        let [even, odd] = [1.0 + parameters[0], 1.0 - parameters[0]].map(|gain| gain as f32);
        EvenOddUniforms { even, odd, width: exposure.width_px as u32 }
    }
    fn apply(uniforms: &EvenOddUniforms, _key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        even_odd(uniforms, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_counted_from_the_frame_not_from_the_run() {
        let exposure = ExposureContext { width_px: 5, height_px: 3, ..ExposureContext::default() };
        let mut pixels = [100.0; 9];
        even_odd(&EvenOddGain::uniforms(&[0.25], &exposure), 3, &mut pixels);
        assert_eq!(pixels, [75.0, 125.0, 125.0, 75.0, 125.0, 75.0, 125.0, 125.0, 75.0]);
    }
}
