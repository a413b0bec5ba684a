//! # Gaussian point spread, integrated over the pixel
//!
//! ## What it does
//!
//! The image of a star is a round Gaussian, and a pixel collects the light that falls on its square.
//!
//! ## Equation
//!
//! Share of the light in the pixel whose centre lies (dx, dy) from the star: E(dx)·E(dy),
//! E(d) = Φ((d + ½)/σ) − Φ((d − ½)/σ), Φ = the normal distribution function, d and σ in px. Computed from upper tails of |d|, so that the
//! wings keep their relative accuracy, which a difference of erf loses to cancellation. Where σ > 2.5 px that difference loses digits too, and
//! E = hφ(z)·(1 + h²He₂(z)/24 + h⁴He₄(z)/1920 + h⁶He₆(z)/322560), h = 1/σ, z = dh, He = Hermite polynomials, is right to 3e-6 of itself.
//!
//! ## Parameters
//!
//! `sigma_px`: σ in px; FWHM = 2.3548 σ. Each star carries its own.
//!
//! ## Signature
//!
//! Without a point spread there are no stars.
//!
//! ## Confused with
//!
//! Jitter and defocus, which widen it; a wrong σ is seen in the shape and in the residuals of the stamps.
//!
//! ## Neglected
//!
//! Diffraction rings and scattered wings. Light beyond a square of ±reach px: reach = ⌈xσ + ½⌉ with
//! x = √(2 ln(electrons/0.01)), at least 5.5 and at most 8, which loses less than 8e-8 of the light, and less than 0.01 electrons per pixel
//! of the brightest star that a detector holds. f32: the sum of a stamp holds to 1e-6 of the light, its centroid to 2e-6 px.
//!
//! ## Source
//!
//! M. V. Newberry, PASP 103, 122 (1991); the same in SExtractor, DAOPHOT (P. B. Stetson, PASP 99, 191 (1987)).

use crate::effects::ParameterSpec;
use crate::effects::pixel::lanes::vectorised;
use crate::effects::pixel::math::{normal_upper_tail, poly_exp};
use crate::effects::pixel::{Atlas, Psf2d, Psf2dStar, Rows, SeparablePsf, SeparableStar};

/// Gaussian point spread.
#[derive(Clone, Copy, Debug)]
pub struct GaussianPsf;

/// A star is followed until its light falls below this many electrons per pixel.
const FAINTEST_E: f64 = 0.01;

/// Density of the standard normal distribution at 0.
pub(super) const DENSITY_AT_CENTRE: f32 = 0.398_942_3;

/// Below this 1/σ (px⁻¹) the pixel is narrow against the image and the integral is taken as a series about its middle.
const WIDE_BELOW: f32 = 0.4;

/// The share of a Gaussian of width 1/`inverse_sigma` px that falls within ±½ px around `d` px from its centre.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
#[must_use]
pub(super) fn pixel_share(d: f32, inverse_sigma: f32) -> f32 {
    let near = (d.abs() - 0.5) * inverse_sigma;
    let far = (d.abs() + 0.5) * inverse_sigma;
    let tail_near = normal_upper_tail(near.abs());
    let tail_far = normal_upper_tail(far);
    let narrow = if near > 0.0 { tail_near - tail_far } else { 1.0 - tail_near - tail_far };
    if inverse_sigma < WIDE_BELOW { wide_share(d, inverse_sigma) } else { narrow }
}

/// The same as a series about the middle of the pixel.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
#[must_use]
fn wide_share(d: f32, inverse_sigma: f32) -> f32 {
    let h = inverse_sigma;
    // z² is bounded so that the exponential does not run out of its range; where it is, the share is nothing or the series is not used.
    let z2 = if d * h * (d * h) < 150.0 { d * h * (d * h) } else { 150.0 };
    let h2 = h * h;
    let hermite_2 = z2 - 1.0;
    let hermite_4 = (z2 - 6.0) * z2 + 3.0;
    let hermite_6 = ((z2 - 15.0) * z2 + 45.0) * z2 - 15.0;
    let correction = 1.0 + h2 * (hermite_2 * (1.0 / 24.0) + h2 * (hermite_4 * (1.0 / 1920.0) + h2 * hermite_6 * (1.0 / 322_560.0)));
    h * DENSITY_AT_CENTRE * poly_exp(-0.5 * z2) * correction
}

/// Fills `shares` with the light, times `scale`, of pixels of which the first lies `first_px` (a whole number) from the star's own pixel. `tails`
/// is as long and one longer.
///
/// Neighbours share the value at their common edge, so the sum over a profile is 1 but for its ends.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
fn profile(first_px: f32, fraction_px: f32, inverse_sigma: f32, scale: f32, shares: &mut [f32], tails: &mut [f32]) {
    if inverse_sigma < WIDE_BELOW {
        for (i, share) in (0_i32..).zip(shares) {
            *share = scale * wide_share((first_px + i as f32) - fraction_px, inverse_sigma);
        }
        return;
    }
    let edge = |i: i32| ((first_px + (i as f32 - 0.5)) - fraction_px) * inverse_sigma;
    for (i, tail) in (0_i32..).zip(&mut *tails) {
        *tail = normal_upper_tail(edge(i).abs());
    }
    for (i, (share, (left, right))) in (0_i32..).zip(shares.iter_mut().zip(tails.iter().zip(&tails[1..]))) {
        // Where the star's own place lies between the edges the tails lie on both sides.
        let across = if edge(i) * edge(i + 1) < 0.0 { 1.0 - left - right } else { (left - right).abs() };
        *share = scale * across;
    }
}

vectorised! {
    /// The twin: adds `star` to the rows, as the product of its two profiles.
    #[allow(clippy::cast_possible_wrap, reason = "the sides of a frame are at most 65 535 px")]
    fn gaussian_psf(star: &SeparableStar, rows: &mut Rows<'_>) {
        let clip = |middle: i32, first: i64, count: usize| {
            let (low, high) = (i64::from(middle) - i64::from(star.reach) - first, i64::from(middle) + i64::from(star.reach) - first);
            (low.clamp(0, count as i64) as usize, (high + 1).clamp(0, count as i64) as usize)
        };
        let (left, right) = clip(star.column, 0, rows.width);
        let (top, bottom) = clip(star.row, rows.first_row as i64, rows.electrons.len() / rows.width.max(1));
        if left >= right || top >= bottom {
            return;
        }
        let (columns, lines) = (right - left, bottom - top);
        rows.scratch.resize(columns + lines + columns.max(lines) + 1, 0.0);
        let (along_columns, rest) = rows.scratch.split_at_mut(columns);
        let (along_rows, tails) = rest.split_at_mut(lines);
        let first_x = (left as i64 - i64::from(star.column)) as f32;
        let first_y = ((rows.first_row + top) as i64 - i64::from(star.row)) as f32;
        profile(first_x, star.fraction_x, star.inverse_sigma, star.electrons, along_columns, &mut tails[..=columns]);
        profile(first_y, star.fraction_y, star.inverse_sigma, 1.0, along_rows, &mut tails[..=lines]);
        for (row, share_y) in (top..bottom).zip(&*along_rows) {
            let line = &mut rows.electrons[row * rows.width + left..row * rows.width + right];
            for (pixel, electrons_x) in line.iter_mut().zip(&*along_columns) {
                *pixel += electrons_x * share_y;
            }
        }
    }
}

impl SeparablePsf for GaussianPsf {
    fn id(&self) -> &'static str {
        "gaussian_psf"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        &[ParameterSpec { name: "sigma_px", unit: "px", typical: 1.0, range: (0.05, 50.0) }]
    }
    fn wgsl(&self) -> &'static str {
        include_str!("../../../shaders/gaussian_psf.wgsl")
    }
    fn source(&self) -> &'static str {
        page_source!("gaussian_psf.rs")
    }
    fn reach(&self, electrons: f64, sigma_px: f64) -> i32 {
        let sigmas = (2.0 * (electrons / FAINTEST_E).max(1.0).ln()).sqrt().clamp(5.5, 8.0);
        (sigmas * sigma_px + 0.5).ceil() as i32
    }
    fn add(&self, star: &SeparableStar, rows: &mut Rows<'_>) {
        gaussian_psf(star, rows);
    }
}

/// The same light row by row, where each row has the star at another place.
impl Psf2d for GaussianPsf {
    fn id(&self) -> &'static str {
        "gaussian_psf"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        SeparablePsf::parameters(self)
    }
    fn wgsl(&self) -> &'static str {
        SeparablePsf::wgsl(self)
    }
    fn wgsl_share(&self) -> &'static str {
        "gaussian_psf(star, dx) * gaussian_psf(star, dy)"
    }
    fn loop_iterations(&self) -> u32 {
        1
    }
    fn source(&self) -> &'static str {
        SeparablePsf::source(self)
    }
    fn add_plane(&self, star: &Psf2dStar, _: &Atlas, rows: &mut Rows<'_>) {
        star.for_each_row(rows, |dy, first_dx, pixels, _| {
            let electrons = star.electrons * pixel_share(dy, star.inverse_sigma);
            for (i, pixel) in pixels.iter_mut().enumerate() {
                *pixel += electrons * pixel_share(first_dx + i as f32, star.inverse_sigma);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::function::erf::{erf, erfc};

    /// A profile is the shares of its pixels, and its sum is 1.
    #[test]
    fn a_profile_is_its_pixels() {
        for (sigma, fraction) in [(0.05_f32, 0.49), (0.3, -0.5), (1.2, 0.0), (1.2, 0.123), (2.6, -0.3), (9.0, 0.5)] {
            let reach = (8.0 * sigma + 0.5).ceil();
            let (mut shares, mut tails) = (vec![0.0; 2 * reach as usize + 1], vec![0.0; 2 * reach as usize + 2]);
            profile(-reach, fraction, 1.0 / sigma, 2.0, &mut shares, &mut tails);
            for (i, share) in shares.iter().enumerate() {
                let alone = 2.0 * pixel_share((i as f32 - reach) - fraction, 1.0 / sigma);
                assert!((share - alone).abs() < 2e-6, "σ {sigma}, pixel {i}: {share} for {alone}");
            }
            let sum: f64 = shares.iter().map(|share| f64::from(*share)).sum();
            assert!((0.5 * sum - 1.0).abs() < 3e-7, "σ {sigma}: {sum}");
        }
    }

    /// Against f64 over widths and distances: to 3e-7 of the light, to 3e-6 of the share in the core and 3e-5 in the wings.
    #[test]
    fn share_agrees_with_f64() {
        let root = std::f64::consts::FRAC_1_SQRT_2;
        for sigma in [0.05_f64, 0.3, 0.5, 1.0, 1.7, 2.45, 2.55, 5.0, 50.0] {
            for step in 0..4000_u16 {
                let d = f64::from((f64::from(step) * 0.002 * sigma) as f32);
                let inverse = f64::from((1.0 / sigma) as f32);
                let (a, b) = ((d - 0.5) * inverse, (d + 0.5) * inverse);
                let exact = if a > 0.3 { 0.5 * (erfc(a * root) - erfc(b * root)) } else { 0.5 * (erf(b * root) - erf(a * root)) };
                let error = (f64::from(pixel_share(d as f32, inverse as f32)) - exact).abs();
                let limit = if a < 3.0 { 3e-6 * exact + 5e-8 } else { 3e-5 * exact + 1e-13 };
                assert!(error < limit.min(3e-7), "σ {sigma}, d {d}: off by {error:.1e} of {exact:.1e}");
            }
        }
    }

    #[test]
    fn reach_grows_with_brightness_and_is_bounded() {
        assert_eq!(GaussianPsf.reach(0.0, 1.0), 6);
        assert_eq!(GaussianPsf.reach(1e7, 1.0), 7);
        assert_eq!(GaussianPsf.reach(1e300, 1.0), 9);
        assert!(GaussianPsf.reach(1e5, 2.0) > GaussianPsf.reach(1e5, 1.0));
    }
}
