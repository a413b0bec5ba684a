//! Gaussian image of a star, integrated over each pixel, with its derivatives; that of a trail is in `trail`.

use statrs::function::erf::erf;

use super::epsf::EmpiricalPsf;
use super::fit::Model;
use super::trail::Trail;
use super::work::{ELLIPSE_NS, ROUND_NS, Work};

/// Second moments of a star image before the pixel integrates it, px².
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shape {
    pub(super) xx: f64,
    pub(super) xy: f64,
    pub(super) yy: f64,
    /// Whether the image is a round Gaussian drawn out along a line; else it is a Gaussian.
    pub(super) trail: bool,
}

impl Shape {
    pub(super) const fn round(sigma_px: f64) -> Self {
        Self::ellipse(sigma_px * sigma_px, 0.0, sigma_px * sigma_px)
    }

    /// A Gaussian's.
    pub(super) const fn ellipse(xx: f64, xy: f64, yy: f64) -> Self {
        Self { xx, xy, yy, trail: false }
    }

    pub(super) fn is_round(self) -> bool {
        self.xy == 0.0 && self.xx == self.yy && !self.trail
    }

    pub(super) fn determinant(self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// σ of the round Gaussian of the same area.
    pub(super) fn sigma_px(self) -> f64 {
        self.determinant().max(0.0).sqrt().sqrt()
    }

    /// σ along the long and the short axis.
    pub(super) fn axes_px(self) -> (f64, f64) {
        let (mean, half) = (f64::midpoint(self.xx, self.yy), (self.xx - self.yy) / 2.0);
        let root = half.hypot(self.xy);
        ((mean + root).max(0.0).sqrt(), (mean - root).max(0.0).sqrt())
    }

    /// Half the side of the square that holds the light up to so many σ.
    pub(super) fn reach_px(self, sigmas: f64) -> f64 {
        if self.trail { Trail::of(self).reach_px(sigmas) } else { sigmas * self.axes_px().0 }
    }

    /// The same shape, so many times as wide.
    pub(super) fn scaled(self, by: f64) -> Self {
        Self { xx: by * by * self.xx, xy: by * by * self.xy, yy: by * by * self.yy, ..self }
    }

    /// A distance in units of σ in its direction.
    pub(super) fn radius_in_sigma(self, dx: f64, dy: f64) -> f64 {
        let [a, b, c] = self.inverse();
        (a * dx * dx + 2.0 * b * dx * dy + c * dy * dy).max(0.0).sqrt()
    }

    /// The inverse matrix: xx, xy, yy.
    fn inverse(self) -> [f64; 3] {
        let d = self.determinant();
        [self.yy / d, -self.xy / d, self.xx / d]
    }
}

/// Free numbers of the star's profile, in this order: x, y, then the width (one), or xx, xy, yy, or a trail's length along x and y and its width.
pub(super) const PROFILE_PARAMETERS: usize = 5;

/// Square block of pixels around a star.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) x0: usize,
    pub(super) y0: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
}

/// Share of the flux in every pixel of a window, and derivatives: `value`, then by x, y and the shape's numbers.
pub(super) struct Profile<'a> {
    pub(super) value: Vec<f64>,
    pub(super) derivatives: Vec<[f64; PROFILE_PARAMETERS]>,
    psf: Option<&'a EmpiricalPsf>,
    /// The correction of the empirical image as it is in the window last drawn.
    local: Option<((usize, usize), Vec<f64>)>,
    /// Where what it draws is counted.
    work: Option<&'a Work>,
}

impl<'a> Profile<'a> {
    pub(super) fn new() -> Self {
        Self::of(None)
    }

    /// One that can draw the empirical image too.
    pub(super) fn of(psf: Option<&'a EmpiricalPsf>) -> Self {
        Self { value: Vec::new(), derivatives: Vec::new(), psf, local: None, work: None }
    }

    /// An empty one that draws the same images.
    pub(super) fn like(&self) -> Self {
        Self { local: self.local.clone(), work: self.work, ..Self::of(self.psf) }
    }

    /// The same, counted.
    pub(super) fn counted(self, work: &'a Work) -> Self {
        Self { work: Some(work), ..self }
    }

    /// So much was done with what was drawn.
    pub(super) fn spend(&self, ns: u64) {
        if let Some(work) = self.work {
            work.spend(ns);
        }
    }

    /// Fills in the image of a star; `elliptical` asks for all derivatives by the shape, even of a round one.
    pub(super) fn draw(&mut self, window: Window, model: &Model, elliptical: bool) {
        let Some(psf) = self.psf.filter(|_| model.empirical) else {
            self.fill(window, model.x, model.y, model.shape, elliptical || !model.shape.is_round());
            return;
        };
        self.fill(window, model.x, model.y, psf.base, !psf.base.is_round());
        let at = (window.x0 + window.columns / 2, window.y0 + window.rows / 2);
        let local = match self.local.take() {
            Some((place, local)) if place == at => local,
            _ => psf.correction_at([at.0 as f64, at.1 as f64]),
        };
        psf.grid.add(&local, window, [model.x, model.y], &mut self.value, &mut self.derivatives);
        self.local = Some((at, local));
    }

    /// Derivatives of a pixel's counts by flux, background, x, y and the shape's numbers.
    pub(super) fn row(&self, pixel: usize, flux: f64) -> [f64; 2 + PROFILE_PARAMETERS] {
        let d = &self.derivatives[pixel];
        [self.value[pixel], 1.0, flux * d[0], flux * d[1], flux * d[2], flux * d[3], flux * d[4]]
    }

    /// Fills in the profile of a star at (`x`, `y`).
    pub(super) fn fill(&mut self, window: Window, x: f64, y: f64, shape: Shape, elliptical: bool) {
        let pixels = window.columns * window.rows;
        self.value.clear();
        self.value.resize(pixels, 0.0);
        self.derivatives.clear();
        self.derivatives.resize(pixels, [0.0; PROFILE_PARAMETERS]);
        if let Some(work) = self.work {
            work.spend(if shape.trail {
                Trail::of(shape).cost_ns(pixels)
            } else {
                (if elliptical { ELLIPSE_NS } else { ROUND_NS }) * pixels as u64
            });
        }
        if shape.trail {
            Trail::of(shape).fill(window, x, y, &mut self.value, &mut self.derivatives);
        } else if elliptical {
            self.fill_elliptical(window, x, y, shape);
        } else {
            self.fill_round(window, x, y, shape.sigma_px());
        }
    }

    fn fill_round(&mut self, window: Window, x: f64, y: f64, sigma: f64) {
        let across = axis_shares(window.x0, window.columns, x, sigma);
        let down = axis_shares(window.y0, window.rows, y, sigma);
        let pixels = self.value.iter_mut().zip(&mut self.derivatives);
        let shares = down.iter().flat_map(|v| across.iter().map(move |u| (u, v)));
        for ((value, derivative), (u, v)) in pixels.zip(shares) {
            *value = u[0] * v[0];
            *derivative = [u[1] * v[0], u[0] * v[1], u[2] * v[0] + u[0] * v[2], 0.0, 0.0];
        }
    }

    /// Gauss–Legendre quadrature inside each pixel: a rotated Gaussian does not part into factors.
    fn fill_elliptical(&mut self, window: Window, x: f64, y: f64, shape: Shape) {
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
                let (mut value, mut derivative) = (0.0, [0.0; PROFILE_PARAMETERS]);
                for &(v, weight_v) in nodes {
                    for &(u, weight_u) in nodes {
                        let (dx, dy) = (px + u, py + v);
                        let (qx, qy) = (a * dx + b * dy, b * dx + c * dy);
                        let f = weight_u * weight_v * norm * (-0.5 * (dx * qx + dy * qy)).exp();
                        value += f;
                        derivative[0] += f * qx;
                        derivative[1] += f * qy;
                        derivative[2] += f * 0.5 * (qx * qx - a);
                        derivative[3] += f * (qx * qy - b);
                        derivative[4] += f * 0.5 * (qy * qy - c);
                    }
                }
                self.value[index] = value;
                self.derivatives[index] = derivative;
            }
        }
    }
}

/// Nodes and weights on (−½, ½).
const GAUSS_LEGENDRE_3: [(f64, f64); 3] =
    [(-0.387_298_334_620_741_7, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.387_298_334_620_741_7, 5.0 / 18.0)];
pub(super) const GAUSS_LEGENDRE_4: [(f64, f64); 4] = [
    (-0.430_568_155_797_026_3, 0.173_927_422_568_726_93),
    (-0.169_990_521_792_428_13, 0.326_072_577_431_273_07),
    (0.169_990_521_792_428_13, 0.326_072_577_431_273_07),
    (0.430_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// Share of a line Gaussian in each pixel of an axis with its derivatives by centre and σ.
pub(super) fn axis_shares(start: usize, length: usize, centre: f64, sigma: f64) -> Vec<[f64; 3]> {
    let at_edge = |i: usize| {
        let t = (start as f64 + i as f64 - 0.5 - centre) / sigma;
        let density = (-0.5 * t * t).exp() * (0.5 * std::f64::consts::FRAC_2_SQRT_PI * std::f64::consts::FRAC_1_SQRT_2);
        [0.5 * erf(t * std::f64::consts::FRAC_1_SQRT_2), -density / sigma, -t * density / sigma]
    };
    let mut low = at_edge(0);
    (1..=length)
        .map(|i| {
            let high = at_edge(i);
            let share = [high[0] - low[0], high[1] - low[1], high[2] - low[2]];
            low = high;
            share
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: Window = Window { x0: 10, y0: 20, columns: 31, rows: 31 };

    fn profile(x: f64, y: f64, shape: Shape, elliptical: bool) -> Profile<'static> {
        let mut p = Profile::new();
        p.fill(WINDOW, x, y, shape, elliptical);
        p
    }

    #[test]
    fn the_two_ways_agree_and_hold_all_flux() {
        for (sigma, tolerance) in [(0.5, 3e-4), (0.7, 1e-5), (1.1, 2e-5), (2.0, 1e-6)] {
            let shape = Shape::round(sigma);
            let (r, e) = (profile(25.3, 34.9, shape, false), profile(25.3, 34.9, shape, true));
            let difference = r.value.iter().zip(&e.value).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(difference < tolerance, "σ {sigma}: {difference}");
            assert!((r.value.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn derivatives_are_those_of_the_values() {
        let base = Shape::ellipse(2.0, 0.6, 1.2);
        let h = 1e-5;
        let moved = |k: usize, h: f64| {
            let mut s = base;
            match k {
                2 => s.xx += h,
                3 => s.xy += h,
                4 => s.yy += h,
                _ => {}
            }
            profile(25.3 + if k == 0 { h } else { 0.0 }, 34.9 + if k == 1 { h } else { 0.0 }, s, true)
        };
        let at = profile(25.3, 34.9, base, true);
        for k in 0..5 {
            let (up, down) = (moved(k, h), moved(k, -h));
            for i in 0..at.value.len() {
                let numeric = (up.value[i] - down.value[i]) / (2.0 * h);
                assert!((numeric - at.derivatives[i][k]).abs() < 1e-7, "{k} {i}: {numeric} {}", at.derivatives[i][k]);
            }
        }
        let at = profile(25.3, 34.9, Shape::round(0.8), false);
        let (up, down) = (profile(25.3, 34.9, Shape::round(0.8 + h), false), profile(25.3, 34.9, Shape::round(0.8 - h), false));
        for i in 0..at.value.len() {
            assert!(((up.value[i] - down.value[i]) / (2.0 * h) - at.derivatives[i][2]).abs() < 1e-8);
        }
    }

    #[test]
    fn axes_of_a_turned_ellipse() {
        let s = Shape::ellipse(5.0, 4.0, 5.0);
        let (long, short) = s.axes_px();
        assert!((long - 3.0).abs() < 1e-12 && (short - 1.0).abs() < 1e-12);
    }
}
