//! Stepwise selection: effects enter one by one by the score of their columns, and leave where others make them superfluous.

use super::evidence::Evidence;
use super::fit_state::{AGREES, AS_GOOD, FitState, SelectedEffect, UNOBSERVABLE, amplitude, cosine, fall, survival};
use super::linear_fit::Fit;
use super::linear_system::Whitened;
use super::noise::NoiseModel;
use super::omitted_nature::is_needed;
use super::scan::{Asks, Scan};
use crate::statistics::order::sort_by;
use crate::statistics::significance::neg_ln_chi2_sf;

/// A formula takes the place of the column that was rendered if it is better by this surprise.
const FORMULA_BETTER_BY: f64 = 2.0;
/// Effects are judged by their likelihood from this surprise of their score on (p of one in a hundred),
const REFIT_FROM: f64 = 4.6;
/// to this beyond the threshold.
const REFIT_BEYOND: f64 = 3.0;
/// Entries at most.
const MAX_EFFECTS: usize = 6;
/// Rounds in which accepted effects may give way to others.
const EXCHANGES: usize = 2;
/// Effects whose columns have a larger cosine are one class; the more usual name is taken.
pub(super) const SAME: f64 = 0.98;
/// Effects of which less is left have to be of a plausible size,
const WEAK: f64 = 0.1;
/// not this many times larger than is usual.
const IMPLAUSIBLE: f64 = 10.0;
/// Range over which a size would be looked for if nobody knew it, in units of the known size.
const PRIOR_RANGE: f64 = 4.0;

/// A hypothesis at its best variant.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    /// Which.
    pub(super) entry: SelectedEffect,
    /// −ln p, the search over variants not counted.
    pub(super) surprise: f64,
    /// Whether its size is the known one.
    pub(super) agrees: bool,
    /// Twice the surprise, the search over variants counted, plus what agreement with a known size is worth.
    pub(super) evidence: f64,
}

/// The candidates, each at its best variant. `threshold` is the surprise that a finding needs: what comes near to it by its score is judged
/// by its likelihood.
pub(super) fn candidates(evidence: &Evidence, stand: &FitState, scan: &Scan, threshold: f64) -> Vec<Candidate> {
    let refitted = REFIT_FROM..threshold + REFIT_BEYOND;
    let mut best: Vec<Option<Candidate>> = vec![None; evidence.hypotheses.len()];
    for group in &scan.groups {
        let Asks::Hypothesis(hypothesis, variant) = group.asks else { continue };
        let surprise = group.surprise();
        // Rendered variants come first; a formula has to be better than chance makes it to take their place.
        let of_formula = evidence.hypotheses[hypothesis].shifts.is_some() && !evidence.hypotheses[hypothesis].variants[variant].rendered;
        let handicap = if of_formula { FORMULA_BETTER_BY } else { 0.0 };
        if best[hypothesis].as_ref().is_none_or(|best| surprise > best.surprise + handicap) {
            let entry = SelectedEffect { hypothesis, variant };
            let surprise = if refitted.contains(&surprise) { surprise.max(after_refit(evidence, stand, entry)) } else { surprise };
            let agrees = agreement(evidence, stand, entry);
            // A size that is known has a sign that is known: chance would have to hit that too.
            let surprise = if agrees > 0.0 { surprise + std::f64::consts::LN_2 } else { surprise };
            let mut candidate = Candidate { entry, surprise, agrees: agrees > 0.0, evidence: 2.0 * surprise };
            candidate.evidence += agrees - 2.0 * searched(evidence, hypothesis);
            best[hypothesis] = Some(candidate);
        }
    }
    best.into_iter().flatten().collect()
}

/// Surprise of the fall of −2·ln of the likelihood once everything is fitted anew with the effect. The score at the start sees stars that the
/// effect moves far as outliers, and they pull little; with the effect they pull fully. In units of the scatter of the scores.
fn after_refit(evidence: &Evidence, stand: &FitState, entry: SelectedEffect) -> f64 {
    let own: Vec<Whitened> = stand.white(evidence, &[entry]);
    let (_, rank) = stand.score(&own);
    let more: Vec<&Whitened> = stand.more.iter().chain(&own).collect();
    let with = Fit::new(&stand.system, &stand.take, &more);
    let fall = fall(stand, &stand.fit, &with);
    neg_ln_chi2_sf(rank as f64, fall)
}

/// What it is worth that a size is as known beforehand, on the scale of BIC. Of an effect that the model contains at that size it is worth
/// nothing: that it is there is no finding, and no explanation of what is missing.
pub(super) fn agreement(evidence: &Evidence, stand: &FitState, entry: SelectedEffect) -> f64 {
    let hypothesis = &evidence.hypotheses[entry.hypothesis];
    let variant = &hypothesis.variants[entry.variant];
    let (Some(known), [column], false) = (hypothesis.known, variant.columns.as_slice(), hypothesis.in_force) else { return 0.0 };
    let column = evidence.white(&stand.noise, column);
    let Some([change, sigma]) = amplitude(stand, &column) else { return 0.0 };
    let value = variant.start[hypothesis.fitted[0]] + change;
    let (ratio, error) = (value / known, (sigma / known).abs());
    if (ratio - 1.0).abs() < AGREES * error { 2.0 * (PRIOR_RANGE / error).ln().max(0.0) } else { 0.0 }
}

/// Effects enter by evidence, among those that are significant for the family of all; each entry is followed by deletions.
/// `threshold` is the surprise asked for.
pub(super) fn select(evidence: &Evidence, allowed: &[bool], begin: &NoiseModel, threshold: f64) -> (Vec<SelectedEffect>, FitState) {
    let mut accepted: Vec<SelectedEffect> = Vec::new();
    let mut stand = FitState::new(evidence, allowed, &accepted, begin);
    for _ in 0..MAX_EFFECTS {
        let free = |index: usize| accepted.iter().all(|entry| entry.hypothesis != index) && !evidence.hypotheses[index].variants.is_empty();
        let scan = Scan::hypotheses(evidence, &stand.noise, &stand.system, &stand.fit, free);
        let mut found = candidates(evidence, &stand, &scan, threshold);
        found.retain(|candidate| {
            let asked = threshold + searched(evidence, candidate.entry.hypothesis);
            candidate.surprise > asked
                && is_observable(evidence, &stand, candidate.entry)
                && is_needed(evidence, &stand, &accepted, candidate.entry, asked)
        });
        let Some(chosen) = choose(evidence, &stand, &found) else { break };
        accepted.push(chosen);
        stand = FitState::new(evidence, allowed, &accepted, &stand.noise);
        // Deletion: whoever is not significant beside the others goes.
        let mut k = 0;
        while accepted.len() > 1 && k + 1 < accepted.len() {
            let mut rest = accepted.clone();
            let tried = rest.remove(k);
            let without = FitState::new(evidence, allowed, &rest, &stand.noise);
            let own: Vec<Whitened> = without.white(evidence, &[tried]);
            let (t, rank) = without.score(&own);
            if neg_ln_chi2_sf(rank as f64, t) < threshold {
                accepted = rest;
                stand = without;
            } else {
                k += 1;
            }
        }
    }
    // Exchange: who entered first was judged without the others.
    for _ in 0..EXCHANGES {
        let before = accepted.clone();
        for k in 0..accepted.len() {
            let mut others = accepted.clone();
            let own = others.remove(k);
            if others.is_empty() {
                break;
            }
            let without = FitState::new(evidence, allowed, &others, &stand.noise);
            let free =
                |index: usize| others.iter().all(|entry| entry.hypothesis != index) && !evidence.hypotheses[index].variants.is_empty();
            let scan = Scan::hypotheses(evidence, &without.noise, &without.system, &without.fit, free);
            let mut found = candidates(evidence, &without, &scan, threshold);
            found.retain(|candidate| is_observable(evidence, &without, candidate.entry));
            let better = choose(evidence, &without, &found).filter(|better| {
                let asked = threshold + searched(evidence, better.hypothesis);
                better.hypothesis != own.hypothesis && is_needed(evidence, &without, &others, *better, asked)
            });
            if let Some(better) = better {
                accepted[k] = better;
            }
        }
        if accepted == before {
            break;
        }
        stand = FitState::new(evidence, allowed, &accepted, &stand.noise);
    }
    (accepted, stand)
}

/// What a search over variants costs: the largest of so many.
pub(super) fn searched(evidence: &Evidence, hypothesis: usize) -> f64 {
    (evidence.hypotheses[hypothesis].variants.len() as f64).ln() * 0.5
}

/// Whether enough of the effect is left to be claimed. Of what is nearly all taken up a small trace needs a large effect: one that is many
/// times larger than any is no explanation.
pub(super) fn is_observable(evidence: &Evidence, stand: &FitState, entry: SelectedEffect) -> bool {
    let own: Vec<Whitened> = stand.white(evidence, &[entry]);
    let left = survival(stand, &own);
    if left < UNOBSERVABLE {
        return false;
    }
    let hypothesis = &evidence.hypotheses[entry.hypothesis];
    left > WEAK
        || hypothesis.fitted.iter().zip(&own).all(|(index, column)| {
            let typical = hypothesis.effect.parameters()[*index].typical.abs();
            let value = amplitude(stand, column).map_or(0.0, |[change, _]| change.abs());
            typical == 0.0 || value < IMPLAUSIBLE * typical
        })
}

/// The candidate of greatest evidence; of those of its class that are about as good, the more usual name, and the smaller displacement.
pub(super) fn choose(evidence: &Evidence, stand: &FitState, found: &[Candidate]) -> Option<SelectedEffect> {
    let best = found.iter().max_by(|a, b| a.evidence.total_cmp(&b.evidence))?;
    let white = |entry: SelectedEffect| stand.white(evidence, &[entry]);
    let own = white(best.entry);
    let mut class: Vec<&Candidate> = found
        .iter()
        .filter(|other| best.evidence - other.evidence < AS_GOOD && cosine(&stand.fit, &own, &white(other.entry)) > SAME)
        .collect();
    // Of those that leave the same trace one whose size is what the recording tells; else that which need not be many times larger than
    // its trace.
    let raw_size = |entry: SelectedEffect| 1.0 / survival(stand, &white(entry)).max(f64::MIN_POSITIVE);
    sort_by(&mut class, |a, b| {
        let name = |candidate: &Candidate| evidence.hypotheses[candidate.entry.hypothesis].effect.facts().name_rank;
        b.agrees.cmp(&a.agrees).then(name(a).cmp(&name(b))).then(raw_size(a.entry).total_cmp(&raw_size(b.entry)))
    });
    class.first().map(|candidate| candidate.entry)
}
