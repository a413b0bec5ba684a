//! Centroid, brightness and moments in a Gaussian window of fixed width.
//!
//! The weight is a product of one factor along each axis, so sums over pixels are gathered by columns first, and those of the noise need no
//! pixels at all.

use super::image_model::PIXEL_VARIANCE;
use super::moments::{Moments, SNR_TO_ADAPT};
use crate::frame::Frame;

/// Pixels along the side of the largest window.
pub(super) const MAX_SIDE: usize = 81;
/// Orders of the sums of the noise along an axis: 0 to 6.
const NOISE_ORDERS: usize = 7;

type Line = [f64; MAX_SIDE];

/// A Gaussian exp(−d² / 2 s²) at whole steps, from which it follows for any centre with two more exponentials.
pub(super) struct Bell {
    variance_px2: f64,
    radius: usize,
    steps: [f64; MAX_SIDE / 2 + 1],
}

impl Bell {
    pub(super) fn new(variance_px2: f64, radius: usize) -> Self {
        let radius = radius.min(MAX_SIDE / 2);
        let mut steps = [0.0; MAX_SIDE / 2 + 1];
        for (k, step) in steps.iter_mut().enumerate().take(radius + 1) {
            *step = (-0.5 * (k * k) as f64 / variance_px2).exp();
        }
        Self { variance_px2, radius, steps }
    }

    /// Its values along an axis of so many pixels; `None` with the centre outside.
    pub(super) fn along(&self, centre: f64, length: usize) -> Option<Axis> {
        let middle = centre.round();
        if !(middle >= 0.0 && middle < length as f64) {
            return None;
        }
        let (part, middle) = (centre - middle, middle as usize);
        let (from, to) = (middle.saturating_sub(self.radius), (middle + self.radius + 1).min(length));
        let mut axis = Axis { from, length: to - from, middle: middle - from, part, value: [0.0; MAX_SIDE] };
        axis.fill(self);
        Some(axis)
    }
}

/// The pixels of a window along an axis, and a Gaussian in them.
#[derive(Clone)]
pub(super) struct Axis {
    pub(super) from: usize,
    pub(super) length: usize,
    /// The centre: a pixel, and how far it lies from there.
    middle: usize,
    part: f64,
    value: Line,
}

impl Axis {
    fn fill(&mut self, bell: &Bell) {
        let top = (-0.5 * self.part * self.part / bell.variance_px2).exp();
        let ratio = (self.part / bell.variance_px2).exp();
        let (mut after, mut before) = (top, top / ratio);
        for k in self.middle..self.length {
            self.value[k] = after * bell.steps[k - self.middle];
            after *= ratio;
        }
        for k in (0..self.middle).rev() {
            self.value[k] = before * bell.steps[self.middle - k];
            before /= ratio;
        }
    }

    /// Distances from the centre and values.
    fn each(&self) -> impl Iterator<Item = (f64, f64)> {
        let start = -(self.middle as f64) - self.part;
        self.value[..self.length].iter().enumerate().map(move |(k, value)| (start + k as f64, *value))
    }

    /// Another Gaussian in the same pixels.
    fn of(&self, bell: &Bell) -> Self {
        let mut other = self.clone();
        other.fill(bell);
        other
    }

    /// Σ value² (times that of another) dᵏ.
    fn squares(&self, other: Option<&Self>) -> [f64; NOISE_ORDERS] {
        let mut sums = [0.0; NOISE_ORDERS];
        for (k, (d, value)) in self.each().enumerate() {
            let mut term = value * value * other.map_or(1.0, |o| o.value[k]);
            for sum in &mut sums {
                *sum += term;
                term *= d;
            }
        }
        sums
    }
}

/// Sums over a window: of w I, and of w I times x, y, and half of x² + y².
pub(super) struct Sums {
    pub(super) light: f64,
    pub(super) shift: [f64; 2],
    pub(super) square: f64,
}

/// Room for sums by columns.
pub(super) struct Scratch {
    columns: [Line; 3],
    factors: [[f64; 3]; MAX_SIDE],
}

impl Scratch {
    pub(super) const fn new() -> Self {
        Self { columns: [[0.0; MAX_SIDE]; 3], factors: [[0.0; 3]; MAX_SIDE] }
    }

    /// Sums of light above a level down each column of a window, each pixel times three factors of its row.
    fn gather(&mut self, frame: &Frame, level: f64, [across, down]: [&Axis; 2], factors: impl Iterator<Item = [f64; 3]>) -> &[Line; 3] {
        for (own, factor) in self.factors.iter_mut().zip(factors) {
            *own = factor;
        }
        for column in &mut self.columns {
            column[..across.length].fill(0.0);
        }
        let first = &frame.pixels_dn[down.from * frame.width_px + across.from..];
        add_rows(first, frame.width_px, level, &self.factors[..down.length], &mut self.columns, across.length);
        &self.columns
    }
}

#[multiversion::multiversion(targets("x86_64+avx2"))]
fn add_rows(pixels: &[f32], stride: usize, level: f64, factors: &[[f64; 3]], out: &mut [Line; 3], columns: usize) {
    let [a, b, c] = out;
    let (a, b, c) = (&mut a[..columns], &mut b[..columns], &mut c[..columns]);
    for (row, [f, g, h]) in factors.iter().enumerate() {
        let line = &pixels[row * stride..row * stride + columns];
        for x in 0..columns {
            let light = f64::from(line[x]) - level;
            a[x] += f * light;
            b[x] += g * light;
            c[x] += h * light;
        }
    }
}

/// χ² of a star whose light is a product of factors, by columns.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn add_misfits(pixels: &[f32], stride: usize, level: f64, light: [&[f64]; 2], noise: [f64; 2], out: &mut [f64]) {
    let [across, down] = light;
    let columns = out.len();
    let across = &across[..columns];
    for (row, factor) in down.iter().enumerate() {
        let line = &pixels[row * stride..row * stride + columns];
        for x in 0..columns {
            let model = factor * across[x];
            let rest = f64::from(line[x]) - level - model;
            out[x] += rest * rest / (noise[0] + noise[1] * model.max(0.0));
        }
    }
}

/// The sums of the pixels under a weight; `None` outside the frame or without light.
pub(super) fn weighted(frame: &Frame, level: f64, centre: [f64; 2], bell: &Bell, scratch: &mut Scratch) -> Option<Sums> {
    let across = bell.along(centre[0], frame.width_px)?;
    let down = bell.along(centre[1], frame.height_px)?;
    let columns = scratch.gather(frame, level, [&across, &down], down.each().map(|(d, w)| [w, w * d, w * d * d]));
    let mut sums = Sums { light: 0.0, shift: [0.0; 2], square: 0.0 };
    for (x, (d, w)) in across.each().enumerate() {
        let light = w * columns[0][x];
        sums.light += light;
        sums.shift[0] += light * d;
        sums.shift[1] += w * columns[1][x];
        sums.square += 0.5 * (light * d * d + w * columns[2][x]);
    }
    (sums.light > 0.0).then_some(sums)
}

/// What a frame's stars are measured with: the image that they have, pixel included, and the weight.
pub(super) struct Bells {
    pub(super) image: Bell,
    pub(super) weight: Bell,
}

/// Noise of a pixel: variance without light, and by how much a count of light adds to it.
#[derive(Clone, Copy)]
pub(super) struct Noise {
    pub(super) variance_dn2: f64,
    pub(super) per_dn: f64,
}

/// A star in its window.
pub(super) struct Weighed {
    pub(super) flux_dn: f64,
    pub(super) flux_sigma_dn: f64,
    pub(super) covariance_px2: [f64; 3],
    pub(super) chi2: f64,
    pub(super) pixels: usize,
    pub(super) peak_dn: f32,
    /// Mean of the squared distances along the axes under the weight, pixel included.
    pub(super) square_px2: f64,
    pub(super) moments: Moments,
    pub(super) is_cut: bool,
}

impl Bells {
    /// Brightness, errors, moments and χ² at a centre; `None` outside the frame or without light.
    pub(super) fn weigh(&self, frame: &Frame, level: f64, centre: [f64; 2], noise: Noise, scratch: &mut Scratch) -> Option<Weighed> {
        let (wx, wy) = (self.weight.along(centre[0], frame.width_px)?, self.weight.along(centre[1], frame.height_px)?);
        let (gx, gy) = (wx.of(&self.image), wy.of(&self.image));
        let image2 = self.image.variance_px2;
        let norm = 1.0 / (2.0 * std::f64::consts::PI * image2);
        // Σ w I dxⁱ dyᵏ by [k][i]
        let mut sums = [[0.0; 4]; 4];
        let mut add = |columns: &Line, k: usize| {
            for (x, (d, w)) in wx.each().enumerate() {
                let mut term = w * columns[x];
                for sum in &mut sums[k][..4 - k] {
                    *sum += term;
                    term *= d;
                }
            }
        };
        let columns = scratch.gather(frame, level, [&wx, &wy], wy.each().map(|(d, w)| [w, w * d, w * d * d]));
        for (k, column) in columns.iter().enumerate() {
            add(column, k);
        }
        let rows = wy.each().zip(gy.each()).map(|((d, w), (_, g))| [w * d.powi(3), g, 0.0]);
        let columns = scratch.gather(frame, level, [&wx, &wy], rows);
        add(&columns[0], 3);
        let light: f64 = norm * gx.each().enumerate().map(|(x, (_, g))| g * columns[1][x]).sum::<f64>();
        let mass = sums[0][0];
        let own = [gx.squares(None)[0], gy.squares(None)[0]];
        let own = norm * norm * own[0] * own[1];
        let flux_dn = light / own;
        let bright = flux_dn.max(0.0) * noise.per_dn * norm;
        let cubes = gx.squares(Some(&gx))[0] * gy.squares(Some(&gy))[0];
        let flux_sigma_dn = (noise.variance_dn2 * own + bright * norm * norm * cubes).sqrt() / own;
        if mass <= 0.0 || !flux_sigma_dn.is_finite() {
            return None;
        }
        // Σ w² V dxⁱ dyᵏ: of the background and of the star's own light
        let dark = [wx.squares(None), wy.squares(None)];
        let lit = [wx.squares(Some(&gx)), wy.squares(Some(&gy))];
        let spread = |i: usize, k: usize| noise.variance_dn2 * dark[0][i] * dark[1][k] + bright * lit[0][i] * lit[1][k];
        let gain = 1.0 + image2 / self.weight.variance_px2;
        let factor = gain * gain / (mass * mass);
        let star = flux_dn > SNR_TO_ADAPT * flux_sigma_dn;
        let moments = self.moments(&sums, spread, star);

        let mut along = [0.0; MAX_SIDE];
        for (a, (_, g)) in along.iter_mut().zip(gx.each()) {
            *a = flux_dn * norm * g;
        }
        let mut misfits = [0.0; MAX_SIDE];
        let first = &frame.pixels_dn[wy.from * frame.width_px + wx.from..];
        let model = [&along[..wx.length], &gy.value[..wy.length]];
        add_misfits(first, frame.width_px, level, model, [noise.variance_dn2, noise.per_dn], &mut misfits[..wx.length]);
        let row = |y: usize| &first[y * frame.width_px..y * frame.width_px + wx.length];
        let side = 2 * self.weight.radius + 1;
        Some(Weighed {
            flux_dn,
            flux_sigma_dn,
            covariance_px2: [spread(2, 0), spread(1, 1), spread(0, 2)].map(|s| factor * s),
            chi2: misfits[..wx.length].iter().sum(),
            pixels: wx.length * wy.length,
            peak_dn: (0..wy.length).flat_map(row).copied().fold(f32::NEG_INFINITY, f32::max),
            square_px2: 0.5 * (sums[0][2] + sums[2][0]) / mass,
            moments,
            is_cut: wx.length < side || wy.length < side,
        })
    }

    /// Moments before weight and pixel, from those under the weight: of a Gaussian of matrix C they are (C⁻¹ + W⁻¹)⁻¹. Of faint stars the step
    /// from the typical image that is linear in the counts.
    fn moments(&self, sums: &[[f64; 4]; 4], spread: impl Fn(usize, usize) -> f64, is_bright: bool) -> Moments {
        let (image2, weight2, mass) = (self.image.variance_px2, self.weight.variance_px2, sums[0][0]);
        let gain = 1.0 + image2 / weight2;
        let seen = [sums[0][2] / mass, sums[1][1] / mass, sums[2][0] / mass];
        let typical = image2 / gain;
        let stepped = [image2 + gain * gain * (seen[0] - typical), gain * gain * seen[1], image2 + gain * gain * (seen[2] - typical)];
        let own = if is_bright { without_weight(seen, weight2) } else { None };
        // what a change of the seen moments is multiplied with
        let stretch = own.map_or(gain * gain, |m| ((m[0] + m[2]) / (seen[0] + seen[2])).powi(2));
        let second = own.unwrap_or(stepped);
        let (s00, s20, s02) = (spread(0, 0), spread(2, 0), spread(0, 2));
        let variance = [
            spread(4, 0) - 2.0 * seen[0] * s20 + seen[0] * seen[0] * s00,
            spread(2, 2) - 2.0 * seen[1] * spread(1, 1) + seen[1] * seen[1] * s00,
            spread(0, 4) - 2.0 * seen[2] * s02 + seen[2] * seen[2] * s00,
        ];
        // ⟨u (|u|² − 4t)⟩ = t³ · skewness, u in widths of the image, t = 1 / gain
        let third = [sums[0][3] + sums[2][1], sums[3][0] + sums[1][2]];
        let shift = [sums[0][1], sums[1][0]];
        let scale = gain.powi(3) / (mass * image2.sqrt());
        let middle = 4.0 / gain;
        let of_skew = |even: [f64; 3], low: [f64; 2]| {
            (even[0] + 2.0 * even[1] + even[2]) / (image2 * image2) - 2.0 * middle * (low[0] + low[1]) / image2
        };
        let skew_variance = [
            of_skew([spread(6, 0), spread(4, 2), spread(2, 4)], [spread(4, 0), spread(2, 2)]) + middle * middle * s20,
            of_skew([spread(0, 6), spread(2, 4), spread(4, 2)], [spread(0, 4), spread(2, 2)]) + middle * middle * s02,
        ];
        Moments {
            second_px2: [second[0] - PIXEL_VARIANCE, second[1], second[2] - PIXEL_VARIANCE],
            second_sigma_px2: variance.map(|v| stretch * v.max(0.0).sqrt() / mass),
            skewness: std::array::from_fn(|k| scale * (third[k] / image2 - middle * shift[k])),
            skewness_sigma: skew_variance.map(|v| scale * v.max(0.0).sqrt()),
        }
    }
}

/// (M⁻¹ − W⁻¹)⁻¹ of moments seen under a round weight; `None` where they are wider than any image makes them.
fn without_weight([xx, xy, yy]: [f64; 3], weight2: f64) -> Option<[f64; 3]> {
    let determinant = xx * yy - xy * xy;
    let inverse = [yy / determinant - 1.0 / weight2, -xy / determinant, xx / determinant - 1.0 / weight2];
    let rest = inverse[0] * inverse[2] - inverse[1] * inverse[1];
    (determinant > 0.0 && xx > 0.0 && rest > 0.0 && inverse[0] > 0.0).then(|| [inverse[2] / rest, -inverse[1] / rest, inverse[0] / rest])
}
