//! Shape of a frame's star images, by adaptive moments.
//!
//! Bernstein & Jarvis 2002 (AJ 123, 583), section 3: moments under a Gaussian weight that is matched to the object until it
//! has the object's own shape. For a Gaussian image of matrix C under a weight W the measured matrix is (C⁻¹ + W⁻¹)⁻¹.

use rayon::prelude::*;

use super::filter::Peak;
use super::psf::Shape;
use crate::statistics::{mad_sigma, median};

/// The pixel widens the image by the variance of a box of side 1.
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;
/// Below this σ along the short axis it is a lone pixel, or a cosmic ray, px.
const SHARPEST_PX: f64 = 0.38;
const WIDEST_PX: f64 = 12.0;
/// Peaks looked at, brightest first.
const MOST_PEAKS: usize = 80;
const LEAST_SNR: f64 = 15.0;
/// An image is round unless its axes differ by more than this.
const ROUND_RATIO: f64 = 1.15;

/// The typical shape, and how many stars tell it.
pub(super) struct Typical {
    pub(super) shape: Shape,
    pub(super) stars: usize,
    /// Scatter of the stars' widths over the typical one.
    pub(super) spread: f64,
}

/// The middle of shapes; round unless they say otherwise. `None` of none.
pub(super) fn middle(shapes: &[Shape]) -> Option<Typical> {
    let middle = |pick: fn(&Shape) -> f64| median(&shapes.iter().map(pick).collect::<Vec<_>>());
    let shape = Shape { xx: middle(|s| s.xx)?, xy: middle(|s| s.xy)?, yy: middle(|s| s.yy)? };
    let (long, short) = shape.axes_px();
    let round = shapes.len() < 3 || long < ROUND_RATIO * short;
    let widths: Vec<f64> = shapes.iter().map(|s| s.sigma_px()).collect();
    let spread = mad_sigma(&widths)? / shape.sigma_px();
    Some(Typical { shape: if round { Shape::round(shape.sigma_px()) } else { shape }, stars: shapes.len(), spread })
}

/// Measures the typical shape; `None` where no bright star is.
pub(super) fn typical(residual: &[f32], width: usize, unusable: &[bool], peaks: &[Peak]) -> Option<Typical> {
    let bright: Vec<&Peak> = peaks.iter().filter(|p| p.snr > LEAST_SNR).collect();
    // the very brightest may be saturated or galaxies of their own; a share of the list, spread over it, tells the rule
    let step = (bright.len() / MOST_PEAKS).clamp(1, 4);
    let chosen: Vec<&Peak> = bright.into_iter().step_by(step).take(2 * MOST_PEAKS).collect();
    let shapes: Vec<Shape> = chosen
        .par_iter()
        .map(|p| adaptive_moments(residual, width, unusable, p))
        .collect::<Vec<_>>()
        .into_iter()
        .flatten()
        .filter(|s| s.axes_px().1 > SHARPEST_PX)
        .collect();
    middle(&shapes)
}

/// Shape of one star, the pixel's own width taken off; `None` where the moments do not settle.
fn adaptive_moments(residual: &[f32], width: usize, unusable: &[bool], peak: &Peak) -> Option<Shape> {
    let height = residual.len() / width;
    let (mut x, mut y) = (peak.x as f64, peak.y as f64);
    let mut weight = Shape::round(1.5);
    for _ in 0..60 {
        let d = weight.determinant();
        let radius = (3.5 * weight.axes_px().0).ceil().clamp(3.0, 3.0 * WIDEST_PX);
        let span = |at: f64, length: usize| ((at - radius).max(0.0) as usize, ((at + radius + 1.0).max(0.0) as usize).min(length));
        let ((x0, x1), (y0, y1)) = (span(x, width), span(y, height));
        let mut sums = [0.0; 6];
        for py in y0..y1 {
            for px in x0..x1 {
                if unusable[py * width + px] {
                    return None;
                }
                let (dx, dy) = (px as f64 - x, py as f64 - y);
                let q = (weight.yy * dx * dx - 2.0 * weight.xy * dx * dy + weight.xx * dy * dy) / d;
                let v = f64::from(residual[py * width + px]) * (-0.5 * q).exp();
                for (sum, term) in sums.iter_mut().zip([v, v * dx, v * dy, v * dx * dx, v * dx * dy, v * dy * dy]) {
                    *sum += term;
                }
            }
        }
        if sums[0] <= 0.0 {
            return None;
        }
        let (mx, my) = (sums[1] / sums[0], sums[2] / sums[0]);
        let m = Shape { xx: sums[3] / sums[0] - mx * mx, xy: sums[4] / sums[0] - mx * my, yy: sums[5] / sums[0] - my * my };
        // under a matched weight the moments are half the matrix; the shift of the centre is half of what is missing
        x += (2.0 * mx).clamp(-1.0, 1.0);
        y += (2.0 * my).clamp(-1.0, 1.0);
        if (x - peak.x as f64).hypot(y - peak.y as f64) > 3.0 + 2.0 * weight.axes_px().0 {
            return None;
        }
        let next = unweighted(m, weight)?;
        let change = (next.xx - weight.xx).abs() + (next.xy - weight.xy).abs() + (next.yy - weight.yy).abs();
        if change < 1e-3 * (weight.xx + weight.yy) {
            return Some(Shape { xx: next.xx - PIXEL_VARIANCE, xy: next.xy, yy: next.yy - PIXEL_VARIANCE });
        }
        weight = next;
    }
    None
}

/// The image's own matrix from that measured under a weight: (M⁻¹ − W⁻¹)⁻¹, kept within what a next weight may be.
fn unweighted(m: Shape, w: Shape) -> Option<Shape> {
    let (dm, dw) = (m.determinant(), w.determinant());
    if dm <= 0.0 || m.xx <= 0.0 {
        return None;
    }
    let i = Shape { xx: m.yy / dm - w.yy / dw, xy: -m.xy / dm + w.xy / dw, yy: m.xx / dm - w.xx / dw };
    let di = i.determinant();
    let c = if di > 0.0 && i.xx > 0.0 {
        Shape { xx: i.yy / di, xy: -i.xy / di, yy: i.xx / di }
    } else {
        // wider than the weight can tell: widen it
        Shape { xx: 2.0 * w.xx, xy: 0.0, yy: 2.0 * w.yy }
    };
    // at most double a step, so that a first wrong guess does not run away
    let (long, short) = c.axes_px();
    if long > WIDEST_PX || short < 0.1 {
        return None;
    }
    let limit = 2.0 * w.axes_px().0;
    let factor = if long > limit { (limit / long).powi(2) } else { 1.0 };
    Some(Shape { xx: c.xx * factor, xy: c.xy * factor, yy: c.yy * factor })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::psf::{Profile, Window};

    #[test]
    fn moments_return_the_shape_that_was_drawn() {
        for (shape, elliptical) in [(Shape::round(0.7), false), (Shape::round(4.0), false), (Shape { xx: 16.0, xy: 6.0, yy: 4.0 }, true)] {
            let mut p = Profile::new();
            p.fill(Window { x0: 0, y0: 0, columns: 80, rows: 80 }, 40.3, 39.8, shape, elliptical);
            let image: Vec<f32> = p.value.iter().map(|v| (1e4 * v) as f32).collect();
            let got = adaptive_moments(&image, 80, &vec![false; 6400], &Peak { x: 40, y: 40, snr: 1e3 }).unwrap();
            for (a, b) in [(got.xx, shape.xx), (got.xy, shape.xy), (got.yy, shape.yy)] {
                // images of a pixel's width depend on where in the pixel they lie
                assert!((a - b).abs() < 0.05 * (shape.xx + shape.yy), "{got:?} for {shape:?}");
            }
        }
    }
}
