//! # Airy point spread
//!
//! ## What it does
//!
//! Diffraction by a round pupil, with a round obstruction in its middle or without: a core and rings.
//!
//! ## Equation
//!
//! Density p(r) = π/(4(λN)²(1 − ε²))·(2J₁(v)/v − ε²·2J₁(εv)/(εv))², v = πr/λN, ε = the obstruction's diameter over the pupil's, J₁ =
//! Bessel's function. The pixel collects it over its square.
//!
//! ## Parameters
//!
//! `lambda_n_px`: λN, the wavelength times the focal ratio, px (0.55 µm at f/2 on 5.5 µm pixels: 0.2; the first dark ring is at
//! 1.22 λN). `obstruction`: ε.
//!
//! ## Signature
//!
//! Rings in the stamps of bright stars; their distance follows the colour.
//!
//! ## Confused with
//!
//! Defocus and spherical aberration, which change the rings' strength.
//!
//! ## Neglected
//!
//! Vanes of a spider; the width of the passband. Light beyond the reach, about 0.2·λN/r of it without obstruction. The truth's
//! landed electrons lack it. Where λN is below 1 px the image has light at a whole cycle a pixel, and pixels show it with a centre that follows
//! the phase, as real ones do: the sum over pixels is right to 1e-5 px against Poisson's formula for the image that is left of it.
//!
//! ## Source
//!
//! G. B. Airy, Trans. Camb. Phil. Soc. 5, 283 (1835); M. Born, E. Wolf, Principles of Optics, 8.5 and 8.6.2.

use nalgebra::Complex;

use super::tables::{Grid, ImageKind, usual_reach_px};
use crate::effects::ParameterSpec;

/// Airy point spread.
#[derive(Clone, Copy, Debug)]
pub struct AiryPsf;

/// 2J₁(x)/x by its power series, and far out by Hankel's expansion; both hold to 1e-10 where they meet.
fn jinc(x: f64) -> f64 {
    const FAR: f64 = 16.0;
    if x < FAR {
        let quarter = -0.25 * x * x;
        let (mut term, mut sum) = (1.0, 1.0);
        for k in 1..60 {
            term *= quarter / f64::from(k * (k + 1));
            sum += term;
        }
        return sum;
    }
    let (mut even, mut odd, mut term) = (0.0, 0.0, 1.0);
    for k in 0..12 {
        match k % 4 {
            0 => even += term,
            1 => odd += term,
            2 => even -= term,
            _ => odd -= term,
        }
        let next = f64::from(2 * k + 1);
        term *= (4.0 - next * next) / (f64::from(8 * (k + 1)) * x);
    }
    let angle = x - 0.75 * std::f64::consts::PI;
    2.0 / x * (2.0 / (std::f64::consts::PI * x)).sqrt() * (even * angle.cos() - odd * angle.sin())
}

impl ImageKind for AiryPsf {
    fn id(&self) -> &'static str {
        "airy"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[
            ParameterSpec { name: "lambda_n_px", unit: "px", typical: 1.5, range: (0.3, 6.0) },
            ParameterSpec { name: "obstruction", unit: "", typical: 0.0, range: (0.0, 0.9) },
        ]
    }
    fn smooth_px(&self, parameters: &[f64]) -> f64 {
        0.42 * parameters[0]
    }
    fn reach_px(&self, parameters: &[f64]) -> usize {
        usual_reach_px(self.smooth_px(parameters))
    }
    fn transfer(&self, parameters: &[f64], grid: &Grid) -> Vec<Complex<f64>> {
        let (lambda_n, hole) = (parameters[0], parameters[1]);
        let scale = std::f64::consts::PI / (4.0 * lambda_n * lambda_n * (1.0 - hole * hole));
        grid.transfer_of_density(|x, y| {
            let v = std::f64::consts::PI * x.hypot(y) / lambda_n;
            let amplitude = jinc(v) - if hole > 0.0 { hole * hole * jinc(hole * v) } else { 0.0 };
            scale * amplitude * amplitude
        })
    }
    fn source(&self) -> &'static str {
        page_source!("airy_psf.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of J₁ of Abramowitz and Stegun 1964, table 9.1, and one step on both sides of where the two ways meet.
    #[test]
    fn bessels_function() {
        for (x, value) in [(1.0, 0.440_050_585_7), (5.0, -0.327_579_137_6), (10.0, 0.043_472_746_2), (17.0, -0.097_668_492_8)] {
            assert!((0.5 * x * jinc(x) - value).abs() < 1e-10, "{x}: {}", 0.5 * x * jinc(x));
        }
        assert!((jinc(16.0 - 1e-9) - jinc(16.0 + 1e-9)).abs() < 1e-9);
    }
}
