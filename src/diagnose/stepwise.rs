//! Stepwise selection: effects enter one by one by the score of their columns, and leave where others make them superfluous.

use super::clusters::coherent;
use super::evidence::Evidence;
use super::linear_system::{Fit, Whitened, WhitenedSystem, dot};
use super::noise::{NoiseModel, freedom};
use super::omitted_nature::is_needed;
use super::scan::{Asks, Scan};
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
/// Rivals whose evidence differs by less (odds of 100 : 1) are as good: 2·ln 100.
pub(super) const AS_GOOD: f64 = 9.21;
/// Effects whose columns have a larger cosine are one class; the more usual name is taken.
pub(super) const SAME: f64 = 0.98;
/// Below this survival nothing is claimed.
pub(super) const UNOBSERVABLE: f64 = 0.02;
/// Effects of which less is left have to be of a plausible size,
const WEAK: f64 = 0.1;
/// not this many times larger than is usual.
const IMPLAUSIBLE: f64 = 10.0;
/// A known size is believed if the size found agrees within so many standard errors; if it does not, it is not that effect alone.
pub(super) const AGREES: f64 = 3.0;
/// Range over which a size would be looked for if nobody knew it, in units of the known size.
const PRIOR_RANGE: f64 = 4.0;

/// An effect that has entered: hypothesis and variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SelectedEffect {
    /// Index of the hypothesis.
    pub(super) hypothesis: usize,
    /// Index of its variant.
    pub(super) variant: usize,
}

/// Everything as it stands with some effects accepted.
#[derive(Clone, Debug)]
pub(super) struct FitState {
    /// The noise.
    pub(super) noise: NoiseModel,
    /// The linear problem, whitened by it.
    pub(super) sheet: WhitenedSystem,
    /// The images that take part.
    pub(super) take: Vec<bool>,
    /// The accepted effects' columns.
    pub(super) more: Vec<Whitened>,
    /// The fit.
    pub(super) fit: Fit,
}

impl FitState {
    /// With effects accepted, on the images allowed. The noise is found anew.
    pub(super) fn new(evidence: &Evidence, allowed: &[bool], accepted: &[SelectedEffect], begin: &NoiseModel) -> Self {
        const TURNS: usize = 3;
        let mut noise = begin.clone();
        let mut take = allowed.to_vec();
        let mut turn = 0;
        loop {
            let sheet = evidence.sheet(&noise);
            let more: Vec<Whitened> = columns(evidence, accepted).map(|column| evidence.white(&noise, column)).collect();
            let fit = Fit::new(&sheet, &take, &more.iter().collect::<Vec<_>>());
            turn += 1;
            if turn == TURNS {
                return Self { noise, sheet, take, more, fit };
            }
            let residual_px = noise.unwhiten(&evidence.images, &evidence.place, &full_residual(&sheet, &fit, &more, &take));
            let free = freedom(&sheet, &take, sheet.camera.len() + more.len());
            let together = coherent(evidence, &noise, &residual_px, allowed);
            let alone: Vec<bool> = take.iter().zip(&together).map(|(take, together)| *take && !together).collect();
            let found = NoiseModel::find(&evidence.images, &evidence.place, &residual_px, &alone, free, &evidence.frame_factors);
            let plausible = found.plausible(&evidence.images, &evidence.place, &residual_px);
            let believed = plausible.iter().zip(&together).map(|(plausible, together)| *plausible || *together);
            let next: Vec<bool> = allowed.iter().zip(believed).map(|(allowed, believed)| *allowed && believed).collect();
            let settled = next == take
                && (found.factor / noise.factor - 1.0).abs() < 0.01
                && found.tail_degrees.total_cmp(&noise.tail_degrees).is_eq();
            if settled {
                return Self { noise, sheet, take, more, fit };
            }
            (noise, take) = (found, next);
        }
    }

    /// The statistic of some columns: what they explain of ψ, over c; and the degrees of freedom.
    pub(super) fn score(&self, columns: &[Whitened]) -> (f64, usize) {
        let rest: Vec<Whitened> = columns.iter().map(|column| self.fit.project(column)).collect();
        let (basis, _) = basis(&rest, columns, &self.fit);
        let t = basis.iter().map(|b| dot(b, &self.fit.psi).powi(2)).sum::<f64>() / self.fit.c;
        (t, basis.len())
    }

    /// ln of the numbers that take part.
    pub(super) fn ln_n(&self) -> f64 {
        (2.0 * self.take.iter().filter(|take| **take).count() as f64).max(1.0).ln()
    }
}

/// Residuals of all images, those not taken too, each frame's attitude as fitted to those taken; x, y, … whitened.
fn full_residual(sheet: &WhitenedSystem, fit: &Fit, more: &[Whitened], take: &[bool]) -> Vec<f64> {
    // Shared parameters are known; a frame's own change follows from what they leave.
    let mut residual = sheet.residual.clone();
    for (column, change) in sheet.camera.iter().chain(more).zip(fit.change.iter()) {
        for (a, b) in residual.iter_mut().zip(column) {
            *a += change * b;
        }
    }
    let own = super::frame_nuisance::own_changes(sheet, take, &residual, &fit.residual);
    for (column, changes) in sheet.own.iter().zip(own) {
        for (k, value) in residual.iter_mut().enumerate() {
            *value += changes[sheet.frame[k / 2]] * column[k];
        }
    }
    for (k, value) in residual.iter_mut().enumerate() {
        if take[k / 2] {
            *value = fit.residual[k];
        }
    }
    residual
}

/// The accepted effects' columns.
pub(super) fn columns<'a>(evidence: &'a Evidence, accepted: &'a [SelectedEffect]) -> impl Iterator<Item = &'a crate::calibrate::Column> {
    accepted.iter().flat_map(|entry| evidence.hypotheses[entry.hypothesis].variants[entry.variant].columns.iter())
}

/// Orthonormal basis of projected columns, those dropped of which too little is left; and the lengths of what is left.
pub(super) fn basis(rest: &[Whitened], raw: &[Whitened], fit: &Fit) -> (Vec<Whitened>, Vec<f64>) {
    let mut found: Vec<Whitened> = Vec::new();
    let mut lengths = Vec::new();
    for (column, raw) in rest.iter().zip(raw) {
        let mut vector = column.clone();
        for _ in 0..2 {
            for b in &found {
                let along = dot(b, &vector);
                for (v, b) in vector.iter_mut().zip(b) {
                    *v -= along * b;
                }
            }
        }
        let length = dot(&vector, &vector).sqrt();
        lengths.push(dot(column, column).sqrt());
        if length > 1e-4 * fit.length_squared(raw).sqrt() && length > 0.0 {
            for v in &mut vector {
                *v /= length;
            }
            found.push(vector);
        }
    }
    (found, lengths)
}

/// Cosine of the largest principal angle's complement: how alike two sets of projected columns are (their best aligned directions).
pub(super) fn cosine(fit: &Fit, a: &[Whitened], b: &[Whitened]) -> f64 {
    let projected = |columns: &[Whitened]| columns.iter().map(|column| fit.project(column)).collect::<Vec<_>>();
    let (a, _) = basis(&projected(a), a, fit);
    let (b, _) = basis(&projected(b), b, fit);
    if a.is_empty() || b.is_empty() {
        return 0.0;
    }
    let matrix = nalgebra::DMatrix::from_fn(a.len(), b.len(), |i, j| dot(&a[i], &b[j]));
    matrix.singular_values().max().min(1.0)
}

/// Share of a hypothesis's displacement (rms) that attitudes and camera leave: of its best surviving parameter.
pub(super) fn survival(stand: &FitState, columns: &[Whitened]) -> f64 {
    let of = |column: &Whitened| {
        let raw = stand.fit.length_squared(column);
        let rest = stand.fit.project(column);
        if raw > 0.0 { (dot(&rest, &rest) / raw).sqrt() } else { 0.0 }
    };
    columns.iter().map(of).fold(0.0, f64::max)
}

/// Value and standard error of the only parameter of a set of columns, given a fit, as a change from the point of linearisation.
pub(super) fn amplitude(stand: &FitState, column: &Whitened) -> Option<[f64; 2]> {
    let rest = stand.fit.project(column);
    let square = dot(&rest, &rest);
    (square > 0.0).then(|| {
        let change = -dot(&rest, &stand.fit.psi) / (square * stand.fit.d);
        [change, (stand.fit.c / square).sqrt() / stand.fit.d]
    })
}

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
    let own: Vec<Whitened> = columns(evidence, &[entry]).map(|column| evidence.white(&stand.noise, column)).collect();
    let (_, rank) = stand.score(&own);
    let more: Vec<&Whitened> = stand.more.iter().chain(&own).collect();
    let with = Fit::new(&stand.sheet, &stand.take, &more);
    let fall = fall(stand, &stand.fit, &with);
    neg_ln_chi2_sf(rank as f64, fall)
}

/// Fall of −2·ln of the likelihood from one fit to another of the same images, in units in which a superfluous parameter gains one.
pub(super) fn fall(stand: &FitState, from: &Fit, to: &Fit) -> f64 {
    let cost = |fit: &Fit| super::descent::cost(&fit.residual, &stand.take, stand.sheet.tail_degrees);
    (cost(from) - cost(to)) * stand.fit.d / stand.fit.c
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
        let scan = Scan::hypotheses(evidence, &stand.noise, &stand.sheet, &stand.fit, free);
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
            let own: Vec<Whitened> = columns(evidence, &[tried]).map(|column| evidence.white(&without.noise, column)).collect();
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
            let scan = Scan::hypotheses(evidence, &without.noise, &without.sheet, &without.fit, free);
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
    let own: Vec<Whitened> = columns(evidence, &[entry]).map(|column| evidence.white(&stand.noise, column)).collect();
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
    let white =
        |entry: SelectedEffect| columns(evidence, &[entry]).map(|column| evidence.white(&stand.noise, column)).collect::<Vec<Whitened>>();
    let own = white(best.entry);
    let mut class: Vec<&Candidate> = found
        .iter()
        .filter(|other| best.evidence - other.evidence < AS_GOOD && cosine(&stand.fit, &own, &white(other.entry)) > SAME)
        .collect();
    // Of those that leave the same trace one whose size is what the recording tells; else that which need not be many times larger than
    // its trace.
    let raw_size = |entry: SelectedEffect| 1.0 / survival(stand, &white(entry)).max(f64::MIN_POSITIVE);
    class.sort_by(|a, b| {
        let name = |candidate: &Candidate| evidence.hypotheses[candidate.entry.hypothesis].effect.facts().name_rank;
        b.agrees.cmp(&a.agrees).then(name(a).cmp(&name(b))).then(raw_size(a.entry).total_cmp(&raw_size(b.entry)))
    });
    class.first().map(|candidate| candidate.entry)
}

impl FitState {
    /// Whitened residuals of all images, those that take no part too.
    pub(super) fn everywhere(&self) -> Vec<f64> {
        full_residual(&self.sheet, &self.fit, &self.more, &self.take)
    }
}
