//! How likely a match would be by chance.
//!
//! Under the hypothesis that the detections have nothing to do with the catalogue stars laid over them, each has the
//! probability λ·πρ² to lie within ρ of one, λ being the local density of the catalogue stars laid over. The number of
//! chance matches is then (nearly) Poisson with the mean Λ = Σ λᵢπρ². Three matches are used up by the triangle that gave the
//! hypothesis, one more if the distortion was fitted too; what counts is the probability of the rest, times the number of
//! hypotheses, depths and radii that were tried.

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
    (2..=n).map(|i| (i as f64).ln()).sum()
}

/// The probability that any of `hypotheses` tries would have given a match at least as good, from ln of the probability of one.
/// The factor 1 + ln n keeps the sum over a search that stops at the first success below the stated value.
pub(super) fn over_all_tries(ln_one: f64, hypotheses: f64) -> f64 {
    let n = hypotheses.max(1.0);
    (ln_one + n.ln() + (1.0 + n.ln()).ln()).exp().min(1.0)
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
}
