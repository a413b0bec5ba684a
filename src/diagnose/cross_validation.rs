//! Cross-validation of the effects chosen on all images: an effect that held-out images do not confirm is dropped.

use super::crossfit::{CrossFit, Proof, Proposal};
use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect};

/// An effect that was tried and does not stand, and why.
#[derive(Clone, Debug)]
pub(super) struct Withheld {
    /// The effect.
    pub(super) entry: SelectedEffect,
    /// The tests that failed, in words.
    pub(super) against: Vec<String>,
    /// Fall of χ² on what took part in nothing.
    pub(super) held_out_delta_chi2: Option<f64>,
}

/// What came of the proposals of all images.
#[derive(Clone, Debug, Default)]
pub(super) struct Confirmed {
    /// Those that stand,
    pub(super) entries: Vec<SelectedEffect>,
    /// with their proofs.
    pub(super) proofs: Vec<Proof>,
    /// The others.
    pub(super) withheld: Vec<Withheld>,
}

/// Confirms proposals, already credited; those that are not leave, the least first, and the others are asked anew: beside it they may show
/// otherwise. `stand` fits all images with some of them.
pub(super) fn confirm(
    evidence: &Evidence,
    tried: &CrossFit,
    mut entries: Vec<SelectedEffect>,
    stand: impl Fn(&[SelectedEffect]) -> FitState,
) -> Confirmed {
    let mut withheld = Vec::new();
    loop {
        if entries.is_empty() {
            return Confirmed { withheld, ..Confirmed::default() };
        }
        let fitted = stand(&entries);
        let proof = |entry: &SelectedEffect| tried.proof(evidence, &fitted, &entries, Proposal::Entry(*entry));
        let proofs: Vec<Proof> = entries.iter().map(proof).collect();
        let failed = (0..entries.len()).filter_map(|k| Some((k, proofs[k].fails()?)));
        let Some((weakest, against)) = failed.min_by(|(a, _), (b, _)| proofs[*a].statistic.total_cmp(&proofs[*b].statistic)) else {
            return Confirmed { entries, proofs, withheld };
        };
        let held_out_delta_chi2 = Some(proofs[weakest].gain.delta_chi2);
        withheld.push(Withheld { entry: entries.remove(weakest), against: vec![against], held_out_delta_chi2 });
    }
}
