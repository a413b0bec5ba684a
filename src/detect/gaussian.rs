//! The image of a star as a Gaussian integrated over each pixel, round or elliptic, with its derivatives.

use super::image_model::{GAUSS_LEGENDRE_4, ImageModel, PROFILE_PARAMETERS, Shape, Window, axis_shares};
use super::work::{ELLIPSE_NS, ROUND_NS};

/// A round one; its number is the width.
pub(super) struct Round {
    pub(super) sigma_px: f64,
}

/// Any; its numbers are xx, xy and yy.
pub(super) struct Elliptic(pub(super) Shape);

impl ImageModel for Round {
    fn cost_ns(&self, pixels: usize) -> u64 {
        ROUND_NS * pixels as u64
    }

    fn fill(&self, window: Window, [x, y]: [f64; 2], value: &mut [f64], derivatives: &mut [[f64; PROFILE_PARAMETERS]]) {
        let sigma = self.sigma_px;
        let across = axis_shares(window.x0, window.columns, x, sigma);
        let down = axis_shares(window.y0, window.rows, y, sigma);
        let pixels = value.iter_mut().zip(derivatives);
        let shares = down.iter().flat_map(|v| across.iter().map(move |u| (u, v)));
        for ((value, derivative), (u, v)) in pixels.zip(shares) {
            *value = u[0] * v[0];
            *derivative = [u[1] * v[0], u[0] * v[1], u[2] * v[0] + u[0] * v[2], 0.0, 0.0];
        }
    }
}

impl ImageModel for Elliptic {
    fn cost_ns(&self, pixels: usize) -> u64 {
        ELLIPSE_NS * pixels as u64
    }

    /// Gauss–Legendre quadrature inside each pixel: a rotated Gaussian does not part into factors.
    fn fill(&self, window: Window, [x, y]: [f64; 2], value: &mut [f64], derivatives: &mut [[f64; PROFILE_PARAMETERS]]) {
        let shape = self.0;
        let [a, b, c] = shape.inverse();
        let norm = 1.0 / (2.0 * std::f64::consts::PI * shape.determinant().sqrt());
        let nodes: &[(f64, f64)] = if shape.axes_px().1 < 1.0 { &GAUSS_LEGENDRE_4 } else { &GAUSS_LEGENDRE_3 };
        for row in 0..window.rows {
            for column in 0..window.columns {
                let index = row * window.columns + column;
                let (px, py) = ((window.x0 + column) as f64 - x, (window.y0 + row) as f64 - y);
                // far outside nothing is worth the exponentials
                if a * px * px + 2.0 * b * px * py + c * py * py > 120.0 {
                    continue;
                }
                let (mut share, mut derivative) = (0.0, [0.0; PROFILE_PARAMETERS]);
                for &(v, weight_v) in nodes {
                    for &(u, weight_u) in nodes {
                        let (dx, dy) = (px + u, py + v);
                        let (qx, qy) = (a * dx + b * dy, b * dx + c * dy);
                        let f = weight_u * weight_v * norm * (-0.5 * (dx * qx + dy * qy)).exp();
                        share += f;
                        derivative[0] += f * qx;
                        derivative[1] += f * qy;
                        derivative[2] += f * 0.5 * (qx * qx - a);
                        derivative[3] += f * (qx * qy - b);
                        derivative[4] += f * 0.5 * (qy * qy - c);
                    }
                }
                value[index] = share;
                derivatives[index] = derivative;
            }
        }
    }
}

/// Nodes and weights on (−½, ½).
const GAUSS_LEGENDRE_3: [(f64, f64); 3] =
    [(-0.387_298_334_620_741_7, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.387_298_334_620_741_7, 5.0 / 18.0)];
