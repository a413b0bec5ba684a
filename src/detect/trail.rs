//! Image of a trailed star: a round Gaussian, drawn out evenly along a line.
//!
//! A trail has the same three second moments as an ellipse, so code that needs its size alone treats both alike; the
//! fit frees its length along x and y and its width instead, which are not degenerate.

use super::image_model::{GAUSS_LEGENDRE_4, ImageModel, PROFILE_PARAMETERS, Shape, Window, axis_shares};
use super::work::{BESIDE_TRAIL_NS, IN_TRAIL_NS};
use crate::statistics::median;

/// Pieces of this length, in widths of the Gaussian, with four nodes each: no pixel is off by more than 5e-6 of the light.
const PIECE: f64 = 2.5;
/// Beyond so many widths of a node its Gaussian is worth nothing.
const REACH: f64 = 6.5;

/// A trail by its numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trail {
    /// From one end of the line to the other, along x and y; both signs mean the same.
    pub(super) along_px: [f64; 2],
    /// Width of the Gaussian.
    pub(super) sigma_px: f64,
}

impl Trail {
    /// Its second moments: an even line of length L has L²/12 along itself.
    pub(super) fn shape(self) -> Shape {
        let ([x, y], own) = (self.along_px, self.sigma_px.max(0.0).powi(2));
        Shape { xx: own + x * x / 12.0, xy: x * y / 12.0, yy: own + y * y / 12.0, trail: true }
    }

    pub(super) fn length_px(self) -> f64 {
        self.along_px[0].hypot(self.along_px[1])
    }

    /// Pieces of which each is drawn by a few round Gaussians.
    fn pieces(self) -> f64 {
        (self.length_px() / (PIECE * self.sigma_px)).ceil().max(1.0)
    }

    /// Half the side of the square that each of these fills.
    fn node_reach_px(self) -> f64 {
        REACH * self.sigma_px + 0.5
    }

    /// The trail of these second moments.
    pub(super) fn of(shape: Shape) -> Self {
        let (along_px, sigma_px) = shape.line_px();
        Self { along_px, sigma_px }
    }

    /// With the sign that points the way of another.
    pub(super) fn like(self, other: Self) -> Self {
        let [x, y] = self.along_px;
        if x * other.along_px[0] + y * other.along_px[1] < 0.0 { Self { along_px: [-x, -y], ..self } } else { self }
    }

    /// A step of the fit further.
    pub(super) fn advanced(self, [x, y, sigma]: [f64; 3]) -> Self {
        Self { along_px: [self.along_px[0] + x, self.along_px[1] + y], sigma_px: self.sigma_px + sigma }
    }

    /// The middle of trails, number by number. `None` of none.
    pub(super) fn middle(trails: &[Self]) -> Option<Self> {
        // both signs mean the same: all take that of the first
        let first = *trails.first()?;
        let along = |axis: usize| median(&trails.iter().map(|t| t.like(first).along_px[axis]).collect::<Vec<_>>());
        Some(Self { along_px: [along(0)?, along(1)?], sigma_px: median(&trails.iter().map(|t| t.sigma_px).collect::<Vec<_>>())? })
    }
}

impl ImageModel for Trail {
    /// Of a long one most of the window is beside it.
    fn cost_ns(&self, pixels: usize) -> u64 {
        let nodes = (GAUSS_LEGENDRE_4.len() as f64 * self.pieces()) as u64;
        let lit = ((2.0 * self.node_reach_px()).powi(2) as u64).min(pixels as u64);
        BESIDE_TRAIL_NS * pixels as u64 + IN_TRAIL_NS * nodes * lit
    }

    /// Its numbers are the length along x and along y, and the width. Along the line Gauss–Legendre quadrature, at every node the pixels' exact shares.
    fn fill(&self, window: Window, [x, y]: [f64; 2], value: &mut [f64], derivatives: &mut [[f64; PROFILE_PARAMETERS]]) {
        let pieces = self.pieces();
        let reach = self.node_reach_px();
        let span = |centre: f64, start: usize, length: usize| {
            let index = |at: f64| (at - start as f64).clamp(0.0, length as f64) as usize;
            (index((centre - reach).ceil()), index((centre + reach).floor() + 1.0))
        };
        for piece in 0..pieces as usize {
            for (node, weight) in GAUSS_LEGENDRE_4 {
                let (t, weight) = ((piece as f64 + 0.5 + node) / pieces - 0.5, weight / pieces);
                let (at_x, at_y) = (x + t * self.along_px[0], y + t * self.along_px[1]);
                let ((left, right), (top, bottom)) = (span(at_x, window.x0, window.columns), span(at_y, window.y0, window.rows));
                if left >= right || top >= bottom {
                    continue;
                }
                let across = axis_shares(window.x0 + left, right - left, at_x, self.sigma_px);
                let down = axis_shares(window.y0 + top, bottom - top, at_y, self.sigma_px);
                for (row, v) in (top..bottom).zip(&down) {
                    let pixels = row * window.columns + left..row * window.columns + right;
                    let v = v.map(|share| weight * share);
                    for ((value, d), u) in value[pixels.clone()].iter_mut().zip(&mut derivatives[pixels]).zip(&across) {
                        let (by_x, by_y) = (u[1] * v[0], u[0] * v[1]);
                        *value += u[0] * v[0];
                        d[0] += by_x;
                        d[1] += by_y;
                        d[2] += t * by_x;
                        d[3] += t * by_y;
                        d[4] += u[2] * v[0] + u[0] * v[2];
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::psf::Profile;
    use super::*;

    const WINDOW: Window = Window { x0: 10, y0: 20, columns: 41, rows: 41 };

    fn profile(x: f64, y: f64, trail: Trail) -> Profile<'static> {
        let mut p = Profile::new();
        p.fill(WINDOW, x, y, trail.shape(), true);
        p
    }

    #[test]
    fn a_trail_along_an_axis_is_the_closed_form() {
        // ∫ Φ(z) dz = zΦ(z) + φ(z): the mean over the trail of the share of a pixel
        let normal = |z: f64| (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
        let integral = |z: f64| z * 0.5 * (1.0 + statrs::function::erf::erf(z / std::f64::consts::SQRT_2)) + normal(z);
        for (length, sigma) in [(0.3, 1.0), (2.0, 0.4), (3.9, 1.0), (12.3, 0.7), (20.0, 1.1), (25.0, 0.35), (18.0, 2.2)] {
            let p = profile(30.3, 39.9, Trail { along_px: [length, 0.0], sigma_px: sigma });
            let down = axis_shares(WINDOW.y0, WINDOW.rows, 39.9, sigma);
            let edge =
                |e: f64| sigma / length * (integral((e - 30.3 + length / 2.0) / sigma) - integral((e - 30.3 - length / 2.0) / sigma));
            let mut worst = 0.0_f64;
            for (i, value) in p.value.iter().enumerate() {
                let px = (WINDOW.x0 + i % WINDOW.columns) as f64;
                let exact = (edge(px + 0.5) - edge(px - 0.5)) * down[i / WINDOW.columns][0];
                worst = worst.max((value - exact).abs());
            }
            println!("length {length}, σ {sigma}: {worst:.1e} of the light");
            assert!(worst < 6e-6, "length {length}, σ {sigma}: {worst}");
        }
    }

    #[test]
    fn derivatives_are_those_of_the_values() {
        let base = Trail { along_px: [7.0, -4.0], sigma_px: 0.9 };
        let h = 1e-5;
        let moved = |k: usize, h: f64| {
            let mut step = [0.0; 3];
            if k > 1 {
                step[k - 2] = h;
            }
            let at = |axis: usize| if k == axis { h } else { 0.0 };
            profile(30.3 + at(0), 39.9 + at(1), base.advanced(step))
        };
        // the numbers' signs are those that the fit sees
        let own = Trail::of(base.shape());
        assert!((own.along_px[0] - base.along_px[0]).abs() < 1e-12 && (own.along_px[1] - base.along_px[1]).abs() < 1e-12);
        let at = profile(30.3, 39.9, base);
        for k in 0..5 {
            let (up, down) = (moved(k, h), moved(k, -h));
            for i in 0..at.value.len() {
                let numeric = (up.value[i] - down.value[i]) / (2.0 * h);
                assert!((numeric - at.derivatives[i][k]).abs() < 1e-7, "{k} {i}: {numeric} {}", at.derivatives[i][k]);
            }
        }
    }

    #[test]
    fn numbers_and_moments_are_each_others() {
        for (along_px, sigma_px) in [([3.0, 4.0], 1.0), ([-3.0, 4.0], 0.7), ([0.0, 9.0], 1.3), ([-20.0, 0.0], 2.0)] {
            let back = Trail::of(Trail { along_px, sigma_px }.shape());
            let sign = if back.along_px[0] * along_px[0] + back.along_px[1] * along_px[1] < 0.0 { -1.0 } else { 1.0 };
            assert!((back.sigma_px - sigma_px).abs() < 1e-9 && (0..2).all(|k| (sign * back.along_px[k] - along_px[k]).abs() < 1e-9));
        }
        let turned = [[3.0, 4.0], [-3.2, -4.2], [2.8, 3.8]].map(|along_px| Trail { along_px, sigma_px: 1.0 });
        assert_eq!(Trail::middle(&turned).unwrap().along_px, [3.0, 4.0]);
    }
}
