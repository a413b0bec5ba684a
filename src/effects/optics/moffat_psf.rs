//! # Moffat point spread
//!
//! ## What it does
//!
//! The image of a star through the turbulent air, or scattered by optics: a core with wings that fall as a power of the distance.
//!
//! ## Equation
//!
//! Density p(r) = (β − 1)/(πα²)·(1 + r²/α²)^−β, FWHM = 2α√(2^(1/β) − 1). The pixel collects it over its square.
//!
//! ## Parameters
//!
//! `fwhm_px`: full width at half maximum before the pixel, px. `beta`: β; 2.5 to 4.8 for air, the more the steeper.
//!
//! ## Signature
//!
//! Light in the wings: aperture fluxes that are too low, and a background too high beside bright stars.
//!
//! ## Confused with
//!
//! Scattered light, a diffuse background, the tails of charge transfer.
//!
//! ## Neglected
//!
//! Light beyond the reach: (1 + r²/α²)^(1 − β) of it lies farther out than r; the truth's landed electrons lack it.
//!
//! ## Source
//!
//! A. F. J. Moffat, A&A 3, 455 (1969).

use nalgebra::Complex;

use super::tables::{Grid, ImageKind, usual_reach_px};
use crate::effects::ParameterSpec;

/// Moffat point spread.
#[derive(Clone, Copy, Debug)]
pub struct MoffatPsf;

/// α for a full width at half maximum.
fn alpha_px(parameters: &[f64]) -> f64 {
    0.5 * parameters[0] / (2.0_f64.powf(1.0 / parameters[1]) - 1.0).sqrt()
}

impl ImageKind for MoffatPsf {
    fn id(&self) -> &'static str {
        "moffat"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[
            ParameterSpec { name: "fwhm_px", unit: "px", typical: 2.2, range: (0.7, 20.0) },
            ParameterSpec { name: "beta", unit: "", typical: 3.5, range: (1.5, 20.0) },
        ]
    }
    fn smooth_px(&self, parameters: &[f64]) -> f64 {
        // Its transform falls as exp(−2παf); a Gaussian of 0.36 FWHM is about as smooth down to 1e-7.
        (0.4 * alpha_px(parameters)).min(parameters[0] / 2.355)
    }
    fn reach_px(&self, parameters: &[f64]) -> usize {
        usual_reach_px(self.smooth_px(parameters))
    }
    fn transfer(&self, parameters: &[f64], grid: &Grid) -> Vec<Complex<f64>> {
        let (alpha, beta) = (alpha_px(parameters), parameters[1]);
        let density = (beta - 1.0) / (std::f64::consts::PI * alpha * alpha);
        grid.transfer_of_density(|x, y| density * (1.0 + (x * x + y * y) / (alpha * alpha)).powf(-beta))
    }
    fn source(&self) -> &'static str {
        page_source!("moffat_psf.rs")
    }
}
