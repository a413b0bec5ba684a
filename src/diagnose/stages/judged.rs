//! Sixth stage: what speaks against the names of the confirmed effects.

use super::Solved;
use crate::diagnose::adequacy::{amplitude_veto, concentration, disagreement, superseded, vetoes};
use crate::diagnose::cross_validation::Withheld;
use crate::diagnose::final_fit::FinalFit;
use crate::diagnose::fit_state::{FitState, SelectedEffect};
use crate::diagnose::patterns::Named;
use crate::diagnose::resimulate::{DIFFERS, Resimulated, resimulate};
use crate::diagnose::resolved::{least_p, told};
use crate::diagnose::scan::Scan;
use crate::diagnose::wild_bootstrap::{WildBootstrap, wild_bootstrap};

/// The confirmed effects and their vetoes.
pub(in crate::diagnose) struct Judged<'a> {
    pub(in crate::diagnose) solved: &'a Solved<'a>,
    /// All images with all confirmed effects, at the baseline's linearisation.
    pub(in crate::diagnose) with_all: FitState,
    /// Of each effect, whether its frames (or stars) agree on it.
    pub(in crate::diagnose) signs: Vec<WildBootstrap>,
    /// The recording simulated anew with all of them.
    pub(in crate::diagnose) resimulated: Option<Resimulated>,
    /// Effects that do not stand, by their place among the confirmed ones, and why.
    pub(in crate::diagnose) vetoes: Vec<(usize, Vec<String>)>,
}

impl<'a> Judged<'a> {
    /// Asks every veto of every effect.
    pub(in crate::diagnose) fn new(solved: &'a Solved<'a>) -> Self {
        let (baseline, evidence, entries) = (solved.validated.baseline, &solved.validated.evidence, solved.entries());
        let with_all =
            if entries.is_empty() { baseline.fit.clone() } else { FitState::new(evidence, &baseline.all, entries, &baseline.stated) };
        let signs = (0..entries.len()).map(|k| wild_bootstrap(evidence, &with_all, entries, k, baseline.options.seed)).collect();
        let mut judged = Self { solved, with_all, signs, resimulated: None, vetoes: Vec::new() };
        judged.resimulated = judged.simulated_anew(entries, &solved.fit);
        let scan = judged.patterns_left();
        let against = |k: usize| judged.against(k, scan.as_ref());
        judged.vetoes = (0..entries.len()).map(|k| (k, against(k))).filter(|(_, against)| !against.is_empty()).collect();
        judged
    }

    /// Effects that stand, by their place among the confirmed ones.
    pub(in crate::diagnose) fn standing(&self) -> Vec<usize> {
        let is_vetoed = |k: &usize| self.vetoes.iter().any(|(vetoed, _)| vetoed == k);
        (0..self.solved.entries().len()).filter(|k| !is_vetoed(k)).collect()
    }

    /// All that was proposed by all images and does not stand.
    pub(in crate::diagnose) fn withheld(&self) -> Vec<Withheld> {
        let confirmed = &self.solved.validated.confirmed;
        let vetoed = self.vetoes.iter().map(|(k, against)| Withheld {
            entry: confirmed.entries[*k],
            against: against.clone(),
            held_out_delta_chi2: confirmed.proofs.get(*k).map(|proof| proof.gain.delta_chi2),
        });
        vetoed.chain(confirmed.withheld.iter().cloned()).collect()
    }

    /// The recording simulated with some of the effects in force, held against the real one.
    pub(in crate::diagnose) fn simulated_anew(&self, entries: &[SelectedEffect], fit: &FinalFit) -> Option<Resimulated> {
        let validated = &self.solved.validated;
        let (baseline, chance) = (validated.baseline, &validated.screened.test.chance);
        if entries.is_empty() {
            return None;
        }
        resimulate(&baseline.joint, &validated.evidence, entries, fit, chance, &baseline.options)
    }

    /// The questions beside all effects at the baseline's linearisation, where something is left.
    fn patterns_left(&self) -> Option<Scan> {
        let (evidence, entries) = (&self.solved.validated.evidence, self.solved.entries());
        let alpha = self.solved.validated.baseline.options.alpha;
        let remains = self.solved.left.as_ref().is_some_and(|(_, test)| test.p_value < alpha);
        let is_free = |index: usize| entries.iter().all(|entry| entry.hypothesis != index);
        let fit = &self.with_all;
        (remains && !entries.is_empty()).then(|| Scan::new(evidence, &fit.noise, &fit.system, &fit.fit, is_free))
    }

    fn against(&self, k: usize, patterns_left: Option<&Scan>) -> Vec<String> {
        let (solved, with_all, validated) = (self.solved, &self.with_all, &self.solved.validated);
        let (evidence, entries) = (&validated.evidence, solved.entries());
        let (statistic, _) = with_all.statistic(evidence, entries, k);
        let mut against = Vec::new();
        if let Some((scan, _)) = &solved.left {
            let named = Named { evidence, stand: with_all, entries, solved: &solved.fit, k };
            against.extend(vetoes(&named, scan, statistic));
        }
        against.extend(concentration(evidence, validated.baseline.points, with_all, entries, k));
        against.extend(amplitude_veto(evidence, with_all, entries, k, &solved.fit));
        against.extend(disagreement(&self.signs[k], patterns_left.is_some()));
        if let Some(p) = self.resimulated.as_ref().and_then(|anew| anew.own_p.get(k)).filter(|p| **p < DIFFERS) {
            let least = least_p(validated.screened.test.chance.nulls);
            against.push(format!("the recording simulated anew with it does not look the same ({})", told(*p, least)));
        }
        if let Some(scan) = patterns_left {
            against.extend(superseded(evidence, with_all, scan, entries, k, validated.screened.threshold));
        }
        against
    }
}
