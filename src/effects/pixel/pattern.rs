//! Patterns that stay: random numbers of a pixel that are the same in every frame, and the power function. The same lines as
//! `shaders/lib/pattern.wgsl`.
#![allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]

use super::math::{poly_exp, poly_ln};
use crate::rng::StageKey;

/// Set in the number of a draw that stays: no draw of a frame's noise has it.
const STAYS: u32 = 0x8000_0000;

/// Four words for a pixel and a stage that are the same in every frame.
#[inline(always)]
#[must_use]
pub fn fixed_words(key: StageKey, pixel: u32, draw: u32) -> [u32; 4] {
    StageKey { frame: 0, ..key }.words(pixel, draw | STAYS)
}

/// Below which a word lies with this probability.
#[must_use]
pub fn word_limit(probability: f64) -> u32 {
    (probability * 4_294_967_296.0) as u32 // f64 to u32 stops at the ends of its range
}

/// Exponential of a number, held within [−80, 80].
#[inline(always)]
#[must_use]
pub fn exponential(x: f32) -> f32 {
    let x = if x > -80.0 { x } else { -80.0 };
    let x = if x < 80.0 { x } else { 80.0 };
    let below = poly_exp(if x > 0.0 { -x } else { x });
    if x > 0.0 { 1.0 / below } else { below }
}

/// A number to a power; 0 for what is not positive. The exponent times the logarithm is held within [−80, 80].
#[inline(always)]
#[must_use]
pub fn power(x: f32, exponent: f32) -> f32 {
    let positive = if x > 1e-30 { x } else { 1e-30 };
    let value = exponential(exponent * poly_ln(positive));
    if x > 1e-30 { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_agree_with_f64() {
        let mut worst = 0.0_f64;
        for i in 0..20_000 {
            let (x, exponent) = (10.0_f32.powf(-9.0 + 18.0 * (i as f32 / 20_000.0)), (i % 23) as f32 * 0.1 - 1.1);
            let exact = f64::from(x).powf(f64::from(exponent));
            worst = worst.max((f64::from(power(x, exponent)) / exact - 1.0).abs());
            let y = (i as f32 - 10_000.0) * 7e-3;
            worst = worst.max((f64::from(exponential(y)) / f64::from(y).exp() - 1.0).abs());
        }
        assert!(worst < 4e-6, "{worst:.1e}"); // the rounding of an exponent of 20 alone is 1e-6
        assert_eq!(power(0.0, 0.5), 0.0);
        assert_eq!(power(-3.0, 0.5), 0.0);
        assert_eq!(power(1.0, 0.7), 1.0);
    }

    #[test]
    fn what_stays_does_not_follow_the_frame_and_is_no_noise() {
        let key = |frame| StageKey { seed: 3, frame, stage: 4 };
        assert_eq!(fixed_words(key(0), 9, 0), fixed_words(key(77), 9, 0));
        assert_ne!(fixed_words(key(0), 9, 0), key(0).words(9, 0));
        assert_ne!(fixed_words(key(0), 9, 0), fixed_words(key(0), 9, 1));
    }
}
