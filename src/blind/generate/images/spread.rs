//! The image of a star on the pixels: a Gaussian core with Moffat wings, blurred and drawn out, summed over points within each pixel.
//!
//! Sources: Moffat, A&A 3, 455 (1969); the blur of a defocused pencil is a disc of radius z/2N, whose variance per axis is a quarter of its radius
//! squared (Born & Wolf, *Principles of Optics*, 8.8: geometric limit); coma of third order shifts the pencil of pupil radius p and azimuth φ by
//! c·p²·(2 + cos 2φ, sin 2φ) (Welford, *Aberrations of Optical Systems* (1986), 7.3).

use std::f64::consts::{PI, TAU};

/// The image without defocus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaintedProfile {
    /// Width of the core (Gaussian σ), px.
    pub sigma_px: f64,
    /// Share of the light in the core.
    pub core: f64,
    /// Moffat's α of the wings, in units of σ.
    pub wings: f64,
    /// Moffat's β.
    pub beta: f64,
    /// Elongation (a² − b²)/(a² + b²) times cosine and sine of twice the angle.
    pub axes: [f64; 2],
}

/// What one star's image has more than the profile.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Blur {
    /// Variances added: xx, xy, yy, px².
    pub(super) added_px2: [f64; 3],
    /// Places over which the light is spread, px from the centre, with shares that sum to one; empty: one place.
    pub(super) places: Vec<[f64; 3]>,
    /// Loss of sensitivity towards the edges of a pixel, at the corner.
    pub(super) edge_drop: f64,
}

/// Light is followed to where it falls below this, electrons per pixel.
const FAINTEST_E: f64 = 0.03;
const MAX_REACH_PX: f64 = 18.0;
/// Points per axis within a pixel near the centre, and farther out.
const FINE: usize = 5;
const COARSE: usize = 2;
const FINE_WITHIN_SIGMA: f64 = 4.0;

impl PaintedProfile {
    /// Variances of the image, xx, xy, yy, as its core has them.
    fn variances(&self, blur: &Blur) -> [f64; 3] {
        let square = self.sigma_px * self.sigma_px;
        [
            square * (1.0 + self.axes[0]) + blur.added_px2[0],
            square * self.axes[1] + blur.added_px2[1],
            square * (1.0 - self.axes[0]) + blur.added_px2[2],
        ]
    }

    /// Adds a star's light to the pixels.
    pub(super) fn shine(&self, light: &mut [f64], size_px: [usize; 2], at: [f64; 2], electrons: f64, blur: &Blur) {
        let [xx, xy, yy] = self.variances(blur);
        let det = xx * yy - xy * xy;
        let inverse = [yy / det, -xy / det, xx / det];
        let (core, wings) =
            (self.core / (TAU * det.sqrt()), (1.0 - self.core) * (self.beta - 1.0) / (PI * self.wings.powi(2) * det.sqrt()));
        let density = |dx: f64, dy: f64| {
            let q = dx * dx * inverse[0] + 2.0 * dx * dy * inverse[1] + dy * dy * inverse[2];
            let tail = (1.0 + q / (self.wings * self.wings)).powf(-self.beta);
            if q < 60.0 { core * (-0.5 * q).exp() + wings * tail } else { wings * tail }
        };
        let sigma = xx.max(yy).sqrt();
        // Beyond the core the wings fall as r^(−2β).
        let wide = self.wings * sigma * (electrons * wings / FAINTEST_E).max(1.0).powf(0.5 / self.beta);
        let longest = blur.places.iter().map(|place| place[0].hypot(place[1])).fold(0.0, f64::max);
        let reach = (wide.max(4.5 * sigma)).min(MAX_REACH_PX) + longest;
        let only = [[0.0, 0.0, 1.0]];
        let places: &[[f64; 3]] = if blur.places.is_empty() { &only } else { &blur.places };
        let range = |centre: f64, length: usize| {
            let (first, last) = ((centre - reach).ceil().max(0.0), (centre + reach).floor().min(length as f64 - 1.0));
            first as usize..if last < first { first as usize } else { last as usize + 1 }
        };
        for row in range(at[1], size_px[1]) {
            for column in range(at[0], size_px[0]) {
                let [dx, dy] = [column as f64 - at[0], row as f64 - at[1]];
                let near = dx.hypot(dy) < FINE_WITHIN_SIGMA * sigma + longest;
                let points = if near { FINE } else { COARSE };
                let mut sum = 0.0;
                for j in 0..points {
                    for i in 0..points {
                        let [sx, sy] = [i, j].map(|k| (k as f64 + 0.5) / points as f64 - 0.5);
                        let seen = 1.0 - blur.edge_drop * 2.0 * (sx * sx + sy * sy);
                        sum += seen * places.iter().map(|[px, py, share]| share * density(dx + sx - px, dy + sy - py)).sum::<f64>();
                    }
                }
                light[row * size_px[0] + column] += electrons * sum / (points * points) as f64;
            }
        }
    }
}

/// The pencils of a comatic image about their centre of mass: rings of the pupil of equal area, at azimuths of equal steps; `tail_px` is c at this
/// place, along `angle`. The centre itself moves by c, in proportion to the field: that is a scale, which the camera's focal length has already.
pub(super) fn coma(tail_px: f64, angle_rad: f64) -> Vec<[f64; 3]> {
    const RINGS: usize = 3;
    const AZIMUTHS: usize = 6;
    let (sin, cos) = angle_rad.sin_cos();
    let mut places = Vec::with_capacity(RINGS * AZIMUTHS);
    for ring in 0..RINGS {
        // Mean of p² over the ring's area.
        let square = (ring as f64 + 0.5) / RINGS as f64;
        for step in 0..AZIMUTHS {
            let twice = TAU * step as f64 / AZIMUTHS as f64;
            let [along, across] = [tail_px * (square * (2.0 + twice.cos()) - 1.0), tail_px * square * twice.sin()];
            places.push([along * cos - across * sin, along * sin + across * cos, ((RINGS * AZIMUTHS) as f64).recip()]);
        }
    }
    places
}

/// A trail of constant speed, px from its middle.
pub(super) fn trail(length_px: [f64; 2]) -> Vec<[f64; 3]> {
    const STEPS: usize = 7;
    (0..STEPS)
        .map(|k| {
            let along = (k as f64 + 0.5) / STEPS as f64 - 0.5;
            [along * length_px[0], along * length_px[1], (STEPS as f64).recip()]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PROFILE: PaintedProfile = PaintedProfile { sigma_px: 0.8, core: 0.9, wings: 2.0, beta: 3.0, axes: [0.0, 0.0] };

    fn moments(profile: &PaintedProfile, blur: &Blur) -> [f64; 5] {
        let mut light = vec![0.0; 61 * 61];
        profile.shine(&mut light, [61, 61], [30.2, 29.7], 1e4, blur);
        let mut sums = [0.0; 5];
        for (k, value) in light.iter().enumerate() {
            let [x, y] = [(k % 61) as f64 - 30.2, (k / 61) as f64 - 29.7];
            for (sum, weight) in sums.iter_mut().zip([1.0, x, y, x * x, y * y]) {
                *sum += weight * value;
            }
        }
        [sums[0], sums[1] / sums[0], sums[2] / sums[0], sums[3] / sums[0], sums[4] / sums[0]]
    }

    /// All light lands, where it should, and a blur adds its variance (of a pure Gaussian: Moffat's own are cut off by the reach).
    #[test]
    fn light_is_kept_and_a_blur_adds_its_variance() {
        let [light, x, y, ..] = moments(&PROFILE, &Blur::default());
        assert!((light / 1e4 - 1.0).abs() < 2e-3, "{light}");
        assert!(x.abs() < 2e-3 && y.abs() < 2e-3, "{x} {y}");
        let gaussian = PaintedProfile { core: 1.0, ..PROFILE };
        let [_, _, _, plain, _] = moments(&gaussian, &Blur::default());
        assert!((plain - 0.64 - 1.0 / 12.0).abs() < 2e-2, "{plain}");
        let [.., wider, same] = moments(&gaussian, &Blur { added_px2: [0.3, 0.0, 0.0], ..Blur::default() });
        assert!((wider - plain - 0.3).abs() < 3e-3 && (same - plain).abs() < 3e-3, "{wider} {same}");
        let [.., drawn, _] = moments(&gaussian, &Blur { places: trail([1.2, 0.0]), ..Blur::default() });
        assert!((drawn - plain - 1.44 / 12.0).abs() < 6e-3, "{drawn}");
    }

    /// The pencils of coma have no shift, half of c² as variance along the tail (⟨p⁴(2 + cos 2φ)²⟩ − 1), a sixth across, and are longer on one side.
    #[test]
    fn coma_draws_out_along_its_tail() {
        let (sin, cos) = 0.3_f64.sin_cos();
        let along: Vec<[f64; 3]> = coma(0.5, 0.3).iter().map(|[x, y, share]| [x * cos + y * sin, y * cos - x * sin, *share]).collect();
        let mean = |of: fn(f64, f64) -> f64| along.iter().map(|[u, v, share]| share * of(*u, *v)).sum::<f64>() / 0.25;
        assert!(mean(|u, _| u).abs() < 1e-9 && mean(|_, v| v).abs() < 1e-9);
        // Three rings have a sum of p⁴ that is 3 % less than the pupil's.
        assert!((mean(|u, _| u * u) - 0.5).abs() < 0.07 && (mean(|_, v| v * v) - 1.0 / 6.0).abs() < 0.01);
        assert!(mean(|u, _| u * u * u) > 0.0);
    }

    #[test]
    fn edges_of_pixels_see_less() {
        let [whole, ..] = moments(&PROFILE, &Blur::default());
        let [less, ..] = moments(&PROFILE, &Blur { edge_drop: 0.1, ..Blur::default() });
        // The mean of 2(x² + y²) over a pixel is a third.
        assert!((less / whole - (1.0 - 0.1 / 3.0)).abs() < 1e-2, "{}", less / whole);
    }
}
