//! Matched filter: signal-to-noise ratio of a star of known shape centred on each pixel, and its maxima.
//!
//! The threshold follows from the number of false maxima asked for, by the density of maxima of a smooth Gaussian random
//! field (Adler 1981, The Geometry of Random Fields, chapter 6): N(>u) = A |Λ|^½ (2π)^(−3/2) u exp(−u²/2), where Λ is the
//! second spectral moment, 1/(4σ²) per axis and variance 1/(2σ²) for white noise smoothed by a Gaussian of σ.

use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Normal};

use super::image_model::{Shape, Window};
use super::psf::Profile;
use crate::parallel;
use crate::statistics::clipped;

/// Rows that one task filters.
const BAND_ROWS: usize = 48;
/// Residuals enter the local mean cut at this many σ, so that stars do not lift it much.
const CUT_FOR_MEAN: f32 = 3.0;

/// A place where a star may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Peak {
    pub(super) x: usize,
    pub(super) y: usize,
    /// Signal-to-noise ratio of the filter.
    pub(super) snr: f64,
}

/// Filter for one shape.
#[derive(Clone)]
pub(super) struct Kernel {
    /// Half the side.
    radius: usize,
    /// Factors of a round kernel.
    line: Option<Vec<f32>>,
    /// The full kernel, row by row.
    full: Vec<f32>,
    /// Half the side of the square whose mean is taken away.
    mean_radius: usize,
    /// What turns the sum into a signal-to-noise ratio.
    scale: f32,
    /// Sum of the kernel, taken off as that times the local mean.
    sum: f32,
    blurred: Shape,
}

/// What the pixel does to the image belongs to the filter.
fn blurred(shape: Shape) -> Shape {
    Shape { xx: shape.xx + 1.0 / 12.0, yy: shape.yy + 1.0 / 12.0, ..shape }
}

/// The image of a trail in a square of this half side; what adds next to nothing is left out, since most of the square is beside the trail.
fn trailed(shape: Shape, radius: usize) -> Vec<f32> {
    const MIN_SHARE: f64 = 3e-3;
    let side = 2 * radius + 1;
    let mut profile = Profile::new();
    profile.fill(Window { x0: 0, y0: 0, columns: side, rows: side }, radius as f64, radius as f64, shape, true);
    let least = MIN_SHARE * profile.value.iter().copied().fold(0.0, f64::max);
    profile.value.iter().map(|v| if *v > least { *v as f32 } else { 0.0 }).collect()
}

impl Kernel {
    pub(super) fn new(shape: Shape) -> Self {
        let blurred = blurred(shape);
        let radius = (blurred.reach_px(3.0).ceil() as usize).clamp(2, if shape.trail { 64 } else { 24 });
        let d = blurred.determinant();
        let side = 2 * radius + 1;
        let value = |dx: f64, dy: f64| (-0.5 * (blurred.yy * dx * dx - 2.0 * blurred.xy * dx * dy + blurred.xx * dy * dy) / d).exp();
        let offset = |i: usize| i as f64 - radius as f64;
        let full: Vec<f32> = if shape.trail {
            trailed(shape, radius)
        } else {
            (0..side * side).map(|i| value(offset(i % side), offset(i / side)) as f32).collect()
        };
        let line = shape.is_round().then(|| (0..side).map(|i| value(offset(i), 0.0) as f32).collect());
        let square: f64 = full.iter().map(|&g| f64::from(g) * f64::from(g)).sum();
        let sum: f64 = full.iter().map(|&g| f64::from(g)).sum();
        let mean_radius = (radius + 4).max(8);
        let mean_side = (2 * mean_radius + 1) as f64;
        let scale = 1.0 / (square - sum * sum / (mean_side * mean_side)).max(1e-12).sqrt();
        Self { radius, line, full, mean_radius, scale: scale as f32, sum: sum as f32, blurred }
    }

    /// What it costs to filter so many pixels, nanoseconds.
    pub(super) fn cost_ns(&self, pixels: usize) -> u64 {
        const TAP_PS: u64 = 150;
        let taps = self.line.as_ref().map_or_else(|| self.full.iter().filter(|g| **g != 0.0).count(), |line| 2 * line.len());
        pixels as u64 * taps as u64 * TAP_PS / 1000
    }

    /// Flux, in units of the noise of a pixel, of a star that the filter gives a signal-to-noise ratio of 1.
    pub(super) fn flux_per_snr(&self) -> f64 {
        f64::from(self.scale * self.sum)
    }

    /// The threshold at which `pixels` of pure noise give `false_alarms` maxima.
    pub(super) fn threshold(&self, pixels: usize, false_alarms: f64) -> f64 {
        let density = pixels as f64 / (2.0 * self.blurred.determinant().sqrt()) / (2.0 * std::f64::consts::PI).powf(1.5);
        let mut u = 4.0_f64;
        for _ in 0..50 {
            u = (2.0 * (density * u / false_alarms).max(1.0).ln()).max(1.0).sqrt();
        }
        u.max(2.5)
    }

    /// Pixels that the light of stars reaches, in the filtered frame.
    pub(super) fn lit(&self, stars: &[Peak], filtered: &[f32], width: usize) -> Vec<bool> {
        let height = filtered.len() / width;
        let mut lit = vec![false; filtered.len()];
        // a filtered star is wider by √2, and falls below one noise σ at √(2 ln snr) of its own
        let sigma = self.blurred.axes_px().0 * std::f64::consts::SQRT_2;
        for star in stars {
            let reach = ((sigma * (2.0 * star.snr.ln()).max(1.0).sqrt()).ceil() as usize + 1).min(40);
            for y in star.y.saturating_sub(reach)..(star.y + reach + 1).min(height) {
                lit[y * width..(y + 1) * width][star.x.saturating_sub(reach)..(star.x + reach + 1).min(width)].fill(true);
            }
        }
        lit
    }

    /// Scatter that the filter gives noise whose neighbouring pixels go together, over that of white noise: from the correlation of
    /// dark pixels at small distances. (The filtered frame's own scatter would count what stars do to the mean around them.)
    pub(super) fn scatter_of_correlated(&self, normalised: &[f32], lit: &[bool], width: usize) -> f64 {
        const DISTANCES: [(usize, usize); 6] = [(1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (2, 2)];
        const NOISE_BELOW: f32 = 4.0;
        let step = (normalised.len() / 60_000).max(1) | 1;
        let dark = |i: usize| !lit[i] && normalised[i].abs() < NOISE_BELOW;
        let sigma2 = self.blurred.determinant().sqrt();
        let mut variance = 1.0;
        for (dx, dy) in DISTANCES {
            let (mut product, mut square) = (0.0, 0.0);
            for i in (0..normalised.len().saturating_sub(dy * width + dx)).step_by(step) {
                let j = i + dy * width + dx;
                if i % width + dx < width && dark(i) && dark(j) {
                    let (a, b) = (f64::from(normalised[i]), f64::from(normalised[j]));
                    product += a * b;
                    square += 0.5 * (a * a + b * b);
                }
            }
            // each stands for those mirrored: four where both are not zero, two otherwise
            let count = if dx > 0 && dy > 0 { 4.0 } else { 2.0 };
            let distance2 = (dx * dx + dy * dy) as f64;
            if square > 0.0 {
                variance += count * product / square * (-distance2 / (4.0 * sigma2)).exp();
            }
        }
        variance.max(1.0).sqrt()
    }

    /// The filter's weights, their squares summing to 1 less what the mean takes.
    pub(super) fn weights(&self) -> Vec<f64> {
        self.full.iter().map(|g| f64::from(g * self.scale)).map(|w| w.min(1.0)).collect()
    }

    /// Filters residuals that have unit noise; what lies outside the frame counts as background.
    pub(super) fn apply(&self, normalised: &[f32], width: usize) -> Vec<f32> {
        let height = normalised.len() / width;
        let mut out = vec![0.0_f32; normalised.len()];
        parallel::for_each_part(&mut out, BAND_ROWS * width, |band, out| {
            let first = band * BAND_ROWS;
            self.apply_band(normalised, width, height, first, out);
        });
        out
    }

    fn apply_band(&self, data: &[f32], width: usize, height: usize, first: usize, out: &mut [f32]) {
        let rows = out.len() / width;
        if let Some(line) = &self.line {
            let reach = self.radius;
            let (top, bottom) = (first.saturating_sub(reach), (first + rows + reach).min(height));
            let mut across = vec![0.0_f32; (bottom - top) * width];
            for (y, target) in (top..bottom).zip(across.chunks_exact_mut(width)) {
                convolve_row(&data[y * width..(y + 1) * width], line, target);
            }
            for (y, target) in (first..first + rows).zip(out.chunks_exact_mut(width)) {
                for (k, &g) in line.iter().enumerate() {
                    let Some(from) = (y + k).checked_sub(reach).filter(|r| *r < height) else { continue };
                    add_scaled(target, &across[(from - top) * width..(from - top + 1) * width], g);
                }
            }
        } else {
            let side = 2 * self.radius + 1;
            let mut row = vec![0.0_f32; width];
            for (y, target) in (first..first + rows).zip(out.chunks_exact_mut(width)) {
                for k in 0..side {
                    let Some(from) = (y + k).checked_sub(self.radius).filter(|r| *r < height) else { continue };
                    row.fill(0.0);
                    convolve_row(&data[from * width..(from + 1) * width], &self.full[k * side..(k + 1) * side], &mut row);
                    add_scaled(target, &row, 1.0);
                }
            }
        }
        self.take_mean_off(data, width, height, first, out);
    }

    /// Takes the mean of the surrounding square off: the filter then ignores any constant.
    fn take_mean_off(&self, data: &[f32], width: usize, height: usize, first: usize, out: &mut [f32]) {
        let reach = self.mean_radius;
        let side = 2 * reach + 1;
        let factor = self.sum / (side * side) as f32;
        let mut column_sum = vec![0.0_f32; width];
        let cut = |v: f32| v.clamp(-CUT_FOR_MEAN, CUT_FOR_MEAN);
        let add = |sums: &mut [f32], y: usize, sign: f32| {
            for (s, v) in sums.iter_mut().zip(&data[y * width..(y + 1) * width]) {
                *s += sign * cut(*v);
            }
        };
        for y in first.saturating_sub(reach)..(first + reach).min(height) {
            add(&mut column_sum, y, 1.0);
        }
        for (y, target) in (first..).zip(out.chunks_exact_mut(width)) {
            if y + reach < height {
                add(&mut column_sum, y + reach, 1.0);
            }
            let mut sum: f32 = column_sum[..reach.min(width)].iter().sum();
            for x in 0..width {
                if x + reach < width {
                    sum += column_sum[x + reach];
                }
                target[x] = (target[x] - sum * factor) * self.scale;
                if x >= reach {
                    sum -= column_sum[x - reach];
                }
            }
            if y >= reach {
                add(&mut column_sum, y - reach, -1.0);
            }
        }
    }
}

/// Adds to `target` the row convolved with a kernel of odd length, which is the same read from both ends or is given reversed
/// together with its rows.
fn convolve_row(row: &[f32], kernel: &[f32], target: &mut [f32]) {
    let (width, reach) = (row.len(), kernel.len() / 2);
    for (k, &g) in kernel.iter().enumerate().filter(|(_, g)| **g != 0.0) {
        // target[x] += g · row[x + k − reach]
        if k >= reach {
            let shift = (k - reach).min(width);
            add_scaled(&mut target[..width - shift], &row[shift..], g);
        } else {
            let shift = (reach - k).min(width);
            add_scaled(&mut target[shift..], &row[..width - shift], g);
        }
    }
}

fn add_scaled(target: &mut [f32], source: &[f32], factor: f32) {
    for (t, s) in target.iter_mut().zip(source) {
        *t += factor * s;
    }
}

/// Scatter of the filtered frame where no star is (`lit` pixels are left out): 1 for white noise, more where neighbouring pixels
/// go together.
pub(super) fn scatter(filtered: &[f32], lit: &[bool]) -> f64 {
    let step = (filtered.len() / 60_000).max(1) | 1;
    let dark = |i: usize| !lit.get(i).copied().unwrap_or(false);
    let sample: Vec<f32> = (0..filtered.len()).step_by(step).filter(|&i| dark(i)).map(|i| filtered[i]).collect();
    clipped(&sample, 0.0).map_or(1.0, |c| c.sigma)
}

/// What `times` of so many standard normal numbers exceed.
pub(super) fn exceeded_in(count: usize, times: f64) -> f64 {
    let share = (times / count.max(1) as f64).clamp(f64::MIN_POSITIVE, 0.1);
    -Normal::standard().inverse_cdf(share)
}

/// Maxima above a threshold, brightest first.
pub(super) fn peaks(filtered: &[f32], width: usize, threshold: f64) -> Vec<Peak> {
    let height = filtered.len() / width;
    let limit = threshold as f32;
    let at = |x: usize, y: usize| filtered[y * width + x];
    let is_maximum = |x: usize, y: usize| {
        let own = at(x, y);
        let before = |nx: usize, ny: usize| (ny, nx) < (y, x);
        (y.saturating_sub(1)..(y + 2).min(height)).all(|ny| {
            (x.saturating_sub(1)..(x + 2).min(width)).all(|nx| {
                let other = at(nx, ny);
                // of equal neighbours the first counts
                (nx, ny) == (x, y) || own > other || (own == other && !before(nx, ny))
            })
        })
    };
    let mut found: Vec<Peak> = (0..height)
        .into_par_iter()
        .flat_map_iter(|y| {
            let row = &filtered[y * width..(y + 1) * width];
            row.iter().enumerate().filter(move |(x, v)| **v > limit && is_maximum(*x, y)).map(move |(x, v)| Peak {
                x,
                y,
                snr: f64::from(*v),
            })
        })
        .collect();
    found.sort_by(|a, b| b.snr.total_cmp(&a.snr).then((a.y, a.x).cmp(&(b.y, b.x))));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sum over the kernel at every pixel, as the definition says.
    fn plain(kernel: &Kernel, data: &[f32], width: usize) -> Vec<f32> {
        let height = data.len() / width;
        let (r, m) = (kernel.radius.cast_signed(), kernel.mean_radius.cast_signed());
        let (columns, rows) = (width.cast_signed(), height.cast_signed());
        let get = |x: isize, y: isize| {
            if x < 0 || y < 0 || x >= columns || y >= rows { 0.0 } else { data[(y * columns + x) as usize] }
        };
        (0..columns * rows)
            .map(|i| {
                let (x, y) = (i % columns, i / columns);
                let mut sum = 0.0;
                for dy in -r..=r {
                    for dx in -r..=r {
                        sum += kernel.full[((dy + r) * (2 * r + 1) + dx + r) as usize] * get(x + dx, y + dy);
                    }
                }
                let mut mean = 0.0;
                for dy in -m..=m {
                    for dx in -m..=m {
                        mean += get(x + dx, y + dy).clamp(-CUT_FOR_MEAN, CUT_FOR_MEAN);
                    }
                }
                (sum - mean * kernel.sum / ((2 * m + 1) * (2 * m + 1)) as f32) * kernel.scale
            })
            .collect()
    }

    #[test]
    fn fast_and_plain_filter_agree() {
        let (width, height) = (37, 115);
        let data: Vec<f32> = (0..width * height).map(|i| ((i * 7919 + i * i * 31) % 101) as f32 / 25.0 - 2.0).collect();
        for shape in [Shape::round(1.1), Shape::ellipse(4.0, 1.5, 1.0)] {
            let kernel = Kernel::new(shape);
            let (fast, slow) = (kernel.apply(&data, width), plain(&kernel, &data, width));
            let worst = fast.iter().zip(&slow).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-3, "{shape:?}: {worst}");
        }
    }

    #[test]
    fn equal_neighbours_give_one_peak() {
        let mut data = vec![0.0; 100];
        for i in [44, 45, 54, 55] {
            data[i] = 9.0;
        }
        assert_eq!(peaks(&data, 10, 5.0), vec![Peak { x: 4, y: 4, snr: 9.0 }]);
    }
}
