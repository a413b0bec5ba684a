//! Joint test of the natural effects of known size (refraction, aberration, parallax, light deflection), before effects are selected one by one.
//! They act on every recording whose place and time are known, and they come together. One that is hardly significant still moves the stars; left
//! out, another that resembles it is estimated too large: in a few frames at one altitude refraction makes aberration twice as large as it is.
//!
//! They are tested together, at their known sizes, with no parameter free. Those that the frames refute go. If together they explain what
//! is missing, those that are significant by themselves are selected like all other effects, with a free size, which is tested against the known
//! one; those too weak to show stay in the model at their known size meanwhile.

use super::evidence::Evidence;
use super::fit_state::{AGREES, AS_GOOD, FitState, SelectedEffect, amplitude, fall};
use super::hypotheses::Hypothesis;
use super::linear_fit::Fit;
use super::linear_system::{Whitened, WhitenedSystem};
use super::noise::NoiseModel;
use crate::camera::Term;
use crate::effects::Segment;
use crate::statistics::significance::neg_ln_chi2_sf;

/// What air, site and clock leave open of sizes that are known, as a share.
const OPEN: f64 = 0.05;

/// An effect of nature that the model lacks.
struct Missing {
    /// Which hypothesis.
    hypothesis: usize,
    /// What its known size changes the residuals by.
    change: Whitened,
    parameters: Vec<f64>,
}

/// Effects that are to be in the model at their known sizes, because others of their kind are there and they are too weak to be chosen.
/// `chosen` is what stepwise selection takes; `threshold` is the surprise that a finding needs.
pub(super) fn too_weak_to_show(
    evidence: &Evidence,
    all: &[bool],
    begin: &NoiseModel,
    chosen: Vec<SelectedEffect>,
    threshold: f64,
) -> Vec<Term> {
    let is_of_nature = |entry: &SelectedEffect| missing(evidence, begin, entry.hypothesis).is_some();
    let (natural, others): (Vec<SelectedEffect>, Vec<SelectedEffect>) = chosen.into_iter().partition(is_of_nature);
    // Where nothing of nature was chosen another name may stand in its place: it is judged without any.
    let stand = FitState::new(evidence, all, if natural.is_empty() { &[] } else { &others }, begin);
    let mut together: Vec<Missing> =
        (0..evidence.hypotheses.len()).filter_map(|hypothesis| missing(evidence, &stand.noise, hypothesis)).collect();
    let worths = drop_refuted(&stand, &mut together);
    if together.len() < 2 || !explains(&stand, &together, threshold) {
        return Vec::new();
    }
    let most = worths.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let shows = |own: &Missing, worth: f64| {
        if natural.is_empty() { worth >= most } else { natural.iter().any(|entry| entry.hypothesis == own.hypothesis) }
    };
    let weak = together.into_iter().zip(worths).filter(|(own, worth)| !shows(own, *worth));
    weak.map(|(own, _)| Term { effect: evidence.hypotheses[own.hypothesis].id().to_owned(), parameters: own.parameters }).collect()
}

/// Whether an effect is significant beside what nature adds too. Nature's effects are there, at sizes that nobody chooses; one with more free
/// parameters (a seam anywhere in the frame) takes their part as well as they do, and chance adds what makes it better. So they enter at their
/// known sizes, with no parameter free, but those that the frames refute beside the effect itself; what the effect then still explains is its
/// own. `stand` holds the `accepted`; `threshold` is the surprise that a choice needs.
pub(super) fn is_needed(evidence: &Evidence, stand: &FitState, accepted: &[SelectedEffect], entry: SelectedEffect, threshold: f64) -> bool {
    if missing(evidence, &stand.noise, entry.hypothesis).is_some() {
        return true; // one of them
    }
    let is_open = |hypothesis: &usize| accepted.iter().all(|own| own.hypothesis != *hypothesis);
    let mut together: Vec<Missing> =
        (0..evidence.hypotheses.len()).filter(is_open).filter_map(|hypothesis| missing(evidence, &stand.noise, hypothesis)).collect();
    if together.is_empty() {
        return true;
    }
    let white = |entry: SelectedEffect| stand.white(evidence, &[entry]);
    let own = white(entry);
    let more: Vec<Whitened> = stand.more.iter().chain(&own).cloned().collect();
    let fit = Fit::new(&stand.system, &stand.take, &more.iter().collect::<Vec<_>>());
    drop_refuted(&FitState { more, fit, ..stand.clone() }, &mut together);
    if together.is_empty() {
        return true;
    }
    let system = moved(stand, together.iter());
    let fitted = |more: &[&Whitened]| Fit::new(&system, &stand.take, more);
    let kept: Vec<&Whitened> = stand.more.iter().collect();
    let without = fitted(&kept);
    let by_likelihood = fall(stand, &without, &fitted(&kept.iter().copied().chain(&own).collect::<Vec<_>>()));
    let beside = FitState { fit: without, system: system.clone(), ..stand.clone() };
    // What is searched for may lie elsewhere once nature has its part.
    let by_score = (0..evidence.hypotheses[entry.hypothesis].variants.len()).map(|variant| {
        let (t, rank) = beside.score(&white(SelectedEffect { variant, ..entry }));
        neg_ln_chi2_sf(rank as f64, t)
    });
    by_score.fold(neg_ln_chi2_sf(own.len() as f64, by_likelihood), f64::max) > threshold
}

/// Takes out what the frames refute, the worst first; what each of the others is worth beside the rest (fall of −2·ln of the likelihood).
fn drop_refuted(stand: &FitState, together: &mut Vec<Missing>) -> Vec<f64> {
    loop {
        let all = gain(stand, together.iter());
        let without = |k: usize| together.iter().enumerate().filter(move |(other, _)| *other != k).map(|(_, own)| own);
        let worths: Vec<f64> = (0..together.len()).map(|k| all - gain(stand, without(k))).collect();
        match worths.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).filter(|(_, value)| **value < -AS_GOOD) {
            Some((least, _)) => together.remove(least),
            None => return worths,
        };
    }
}

fn missing(evidence: &Evidence, noise: &NoiseModel, index: usize) -> Option<Missing> {
    let hypothesis: &Hypothesis = &evidence.hypotheses[index];
    let ([variant], [fitted]) = (hypothesis.variants.as_slice(), hypothesis.fitted.as_slice()) else { return None };
    if hypothesis.in_force || hypothesis.effect.segment() != Segment::Sky {
        return None;
    }
    let (known, [column]) = (hypothesis.known?, variant.columns.as_slice()) else { return None };
    let by = known - variant.start[*fitted];
    let change = evidence.white(noise, column).into_iter().map(|value| by * value).collect();
    let mut parameters = variant.start.clone();
    parameters[*fitted] = known;
    Some(Missing { hypothesis: index, change, parameters })
}

fn sum<'a>(stand: &FitState, some: impl Iterator<Item = &'a Missing>) -> Whitened {
    some.fold(vec![0.0; stand.system.residual.len()], |sum, own| sum.iter().zip(&own.change).map(|(a, b)| a + b).collect())
}

/// The linear problem with some of them in the model at their known sizes.
fn moved<'a>(stand: &FitState, some: impl Iterator<Item = &'a Missing>) -> WhitenedSystem {
    let residual = stand.system.residual.iter().zip(sum(stand, some)).map(|(a, b)| a + b).collect();
    WhitenedSystem { residual, ..stand.system.clone() }
}

/// Fall of −2·ln of the likelihood with some of them at their known sizes.
fn gain<'a>(stand: &FitState, some: impl Iterator<Item = &'a Missing>) -> f64 {
    let system = moved(stand, some);
    let more: Vec<&Whitened> = stand.more.iter().collect();
    fall(stand, &stand.fit, &Fit::new(&system, &stand.take, &more))
}

/// Whether together they explain what is missing, and as much of it as their known sizes do.
fn explains(stand: &FitState, together: &[Missing], threshold: f64) -> bool {
    let column = sum(stand, together.iter());
    let (t, rank) = stand.score(std::slice::from_ref(&column));
    let Some([size, sigma]) = amplitude(stand, &column) else { return false };
    neg_ln_chi2_sf(rank as f64, t) > threshold && (size - 1.0).abs() < AGREES * sigma.hypot(OPEN)
}
