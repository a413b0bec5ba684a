//! Omnibus test: the most significant hypothesis and the most significant covariate, against their null distributions.

use super::evidence::Evidence;
use super::fit_state::FitState;
use super::null_distribution::{NullDistribution, family_p, family_p_error};
use super::options::DiagnoseOptions;
use super::scan::{Asks, Scan};

/// Where the decision is near, up to this many times the simulations asked for are added.
const MORE: usize = 8;
/// It is near while p is within so many standard errors of where it is decided.
const NEAR: f64 = 6.0;

/// Whether there is something, by the hypotheses and by the covariates; each has half of α.
#[derive(Clone, Debug)]
pub(super) struct Omnibus {
    pub(super) p_value: f64,
    pub(super) largest: String,
    pub(super) chance: NullDistribution,
}

/// Asks all questions, and chance too. `level` is the probability at which it is decided; `stream` makes the simulations those of this call.
pub(super) fn omnibus(
    evidence: &Evidence,
    stand: &FitState,
    scan: &Scan,
    options: &DiagnoseOptions,
    (stream, level): (u64, f64),
) -> Omnibus {
    let mut most = [(0.0_f64, String::new()), (0.0, String::new())];
    for group in &scan.groups {
        let (which, name) = match group.asks {
            Asks::Hypothesis(index, _) => (0, evidence.hypotheses[index].id()),
            Asks::Covariate(index) => (1, evidence.covariates[index].name.as_str()),
        };
        let surprise = group.surprise();
        if surprise > most[which].0 {
            most[which] = (surprise, name.to_owned());
        }
    }
    let seed = options.seed ^ stream.wrapping_mul(0x517c_c1b7_2722_0a95);
    let simulated = |from: usize, to: usize| scan.chance(&stand.fit, &stand.take, seed, from, to);
    let mut chance = simulated(0, options.nulls);
    // p of the hypotheses and of the covariates, and the standard error of ln p of the smaller.
    let decide = |chance: &NullDistribution| {
        let (h, c) = (family_p(&chance.hypotheses, most[0].0), family_p(&chance.covariates, most[1].0));
        let error = if h <= c { family_p_error(&chance.hypotheses, most[0].0) } else { family_p_error(&chance.covariates, most[1].0) };
        (h, c, error)
    };
    let (mut h, mut c, mut error) = decide(&chance);
    let p_of = |h: f64, c: f64| (2.0 * h.min(c)).min(1.0);
    while chance.nulls >= options.nulls && chance.nulls < options.nulls * (1 + MORE) && (p_of(h, c) / level).ln().abs() < NEAR * error {
        let to = (2 * chance.nulls).min(options.nulls * (1 + MORE));
        let from = chance.nulls;
        chance = chance.and(simulated(from, to));
        (h, c, error) = decide(&chance);
    }
    let [of_hypotheses, of_covariates] = most.map(|(_, name)| name);
    Omnibus { p_value: p_of(h, c), largest: if h <= c { of_hypotheses } else { of_covariates }, chance }
}

/// p-value of a covariate among all.
pub(super) fn among_covariates(chance: &NullDistribution, surprise: f64) -> f64 {
    family_p(&chance.covariates, surprise)
}
