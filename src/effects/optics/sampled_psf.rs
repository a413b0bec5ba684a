//! # Point spread from an image
//!
//! ## What it does
//!
//! The image of a star as an optical design program or a measurement gives it: densities of light at points finer than the
//! pixels.
//!
//! ## Equation
//!
//! The image's transform, continued with nothing beyond half a cycle a point, times that of the pixel unless the image has the pixel
//! in it. The image's sum is brought to 1; the star's place is the centre of its light.
//!
//! ## Parameters
//!
//! `image`: the file (FITS, TIFF or PNG). `image_points_per_px`: its points along the side of a pixel. `image_has_pixel`: whether the
//! pixel's square is in it already, as in an effective point spread measured from stars.
//!
//! ## Signature
//!
//! Residuals of the stamps that have the shape of the difference.
//!
//! ## Confused with
//!
//! What made the image: diffraction, aberrations, jitter.
//!
//! ## Neglected
//!
//! Light beyond the image's edges; details finer than its points.
//!
//! ## Source
//!
//! The sampling theorem; J. Anderson, I. King, PASP 112, 1360 (2000) for images with the pixel in them.

use nalgebra::Complex;

use super::tables::Grid;

/// A star's image at points finer than the pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct SampledImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Densities of light, row by row, the first row on top; any unit.
    pub values: Vec<f32>,
    /// Points along the side of a pixel.
    pub points_per_px: usize,
}

impl SampledImage {
    /// The sum of the values.
    #[must_use]
    pub fn sum(&self) -> f64 {
        self.values.iter().map(|value| f64::from(*value)).sum()
    }

    /// How far the image reaches from its middle, px.
    #[must_use]
    pub fn reach_px(&self) -> usize {
        (self.width.max(self.height) / 2).div_ceil(self.points_per_px)
    }

    /// A width that is surely not above that of the Gaussian as smooth as the image, px: the root of 0.16 of the area over which the light
    /// would be spread if it had the density of its peak everywhere.
    #[must_use]
    pub fn smooth_px(&self) -> f64 {
        let peak = self.values.iter().copied().fold(0.0_f32, f32::max);
        0.5 * (0.16 * self.sum() / f64::from(peak)).sqrt() / self.points_per_px as f64 + 0.25 / self.points_per_px as f64
    }

    /// The grid for it: at least 16 points a pixel, a multiple of its own by a power of two.
    #[must_use]
    pub fn grid(&self, reach_px: usize) -> (Grid, usize) {
        let mut finer = 1;
        while self.points_per_px * finer < 16 {
            finer *= 2;
        }
        let oversampling = self.points_per_px * finer;
        let least = (oversampling * 2 * (reach_px + 5)).max(finer * self.width.max(self.height));
        (Grid { side: least.next_power_of_two(), oversampling }, finer)
    }

    #[allow(clippy::cast_possible_wrap, reason = "images are small")]
    /// The transform of its light on its grid.
    #[must_use]
    pub fn transfer(&self, grid: &Grid, finer: usize) -> Vec<Complex<f64>> {
        let sum = self.sum();
        let (middle_x, middle_y) = (self.width as i64 / 2, self.height as i64 / 2);
        grid.transfer_of_samples(finer, |x, y| {
            let (column, row) = (x + middle_x, y + middle_y);
            let inside = (0..self.width as i64).contains(&column) && (0..self.height as i64).contains(&row);
            if inside { f64::from(self.values[row as usize * self.width + column as usize]) / sum } else { 0.0 }
        })
    }
}

/// The text of this file, whose head is its page.
#[must_use]
pub fn source() -> &'static str {
    page_source!("sampled_psf.rs")
}
