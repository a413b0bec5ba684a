//! False-match probability: how likely chance alone would match as many stars.
//!
//! Under the hypothesis that the detections have nothing to do with the catalogue stars laid over them, each has the
//! probability λ·πρ² to lie within ρ of one, λ being the local density of the catalogue stars laid over. The number of
//! chance matches is then (nearly) Poisson with the mean Λ = Σ λᵢπρ². Three matches are used up by the triangle that gave the
//! hypothesis, one more if the distortion was fitted too; what counts is the probability of the rest, times the number of
//! hypotheses, depths and radii that were tried: [`over_all_tries`], by which a hypothesis is accepted. It is a bound, and mostly
//! a hundred times too large; what is stated is [`calibrated_false_match_probability`], which follows how often chance does as well.

use std::sync::LazyLock;

use crate::units::DEG_RAD;

/// ln of the probability that a Poisson variable of the given mean is `at_least` or more.
pub(super) fn ln_poisson_tail(mean: f64, at_least: usize) -> f64 {
    if at_least == 0 {
        return 0.0;
    }
    if mean <= 0.0 {
        return f64::NEG_INFINITY;
    }
    let k = at_least as f64;
    if k <= mean {
        return 0.0; // more than half: of no interest here, and 1 is the safe side
    }
    let ln_first = k * mean.ln() - mean - ln_factorial(at_least);
    // Sum of the terms relative to the first: falls geometrically since mean < k.
    let (mut sum, mut term, mut next) = (1.0, 1.0, k + 1.0);
    while term > 1e-12 * sum && next < k + 10_000.0 {
        term *= mean / next;
        sum += term;
        next += 1.0;
    }
    (ln_first + f64::ln(sum)).min(0.0)
}

/// ln n!.
fn ln_factorial(n: usize) -> f64 {
    static FIRST: LazyLock<[f64; 512]> = LazyLock::new(|| {
        let mut sum = 0.0;
        std::array::from_fn(|n| {
            sum += (n.max(1) as f64).ln();
            sum
        })
    });
    FIRST.get(n).copied().unwrap_or_else(|| (2..=n).map(|i| (i as f64).ln()).sum())
}

/// A bound on the probability that any of `hypotheses` tries would have given a match at least as good, from ln of the probability of
/// one. The factor 1 + ln n keeps the sum over a search that stops at the first success below the stated value.
pub(super) fn over_all_tries(ln_one: f64, hypotheses: f64) -> f64 {
    let n = hypotheses.max(1.0);
    (ln_one + n.ln() + (1.0 + n.ln()).ln()).exp().min(1.0)
}

/// ln of the probability of one below which [`over_all_tries`] stays below `most`.
pub(super) fn ln_below(most: f64, hypotheses: f64) -> f64 {
    let n = hypotheses.max(1.0);
    most.ln() - n.ln() - (1.0 + n.ln()).ln()
}

/// The probability by which a match is stated to be one of chance: the share of searches in which detections that have nothing to do with
/// the stars are matched as well.
///
/// P, `ln_best`: the least probability by chance of all depths and radii, of this one hypothesis, the `hypotheses`-th; `width_rad`: the
/// width of the field; `judges`: the detections that it was weighed on. Were every hypothesis a draw of its own and every draw weighed,
/// chance would do as well n·P times; it does not, and how often it does was measured, on 65,000 lists without stars (4 to 200 points, fields
/// 4° to 60° wide, focal lengths known to 1 %, to 10 % and not at all):
///
/// ```text
/// 0.14 · (n + 1000) · P · (1 + P/1e-5)^−0.45 · (15°/width)^1.7 · min(1, judges/18)^1.5
/// ```
/// Of the early hypotheses each has no more than its share of all that were to be tried; weak alignments mostly fail the test before the
/// brightest stars around the triangle; the wider the field the more hypotheses come down to one and the same; few detections match in
/// numbers so small that most values of P are never met. `make bench-identify` measures it anew on other lists; it is never above the bound.
/// Stars of the sky, which are no points by chance, do as well two to three times as often as is stated below 3e-4.
pub(super) fn calibrated_false_match_probability(ln_best: f64, hypotheses: f64, width_rad: f64, judges: usize) -> f64 {
    let one = ln_best.exp();
    let weak = -0.45 * (one / 1e-5).ln_1p();
    let wide = -1.7 * (width_rad / (15.0 * DEG_RAD)).ln();
    let few = 1.5 * (judges as f64 / 18.0).min(1.0).ln();
    (ln_best + 0.14_f64.ln() + (hypotheses + 1000.0).ln() + weak + wide + few).exp().min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tail_agrees_with_known_values() {
        // SciPy: poisson.sf(k - 1, mean).
        for (mean, k, expected) in [(1.0, 3, 0.080_301_397_071_394_2), (0.1, 5, 7.667_8e-8), (20.0, 40, 5.320_2e-5)] {
            let tail = ln_poisson_tail(mean, k).exp();
            assert!((tail / expected - 1.0).abs() < 1e-5, "{mean} {k}: {tail}");
        }
        assert_eq!(ln_poisson_tail(0.3, 0), 0.0);
        assert_eq!(ln_poisson_tail(0.0, 2), f64::NEG_INFINITY);
    }

    #[test]
    fn below_this_probability_of_one_all_tries_stay_below_the_limit() {
        for n in [1.0, 20.0, 3e5] {
            for most in [1e-6, 1e-3] {
                let limit = ln_below(most, n);
                assert!(over_all_tries(limit - 1e-9, n) < most && over_all_tries(limit + 1e-9, n) > most, "{n} {most}");
            }
        }
    }

    #[test]
    fn what_is_stated_follows_its_formula_and_stays_a_probability() {
        let stated = |ln_best: f64| calibrated_false_match_probability(ln_best, 4000.0, 15.0 * DEG_RAD, 40);
        assert!((stated(1e-9_f64.ln()) / (0.14 * 5000.0 * 1e-9) - 1.0).abs() < 1e-3);
        assert!((stated(1e-5_f64.ln()) / (0.14 * 5000.0 * 1e-5 * 2_f64.powf(-0.45)) - 1.0).abs() < 1e-9);
        // 6 of 18 judges, a field twice as wide.
        let few = calibrated_false_match_probability(1e-9_f64.ln(), 4000.0, 30.0 * DEG_RAD, 6);
        assert!((few / stated(1e-9_f64.ln()) - 3_f64.powf(-1.5) * 2_f64.powf(-1.7)).abs() < 1e-9);
        assert_eq!(stated(0.0), 1.0);
        assert_eq!(stated(f64::NEG_INFINITY), 0.0);
    }
}
