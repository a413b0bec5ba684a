//! The covariates that the residuals follow, which tell where a mismatch shows.

use super::diagnosis::Located;
use super::evidence::Evidence;
use super::fit_state::FitState;
use super::linear_fit::Fit;
use super::linear_system::Whitened;
use super::null_distribution::NullDistribution;
use super::omnibus::among_covariates;
use super::permutation::Permutations;
use super::scan::{Asks, Scan};
use crate::statistics::order::descending;
use crate::statistics::significance::neg_ln_chi2_sf;

/// So many are named.
pub(super) const NAMED: usize = 3;
/// A covariate is listed below this probability.
const LISTED_P: f64 = 0.05;

/// Covariates by how surprisingly residuals follow them.
pub(super) fn ranked(evidence: &Evidence, stand: &FitState, scan: &Scan) -> Vec<(usize, f64, f64)> {
    let mut best: Vec<Option<(f64, f64)>> = vec![None; evidence.covariates.len()];
    for group in &scan.groups {
        let Asks::Covariate(index) = group.asks else { continue };
        let surprise = group.surprise();
        let explained = (group.statistic - group.rank as f64) / stand.fit.degrees;
        if best[index].is_none_or(|(most, _)| surprise > most) {
            best[index] = Some((surprise, explained));
        }
    }
    let mut all: Vec<(usize, f64, f64)> = best.into_iter().enumerate().filter_map(|(k, b)| b.map(|(s, e)| (k, s, e))).collect();
    descending(&mut all, |a| a.1);
    all
}

/// The covariates that residuals follow, each also with those before it taken out.
/// `deals` holds their permutation tests, where these were asked for.
pub(super) fn located(evidence: &Evidence, stand: &FitState, scan: &Scan, chance: &NullDistribution, deals: &Permutations) -> Vec<Located> {
    let all = ranked(evidence, stand, scan);
    let mut leaders: Vec<Whitened> = Vec::new();
    let mut found = Vec::new();
    for (place, (index, surprise, explained)) in all.into_iter().enumerate() {
        let p_value = among_covariates(chance, surprise);
        let dealt = deals.p_value(index);
        if p_value > LISTED_P && place > 0 {
            break;
        }
        // Correlated errors may follow a covariate as closely as any effect: permuted, the covariate then does as well.
        if dealt.is_some_and(|(p, _)| p > LISTED_P) && place > 0 {
            continue;
        }
        let conditional_p_value = (place > 0 && place <= NAMED).then(|| {
            let fit = Fit::new(&stand.system, &stand.take, &leaders.iter().collect::<Vec<_>>());
            let beside = FitState { fit, ..stand.clone() };
            let most = evidence.covariates[index].patterns.iter().map(|pattern| {
                let own: Vec<Whitened> = pattern.iter().map(|column| evidence.white(&stand.noise, column)).collect();
                let (t, rank) = beside.score(&own);
                neg_ln_chi2_sf(rank as f64, t)
            });
            among_covariates(chance, most.fold(0.0, f64::max))
        });
        if place < NAMED {
            let patterns = evidence.covariates[index].patterns.iter().flatten();
            leaders.extend(patterns.map(|column| evidence.white(&stand.noise, column)));
        }
        let covariate = evidence.covariates[index].name.clone();
        found.push(Located {
            covariate,
            explained: explained.max(0.0),
            p_value,
            p_value_is: None,
            permutation_p_value: dealt.map(|(p, _)| p),
            permuted: dealt.map(|(_, unit)| unit.to_owned()),
            conditional_p_value,
        });
    }
    found
}
