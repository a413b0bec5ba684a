//! Poisson numbers by inversion, a block of pixels at once; the equations and their sources stand on the page of photon noise.

use super::lanes::BLOCK_PX;
use super::math::{floor_positive, normal_upper_tail, poly_exp, round};

/// Expected electrons from which on the expansion of z is used instead of sums of probabilities.
pub(crate) const EXPANSION_FROM_E: f32 = 12.0;

/// Bits from which half of those of a number are taken for the reciprocal of its root (Lomont 2003, Fast inverse square root).
const ROUGH_INVERSE_ROOT: u32 = 0x5f37_59df;

/// Pixels that are worked out by z together where one of them has to be.
const LANES: usize = 8;

/// a, c₁, c₂ and c₃ of the page as polynomials of t, the constant first.
#[allow(clippy::approx_constant, clippy::excessive_precision, clippy::unreadable_literal, reason = "as fitted")]
mod coefficients {
    pub(super) const A: [f32; 9] =
        [1.41421356, -0.235699955, 0.216110651, -0.105653824, 0.105470141, -0.0598661338, 0.0817357317, -0.108672987, 0.0872841137];
    pub(super) const C1: [f32; 9] =
        [0.471404521, 0.15714833, 0.108217197, 0.0755815762, 0.0436860547, 0.145396395, 0.174959931, -0.838543406, 0.920841109];
    pub(super) const C2: [f32; 5] = [0.0227193453, 0.0517626576, 0.0556984971, 0.0480907339, 0.207448841];
    pub(super) const C3: [f32; 3] = [-0.0217364629, -0.0350709349, -0.154754407];
}

#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn polynomial<const N: usize>(coefficients: [f32; N], t: f32) -> f32 {
    let mut sum = coefficients[N - 1];
    for i in 1..N {
        sum = sum * t + coefficients[N - 1 - i];
    }
    sum
}

/// The Poisson number of expectation `lambda` ≥ [`EXPANSION_FROM_E`] at the quantile of a standard normal number.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn poisson_quantile(lambda: f32, w: f32) -> f32 {
    let whole = floor_positive(lambda);
    let part = lambda - whole;
    let root = lambda.sqrt();
    let w2 = w * w + 2.0;
    // 1/√λ from the bits, to 4 %: m may be off by half, and a division is dear.
    let inverse_root = f32::from_bits(ROUGH_INVERSE_ROOT.wrapping_sub(lambda.to_bits() >> 1));
    let near = whole + round(part + root * w + w2 * (1.0 / 6.0 - (1.0 / 72.0) * w * inverse_root));
    let m = if near > 1.0 { near } else { 1.0 };
    // Whole numbers first: their difference is exact.
    let difference = (whole - m) + part;
    let scale = 1.0 / (lambda + m).sqrt();
    let inverse = scale * scale;
    let t = difference * inverse;
    let c = polynomial(coefficients::C1, t) + inverse * (polynomial(coefficients::C2, t) + inverse * polynomial(coefficients::C3, t));
    let z = scale * (difference * polynomial(coefficients::A, t) + c);
    if w + z >= 0.0 { m } else { m - 1.0 }
}

/// The first survival P(K > 0) = 1 − e^(−λ); a series where the difference would lose digits. λ ≤ 12.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn first_survival(lambda: f32, zero: f32) -> f32 {
    let l = lambda;
    let series = l * (1.0 - l * 0.5 * (1.0 - l * (1.0 / 3.0) * (1.0 - l * 0.25 * (1.0 - l * 0.2))));
    if l < 0.1 { series } else { 1.0 - zero }
}

/// What [`poisson_quantile`] gives, from the expansion of the quantile alone, and whether that may err: it lies near a whole number, or far out.
///
/// What the expansion leaves out is below 0.81 λ^(−3/2) for |w| ≤ 3.2 and λ ≥ 12, by the incomplete gamma function; the bound has more, for rounding.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
#[allow(clippy::needless_bitwise_bool, reason = "a lazy `and` is a branch, and the loop would not vectorise")]
fn quick_quantile(lambda: f32, w: f32) -> (f32, bool) {
    /// The square of the largest |w|.
    const MAX_W2: f32 = 3.2 * 3.2;
    /// Expected electrons from which on the rounding of f32 is too coarse for it.
    const MAX_E: f32 = 1e6;
    let whole = floor_positive(lambda);
    let root = lambda.sqrt();
    // One step of Newton's from the bits: to 0.2 %, which is enough for what is small.
    let rough = f32::from_bits(ROUGH_INVERSE_ROOT.wrapping_sub(lambda.to_bits() >> 1));
    let inverse_root = rough * (1.5 - 0.5 * lambda * (rough * rough));
    let w2 = w * w;
    let third = w * (w2 + 2.0) * (1.0 / 72.0);
    let fourth = (w2 * (1.0 / 270.0) + 7.0 / 810.0) * w2 - 8.0 / 405.0;
    let quantile = (lambda - whole) + root * w + ((w2 + 2.0) * (1.0 / 6.0) + inverse_root * (inverse_root * fourth - third));
    let near = round(quantile);
    let beyond = quantile - near;
    let number = whole + (near - if beyond < 0.0 { 1.0 } else { 0.0 });
    let error = 0.003 + 0.9 * inverse_root * (inverse_root * inverse_root);
    (number, !((beyond.abs() > error) & (w2 < MAX_W2) & (lambda < MAX_E)))
}

/// Poisson numbers of expectations from [`EXPANSION_FROM_E`] on; where λ is smaller the result means nothing.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn poisson_expansion(lambda: &[f32; BLOCK_PX], w: &[f32; BLOCK_PX], numbers: &mut [f32; BLOCK_PX]) {
    let bright = |lambda: f32| if lambda < EXPANSION_FROM_E { EXPANSION_FROM_E } else { lambda };
    let mut unsure = [0_u32; BLOCK_PX];
    for i in 0..BLOCK_PX {
        let (number, may_err) = quick_quantile(bright(lambda[i]), w[i]);
        (numbers[i], unsure[i]) = (number, u32::from(may_err));
    }
    for run in (0..BLOCK_PX).step_by(LANES) {
        let run = run..run + LANES;
        // No `any`: it would look at one after the other.
        if unsure[run.clone()].iter().fold(0, |all, one| all | one) > 0 {
            for i in run {
                numbers[i] = poisson_quantile(bright(lambda[i]), w[i]);
            }
        }
    }
}

/// Poisson numbers of expectations below [`EXPANSION_FROM_E`] by inversion; others stay.
///
/// The loop over the numbers is the outer one: the inner one runs over all pixels at once, as long as any of them goes on.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
#[allow(clippy::needless_bitwise_bool, reason = "a lazy `and` is a branch, and the loop would not vectorise")]
fn poisson_inversion(lambda: &[f32; BLOCK_PX], w: &[f32; BLOCK_PX], numbers: &mut [f32; BLOCK_PX]) {
    let mut probability = [0.0_f32; BLOCK_PX];
    let mut survival = [0.0_f32; BLOCK_PX];
    let mut last = [0.0_f32; BLOCK_PX];
    let mut small = [0.0_f32; BLOCK_PX];
    // Uniform in (0, 1], and small where the number is to be large.
    let mut u = [0.0_f32; BLOCK_PX];
    for i in 0..BLOCK_PX {
        let tail = normal_upper_tail(w[i].abs());
        u[i] = if w[i] < 0.0 { 1.0 - tail } else { tail };
    }
    for i in 0..BLOCK_PX {
        let l = if lambda[i] < EXPANSION_FROM_E { lambda[i] } else { 0.0 };
        probability[i] = poly_exp(-l);
        survival[i] = first_survival(l, probability[i]);
        last[i] = 6.0 + l + 6.5 * l.sqrt();
    }
    let mut k = 0.0_f32;
    loop {
        let mut running = 0_u32;
        let reciprocal = 1.0 / (k + 1.0);
        for i in 0..BLOCK_PX {
            let goes_on = (u[i] < survival[i]) & (k < last[i]);
            running |= u32::from(goes_on);
            small[i] += if goes_on { 1.0 } else { 0.0 };
            // Nothing where the number is found: probabilities that go on falling become denormal, and processors are slow with these.
            probability[i] = if goes_on { probability[i] * (lambda[i] * reciprocal) } else { 0.0 };
            survival[i] -= probability[i];
        }
        if running == 0 {
            break;
        }
        k += 1.0;
    }
    for i in 0..BLOCK_PX {
        numbers[i] = if lambda[i] < EXPANSION_FROM_E { small[i] } else { numbers[i] };
    }
}

/// Poisson numbers of a block of pixels at the quantiles of standard normal numbers.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
pub(crate) fn poisson_numbers(lambda: &[f32; BLOCK_PX], w: &[f32; BLOCK_PX]) -> [f32; BLOCK_PX] {
    let mut numbers = [0.0_f32; BLOCK_PX];
    let faint = lambda.iter().map(|lambda| u32::from(*lambda < EXPANSION_FROM_E)).sum::<u32>() as usize;
    if faint < BLOCK_PX {
        poisson_expansion(lambda, w, &mut numbers);
    }
    if faint > 0 {
        poisson_inversion(lambda, w, &mut numbers);
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The number at a normal quantile, by the same lines as the twin's.
    fn at_quantile(lambda: f32, w: f32) -> f64 {
        f64::from(poisson_numbers(&[lambda; BLOCK_PX], &[w; BLOCK_PX])[0])
    }

    /// The law itself, not draws of it: where along w each number begins, found by bisection, and what lies between has the right probability.
    #[test]
    fn the_law_is_exact() {
        use statrs::function::{erf::erfc, gamma::ln_gamma};
        for lambda in [0.003_f32, 0.1, 0.7, 1.0, 3.3, 8.0, 11.9, 12.0, 12.6, 14.0, 17.3, 20.0, 31.0, 50.0, 100.0, 1000.0, 12_345.6, 1e5] {
            let l = f64::from(lambda);
            let survival = |k: f64| {
                let (mut low, mut high) = (-6.6_f32, 6.6_f32);
                if at_quantile(lambda, low) >= k {
                    return 1.0;
                }
                for _ in 0..45 {
                    let middle = 0.5 * (low + high);
                    if at_quantile(lambda, middle) >= k { high = middle } else { low = middle }
                }
                0.5 * erfc(f64::from(high) * std::f64::consts::FRAC_1_SQRT_2)
            };
            let (first, last) = ((l - 7.0 * l.sqrt()).floor().max(0.0), (l + 7.0 * l.sqrt() + 10.0).ceil());
            let (mut distance, mut moments) = (0.0, [0.0; 3]);
            let mut above = survival(first);
            for k in first as u32..last as u32 {
                let k = f64::from(k);
                let next = survival(k + 1.0);
                let error = (above - next) - (k * l.ln() - l - ln_gamma(k + 1.0)).exp();
                above = next;
                distance += 0.5 * error.abs();
                for (power, moment) in (1..).zip(&mut moments) {
                    *moment += error * (k - l).powi(power);
                }
            }
            // Central moments of the law: λ, λ, and λ again.
            let errors = [moments[0] / l.sqrt(), moments[1] / l, (moments[2] - 3.0 * l * moments[0]) / l.powf(1.5)];
            println!(
                "λ {lambda}: distance {distance:.1e}; mean {:.1e} σ, variance {:.1e}, skewness {:.1e}",
                errors[0], errors[1], errors[2]
            );
            assert!(errors.iter().all(|error| error.abs() < 2e-4), "λ {lambda}: {errors:.1?}");
            assert!(distance < 1e-5, "λ {lambda}: total variation distance {distance:.1e}");
        }
    }

    /// Where the expansion is trusted, the number is the same as by z: at random places, and on both sides of where numbers begin.
    #[test]
    fn the_quick_way_changes_no_number() {
        let mut state = 1_u32;
        let mut uniform = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f32::from((state >> 16) as u16) / 65_536.0
        };
        let (mut tried, mut trusted) = (0, 0);
        for step in 0..160_u16 {
            let lambda = EXPANSION_FROM_E * (f32::from(step) * 0.085).exp() + uniform();
            let exact = |w: f32| poisson_quantile(lambda, w);
            for _ in 0..400 {
                // The place where the number of a random quantile begins.
                let (mut low, mut high) = (-8.0_f32, 7.0 * uniform() - 3.5);
                let number = exact(high);
                for _ in 0..40 {
                    let middle = 0.5 * (low + high);
                    if exact(middle) >= number { high = middle } else { low = middle }
                }
                for offset in [0.0, 1e-6, 1e-4, 1e-3, 0.01, 0.1, 1.0] {
                    for w in [low - offset, high + offset * uniform()] {
                        let (quick, may_err) = quick_quantile(lambda, w);
                        tried += 1;
                        trusted += u32::from(!may_err);
                        assert!(may_err || quick == exact(w), "λ {lambda}, w {w}: {quick} instead of {}", exact(w));
                    }
                }
            }
        }
        assert!(tried / 4 < trusted, "of {tried} numbers {trusted} are trusted");
        // The bound is needed: beside where a number begins the expansion alone errs.
        let errs = |lambda: f32| {
            (-3200..3200_i16).map(|w| f32::from(w) * 1e-3).any(|w| quick_quantile(lambda, w).0 != poisson_quantile(lambda, w))
        };
        assert!(errs(12.0) && errs(40.0));
    }
}
