//! Findings from accepted effects: size with error, evidence, the covariates that located it, and its rivals.

use super::channels::{ByChannel, Channel, ChannelMeasure};
use super::crossfit::{CrossFit, Proof};
use super::diagnosis::{ColumnSource, Finding, Signs};
use super::evidence::Evidence;
use super::final_fit::FinalFit;
use super::fit_state::{FitState, SelectedEffect, fall};
use super::located::{NAMED, ranked};
use super::omnibus::among_covariates;
use super::options::DiagnoseOptions;
use super::rivals::{decided_by, held_out_of_rivals, rivals};
use super::scan::Scan;
use super::wild_bootstrap::WildBootstrap;
use super::wording;
use crate::calibrate::BundleSolution;
use crate::identify::ControlPoints;
use crate::statistics::significance::{chi2_p_value, deviations, family_wise_p_value, neg_ln_chi2_sf};

/// A covariate locates a finding if chance does as well with less than this probability.
const LOCATES_P: f64 = 0.01;

/// What the findings are made of.
pub(super) struct Context<'a> {
    pub(super) evidence: &'a Evidence,
    pub(super) joint: &'a BundleSolution,
    pub(super) points: &'a ControlPoints,
    pub(super) base: &'a FitState,
    pub(super) with_all: &'a FitState,
    pub(super) entries: &'a [SelectedEffect],
    pub(super) proofs: &'a [Proof],
    /// Of each entry, the sign-flip test over frames (or stars).
    pub(super) signs: &'a [WildBootstrap],
    /// Choice and size made anew in turns.
    pub(super) tried: &'a CrossFit,
    /// Of each entry, whether the recording simulated with it looks the same.
    pub(super) resimulated: &'a [f64],
    pub(super) hypotheses: f64,
}

/// The finding in every channel: so far places alone measure it.
fn by_channel(finding: &Finding) -> ByChannel {
    let places = finding.parameters.first().map(|first| ChannelMeasure {
        delta_chi2: finding.delta_chi2,
        held_out_delta_chi2: Some(finding.held_out_delta_chi2),
        held_out_chi2_per_dof: None,
        held_out_dof: None,
        amplitude: first.value,
        sigma: first.sigma,
    });
    Channel::ALL.into_iter().map(|channel| (channel, places.filter(|_| channel == Channel::Astrometry))).collect()
}

impl Context<'_> {
    /// The finding of entry `k`.
    pub(super) fn finding(&self, k: usize, solved: &FinalFit, options: &DiagnoseOptions) -> Finding {
        let entry = self.entries[k];
        let hypothesis = &self.evidence.hypotheses[entry.hypothesis];
        let variant = &hypothesis.variants[entry.variant];
        let parameters = solved.parameters(k, variant);
        let (t, rank) = self.with_all.statistic(self.evidence, self.entries, k);
        let p_value = chi2_p_value(t, rank);
        let without = self.with_all.without(self.evidence, self.entries, k);
        let scan = Scan::new(self.evidence, &without.noise, &without.system, &without.fit, |_| false);
        let chance = scan.chance(&without.fit, &without.take, options.seed ^ 0x0010_ca7e, 0, options.nulls.min(200));
        let mut located_by: Vec<String> = Vec::new();
        for (index, surprise, _) in ranked(self.evidence, &without, &scan) {
            if located_by.is_empty() || (located_by.len() < NAMED && among_covariates(&chance, surprise) < LOCATES_P) {
                located_by.push(self.evidence.covariates[index].name.clone());
            }
        }
        let mut listed = rivals(self.evidence, self.with_all, self.entries, k);
        held_out_of_rivals(self.evidence, self.tried, entry.hypothesis, &mut listed);
        let set: Vec<String> = listed.iter().filter(|own| own.in_set).map(|own| own.rival.id.clone()).collect();
        let magnitudes: Vec<f64> = self.evidence.images.iter().map(|image| self.points.points[image.point].magnitude).collect();
        let mean = magnitudes.iter().sum::<f64>() / magnitudes.len().max(1) as f64;
        let faintness: Vec<f64> = magnitudes.iter().map(|m| m - mean).collect();
        let nearest = set.first().or_else(|| listed.first().map(|own| &own.rival.id));
        let rival = nearest.and_then(|id| self.evidence.hypotheses.iter().position(|hypothesis| hypothesis.id() == id));
        let decided = rival.and_then(|index| {
            let other = SelectedEffect { hypothesis: index, variant: self.evidence.hypotheses[index].variants.len() / 2 };
            decided_by(self.evidence, self.with_all, self.joint, [entry, other], &faintness)
        });
        let proof = &self.proofs[k];
        let mut finding = Finding {
            id: hypothesis.id().to_owned(),
            known_amplitude: None,
            parameters,
            columns: if variant.rendered { ColumnSource::Rendered } else { ColumnSource::Formula },
            located_by,
            delta_chi2: fall(self.with_all, &without.fit, &self.with_all.fit),
            p_value,
            p_value_is: None,
            family_p_value: family_wise_p_value(p_value, self.hypotheses),
            family_p_value_is: None,
            held_out_delta_chi2: proof.gain.delta_chi2,
            held_out_expected: proof.expected,
            held_out_score: proof.gain.score(),
            held_out_remark: proof.remark(),
            chosen_again: proof.chosen,
            left_out: proof.left_out.to_owned(),
            signs: self.signs.get(k).map_or_else(Signs::default, |own| Signs {
                units: own.units.to_owned(),
                effective: own.effective,
                p_value: own.p_value,
                between_frames_p_value: own.between_frames,
            }),
            resimulated_p_value: self.resimulated.get(k).copied(),
            score_sigma: deviations(neg_ln_chi2_sf(rank as f64, t)),
            snr: (t - rank as f64 + 1.0).max(0.0).sqrt(),
            channels: ByChannel::new(),
            indistinguishable_from: set,
            rivals: listed.into_iter().map(|own| own.rival).collect(),
            decided_by: decided.unwrap_or_else(|| "nothing stands beside it that would have to be decided from".to_owned()),
            sentence: String::new(),
        };
        finding.channels = by_channel(&finding);
        finding.known_amplitude = solved.ratio_beside_rivals(k, variant, &finding.rivals);
        finding.sentence = wording::finding(&finding, hypothesis.effect, hypothesis.in_force);
        finding
    }
}
