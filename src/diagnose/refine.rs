//! Places and lengths that no derivative tells are searched for: finer about what was found, with an error from how the fit falls off.

use super::attribute::{Entry, Stand, columns};
use super::evidence::Evidence;
use super::hypotheses::finer;
use super::noise::NoiseModel;
use super::sheet::Whitened;
use crate::calibrate::Joint;

/// Halvings of the search over places and lengths.
const REFINEMENTS: usize = 5;

/// Makes the search over places and lengths finer about what was found, and tells how well it is known.
pub(super) fn refine(evidence: &mut Evidence, joint: &Joint, entries: &mut [Entry], all: &[bool], begin: &NoiseModel) {
    for k in 0..entries.len() {
        let others: Vec<Entry> = entries.iter().enumerate().filter(|(index, _)| *index != k).map(|(_, entry)| *entry).collect();
        let hypothesis = entries[k].hypothesis;
        if evidence.hypotheses[hypothesis].searched.is_none() {
            continue;
        }
        let stand = Stand::new(evidence, all, &others, begin);
        let mut seen: Vec<(f64, f64)> = Vec::new();
        for step in 0..REFINEMENTS {
            let best = evidence.hypotheses[hypothesis].variants[entries[k].variant].clone();
            let tried = finer(&evidence.hypotheses[hypothesis], &best, joint, step);
            if tried.is_empty() {
                break;
            }
            let at = evidence.hypotheses[hypothesis].variants.len();
            let count = tried.len();
            evidence.hypotheses[hypothesis].variants.extend(tried);
            let score = |variant: usize| {
                let entry = Entry { hypothesis, variant };
                let own: Vec<Whitened> = columns(evidence, &[entry]).map(|column| evidence.white(&stand.noise, column)).collect();
                stand.score(&own).0
            };
            let from = if step == 0 { 0 } else { at };
            let options: Vec<(f64, usize)> =
                std::iter::once(entries[k].variant).chain(from..at + count).map(|variant| (score(variant), variant)).collect();
            seen.extend(options.iter().filter_map(|(t, variant)| Some((evidence.hypotheses[hypothesis].searched_value(*variant)?, *t))));
            if let Some((_, variant)) = options.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)) {
                entries[k].variant = variant;
            }
        }
        if let Some(here) = evidence.hypotheses[hypothesis].searched_value(entries[k].variant).filter(|_| !seen.is_empty()) {
            let most = seen.iter().map(|(_, t)| *t).fold(0.0, f64::max);
            // Half of how far T stays within 4 of its largest (two standard errors, other places as good included). Where it falls lies between
            // two places tried, the last within and the first beyond: halfway.
            let reach = |sign: f64| {
                let on_this_side = |within: bool| {
                    let of = move |(value, t): &(f64, f64)| ((*t > most - 4.0) == within).then_some(sign * (value - here));
                    seen.iter().filter_map(of).filter(|distance| *distance >= 0.0)
                };
                let last = on_this_side(true).fold(0.0, f64::max);
                let beyond = on_this_side(false).filter(|distance| *distance > last).fold(f64::INFINITY, f64::min);
                if beyond.is_finite() { f64::midpoint(last, beyond) } else { last }
            };
            let sigma = 0.5 * reach(1.0).max(reach(-1.0));
            evidence.hypotheses[hypothesis].variants[entries[k].variant].searched_sigma = Some(sigma).filter(|sigma| *sigma > 0.0);
        }
    }
}
