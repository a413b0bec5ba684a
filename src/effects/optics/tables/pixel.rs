//! How a pixel weighs the light that falls on it.

use nalgebra::Complex;

/// A pixel's response along its two axes: a square whose sensitivity may change within, and charge that diffuses.
///
/// At the offset u px from the centre along an axis the weight is 1 + a·cos 2πu + b·u for |u| ≤ ½, and 0 beyond; both axes multiply. The charge
/// then diffuses by a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelResponse {
    /// a: how much more sensitive the middle is than the edge, halved, along x and y.
    pub cosine: [f64; 2],
    /// b: slope, px⁻¹, along x and y.
    pub slope: [f64; 2],
    /// Width σ of the diffusion, px.
    pub diffusion_px: f64,
    /// The image holds the pixel already: none is added.
    pub is_in_image: bool,
}

impl PixelResponse {
    /// The factors along x and y by which a pixel's response multiplies an image's transform at this frequency, cycles per px.
    #[must_use]
    pub fn transfer(&self, frequency: f64) -> [Complex<f64>; 2] {
        let diffusion = (-2.0 * (std::f64::consts::PI * frequency * self.diffusion_px).powi(2)).exp();
        [0, 1].map(|axis| {
            if self.is_in_image {
                return Complex::new(diffusion, 0.0);
            }
            let even = sinc(frequency) + 0.5 * self.cosine[axis] * (sinc(frequency - 1.0) + sinc(frequency + 1.0));
            // ∫ u·exp(−2πifu) du = (i/2π)·d sinc/df; the response is correlated with the image, which takes the conjugate.
            let odd = -self.slope[axis] * sinc_slope(frequency) / std::f64::consts::TAU;
            Complex::new(even, odd) * diffusion
        })
    }
}

/// sin(πx)/(πx).
fn sinc(x: f64) -> f64 {
    let angle = std::f64::consts::PI * x;
    if angle.abs() < 1e-4 { 1.0 - angle * angle / 6.0 } else { angle.sin() / angle }
}

/// Its derivative.
fn sinc_slope(x: f64) -> f64 {
    let angle = std::f64::consts::PI * x;
    if angle.abs() < 1e-3 {
        -std::f64::consts::PI * angle / 3.0
    } else {
        std::f64::consts::PI * (angle * angle.cos() - angle.sin()) / (angle * angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a sum over the pixel.
    #[test]
    fn the_transform_is_that_of_the_weights() {
        let pixel = PixelResponse { cosine: [0.2, -0.1], slope: [0.3, 0.05], ..PixelResponse::default() };
        for frequency in [0.0, 1e-5, 0.3, 1.0, 1.7, -2.4] {
            for axis in 0..2 {
                let mut sum = Complex::new(0.0, 0.0);
                for step in 0..20_000 {
                    let u = (f64::from(step) + 0.5) / 20_000.0 - 0.5;
                    let weight = 1.0 + pixel.cosine[axis] * (std::f64::consts::TAU * u).cos() + pixel.slope[axis] * u;
                    // T(d) = ∫ p(u)·R(u − d) du turns p̂ into p̂·conj(R̂).
                    sum += Complex::from_polar(weight / 20_000.0, std::f64::consts::TAU * frequency * u);
                }
                assert!((pixel.transfer(frequency)[axis] - sum).norm() < 1e-7, "{frequency}, {axis}");
            }
        }
    }
}
