//! What was found on a part of the frames is confirmed by the others, or goes.

use super::attribute::{Entry, Stand, select};
use super::evidence::Evidence;
use super::findings::statistic;
use super::noise::NoiseModel;
use super::prove::{Again, Proof, folds, prove};

/// What the confirmation works with.
pub(super) struct Confirmation<'a> {
    pub(super) evidence: &'a Evidence,
    /// Images that effects were looked for in.
    pub(super) training: &'a [bool],
    /// Masks of held-out images.
    pub(super) tests: &'a [Vec<bool>],
    pub(super) begin: &'a NoiseModel,
    /// The surprise that a choice needs, and for each mask what is chosen without its images; nothing where the choice was made without them
    /// anyhow.
    repeated: Option<(f64, Vec<Vec<Entry>>)>,
}

/// An effect that was tried and does not stand, and why.
pub(super) type Withheld = (Entry, Vec<String>);

impl<'a> Confirmation<'a> {
    /// Where each frame is left out in its turn the choice of effects is repeated without it, by the same `threshold`.
    pub(super) fn new(
        evidence: &'a Evidence,
        training: &'a [bool],
        tests: &'a [Vec<bool>],
        begin: &'a NoiseModel,
        repeated: Option<f64>,
    ) -> Self {
        let repeated = repeated.map(|threshold| {
            let without = |test: &Vec<bool>| training.iter().zip(test).map(|(training, test)| *training && !*test).collect::<Vec<bool>>();
            (threshold, tests.iter().map(|test| select(evidence, &without(test), begin, threshold).0).collect())
        });
        Self { evidence, training, tests, begin, repeated }
    }

    /// For each mask whether an effect is chosen without its images.
    fn again(&self, entry: Entry) -> Option<Again> {
        let (threshold, chosen) = self.repeated.as_ref()?;
        let in_turn = |own: &Vec<Entry>| own.iter().any(|other| other.hypothesis == entry.hypothesis);
        Some(Again { threshold: *threshold, chosen: chosen.iter().map(in_turn).collect() })
    }

    /// In how many of how many turns an effect was chosen again.
    pub(super) fn chosen_again(&self, entry: Entry) -> Option<[usize; 2]> {
        let again = self.again(entry)?;
        Some([again.chosen.iter().filter(|own| **own).count(), again.chosen.len()])
    }

    fn proofs(&self, stand: &Stand, entries: &[Entry]) -> Vec<Proof> {
        (0..entries.len()).map(|k| proof(self.evidence, stand, entries, k, self.tests, self.again(entries[k]).as_ref())).collect()
    }

    /// Proofs of those that stand; the others leave `entries`, the least first.
    pub(super) fn confirm(&self, entries: &mut Vec<Entry>) -> (Vec<Proof>, Vec<Withheld>, Vec<String>) {
        let evidence = self.evidence;
        let stand = |entries: &[Entry]| Stand::new(evidence, self.training, entries, self.begin);
        let mut proofs = self.proofs(&stand(entries), entries);
        let (mut withheld, mut warnings) = (Vec::new(), Vec::new());
        loop {
            if proofs.iter().any(|proof| proof.powerless && !proof.confirms) && self.tests.len() == 1 {
                // The locked frames hold too little of it: every frame in its turn decides.
                let turns = folds(evidence, &[]);
                let stand = Stand::new(evidence, &vec![true; evidence.images.len()], entries, self.begin);
                for (k, own) in proofs.iter_mut().enumerate().filter(|(_, own)| own.powerless && !own.confirms) {
                    *own = proof(evidence, &stand, entries, k, &turns, None);
                }
            }
            // The least of those that do not stand goes, and the others are asked anew: beside it they may not have been needed.
            let weakest =
                (0..entries.len()).filter(|k| !proofs[*k].confirms).min_by(|a, b| proofs[*a].expected.total_cmp(&proofs[*b].expected));
            let Some(weakest) = weakest else { return (proofs, withheld, warnings) };
            let Proof { delta_chi2: held, expected, .. } = proofs[weakest];
            let entry = entries.remove(weakest);
            let id = evidence.hypotheses[entry.hypothesis].id();
            warnings.push(format!(
                "{id} was found on the training part and not confirmed on the held-out one (χ² falls by {held:.1} where {expected:.1} is expected): it is not claimed"
            ));
            let against = format!("frames that were not used do not confirm it (χ² falls by {held:.1} where {expected:.1} is expected)");
            withheld.push((entry, vec![against]));
            proofs = self.proofs(&stand(entries), entries);
        }
    }
}

/// The proof of entry `k` on held-out images; `again` as in [`prove`].
pub(super) fn proof(evidence: &Evidence, stand: &Stand, entries: &[Entry], k: usize, tests: &[Vec<bool>], again: Option<&Again>) -> Proof {
    prove(evidence, stand, entries, k, (tests, again), statistic(evidence, stand, entries, k))
}
