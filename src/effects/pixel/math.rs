//! Elementary functions as polynomials, the same lines as `shaders/lib/math.wgsl`.
//!
//! Built-in functions differ between GPUs, drivers and libraries of C; these do not, but for fused operations that a driver may choose.
//! They have no branch, so loops over pixels vectorise. The polynomials of ln, exp, sin and cos are the single-precision ones of the
//! Cephes library (S. L. Moshier). Worst errors, tested below against f64: ln 2e-7 relative or absolute, exp 2e-7 relative, cos 2e-7.
#![allow(clippy::excessive_precision, clippy::unreadable_literal, reason = "coefficients stand as published")]
#![allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]

/// Natural logarithm of a normal positive number.
#[inline(always)]
#[must_use]
pub fn poly_ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let m0 = f32::from_bits((bits & 0x007f_ffff) | 0x3f00_0000); // in [1/2, 1)
    let small = m0 < std::f32::consts::FRAC_1_SQRT_2;
    let m = if small { m0 + m0 - 1.0 } else { m0 - 1.0 };
    let e = (bits >> 23).cast_signed().wrapping_sub(126) as f32 - if small { 1.0 } else { 0.0 };
    let z = m * m;
    let mut p = 7.0376836292e-2;
    p = p * m - 1.1514610310e-1;
    p = p * m + 1.1676998740e-1;
    p = p * m - 1.2420140846e-1;
    p = p * m + 1.4249322787e-1;
    p = p * m - 1.6668057665e-1;
    p = p * m + 2.0000714765e-1;
    p = p * m - 2.4999993993e-1;
    p = p * m + 3.3333331174e-1;
    let y = p * m * z - 2.12194440e-4 * e - 0.5 * z;
    m + y + 0.693359375 * e
}

/// Exponential of a number in [−87, 0].
#[inline(always)]
#[must_use]
pub fn poly_exp(x: f32) -> f32 {
    // The shader converts to an integer here; Rust's own conversion is checked and does not vectorise.
    let shifted = x * std::f32::consts::LOG2_E + ROUNDER;
    let n = shifted - ROUNDER; // the nearest integer
    let r = x - n * 0.693359375 + n * 2.12194440e-4;
    let mut p = 1.9875691500e-4;
    p = p * r + 1.3981999507e-3;
    p = p * r + 8.3334519073e-3;
    p = p * r + 4.1665795894e-2;
    p = p * r + 1.6666665459e-1;
    p = p * r + 5.0000001201e-1;
    (p * (r * r) + r + 1.0) * f32::from_bits(shifted.to_bits().wrapping_sub(ROUNDER.to_bits()).wrapping_add(127) << 23)
}

/// Cosine and sine of an angle given as a part of a turn in units of 2⁻³²: the reduction to an octant is exact.
#[inline(always)]
#[must_use]
pub fn cos_sin_turn(turn: u32) -> [f32; 2] {
    let quadrant = turn.wrapping_add(0x2000_0000) >> 30;
    let x = turn.wrapping_sub(quadrant << 30).cast_signed() as f32 * 1.46291807926715968e-9; // (π/2) / 2³⁰; in [−π/4, π/4]
    let z = x * x;
    let sine = ((-1.9515295891e-4 * z + 8.3321608736e-3) * z - 1.6666654611e-1) * z * x + x;
    let cosine = ((2.443315711809948e-5 * z - 1.388731625493765e-3) * z + 4.166664568298827e-2) * (z * z) - 0.5 * z + 1.0;
    let [size_of_cosine, size_of_sine] = if quadrant & 1 == 1 { [sine, cosine] } else { [cosine, sine] };
    // Signs are bits: the cosine's in the quadrants 1 and 2, the sine's in 2 and 3.
    let signed = |size: f32, quadrant: u32| f32::from_bits(size.to_bits() ^ ((quadrant & 2) << 30));
    [signed(size_of_cosine, quadrant.wrapping_add(1)), signed(size_of_sine, quadrant)]
}

/// The cosine alone.
#[inline(always)]
#[must_use]
pub fn cos_turn(turn: u32) -> f32 {
    cos_sin_turn(turn)[0]
}

/// A word as a number in (0, 1], fine near 0.
#[inline(always)]
#[must_use]
pub fn unit_interval(word: u32) -> f32 {
    ((word >> 1).cast_signed() as f32 + 0.5) * 4.656612873077393e-10
}

/// Two independent standard normal numbers from two words (Box and Muller 1958). Their largest size is 6.7.
#[inline(always)]
#[must_use]
pub fn normal_pair(radius_word: u32, angle_word: u32) -> [f32; 2] {
    let radius = (-2.0 * poly_ln(unit_interval(radius_word))).sqrt();
    cos_sin_turn(angle_word).map(|share| radius * share)
}

/// A standard normal number from two words: the first of [`normal_pair`].
#[inline(always)]
#[must_use]
pub fn standard_normal(radius_word: u32, angle_word: u32) -> f32 {
    normal_pair(radius_word, angle_word)[0]
}

/// Probability that a standard normal number exceeds `x` ≥ 0.
///
/// exp(−x²/2) times a polynomial in 1/(1 + 0.26 x) fitted to Mills' ratio on 0 ≤ x ≤ 14 (largest relative error of the fit 6.4e-8); in
/// f32 it holds to 2e-6 of itself up to x = 8. Beyond 12 (2e-33) it stays: what follows soon is denormal, and products with it are, and processors
/// are many times slower with such numbers.
#[inline(always)]
#[must_use]
pub fn normal_upper_tail(x: f32) -> f32 {
    let x = if x < 12.0 { x } else { 12.0 };
    let t = 1.0 / (1.0 + 0.26 * x);
    let mut p = 0.0321890587012;
    p = p * t - 0.160858160315;
    p = p * t + 0.267731231854;
    p = p * t - 0.169100441049;
    p = p * t + 0.173176696023;
    p = p * t + 0.045955999474;
    p = p * t + 0.104291784814;
    p = p * t + 0.102844978828;
    p = p * t + 0.103768853929;
    p * t * poly_exp(-0.5 * x * x)
}

/// A number of 2²² or more added to a smaller one leaves an integer in the sum's last bits: 1.5 · 2²³.
const ROUNDER: f32 = 12_582_912.0;

/// The largest integer not above `x`, without a call into the library; exact for |x| < 2²² and for whole numbers, else `x` itself.
#[inline(always)]
#[must_use]
pub fn floor(x: f32) -> f32 {
    let nearest = (x + ROUNDER) - ROUNDER;
    let below = nearest - if nearest > x { 1.0 } else { 0.0 };
    if x.abs() < 4_194_304.0 { below } else { x }
}

/// The nearest whole number; exact for |x| < 2²², else `x` itself.
#[inline(always)]
#[must_use]
pub fn round(x: f32) -> f32 {
    let nearest = (x + ROUNDER) - ROUNDER;
    if x.abs() < 4_194_304.0 { nearest } else { x }
}

/// The largest whole number not above `x` ≥ 0, exact at any size.
#[inline(always)]
#[must_use]
pub fn floor_positive(x: f32) -> f32 {
    const WHOLE_FROM: f32 = 8_388_608.0; // 2²³
    let nearest = (x + WHOLE_FROM) - WHOLE_FROM;
    let below = nearest - if nearest > x { 1.0 } else { 0.0 };
    if x < WHOLE_FROM { below } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::function::erf::erfc;

    #[test]
    fn polynomials_agree_with_f64() {
        let (mut ln, mut exp, mut cos) = (0.0_f64, 0.0_f64, 0.0_f64);
        for i in 0..200_000_u32 {
            let u = unit_interval(i.wrapping_mul(0x9E37_79B9));
            let exact = f64::from(u).ln();
            ln = ln.max((f64::from(poly_ln(u)) - exact).abs() / exact.abs().max(1.0));
            let x = -87.0 * u;
            exp = exp.max((f64::from(poly_exp(x)) / f64::from(x).exp() - 1.0).abs());
            let turn = i.wrapping_mul(0x85EB_CA6B);
            let [c, s] = cos_sin_turn(turn).map(f64::from);
            let (exact_s, exact_c) = (f64::from(turn) * std::f64::consts::TAU / 4_294_967_296.0).sin_cos();
            cos = cos.max((c - exact_c).abs()).max((s - exact_s).abs());
        }
        assert!(ln < 2e-7 && exp < 2e-7 && cos < 2e-7, "ln {ln:.1e}, exp {exp:.1e}, cos {cos:.1e}");
        assert!(unit_interval(0) > 0.0 && unit_interval(u32::MAX) <= 1.0);
    }

    #[test]
    fn upper_tail_agrees_with_f64() {
        let mut worst = 0.0_f64;
        for i in 0..80_000_u32 {
            let x = i as f32 * 1e-4;
            let exact = 0.5 * erfc(f64::from(x) * std::f64::consts::FRAC_1_SQRT_2);
            worst = worst.max((f64::from(normal_upper_tail(x)) / exact - 1.0).abs());
        }
        assert!(worst < 2e-6, "{worst:.1e}");
        let last = normal_upper_tail(1e9);
        assert!((normal_upper_tail(0.0) - 0.5).abs() < 1e-7 && last < 1e-32 && (1e-3 * last).is_normal());
    }

    #[test]
    fn floor_is_floor() {
        for x in [-2.5_f32, -2.0, -0.1, 0.0, 0.9, 1.0, 123_456.7] {
            assert_eq!(floor(x), x.floor());
            assert_eq!(round(x + 0.1), (x + 0.1).round());
        }
        for x in [0.0_f32, 0.3, 0.5, 0.999_999_94, 1.5, 2.5, 4_194_305.5, 8_388_607.5, 8_388_609.0, 1e20] {
            assert_eq!(floor_positive(x), x.floor());
        }
    }
}
