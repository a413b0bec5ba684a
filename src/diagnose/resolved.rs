//! Lower limits of stated p-values: what the null simulations resolve. The tail is extrapolated to a thousandth of the last simulated p-value at
//! most; below one in a million no distribution of errors is known well enough.

use super::diagnosis::Diagnosis;
use super::verdict::Bound;

/// No p-value is stated below this.
const MIN_P: f64 = 1e-6;
/// So many times beyond the last simulation the tail is followed.
const BEYOND: f64 = 1e-3;

/// The smallest probability that so many simulations resolve.
pub(super) fn least_p(nulls: usize) -> f64 {
    (BEYOND / nulls.max(1) as f64).max(MIN_P)
}

/// In a sentence: `p = 0.03`, or `p < 1e-6` where no smaller one is resolved.
pub(super) fn told(p: f64, least: f64) -> String {
    if p < least {
        format!("p < {}", power(least))
    } else if p >= 0.01 {
        format!("p = {p:.2}")
    } else {
        format!("p = {p:.1e}")
    }
}

fn power(p: f64) -> String {
    let text = format!("{p:.1e}");
    text.replace(".0e", "e")
}

/// Puts bounds in the place of what is not resolved.
pub(super) fn bound(diagnosis: &mut Diagnosis) {
    let least = least_p(diagnosis.nulls);
    let one = |p: &mut f64, is: &mut Option<Bound>| {
        if *p < least {
            (*p, *is) = (least, Some(Bound::Upper));
        }
    };
    let alone = |p: &mut Option<f64>| *p = p.map(|p| p.max(least));
    for finding in &mut diagnosis.findings {
        one(&mut finding.p_value, &mut finding.p_value_is);
        one(&mut finding.family_p_value, &mut finding.family_p_value_is);
        alone(&mut finding.signs.p_value);
        alone(&mut finding.resimulated_p_value);
    }
    for unknown in &mut diagnosis.unknown {
        one(&mut unknown.p_value, &mut unknown.p_value_is);
    }
    for effect in &mut diagnosis.effects {
        if let Some(p) = &mut effect.p_value {
            one(p, &mut effect.p_value_is);
        }
    }
    for located in &mut diagnosis.located {
        one(&mut located.p_value, &mut located.p_value_is);
        alone(&mut located.permutation_p_value);
        alone(&mut located.conditional_p_value);
    }
    let channels = &mut diagnosis.channels;
    for report in [
        &mut channels.astrometry,
        &mut channels.flux,
        &mut channels.shape,
        &mut channels.stamp,
        &mut channels.noise,
        &mut channels.background,
    ] {
        if let Some(p) = &mut report.p_value {
            one(p, &mut report.p_value_is);
        }
    }
    alone(&mut diagnosis.resimulated_p_value);
    alone(&mut diagnosis.left_p_value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_is_told_than_is_resolved() {
        assert_eq!((least_p(1000), least_p(20), least_p(1_000_000)), (1e-6, 5e-5, 1e-6));
        assert_eq!(told(1e-40, 1e-6), "p < 1e-6");
        assert_eq!(told(3e-5, 5e-5), "p < 5e-5");
        assert_eq!(told(0.0312, 1e-6), "p = 0.03");
        assert_eq!(told(4.2e-5, 1e-6), "p = 4.2e-5");
    }
}
