//! The fast Fourier transform in two dimensions, radix 2.

use nalgebra::Complex;
use rayon::prelude::*;

/// Transforms a square of `side` × `side` values, row by row, `side` a power of two: Σ value·exp(∓2πi(jx + ky)/side), with + if `inverse`; nothing
/// is divided.
///
/// # Panics
/// If the values are not as many.
pub fn transform(values: &mut [Complex<f64>], side: usize, inverse: bool) {
    assert!(side.is_power_of_two() && values.len() == side * side, "{} values are no square of {side}", values.len());
    let sign = if inverse { 1.0 } else { -1.0 };
    let turn = |k: usize| Complex::from_polar(1.0, sign * std::f64::consts::TAU * k as f64 / side as f64);
    // Those of each pass one after another: every second, fourth, … of the last pass's.
    let passes = side.trailing_zeros();
    let turns: Vec<Complex<f64>> =
        (0..passes).flat_map(|pass| (0..1 << pass).map(move |k: usize| k << (passes - 1 - pass))).map(turn).collect();
    let nothing = Complex::new(0.0, 0.0);
    for _ in 0..2 {
        // A pupil, and the transform of an image that is smooth, leave most rows dark: these stay so.
        values.par_chunks_mut(side).filter(|row| row.iter().any(|value| *value != nothing)).for_each(|row| line(row, &turns));
        transpose(values, side);
    }
}

fn transpose(values: &mut [Complex<f64>], side: usize) {
    const BLOCK: usize = 16;
    for top in (0..side).step_by(BLOCK) {
        for left in (top..side).step_by(BLOCK) {
            for row in top..(top + BLOCK).min(side) {
                for column in left.max(row + 1)..(left + BLOCK).min(side) {
                    values.swap(row * side + column, column * side + row);
                }
            }
        }
    }
}

/// Cooley and Tukey, in place.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn line(values: &mut [Complex<f64>], turns: &[Complex<f64>]) {
    let side = values.len();
    if side < 2 {
        return;
    }
    let shift = usize::BITS - side.trailing_zeros();
    for index in 0..side {
        let mirrored = index.reverse_bits() >> shift;
        if index < mirrored {
            values.swap(index, mirrored);
        }
    }
    let (mut half, mut turns) = (1, turns);
    while half < side {
        let (own, rest) = turns.split_at(half);
        for pair in values.chunks_exact_mut(2 * half) {
            let (low, high) = pair.split_at_mut(half);
            for ((a, b), turn) in low.iter_mut().zip(high).zip(own) {
                let turned = *b * turn;
                (*a, *b) = (*a + turned, *a - turned);
            }
        }
        (half, turns) = (2 * half, rest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the sum itself, and back again.
    #[test]
    fn it_is_the_sum_and_has_an_inverse() {
        const SIDE: usize = 32;
        let before: Vec<_> = (0..SIDE * SIDE).map(|i| Complex::new((i as f64 * 0.37).sin(), (i as f64 * 1.7).cos() * 0.3)).collect();
        let mut after = before.clone();
        transform(&mut after, SIDE, false);
        for (j, k) in [(0, 0), (1, 0), (0, 5), (31, 17), (16, 16)] {
            let mut sum = Complex::new(0.0, 0.0);
            for (i, value) in before.iter().enumerate() {
                let turn = ((i % SIDE) * j + (i / SIDE) * k) as f64 / SIDE as f64;
                sum += value * Complex::from_polar(1.0, -std::f64::consts::TAU * turn);
            }
            assert!((after[k * SIDE + j] - sum).norm() < 1e-10, "{j} {k}");
        }
        transform(&mut after, SIDE, true);
        for (a, b) in after.iter().zip(&before) {
            assert!((a / (SIDE * SIDE) as f64 - b).norm() < 1e-13);
        }
    }
}
