//! Footprint of a light: which pixels of the frame show it, where most of it is, and how well it can be measured at best.
//!
//! **Bound.** With the expected electrons s of the light in each pixel, those b of everything else and the read noise r, with which the rounding of the
//! converter counts (gain²/12), the Fisher information of column, row and logarithm of the flux is F = Σ ∇s ∇sᵀ/(s + b + r²); the standard errors that no unbiased estimate falls below are the roots of the
//! first two elements on the diagonal of F⁻¹ (Cramér and Rao). Background and shape of the image are taken as known. Derivatives along columns and rows are
//! differences between the light in its place and a little beside it, by the code that renders.

use nalgebra::Matrix3;

use super::light::{Spreader, StarLight};
use super::truth::Seen;
use crate::imaging::{Imager, ImagingError};
use crate::scene::Scene;

/// What the frame shows of one light, without noise.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Footprint {
    /// Electrons over their expected standard error where every pixel is weighted in the best way.
    pub snr: f64,
    /// Centre of its expected electrons on the frame; `None` if none of them is there.
    pub centre_px: Option<[f64; 2]>,
    /// Expected electrons of everything else in its brightest pixel.
    pub background_e: f64,
    /// Whether one of its pixels is expected to be full.
    pub is_saturated: bool,
    /// First column, first row, last column and last row of the pixels that hold its light but for a fortieth beyond each side; all 0 if none of it
    /// reaches the frame.
    pub box_px: [usize; 4],
    /// The least standard error of column and row; infinite where the light is too faint or too little of it is on the frame.
    pub bound_px: [f64; 2],
    /// Pixels (index in the frame, row by row) in which it is expected to stand above the noise of everything else, with its electrons.
    pub pixels: Vec<(u32, f32)>,
}

/// Step of the differences, px: small beside any image, large beside the rounding of places.
const STEP_PX: f64 = 0.02;
/// What stays beyond each side of the box.
const BEYOND: f64 = 0.025;

impl Footprint {
    /// Of a light that is seen on the frame.
    pub(super) fn new(scene: &Scene, spreader: &Spreader, imager: &Imager, light: &StarLight, seen: &Seen) -> Result<Self, ImagingError> {
        let landed = seen.landed(spreader.whole_e(light));
        let width_px = scene.camera.width_px;
        let mut pixels = Vec::new();
        let own_width = seen.width_px.max(1);
        let rows = seen.light.electrons.chunks_exact(own_width).zip(seen.light.background_e.chunks_exact(own_width));
        for (y, (electrons, background_e)) in (seen.top_px..).zip(rows) {
            for (x, (electrons, background_e)) in (seen.left_px..).zip(electrons.iter().zip(background_e)) {
                if electrons * electrons >= background_e + seen.read_variance && *electrons > 0.0 {
                    pixels.push(((y * width_px + x) as u32, *electrons as f32));
                }
            }
        }
        let moved = [[STEP_PX, 0.0], [0.0, STEP_PX]].map(|by_px| spreader.stamp(&spreader.moved(light, by_px), imager));
        let [right, down] = moved;
        let beside = [right?, down?].map(|stamp| stamp.map(|stamp| seen.beside(scene, &stamp)));
        let bound_px = match beside {
            [Some(right), Some(down)] => bound_px(seen, &[right, down]),
            _ => [f64::INFINITY; 2],
        };
        Ok(Self {
            snr: landed.snr,
            centre_px: seen.light_centre_px(),
            background_e: landed.background_e,
            is_saturated: landed.is_full,
            box_px: box_px(seen),
            bound_px,
            pixels,
        })
    }
}

/// See the head of this file; `beside`: electrons of the light a step to the right and a step down, in the pixels of `seen`.
fn bound_px(seen: &Seen, beside: &[Vec<f64>; 2]) -> [f64; 2] {
    // The upper triangle, row by row.
    let mut sums = [0.0; 6];
    let both = beside[0].iter().zip(&beside[1]);
    for ((electrons, background_e), (right, down)) in seen.light.electrons.iter().zip(&seen.light.background_e).zip(both) {
        // Much of the rectangle about a trail holds nothing of it.
        if *electrons == 0.0 && *right == 0.0 && *down == 0.0 {
            continue;
        }
        let variance = electrons + background_e + seen.read_variance;
        if variance > 0.0 {
            let (x, y, flux) = ((right - electrons) / STEP_PX, (down - electrons) / STEP_PX, *electrons);
            let weight = variance.recip();
            for (sum, product) in sums.iter_mut().zip([x * x, x * y, x * flux, y * y, y * flux, flux * flux]) {
                *sum += product * weight;
            }
        }
    }
    let [xx, xy, xf, yy, yf, ff] = sums;
    let information = Matrix3::new(xx, xy, xf, xy, yy, yf, xf, yf, ff);
    let covariance = information.try_inverse();
    let bound = |axis: usize| covariance.map_or(f64::INFINITY, |covariance| covariance[(axis, axis)].max(0.0).sqrt());
    [0, 1].map(bound).map(|bound| if bound.is_finite() { bound } else { f64::INFINITY })
}

/// Columns and rows between which most of the light is.
fn box_px(seen: &Seen) -> [usize; 4] {
    let rows = seen.light.electrons.len() / seen.width_px.max(1);
    let (mut of_columns, mut of_rows) = (vec![0.0; seen.width_px], vec![0.0; rows]);
    for (row, electrons) in seen.light.electrons.chunks_exact(seen.width_px.max(1)).enumerate() {
        for (column, electrons) in electrons.iter().enumerate() {
            of_columns[column] += electrons;
            of_rows[row] += electrons;
        }
    }
    let span = |sums: &[f64]| -> [usize; 2] {
        let beyond = BEYOND * sums.iter().sum::<f64>();
        let first = |sums: &mut dyn Iterator<Item = &f64>| {
            let mut sum = 0.0;
            sums.take_while(|electrons| {
                sum += **electrons;
                sum <= beyond
            })
            .count()
        };
        let last = sums.len().saturating_sub(1);
        let low = first(&mut sums.iter()).min(last);
        [low, last.saturating_sub(first(&mut sums.iter().rev())).max(low)]
    };
    let ([left, right], [top, bottom]) = (span(&of_columns), span(&of_rows));
    [seen.left_px + left, seen.top_px + top, seen.left_px + right, seen.top_px + bottom]
}
