//! # Bayer pattern
//!
//! **What it is.** Over the pixels of a colour sensor lie filters in red, green and blue, two by two. Measured in the raw frame, a red star
//! is bright on the red pixels, and its centre is drawn towards them.
//!
//! **Equation.** With c = B − V − 0.6 and ε = q·c a pixel of even column and even row (red) counts 1 + ε, one of odd column and odd row (blue)
//! 1 − ε, the others (green) 1. That is a ripple of ε/2 along each axis, so Δ = −½·A₂·ε·(sin πx, sin πy), x and y the MEASURED column and
//! row, A₂ = 0.211 as in `even-odd`; the ideal point is the measured one minus Δ. A star of unknown colour counts as one with c = 0.
//!
//! **Parameter.** `relative_per_mag` (q): by how much more than green ones red pixels count, per magnitude of B − V. Negative where the blue
//! pixels stand at even columns and rows.
//!
//! **What it leaves when left out.** Residuals that follow column and row modulo 2 in proportion to the colour: 0.03 px along each axis for
//! ε = 0.3 with the centre of mass at σ = 0.7 px, three to four times that with an unweighted fit.
//!
//! **Confused with.** Even and odd columns: the same for stars of all colours. Lateral colour and a wedge go with the colour, but are smooth.
//!
//! **Neglected.** The part that stars of all colours share (a filter of another transmission for the Sun's colour too), which is `even-odd`
//! along the columns; patterns with green at even columns and rows; the dependence of A₂ on the image's width and the estimator; terms in ε²
//! and in c²; mirrored images of an even number of columns, where the pattern begins with another filter.
//!
//! **Source.** B. E. Bayer, US patent 3,971,065 (1976), for the pattern. A₂ is Poisson's sum of the image's moments at the frequency of the
//! pattern.

use crate::dual::Real;
use crate::effects::centroid::ripple_shift;
use crate::effects::{CentroidShift, Context, Light, Observation, ParameterSpec, ReferenceValue, StarState};

/// A ripple of the response along both axes, in proportion to the colour.
#[derive(Clone, Copy, Debug)]
pub struct Bayer;

impl CentroidShift for Bayer {
    const ID: &'static str = "bayer";
    const WITHIN_PIXELS: bool = true;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "relative_per_mag", unit: "1/mag", typical: 0.2, range: (-1.0, 1.0) }];

    fn unit_shift<T: Real>(_: usize, measured: &Light<T>, context: &Context) -> [T; 2] {
        measured.pixel_px.map(|pixel| ripple_shift(pixel) * (context.star.colour_offset() / 2.0))
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
        include_str!("bayer.rs")
    }
}
