//! Tail probabilities so small that they are kept as logarithms.

use statrs::function::gamma::ln_gamma;

/// −ln of the probability that χ² of so many degrees of freedom exceeds a value. Exact to about 1e-10 relative, and without underflow.
///
/// Source: the incomplete gamma function Q(q/2, t/2) by its series and its continued fraction, Press et al., Numerical Recipes (2007), 6.2.
#[must_use]
pub fn neg_ln_chi2_sf(degrees: f64, value: f64) -> f64 {
    if value <= 0.0 || degrees <= 0.0 {
        return 0.0;
    }
    let (a, x) = (degrees / 2.0, value / 2.0);
    let ln_front = a * x.ln() - x - ln_gamma(a);
    if x < a + 1.0 {
        let (mut term, mut sum, mut k) = (1.0 / a, 1.0 / a, a);
        for _ in 0..500 {
            k += 1.0;
            term *= x / k;
            sum += term;
            if term < sum * 1e-13 {
                break;
            }
        }
        let below = (ln_front + sum.ln()).exp();
        return -(-below.min(1.0 - 1e-16)).ln_1p();
    }
    // Lentz's continued fraction.
    let mut b = x + 1.0 - a;
    let mut c = 1e300;
    let mut d = 1.0 / b;
    let mut h = d;
    for i in 1..500 {
        let an = -f64::from(i) * (f64::from(i) - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        let step = d * c;
        h *= step;
        if (step - 1.0).abs() < 1e-13 {
            break;
        }
    }
    -(ln_front + h.ln())
}

/// The number of standard deviations that a normal variable exceeds, to either side, with a probability of exp(−surprise).
#[must_use]
pub fn deviations(surprise: f64) -> f64 {
    let (mut low, mut high) = (0.0, (2.0 * surprise.max(0.0)).sqrt() + 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if neg_ln_chi2_sf(1.0, middle * middle) < surprise { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The value of χ² that is exceeded with probability e^−surprise.
#[must_use]
pub fn chi_squared_quantile(degrees: f64, surprise: f64) -> f64 {
    let (mut low, mut high) = (0.0, degrees + 10.0);
    while neg_ln_chi2_sf(degrees, high) < surprise {
        high *= 2.0;
    }
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if neg_ln_chi2_sf(degrees, middle) < surprise {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

/// Φ(z), the normal distribution.
#[must_use]
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * statrs::function::erf::erfc(-z / std::f64::consts::SQRT_2)
}

/// p-value of a χ² statistic of so many degrees of freedom.
pub(crate) fn chi2_p_value(statistic: f64, degrees: usize) -> f64 {
    (-neg_ln_chi2_sf(degrees as f64, statistic)).exp()
}

/// Family-wise p-value: that of the smallest of `questions` independent p-values (Šidák, J. Am. Stat. Assoc. 62, 626 (1967)).
pub(crate) fn family_wise_p_value(p: f64, questions: f64) -> f64 {
    -(questions * (-p).ln_1p()).exp_m1()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surprise_is_that_of_the_tables() {
        // scipy 1.14: chi2.sf(10.83, 1) = 9.990e-4; chi2.sf(100, 40) = 4.8207e-7; chi2.logsf(2000, 2) = -1000 exactly.
        assert!((neg_ln_chi2_sf(1.0, 10.827_566_170_662_733) - 1000.0_f64.ln()).abs() < 1e-9);
        assert!((neg_ln_chi2_sf(2.0, 2000.0) - 1000.0).abs() < 1e-9);
        assert!((neg_ln_chi2_sf(1.0, 1.0) + 0.317_310_507_862_914_f64.ln()).abs() < 1e-10);
        assert!((chi_squared_quantile(2.0, 5.0) - 10.0).abs() < 1e-9);
        for degrees in [1.0, 3.0, 10.0, 70.0] {
            let (a, b) = (neg_ln_chi2_sf(degrees, degrees + 1.999_999), neg_ln_chi2_sf(degrees, degrees + 2.000_001));
            assert!((a - b).abs() < 1e-5, "the two ways meet");
        }
    }
}
