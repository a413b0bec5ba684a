//! How tables of point spreads are made: an image's Fourier transform, times that of the pixel, turned back onto a grid finer than the pixels.
//!
//! Working on transforms makes the pixel exact (its square is a product of two sinc), lets charge diffuse by a factor, and gives the spline
//! its coefficients by a division. A kind of image ([`ImageKind`]) gives its transform on the grid; the rest is the same for all.

mod fft;
mod pixel;

use std::sync::Arc;

use nalgebra::Complex;

pub use fft::transform;
pub use pixel::PixelResponse;

use super::{airy_psf, gaussian_image, moffat_psf, zernike_psf};
use crate::effects::ParameterSpec;
use crate::effects::pixel::Atlas;

/// Pixels by which a table is larger than the light it holds: room for the pixel, the spline's taps and a star's fraction of a pixel.
const MARGIN_PX: usize = 4;

/// The fine grid on which images are worked out; its point (0, 0) is at the place of the star, and it repeats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Points along a side, a power of two.
    pub side: usize,
    /// Points a pixel.
    pub oversampling: usize,
}

impl Grid {
    /// A grid for images of a smooth width of `width_px` (σ of a Gaussian) that reach `reach_px` to each side.
    #[must_use]
    pub fn new(width_px: f64, reach_px: usize) -> Self {
        // With the pixel's own width, 1/√12: the error of the spline between the points stays below 3e-6 of the light.
        let width = (width_px * width_px + 1.0 / 12.0).sqrt();
        let oversampling = if width >= 1.1 {
            8
        } else if width >= 0.5 {
            16
        } else {
            32
        };
        let side = (oversampling * 2 * (reach_px + MARGIN_PX + 1)).next_power_of_two();
        Self { side, oversampling }
    }

    /// The offset from the star of the `index`-th point along an axis, px: first those to the right, then those to the left.
    #[must_use]
    pub fn place_px(&self, index: usize) -> f64 {
        self.folded(index) / self.oversampling as f64
    }

    /// The `index`-th frequency along an axis, cycles per px.
    #[must_use]
    pub fn frequency(&self, index: usize) -> f64 {
        self.folded(index) * self.oversampling as f64 / self.side as f64
    }

    fn folded(&self, index: usize) -> f64 {
        if index < self.side / 2 { index as f64 } else { index as f64 - self.side as f64 }
    }

    /// A transform from its value at the frequencies (fx, fy).
    #[must_use]
    pub fn transfer(&self, value: impl Fn(f64, f64) -> Complex<f64> + Sync) -> Vec<Complex<f64>> {
        use rayon::prelude::*;
        let of = |i: usize| value(self.frequency(i % self.side), self.frequency(i / self.side));
        (0..self.side * self.side).into_par_iter().map(of).collect()
    }

    /// The transform of an image given by its density of light (px⁻²) at the points of the grid.
    #[must_use]
    pub fn transfer_of_density(&self, density: impl Fn(f64, f64) -> f64 + Sync) -> Vec<Complex<f64>> {
        use rayon::prelude::*;
        let cell = 1.0 / (self.oversampling * self.oversampling) as f64;
        let of = |i: usize| Complex::new(cell * density(self.place_px(i % self.side), self.place_px(i / self.side)), 0.0);
        let mut values: Vec<Complex<f64>> = (0..self.side * self.side).into_par_iter().map(of).collect();
        transform(&mut values, self.side, false);
        values
    }

    #[allow(clippy::cast_possible_wrap, reason = "grids are small")]
    /// The transform of an image given by its light at points that are coarser by the factor `coarser`, a power of two: `light(x, y)` for the
    /// offsets of the points from the star, in steps of the coarse points. What the image has between them follows from its transform, which
    /// ends at half a cycle a step.
    #[must_use]
    pub fn transfer_of_samples(&self, coarser: usize, light: impl Fn(i64, i64) -> f64) -> Vec<Complex<f64>> {
        let side = self.side / coarser;
        let signed = |index: usize| if index < side / 2 { index as i64 } else { index as i64 - side as i64 };
        let mut coarse: Vec<Complex<f64>> =
            (0..side * side).map(|i| Complex::new(light(signed(i % side), signed(i / side)), 0.0)).collect();
        transform(&mut coarse, side, false);
        let mut values = vec![Complex::new(0.0, 0.0); self.side * self.side];
        // The highest frequency of an even number of points stands for itself and its mirror: it is left out.
        let inner = (0..side).filter(|index| *index != side / 2 || coarser == 1);
        let wide = |index: usize| (signed(index) + self.side as i64) as usize % self.side;
        for y in inner.clone() {
            for x in inner.clone() {
                values[wide(y) * self.side + wide(x)] = coarse[y * side + x];
            }
        }
        values
    }
}

/// A kind of image that fills tables.
pub trait ImageKind: Sync {
    /// Its id.
    fn id(&self) -> &'static str;
    /// Its parameters.
    fn parameters(&self) -> &'static [ParameterSpec];
    /// Width σ of the Gaussian that is about as smooth, px: it decides how fine grids and sums over time must be.
    fn smooth_px(&self, parameters: &[f64]) -> f64;
    /// How far its light is followed where the user does not say, px.
    fn reach_px(&self, parameters: &[f64]) -> usize;
    /// The transform of its light on a grid; 1 at frequency 0 if all its light falls within the grid.
    fn transfer(&self, parameters: &[f64], grid: &Grid) -> Vec<Complex<f64>>;
    /// The text of its source file, whose head is its page.
    fn source(&self) -> &'static str;
}

/// How far light of diffraction or scattering is followed by default: as far as a grid of 1024 or, for sharp images, 2048 points allows, px.
#[must_use]
pub fn usual_reach_px(width_px: f64) -> usize {
    if width_px * width_px + 1.0 / 12.0 >= 1.1 * 1.1 { 59 } else { 27 }
}

/// Every kind of image that fills tables.
pub static IMAGE_KINDS: &[&dyn ImageKind] =
    &[&gaussian_image::GaussianImage, &moffat_psf::MoffatPsf, &airy_psf::AiryPsf, &zernike_psf::ZernikePsf];

/// The kind of image with this id.
#[must_use]
pub fn image_kind(id: &str) -> Option<&'static dyn ImageKind> {
    IMAGE_KINDS.iter().copied().find(|kind| kind.id() == id)
}

/// Makes an atlas, table by table.
#[derive(Clone, Debug)]
pub struct AtlasBuilder {
    grid: Grid,
    reach_px: usize,
    values: Vec<f32>,
    count: u32,
}

impl AtlasBuilder {
    /// Tables on this grid for light within `reach_px` of the star's pixel.
    #[must_use]
    pub fn new(grid: Grid, reach_px: usize) -> Self {
        let side = 2 * (reach_px + MARGIN_PX) + 1;
        Self { grid, reach_px, values: vec![grid.oversampling as f32, side as f32, 0.0, 0.0], count: 0 }
    }

    /// Bytes that so many tables take.
    #[must_use]
    pub fn bytes(&self, tables: usize) -> u64 {
        let side = 2 * (self.reach_px + MARGIN_PX) + 1;
        (tables * (side * self.grid.oversampling).pow(2) * size_of::<f32>()) as u64
    }

    /// Adds tables that [`Self::table`] made and returns the number of the first.
    pub fn add(&mut self, table: &[f32]) -> u32 {
        self.values.extend_from_slice(table);
        self.count += 1;
        self.values[2] = self.count as f32;
        self.count - 1
    }

    /// The table of an image with this transform, seen by pixels of this response. Over the last fifth of the reach the light fades to nothing,
    /// so that neither the sum nor the centre of what is left depends on where the pixels lie; the star's place is the centre of this light.
    #[must_use]
    pub fn table(&self, mut image: Vec<Complex<f64>>, pixel: &PixelResponse) -> Vec<f32> {
        let grid = self.grid;
        let centre = self.fade(&mut image);
        let response: Vec<[Complex<f64>; 2]> = (0..grid.side)
            .map(|index| {
                let frequency = grid.frequency(index);
                // What a cubic B-spline makes of its coefficients, at the points themselves.
                let spline = 2.0 / 3.0 + (std::f64::consts::TAU * frequency / grid.oversampling as f64).cos() / 3.0;
                let shift = centre.map(|place| Complex::from_polar(1.0 / spline, std::f64::consts::TAU * frequency * place));
                let [x, y] = pixel.transfer(frequency);
                [x * shift[0], y * shift[1]]
            })
            .collect();
        for (i, value) in image.iter_mut().enumerate() {
            *value *= response[i % grid.side][0] * response[i / grid.side][1];
        }
        transform(&mut image, grid.side, true);
        let scale = (grid.oversampling as f64 / grid.side as f64).powi(2);
        let (fine, half) = (grid.oversampling, self.reach_px + MARGIN_PX);
        let at = |pixel: usize, phase: usize| (pixel * fine + phase + grid.side - half * fine) % grid.side;
        let mut table = Vec::with_capacity((fine * (2 * half + 1)).pow(2));
        for phase_y in 0..fine {
            for phase_x in 0..fine {
                for y in 0..=2 * half {
                    let row = at(y, phase_y) * grid.side;
                    table.extend((0..=2 * half).map(|x| (image[row + at(x, phase_x)].re * scale) as f32));
                }
            }
        }
        table
    }

    /// Lets an image's light fade to nothing around the centre of what is left, and returns this centre, px. Transform in, transform out.
    fn fade(&self, image: &mut [Complex<f64>]) -> [f64; 2] {
        const ROUNDS: usize = 20;
        let grid = self.grid;
        transform(image, grid.side, true);
        let reach = self.reach_px as f64;
        let fading = |share: f64| (0.5 * std::f64::consts::PI * share).cos().powi(2);
        let dark = fading(1.0);
        let window = |x: f64, y: f64| {
            // Most points lie well within or well without, where no root need be drawn.
            let square = (x * x + y * y) / (reach * reach);
            if square < 0.6399 {
                1.0
            } else if square > 1.0001 {
                dark
            } else {
                fading(((x.hypot(y) / reach - 0.8) / 0.2).clamp(0.0, 1.0))
            }
        };
        let mut centre = [0.0_f64; 2];
        for _ in 0..ROUNDS {
            let (mut sum, mut first) = (0.0, [0.0; 2]);
            let along: Vec<[f64; 2]> = (0..grid.side).map(|index| centre.map(|centre| grid.place_px(index) - centre)).collect();
            for (row, [_, y]) in image.chunks_exact(grid.side).zip(&along).filter(|(_, [_, y])| y.abs() < reach) {
                for (value, [x, _]) in row.iter().zip(&along).filter(|(_, [x, _])| x.abs() < reach) {
                    let light = value.re * window(*x, *y);
                    sum += light;
                    first = [first[0] + light * x, first[1] + light * y];
                }
            }
            let step = first.map(|moment| moment / sum);
            centre = [centre[0] + step[0], centre[1] + step[1]];
            if step[0].hypot(step[1]) < 1e-9 {
                break;
            }
        }
        let cells = (grid.side * grid.side) as f64;
        for (i, value) in image.iter_mut().enumerate() {
            let (x, y) = (grid.place_px(i % grid.side) - centre[0], grid.place_px(i / grid.side) - centre[1]);
            *value = Complex::new(value.re * window(x, y) / cells, 0.0);
        }
        transform(image, grid.side, false);
        centre
    }

    /// The atlas.
    #[must_use]
    pub fn finish(self) -> Atlas {
        Atlas { values: Arc::from(self.values) }
    }
}
