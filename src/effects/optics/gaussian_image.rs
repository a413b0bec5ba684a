//! # Gaussian image in tables
//!
//! ## What it does
//!
//! A round Gaussian image seen by pixels whose response is not even: the same light as that of the Gaussian point spread, where
//! the pixel has to be worked out in tables.
//!
//! ## Equation
//!
//! The transform of its light is exp(−2π²σ²f²), f in cycles per px.
//!
//! ## Parameters
//!
//! `sigma_px`: σ in px.
//!
//! ## Signature
//!
//! See the Gaussian point spread; what the pixel's response leaves is a centroid and a flux that follow the
//! place of the star within its pixel.
//!
//! ## Confused with
//!
//! The S-curve of an estimator, which leaves the flux alone.
//!
//! ## Neglected
//!
//! Rings and wings.
//!
//! ## Source
//!
//! Textbook transform; for pixels T. R. Lauer, PASP 111, 1434 (1999).

use nalgebra::Complex;

use super::tables::{Grid, ImageKind};
use crate::effects::ParameterSpec;

/// Gaussian image in tables.
#[derive(Clone, Copy, Debug)]
pub struct GaussianImage;

impl ImageKind for GaussianImage {
    fn id(&self) -> &'static str {
        "gaussian"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[ParameterSpec { name: "sigma_px", unit: "px", typical: 1.0, range: (0.2, 20.0) }]
    }
    fn smooth_px(&self, parameters: &[f64]) -> f64 {
        parameters[0]
    }
    fn reach_px(&self, parameters: &[f64]) -> usize {
        (7.0 * parameters[0] + 1.0).ceil() as usize
    }
    fn transfer(&self, parameters: &[f64], grid: &Grid) -> Vec<Complex<f64>> {
        let of = |f: f64| (-2.0 * (std::f64::consts::PI * f * parameters[0]).powi(2)).exp();
        grid.transfer(|fx, fy| Complex::new(of(fx) * of(fy), 0.0))
    }
    fn source(&self) -> &'static str {
        page_source!("gaussian_image.rs")
    }
}
