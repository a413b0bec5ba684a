//! Shape of a frame's star images, by adaptive moments.
//!
//! Bernstein & Jarvis 2002 (AJ 123, 583), section 3: moments under a Gaussian weight that is matched to the object until it
//! has the object's own shape. For a Gaussian image of matrix C under a weight W the measured matrix is (C⁻¹ + W⁻¹)⁻¹.

use super::filter::Peak;
use super::image_model::{PIXEL_VARIANCE, Shape};
use super::trail::Trail;
use crate::parallel;
use crate::statistics::{mad_sigma, median};

/// Below this σ along the short axis it is a lone pixel, or a cosmic ray, px.
const SHARPEST_PX: f64 = 0.38;
const WIDEST_PX: f64 = 12.0;
/// Peaks looked at, brightest first.
const MAX_PEAKS: usize = 80;
const MIN_SNR: f64 = 15.0;
/// An image is round unless its axes differ by more than this.
const ROUND_RATIO: f64 = 1.15;

/// The typical shape, and how many stars tell it.
pub(super) struct Typical {
    pub(super) shape: Shape,
    pub(super) stars: usize,
    /// Scatter of the stars' widths over the typical one.
    pub(super) spread: f64,
    /// The middle itself, where it is elongated by more than chance makes.
    pub(super) elongated: Option<Shape>,
}

/// The middle of shapes; round unless they say otherwise. `None` of none.
pub(super) fn middle(shapes: &[Shape]) -> Option<Typical> {
    let widths: Vec<f64> = shapes.iter().map(|s| s.sigma_px()).collect();
    if shapes.iter().any(|s| s.trail) {
        let shape = Trail::middle(&shapes.iter().map(|s| Trail::of(*s)).collect::<Vec<_>>())?.shape();
        return Some(Typical { shape, stars: shapes.len(), spread: mad_sigma(&widths)? / shape.sigma_px(), elongated: Some(shape) });
    }
    let middle = |pick: fn(&Shape) -> f64| median(&shapes.iter().map(pick).collect::<Vec<_>>());
    let shape = Shape::ellipse(middle(|s| s.xx)?, middle(|s| s.xy)?, middle(|s| s.yy)?);
    let (long, short) = shape.axes_px();
    let round = shapes.len() < 3 || long < ROUND_RATIO * short;
    let spread = mad_sigma(&widths)? / shape.sigma_px();
    Some(Typical {
        shape: if round { Shape::round(shape.sigma_px()) } else { shape },
        stars: shapes.len(),
        spread,
        elongated: is_elongated(shapes).then_some(shape),
    })
}

/// Whether shapes lie to one side of round ones by more than chance makes.
fn is_elongated(shapes: &[Shape]) -> bool {
    /// In σ of the middle; such a one costs more fits, which decide.
    const CLEARLY: f64 = 5.0;
    const MIN_PEAKS: usize = 3;
    let clear = |pick: fn(&Shape) -> f64| {
        let values: Vec<f64> = shapes.iter().map(pick).collect();
        let scatter = mad_sigma(&values).unwrap_or(f64::INFINITY) / (values.len() as f64).sqrt();
        median(&values).is_some_and(|middle| middle.abs() > CLEARLY * 1.25 * scatter)
    };
    shapes.len() >= MIN_PEAKS && (clear(|s| (s.xx - s.yy) / (s.xx + s.yy)) || clear(|s| 2.0 * s.xy / (s.xx + s.yy)))
}

/// Measures the typical shape; `None` where no bright star is.
pub(super) fn typical(residual: &[f32], width: usize, unusable: &[bool], peaks: &[Peak]) -> Option<Typical> {
    let bright: Vec<&Peak> = peaks.iter().filter(|p| p.snr > MIN_SNR).collect();
    // the very brightest may be saturated or galaxies of their own; a share of the list, spread over it, tells the rule
    let step = (bright.len() / MAX_PEAKS).clamp(1, 4);
    let chosen: Vec<&Peak> = bright.into_iter().step_by(step).take(2 * MAX_PEAKS).collect();
    let shapes: Vec<Shape> = parallel::map(&chosen, |p| adaptive_moments(residual, width, unusable, p, WIDEST_PX))
        .into_iter()
        .flatten()
        .filter(|s| s.axes_px().1 > SHARPEST_PX)
        .collect();
    middle(&shapes)
}

/// What the surroundings of all peaks together are drawn out to: where noise breaks faint trails into peaks, these lie anywhere along them, and
/// the sum of their surroundings is the trail with itself laid over, its variance along the line twice as large. `None` where it is round.
pub(super) fn drawn_out(normalised: &[f32], width: usize, peaks: &[Peak]) -> Option<Trail> {
    const MIN_PEAKS: usize = 8;
    const MAX_SUMMED: usize = 200;
    /// Half the side of what is summed, and σ of the longest sum that is seen in it.
    const REACH: usize = 90;
    const LONGEST_PX: f64 = 42.0;
    /// No star shall outshine the others.
    const CUT: f32 = 5.0;
    /// Less drawn out than this, over the width, stars are found by their round filter.
    const MIN_ELONGATION: f64 = 3.0;
    let height = normalised.len() / width;
    let inside = |p: &&Peak| p.x >= REACH && p.y >= REACH && p.x + REACH < width && p.y + REACH < height;
    let chosen: Vec<&Peak> = peaks.iter().filter(inside).take(MAX_SUMMED).collect();
    if chosen.len() < MIN_PEAKS {
        return None;
    }
    let side = 2 * REACH + 1;
    let mut sum = vec![0.0_f32; side * side];
    for p in chosen {
        for (row, target) in sum.chunks_exact_mut(side).enumerate() {
            let from = (p.y + row - REACH) * width + p.x - REACH;
            for (t, v) in target.iter_mut().zip(&normalised[from..from + side]) {
                *t += v.clamp(-CUT, CUT);
            }
        }
    }
    // it looks the same from both ends but for noise
    let both: Vec<f32> = sum.iter().zip(sum.iter().rev()).map(|(a, b)| a + b).collect();
    let moments = adaptive_moments(&both, side, &vec![false; both.len()], &Peak { x: REACH, y: REACH, snr: f64::INFINITY }, LONGEST_PX)?;
    let of_sum = Trail::of(moments);
    let trail = Trail { along_px: of_sum.along_px.map(|v| v * std::f64::consts::FRAC_1_SQRT_2), ..of_sum };
    (trail.length_px() > MIN_ELONGATION * trail.sigma_px).then_some(trail)
}

/// Shape of one star, the pixel's own width taken off; `None` where the moments do not settle.
fn adaptive_moments(residual: &[f32], width: usize, unusable: &[bool], peak: &Peak, widest_px: f64) -> Option<Shape> {
    let height = residual.len() / width;
    let (mut x, mut y) = (peak.x as f64, peak.y as f64);
    let mut weight = Shape::round(1.5);
    for _ in 0..60 {
        let d = weight.determinant();
        let radius = (3.5 * weight.axes_px().0).ceil().clamp(3.0, 3.0 * widest_px);
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
        let m = Shape::ellipse(sums[3] / sums[0] - mx * mx, sums[4] / sums[0] - mx * my, sums[5] / sums[0] - my * my);
        // under a matched weight the moments are half the matrix; the shift of the centre is half of what is missing
        x += (2.0 * mx).clamp(-1.0, 1.0);
        y += (2.0 * my).clamp(-1.0, 1.0);
        if (x - peak.x as f64).hypot(y - peak.y as f64) > 3.0 + 2.0 * weight.axes_px().0 {
            return None;
        }
        let next = unweighted(m, weight, widest_px)?;
        let change = (next.xx - weight.xx).abs() + (next.xy - weight.xy).abs() + (next.yy - weight.yy).abs();
        if change < 1e-3 * (weight.xx + weight.yy) {
            return Some(Shape::ellipse(next.xx - PIXEL_VARIANCE, next.xy, next.yy - PIXEL_VARIANCE));
        }
        weight = next;
    }
    None
}

/// The image's own matrix from that measured under a weight: (M⁻¹ − W⁻¹)⁻¹, kept within what a next weight may be.
fn unweighted(m: Shape, w: Shape, widest_px: f64) -> Option<Shape> {
    let (dm, dw) = (m.determinant(), w.determinant());
    if dm <= 0.0 || m.xx <= 0.0 {
        return None;
    }
    let i = Shape::ellipse(m.yy / dm - w.yy / dw, -m.xy / dm + w.xy / dw, m.xx / dm - w.xx / dw);
    // at most double a step along each axis, so that a first wrong guess does not run away, nor what is wider than the weight can tell
    let least = (2.0 * w.axes_px().0).powi(-2);
    let (mean, half) = (f64::midpoint(i.xx, i.yy), ((i.xx - i.yy) / 2.0).hypot(i.xy));
    let [short2, long2] = [mean + half, mean - half].map(|inverse| 1.0 / inverse.max(least));
    if long2 > widest_px * widest_px || short2 < 0.01 {
        return None;
    }
    // of the inverse the axis of the larger value is the short one
    let (s, c) = (0.5 * (2.0 * i.xy).atan2(i.xx - i.yy)).sin_cos();
    Some(Shape::ellipse(short2 * c * c + long2 * s * s, (short2 - long2) * s * c, short2 * s * s + long2 * c * c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::image_model::Window;
    use crate::detect::psf::Profile;

    #[test]
    fn moments_return_the_shape_that_was_drawn() {
        for (shape, elliptical) in [(Shape::round(0.7), false), (Shape::round(4.0), false), (Shape::ellipse(16.0, 6.0, 4.0), true)] {
            let mut p = Profile::new();
            p.fill(Window { x0: 0, y0: 0, columns: 80, rows: 80 }, 40.3, 39.8, shape, elliptical);
            let image: Vec<f32> = p.value.iter().map(|v| (1e4 * v) as f32).collect();
            let got = adaptive_moments(&image, 80, &vec![false; 6400], &Peak { x: 40, y: 40, snr: 1e3 }, WIDEST_PX).unwrap();
            for (a, b) in [(got.xx, shape.xx), (got.xy, shape.xy), (got.yy, shape.yy)] {
                // images of a pixel's width depend on where in the pixel they lie
                assert!((a - b).abs() < 0.05 * (shape.xx + shape.yy), "{got:?} for {shape:?}");
            }
        }
    }
}
