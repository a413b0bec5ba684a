//! What the image of a star is to all that draws or fits one: its shape, its pixels, and what a model of it has to give. Knows no model.

use statrs::function::erf::erf;

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
        if !self.trail {
            return sigmas * self.axes_px().0;
        }
        let ([x, y], sigma_px) = self.line_px();
        x.abs().max(y.abs()) / 2.0 + sigmas * sigma_px
    }

    /// Of a trail: its line from one end to the other, along x and y, and the width of the Gaussian that is drawn out.
    pub(super) fn line_px(self) -> ([f64; 2], f64) {
        let (long, short) = self.axes_px();
        let length = (12.0 * (long * long - short * short)).max(0.0).sqrt();
        let (s, c) = (0.5 * (2.0 * self.xy).atan2(self.xx - self.yy)).sin_cos();
        ([length * c, length * s], short)
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
    pub(super) fn inverse(self) -> [f64; 3] {
        let d = self.determinant();
        [self.yy / d, -self.xy / d, self.xx / d]
    }
}

/// A star as modelled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) flux_dn: f64,
    pub(super) shape: Shape,
    /// Half the side of its window, px.
    pub(super) radius: usize,
    /// Whether its image is the empirical one; the shape is then only a measure of its size.
    pub(super) empirical: bool,
}

/// Half the side of the window for a shape.
pub(super) fn radius_px(shape: Shape) -> usize {
    ((shape.reach_px(4.0) + 1.0).ceil() as usize).clamp(4, if shape.trail { 64 } else { 32 })
}

/// The pixel widens the image by the variance of a box of side 1.
pub(super) const PIXEL_VARIANCE: f64 = 1.0 / 12.0;
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

/// A way in which the light of a star is spread.
pub(super) trait ImageModel {
    /// What it costs to be drawn in a window of so many pixels, nanoseconds.
    fn cost_ns(&self, pixels: usize) -> u64;

    /// Fills in the share of the light of a star at (x, y) in every pixel of a window, and its derivatives by x, y and the model's numbers.
    /// All are 0 before.
    fn fill(&self, window: Window, centre_px: [f64; 2], value: &mut [f64], derivatives: &mut [[f64; PROFILE_PARAMETERS]]);
}

/// Nodes and weights on (−½, ½).
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

/// Adds a star of round Gaussians, each a share of its light with a σ in px, to the light of a square frame: what tests find stars in.
#[cfg(test)]
pub(super) fn paint_star(light: &mut [f64], side: usize, at_px: [f64; 2], flux_dn: f64, parts: &[(f64, f64)]) {
    const REACH_PX: usize = 12;
    let start = at_px.map(|along| along.round() as usize - REACH_PX);
    for (share, sigma_px) in parts {
        let lines = [0, 1].map(|axis| axis_shares(start[axis], 2 * REACH_PX + 1, at_px[axis], *sigma_px));
        for (y, down) in lines[1].iter().enumerate() {
            for (x, across) in lines[0].iter().enumerate() {
                light[(start[1] + y) * side + start[0] + x] += flux_dn * share * down[0] * across[0];
            }
        }
    }
}
