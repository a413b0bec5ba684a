//! # Point spread of an aberrated wavefront
//!
//! ## What it does
//!
//! Diffraction by a round pupil, obstructed or not, whose wavefront is bent: defocus, astigmatism, coma, trefoil, spherical
//! aberration and higher terms.
//!
//! ## Equation
//!
//! p(x) ∝ |∫ P(u)·exp(2πi[W(u) − x·u/λN]) d²u|², P = the pupil (diameter 1), W = Σ zⱼ·Zⱼ(2u) in waves, Zⱼ = Zernike's polynomials in
//! Noll's order, of variance 1 over the full disc: Z₄ defocus, Z₅ and Z₆ astigmatism, Z₇ and Z₈ coma along y and x, Z₉ and Z₁₀ trefoil, Z₁₁
//! spherical aberration, and on to Z₂₂. Axes of the pupil are those of the frame, x right and y down. The star's place is the centre of its
//! light, so that coma changes the shape and not the place.
//!
//! ## Parameters
//!
//! `lambda_n_px`: λN, wavelength times focal ratio, px. `obstruction`: diameter of the obstruction over the pupil's.
//! `z4_waves`, `z5_waves`, `z6_waves`, `z7_waves`, `z8_waves`, `z9_waves`, `z10_waves`, `z11_waves`, `z12_waves`, `z13_waves`, `z14_waves`,
//! `z15_waves`, `z16_waves`, `z17_waves`, `z18_waves`, `z19_waves`, `z20_waves`, `z21_waves`, `z22_waves`: z₄ … z₂₂, rms waves.
//!
//! ## Signature
//!
//! Residuals of the stamps that follow the field and the focus; through windows, thresholds and weights also
//! shifts of the measured centres.
//!
//! ## Confused with
//!
//! Motion smear (astigmatism), charge transfer (coma along one axis), a wider Gaussian (defocus).
//!
//! ## Neglected
//!
//! The pupil is a grid of 85 cells or more across, with cells of the edge in part. Polarisation, width of the passband, changes of
//! the pupil over the field. Light beyond the reach.
//!
//! ## Source
//!
//! R. J. Noll, J. Opt. Soc. Am. 66, 207 (1976); J. W. Goodman, Introduction to Fourier Optics, ch. 6.

use nalgebra::Complex;
use rayon::prelude::*;

use super::tables::{Grid, ImageKind, transform, usual_reach_px};
use crate::effects::ParameterSpec;

/// Point spread of an aberrated wavefront.
#[derive(Clone, Copy, Debug)]
pub struct ZernikePsf;

/// Points along the side of the grid of the pupil.
const PUPIL_SIDE: usize = 1024;

/// Parameters before the first coefficient, which is that of Z₄.
const BEFORE: usize = 2;

const fn term(name: &'static str, typical: f64) -> ParameterSpec {
    ParameterSpec { name, unit: "", typical, range: (-3.0, 3.0) }
}

/// λN, the obstruction, and the coefficients from Z₄ on.
static SPECS: &[ParameterSpec] = &[
    ParameterSpec { name: "lambda_n_px", unit: "px", typical: 1.5, range: (0.3, 6.0) },
    ParameterSpec { name: "obstruction", unit: "", typical: 0.0, range: (0.0, 0.9) },
    term("z4_waves", 0.1),
    term("z5_waves", 0.0),
    term("z6_waves", 0.0),
    term("z7_waves", 0.0),
    term("z8_waves", 0.05),
    term("z9_waves", 0.0),
    term("z10_waves", 0.0),
    term("z11_waves", 0.0),
    term("z12_waves", 0.0),
    term("z13_waves", 0.0),
    term("z14_waves", 0.0),
    term("z15_waves", 0.0),
    term("z16_waves", 0.0),
    term("z17_waves", 0.0),
    term("z18_waves", 0.0),
    term("z19_waves", 0.0),
    term("z20_waves", 0.0),
    term("z21_waves", 0.0),
    term("z22_waves", 0.0),
];

#[allow(clippy::cast_possible_wrap, reason = "numbers up to 22")]
/// Radial order n and azimuthal order m (below 0: sine) of Noll's j-th polynomial.
fn orders(j: usize) -> (i32, i32) {
    let (mut n, mut before) = (0_i32, 0_usize);
    while before + n as usize + 1 < j {
        before += n as usize + 1;
        n += 1;
    }
    let place = (j - before - 1) as i32;
    let size = if n % 2 == 0 { 2 * ((place + 1) / 2) } else { 2 * (place / 2) + 1 };
    (n, if j.is_multiple_of(2) { size } else { -size })
}

/// Noll's j-th polynomial at the point (x, y) of the unit disc.
fn zernike(j: usize, x: f64, y: f64) -> f64 {
    let (n, m) = orders(j);
    let (radius, azimuth) = (x.hypot(y), y.atan2(x));
    let size = m.abs();
    let factorial = |k: i32| (1..=k).map(f64::from).product::<f64>();
    let radial: f64 = (0..=(n - size) / 2)
        .map(|k| {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            sign * factorial(n - k) / (factorial(k) * factorial(i32::midpoint(n, size) - k) * factorial((n - size) / 2 - k))
                * radius.powi(n - 2 * k)
        })
        .sum();
    let norm = f64::from(n + 1).sqrt();
    match m {
        0 => norm * radial,
        1.. => norm * std::f64::consts::SQRT_2 * radial * (f64::from(m) * azimuth).cos(),
        _ => norm * std::f64::consts::SQRT_2 * radial * (f64::from(size) * azimuth).sin(),
    }
}

/// Share of a cell of width `cell` (diameters) around (x, y) that lies in the pupil.
fn coverage(x: f64, y: f64, cell: f64, obstruction: f64) -> f64 {
    const FINE: i32 = 8;
    let open = |r: f64| (0.5 * obstruction..=0.5).contains(&r);
    let (r, slack) = (x.hypot(y), 0.75 * cell);
    if r > 0.5 + slack || r + slack < 0.5 * obstruction {
        return 0.0;
    }
    if r + slack < 0.5 && (obstruction == 0.0 || r > 0.5 * obstruction + slack) {
        return 1.0;
    }
    let at = |middle: f64, step: i32| middle + cell * ((f64::from(step) + 0.5) / f64::from(FINE) - 0.5);
    let hits = (0..FINE * FINE).filter(|k| open(at(x, k % FINE).hypot(at(y, k / FINE)))).count();
    hits as f64 / f64::from(FINE * FINE)
}

impl ImageKind for ZernikePsf {
    fn id(&self) -> &'static str {
        "zernike"
    }
    fn parameters(&self) -> &'static [ParameterSpec] {
        SPECS
    }
    fn smooth_px(&self, parameters: &[f64]) -> f64 {
        0.42 * parameters[0]
    }
    fn reach_px(&self, parameters: &[f64]) -> usize {
        usual_reach_px(self.smooth_px(parameters))
    }
    #[allow(clippy::cast_possible_wrap, reason = "grids are small")]
    fn transfer(&self, parameters: &[f64], grid: &Grid) -> Vec<Complex<f64>> {
        let (lambda_n_px, obstruction) = (parameters[0], parameters[1]);
        let terms: Vec<(usize, f64)> =
            parameters[BEFORE..].iter().enumerate().filter(|(_, waves)| **waves != 0.0).map(|(k, waves)| (k + 4, *waves)).collect();
        // The light has no frequency above 1/λN: points twice as dense hold all of it, and reach far out, so that little is folded back.
        let mut coarser = 1;
        while grid.oversampling.is_multiple_of(2 * coarser) && (grid.oversampling / (2 * coarser)) as f64 * lambda_n_px >= 2.2 {
            coarser *= 2;
        }
        let far = Grid { side: PUPIL_SIDE, oversampling: grid.oversampling / coarser };
        // The transform of cells so wide has its values at these points.
        let cell = far.oversampling as f64 * lambda_n_px / far.side as f64;
        let place = |index: usize| far.place_px(index) * far.oversampling as f64 * cell;
        let mut field: Vec<Complex<f64>> = (0..far.side * far.side)
            .into_par_iter()
            .map(|i| {
                let (x, y) = (place(i % far.side), place(i / far.side));
                let open = coverage(x, y, cell, obstruction);
                if open == 0.0 {
                    return Complex::new(0.0, 0.0);
                }
                let waves: f64 = terms.iter().map(|(j, waves)| waves * zernike(*j, 2.0 * x, 2.0 * y)).sum();
                Complex::from_polar(open, std::f64::consts::TAU * waves)
            })
            .collect();
        // Light goes by the area that is open. (A sum over these points lacks what falls beyond them.)
        let total = field.iter().map(|value| value.norm()).sum::<f64>() * (far.side * far.side) as f64;
        transform(&mut field, far.side, false);
        let index = |offset: i64| offset.rem_euclid(far.side as i64) as usize;
        grid.transfer_of_samples(coarser, |x, y| field[index(y) * far.side + index(x)].norm_sqr() / total)
    }
    fn source(&self) -> &'static str {
        page_source!("zernike_psf.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noll's table: orders of the first polynomials.
    #[test]
    fn the_order_is_nolls() {
        let expected = [
            (1, (0, 0)),
            (2, (1, 1)),
            (3, (1, -1)),
            (4, (2, 0)),
            (5, (2, -2)),
            (6, (2, 2)),
            (7, (3, -1)),
            (8, (3, 1)),
            (9, (3, -3)),
            (10, (3, 3)),
            (11, (4, 0)),
            (12, (4, 2)),
            (13, (4, -2)),
            (14, (4, 4)),
            (15, (4, -4)),
            (16, (5, 1)),
            (22, (6, 0)),
        ];
        for (j, order) in expected {
            assert_eq!(orders(j), order, "Z{j}");
        }
    }

    /// Variance 1 and no overlap over the disc, by a dense sum; and the closed forms of three of them.
    #[test]
    fn polynomials_are_orthonormal() {
        const STEPS: i32 = 400;
        let points: Vec<(f64, f64)> = (0..STEPS * STEPS)
            .map(|i| {
                let at = |k: i32| 2.0 * (f64::from(k) + 0.5) / f64::from(STEPS) - 1.0;
                (at(i % STEPS), at(i / STEPS))
            })
            .filter(|(x, y)| x.hypot(*y) <= 1.0)
            .collect();
        for (a, b) in [(4, 4), (8, 8), (11, 11), (22, 22), (4, 11), (5, 6), (8, 16), (7, 9)] {
            let mean = points.iter().map(|(x, y)| zernike(a, *x, *y) * zernike(b, *x, *y)).sum::<f64>() / points.len() as f64;
            assert!((mean - f64::from(u8::from(a == b))).abs() < 5e-3, "Z{a}·Z{b}: {mean}");
        }
        let (x, y) = (0.3_f64, -0.5_f64);
        let r2 = x * x + y * y;
        for (j, exact) in
            [(4, 3.0_f64.sqrt() * (2.0 * r2 - 1.0)), (5, 6.0_f64.sqrt() * 2.0 * x * y), (8, 8.0_f64.sqrt() * (3.0 * r2 - 2.0) * x)]
        {
            assert!((zernike(j, x, y) - exact).abs() < 1e-14, "Z{j}");
        }
    }
}
