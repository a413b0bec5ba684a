//! # Elliptic Gaussian point spread, integrated over the pixel
//!
//! ## What it does
//!
//! The image of a star is a Gaussian that is wider along one axis than along the other: astigmatism, or trembling about one
//! axis. A pixel collects the light that falls on its square.
//!
//! ## Equation
//!
//! With the covariance C of the image, the share of the light in the pixel whose centre lies (dx, dy) from the star is
//! ∫ φ(v/s_y)/s_y · E(dx − m·v, s) dv over v = dy − ½ … dy + ½, s_y² = C_yy, m = C_xy/C_yy, s² = C_xx − C_xy²/C_yy, φ = the normal density and
//! E(d, s) = Φ((d + ½)/s) − Φ((d − ½)/s): exact along x, and along y a Gauss–Legendre sum of eight nodes. C has the eigenvalues `sigma_major_px`²
//! and `sigma_minor_px`²; the major axis stands `angle_deg` from the x axis towards y.
//!
//! ## Parameters
//!
//! `sigma_major_px`, `sigma_minor_px`: widths σ along the two axes, px. `angle_deg`: direction of the major axis.
//!
//! ## Signature
//!
//! Stamps whose residuals have a plus or a cross; ellipticities that follow the field. Centres stay.
//!
//! ## Confused with
//!
//! Motion smear, which turns with the rate; coma, which is one-sided.
//!
//! ## Neglected
//!
//! Wings beyond the Gaussian's. The sum over y is right within 1e-6 of the light for σ ≥ 0.3 px.
//!
//! ## Source
//!
//! The conditional distribution of two normal variables; the same image in SExtractor (E. Bertin, S. Arnouts, A&AS 117, 393
//! (1996)) without the pixel.

use super::gaussian_psf::{DENSITY_AT_CENTRE, pixel_share};
use crate::effects::ParameterSpec;
use crate::effects::pixel::math::poly_exp;
use crate::effects::pixel::{Atlas, Psf2d, Psf2dStar, Rows};

/// Elliptic Gaussian point spread.
#[derive(Clone, Copy, Debug)]
pub struct EllipticGaussianPsf;

/// Nodes in (−½, ½) and weights of the Gauss–Legendre rule with eight nodes (Abramowitz and Stegun 1964, table 25.4, halved).
const NODES: [[f32; 2]; 8] = [
    [-0.480_144_93, 0.050_614_268],
    [-0.398_333_24, 0.111_190_52],
    [-0.262_766_2, 0.156_853_32],
    [-0.091_717_32, 0.181_341_89],
    [0.091_717_32, 0.181_341_89],
    [0.262_766_2, 0.156_853_32],
    [0.398_333_24, 0.111_190_52],
    [0.480_144_93, 0.050_614_268],
];

/// Covariance (xx, xy, yy, px²) of an image with these widths, its major axis `angle_rad` from x towards y.
#[must_use]
pub fn covariance_px2(sigma_major_px: f64, sigma_minor_px: f64, angle_rad: f64) -> [f64; 3] {
    let (sine, cosine) = angle_rad.sin_cos();
    let (major, minor) = (sigma_major_px * sigma_major_px, sigma_minor_px * sigma_minor_px);
    [major * cosine * cosine + minor * sine * sine, (major - minor) * sine * cosine, major * sine * sine + minor * cosine * cosine]
}

/// What a deposit carries for a covariance (xx, xy, yy, px²): the width σ across, and the shape.
#[must_use]
pub fn shape([xx, xy, yy]: [f64; 3]) -> (f64, [f32; 4]) {
    let across = (xx - xy * xy / yy).sqrt();
    (across, [(1.0 / yy.sqrt()) as f32, (xy / yy) as f32, 0.0, 0.0])
}

/// The twin: adds `star` to the rows.
fn elliptic_gaussian_psf(star: &Psf2dStar, rows: &mut Rows<'_>) {
    let [inverse_sigma_y, slope, ..] = star.shape;
    star.for_each_row(rows, |dy, first_dx, pixels, _| {
        for [node, weight] in NODES {
            let v = dy + node;
            let z2 = v * inverse_sigma_y * (v * inverse_sigma_y);
            let density = inverse_sigma_y * DENSITY_AT_CENTRE * poly_exp(-0.5 * if z2 < 150.0 { z2 } else { 150.0 });
            let electrons = star.electrons * (weight * density);
            let first = first_dx - slope * v;
            for (i, pixel) in pixels.iter_mut().enumerate() {
                *pixel += electrons * pixel_share(first + i as f32, star.inverse_sigma);
            }
        }
    });
}

impl Psf2d for EllipticGaussianPsf {
    fn id(&self) -> &'static str {
        "elliptic_gaussian_psf"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[
            ParameterSpec { name: "sigma_major_px", unit: "px", typical: 1.2, range: (0.3, 50.0) },
            ParameterSpec { name: "sigma_minor_px", unit: "px", typical: 0.9, range: (0.3, 50.0) },
            ParameterSpec { name: "angle_deg", unit: "deg", typical: 30.0, range: (-180.0, 180.0) },
        ]
    }
    fn wgsl_library(&self) -> &'static str {
        include_str!("../../../shaders/gaussian_psf.wgsl")
    }
    fn wgsl(&self) -> &'static str {
        include_str!("../../../shaders/elliptic_gaussian_psf.wgsl")
    }
    fn wgsl_share(&self) -> &'static str {
        "elliptic_gaussian_psf(star, dx, dy)"
    }
    fn loop_iterations(&self) -> u32 {
        9
    }
    fn source(&self) -> &'static str {
        page_source!("elliptic_gaussian_psf.rs")
    }
    fn add_plane(&self, star: &Psf2dStar, _: &Atlas, rows: &mut Rows<'_>) {
        elliptic_gaussian_psf(star, rows);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a midpoint sum of 1000 × 1000 points a pixel in f64, over shapes and places.
    #[test]
    fn shares_agree_with_a_dense_sum() {
        const FINE: u32 = 1000;
        for (major, minor, angle) in
            [(1.2, 0.9, 0.5), (0.35, 0.3, 1.0), (3.0, 0.4, 0.785), (2.0, 0.5, 0.0), (1.5, 0.6, 1.5), (4.0, 3.0, -1.0)]
        {
            let [xx, xy, yy] = covariance_px2(major, minor, angle);
            let (sigma, shape) = shape([xx, xy, yy]);
            let determinant = xx * yy - xy * xy;
            let (fraction_x, fraction_y) = (0.3_f32, -0.2_f32);
            let star = Psf2dStar {
                column: 8,
                row: 8,
                fraction_x,
                fraction_y,
                electrons: 1.0,
                inverse_sigma: (1.0 / sigma) as f32,
                shear_x: 0.0,
                shear_y: 0.0,
                shape,
                reach: 8,
                nodes: 0,
                unused: [0; 2],
                node: [0; 8],
                weight: [0.0; 8],
            };
            let (mut electrons, mut scratch) = (vec![0.0; 17 * 17], Vec::new());
            EllipticGaussianPsf.add_plane(
                &star,
                &Atlas::default(),
                &mut Rows { width: 17, first_row: 0, electrons: &mut electrons, scratch: &mut scratch },
            );
            for (x, y) in [(8, 8), (9, 8), (8, 7), (9, 9), (6, 10), (11, 11), (4, 8)] {
                let mut exact = 0.0;
                for i in 0..FINE {
                    for j in 0..FINE {
                        let at = |pixel: i32, step: u32, fraction: f32| {
                            f64::from(pixel - 8) - f64::from(fraction) + (f64::from(step) + 0.5) / f64::from(FINE) - 0.5
                        };
                        let (dx, dy) = (at(x, i, fraction_x), at(y, j, fraction_y));
                        let z2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
                        exact += (-0.5 * z2).exp();
                    }
                }
                exact /= std::f64::consts::TAU * determinant.sqrt() * f64::from(FINE * FINE);
                let found = f64::from(electrons[(y * 17 + x) as usize]);
                assert!((found - exact).abs() < 1e-6, "{major} × {minor} at {angle}, pixel {x} {y}: {found} instead of {exact}");
            }
        }
    }
}
