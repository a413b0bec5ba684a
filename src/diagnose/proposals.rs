//! All proposals of the cross-fitting and their hold-out scores, for the result. Over this list the mean score is below zero if there is no effect.

use super::cross_validation::Withheld;
use super::crossfit::{CrossFit, Proposal};
use super::diagnosis::{LeftOut, Proposed};
use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect};

/// Of what turns alone propose.
const NOT_SIGNIFICANT: &str = "parts of the recording propose it, all star images together do not";

/// Every proposal: those of all images (`proposals`), named (`kept`) or withheld, then those of turns alone. `stand` holds `kept`.
pub(super) fn proposed(
    evidence: &Evidence,
    tried: &CrossFit,
    stand: &FitState,
    kept: &[SelectedEffect],
    proposals: &[SelectedEffect],
    withheld: &[Withheld],
) -> Vec<Proposed> {
    let of = |hypothesis: &usize| {
        let named = kept.iter().find(|entry| entry.hypothesis == *hypothesis);
        let by_all = named.or_else(|| proposals.iter().find(|entry| entry.hypothesis == *hypothesis));
        let proposal = by_all.map_or(Proposal::Turns(*hypothesis), |entry| Proposal::Entry(*entry));
        let proof = tried.proof(evidence, stand, kept, proposal);
        let against = withheld.iter().find(|own| own.entry.hypothesis == *hypothesis).map(|own| own.against.clone());
        Proposed {
            id: evidence.hypotheses[*hypothesis].id().to_owned(),
            named: named.is_some(),
            by_all_images: by_all.is_some(),
            delta_chi2: proof.statistic,
            held_out_delta_chi2: proof.gain.delta_chi2,
            held_out_expected: proof.expected,
            held_out_score: proof.gain.score(),
            chosen_again: proof.chosen,
            left_out: proof.left_out.to_owned(),
            against: match (named, against) {
                (Some(_), _) => Vec::new(),
                (None, Some(against)) => against,
                (None, None) => vec![NOT_SIGNIFICANT.to_owned()],
            },
        }
    };
    tried.proposed().iter().map(of).collect()
}

/// What was left out in turn.
pub(super) fn left_out(evidence: &Evidence, tried: &CrossFit) -> LeftOut {
    let block = &tried.folds.block;
    let count = block.iter().max().map_or(0, |last| last + 1);
    let frames_of = |own: usize| (0..block.len()).filter(|place| block[*place] == own).map(|place| evidence.frames[place].0).collect();
    let [turns, turns_of_stars] = tried.counts();
    LeftOut { what: tried.folds.words(false).to_owned(), blocks: (0..count).map(frames_of).collect(), turns, turns_of_stars }
}
