//! Star images drawn for tests and benches of the measurement, not by the renderer, and the least error that any estimate of them can have.

use boresight::frame::Frame;
use rand_distr::{Distribution, Normal, Poisson};
use rand_pcg::Pcg64;
use statrs::function::erf::erf;

/// A round Gaussian that is a part of an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    /// Its share of the light, and where it lies from the image's centre.
    pub(crate) share: f64,
    pub(crate) at_px: [f64; 2],
    pub(crate) sigma_px: f64,
}

/// The image of a point of light before the pixels sum it: parts whose shares sum to 1 and whose common centre is the origin.
#[derive(Clone, Debug)]
pub(crate) struct Image(pub(crate) Vec<Part>);

impl Image {
    pub(crate) fn gaussian(sigma_px: f64) -> Self {
        Self(vec![Part { share: 1.0, at_px: [0.0; 2], sigma_px }])
    }

    /// Core, a flare to one side as coma makes it, and wings.
    pub(crate) fn comatic(core_px: f64, turned_rad: f64) -> Self {
        let (s, c) = turned_rad.sin_cos();
        let flare =
            |share: f64, far: f64, wide: f64| Part { share, at_px: [far * core_px * c, far * core_px * s], sigma_px: wide * core_px };
        let mut parts = vec![flare(0.62, 0.0, 1.0), flare(0.18, 1.3, 1.1), flare(0.10, 2.4, 1.5), flare(0.10, 0.3, 3.0)];
        let centre: [f64; 2] = std::array::from_fn(|k| parts.iter().map(|p| p.share * p.at_px[k]).sum());
        for part in &mut parts {
            part.at_px = [part.at_px[0] - centre[0], part.at_px[1] - centre[1]];
        }
        Self(parts)
    }

    /// The same with all distances from its core so many times as far; about its common centre again.
    pub(crate) fn with_flare(mut self, times: f64) -> Self {
        let core = self.0[0].at_px;
        for part in &mut self.0 {
            part.at_px = std::array::from_fn(|k| times * (part.at_px[k] - core[k]));
        }
        let centre: [f64; 2] = std::array::from_fn(|k| self.0.iter().map(|p| p.share * p.at_px[k]).sum());
        for part in &mut self.0 {
            part.at_px = [part.at_px[0] - centre[0], part.at_px[1] - centre[1]];
        }
        self
    }

    /// Half the side of a window that holds all its light.
    pub(crate) fn reach_px(&self) -> usize {
        let far = |p: &Part| p.at_px[0].abs().max(p.at_px[1].abs()) + 6.0 * p.sigma_px;
        self.0.iter().map(far).fold(0.0, f64::max) as usize + 2
    }
}

/// Share of a line Gaussian in the pixel at `pixel`, and its derivatives by centre and σ.
fn along(pixel: f64, centre: f64, sigma: f64) -> [f64; 3] {
    let at = |edge: f64| {
        let t = (pixel + edge - centre) / sigma;
        let density = (-0.5 * t * t).exp() / (2.0 * std::f64::consts::PI).sqrt();
        [0.5 * erf(t * std::f64::consts::FRAC_1_SQRT_2), -density / sigma, -t * density / sigma]
    };
    let (low, high) = (at(-0.5), at(0.5));
    std::array::from_fn(|k| high[k] - low[k])
}

/// A star.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Star<'a> {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) electrons: f64,
    pub(crate) image: &'a Image,
}

impl Star<'_> {
    /// Calls `each` with every pixel (column, row; below zero outside) of the star's window: share of the light there, and derivatives by x, y and σ.
    pub(crate) fn shares(&self, mut each: impl FnMut(i64, i64, [f64; 4])) {
        let reach = self.image.reach_px().cast_signed() as i64;
        let (cx, cy) = (self.x.round() as i64, self.y.round() as i64);
        let line = |part: &Part, axis: usize, from: i64, centre: f64| -> Vec<[f64; 3]> {
            (from - reach..=from + reach).map(|p| along(p as f64, centre + part.at_px[axis], part.sigma_px)).collect()
        };
        let lines: Vec<_> = self.image.0.iter().map(|p| (p.share, line(p, 0, cx, self.x), line(p, 1, cy, self.y))).collect();
        for (row, y) in (cy - reach..=cy + reach).enumerate() {
            for (column, x) in (cx - reach..=cx + reach).enumerate() {
                let mut sum = [0.0; 4];
                for (share, across, down) in &lines {
                    let (u, v) = (across[column], down[row]);
                    let terms = [u[0] * v[0], u[1] * v[0], u[0] * v[1], u[2] * v[0] + u[0] * v[2]];
                    for (s, term) in sum.iter_mut().zip(terms) {
                        *s += share * term;
                    }
                }
                each(x, y, sum);
            }
        }
    }

    /// Cramér–Rao bound: the inverse Fisher matrix of x, y, flux and background (and width): variances of x and y, σ of the flux in electrons.
    pub(crate) fn bound(&self, background_e: f64, detector: &Detector, free_width: bool) -> ([f64; 2], f64) {
        let count = if free_width { 5 } else { 4 };
        let mut fisher = nalgebra::DMatrix::<f64>::zeros(count, count);
        self.shares(|_, _, [share, by_x, by_y, by_sigma]| {
            let row = [self.electrons * by_x, self.electrons * by_y, share, 1.0, self.electrons * by_sigma];
            let weight = 1.0 / detector.variance_e2(background_e + self.electrons * share);
            for i in 0..count {
                for j in 0..count {
                    fisher[(i, j)] += weight * row[i] * row[j];
                }
            }
        });
        let covariance = fisher.try_inverse().expect("a star tells its place");
        ([covariance[(0, 0)], covariance[(1, 1)]], covariance[(2, 2)].sqrt())
    }
}

/// Electrons at which a star of this image has a signal-to-noise ratio.
pub(crate) fn electrons_for(snr: f64, image: &Image, background_e: f64, detector: &Detector) -> f64 {
    let (mut low, mut high) = (1.0_f64, 1e9_f64);
    for _ in 0..60 {
        let electrons = (low * high).sqrt();
        let star = Star { x: 50.2, y: 50.3, electrons, image };
        if electrons / star.bound(background_e, detector, false).1 > snr { high = electrons } else { low = electrons }
    }
    low
}

/// What turns light into counts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Detector {
    pub(crate) gain_e_per_dn: f64,
    pub(crate) read_noise_e: f64,
    pub(crate) bias_dn: f64,
    pub(crate) top_dn: f64,
}

impl Detector {
    /// Variance of a pixel in electrons that expects so many: photons, reading, rounding.
    pub(crate) fn variance_e2(&self, electrons: f64) -> f64 {
        electrons + self.read_noise_e.powi(2) + self.gain_e_per_dn.powi(2) / 12.0
    }
}

/// A frame in the making: expected electrons.
pub(crate) struct Sky {
    pub(crate) width_px: usize,
    pub(crate) height_px: usize,
    pub(crate) electrons: Vec<f64>,
}

impl Sky {
    pub(crate) fn new(width_px: usize, height_px: usize, background_e: f64) -> Self {
        Self { width_px, height_px, electrons: vec![background_e; width_px * height_px] }
    }

    pub(crate) fn add(&mut self, star: &Star<'_>) {
        let (columns, rows) = (self.width_px.cast_signed() as i64, self.height_px.cast_signed() as i64);
        star.shares(|x, y, [share, ..]| {
            if (0..columns).contains(&x) && (0..rows).contains(&y) {
                self.electrons[(y * columns + x) as usize] += star.electrons * share;
            }
        });
    }

    /// Photon noise, read noise, gain, bias, rounding, and what the converter cannot hold.
    pub(crate) fn expose(&self, detector: &Detector, rng: &mut Pcg64) -> Frame {
        let read = Normal::new(0.0, detector.read_noise_e).expect("a read noise of 0 or above");
        let convert = |&mean: &f64| {
            let photons = if mean > 0.0 { Poisson::new(mean).expect("a positive mean").sample(rng) } else { 0.0 };
            let dn = (photons + read.sample(rng)) / detector.gain_e_per_dn + detector.bias_dn;
            dn.round().clamp(0.0, detector.top_dn) as f32
        };
        let pixels_dn = self.electrons.iter().map(convert).collect();
        Frame { width_px: self.width_px, height_px: self.height_px, pixels_dn, saturation_dn: detector.top_dn as f32 }
    }

    /// The expected counts themselves.
    pub(crate) fn noiseless(&self, detector: &Detector) -> Frame {
        let pixels_dn = self.electrons.iter().map(|&e| (e / detector.gain_e_per_dn + detector.bias_dn) as f32).collect();
        Frame { width_px: self.width_px, height_px: self.height_px, pixels_dn, saturation_dn: f32::MAX }
    }
}
