//! Fourth stage: which proposals star images confirm that took no part in choosing them.

use super::{Baseline, Screened, Selected};
use crate::diagnose::cross_validation::{Confirmed, confirm};
use crate::diagnose::crossfit::CrossFit;
use crate::diagnose::evidence::Evidence;
use crate::diagnose::fit_state::{FitState, SelectedEffect};
use crate::diagnose::refine::refine;

/// Proposals and their proofs.
pub(in crate::diagnose) struct Validated<'a> {
    pub(in crate::diagnose) baseline: &'a Baseline<'a>,
    pub(in crate::diagnose) screened: &'a Screened,
    /// The baseline's evidence with searches made finer about what was proposed.
    pub(in crate::diagnose) evidence: Evidence,
    /// Choice and size made anew in turns that leave images out.
    pub(in crate::diagnose) turns: CrossFit,
    /// All that all images proposed.
    pub(in crate::diagnose) proposals: Vec<SelectedEffect>,
    /// What came of them.
    pub(in crate::diagnose) confirmed: Confirmed,
}

impl<'a> Validated<'a> {
    /// Makes the searches finer, chooses anew in turns, and confirms.
    pub(in crate::diagnose) fn new(baseline: &'a Baseline<'a>, screened: &'a Screened, selected: Selected) -> Self {
        let asked = (screened.threshold, screened.hypotheses);
        let turns = CrossFit::new(&baseline.evidence, &baseline.joint, baseline.points, &baseline.stated, asked);
        let (mut evidence, mut proposals) = (baseline.evidence.clone(), selected.proposals);
        refine(&mut evidence, &baseline.joint, &mut proposals, &baseline.all, &baseline.stated);
        let entries = proposals.clone();
        Self { baseline, screened, evidence, turns, proposals, confirmed: Confirmed::default() }.confirmed(entries)
    }

    /// The same with more proposals beside those that are confirmed; those withheld before stay so.
    pub(in crate::diagnose) fn with_more(mut self, mut more: Vec<SelectedEffect>) -> Self {
        let before = self.confirmed.entries.len();
        refine(&mut self.evidence, &self.baseline.joint, &mut more, &self.baseline.all, &self.baseline.stated);
        self.proposals.extend(&more[before..]);
        self.confirmed(more)
    }

    fn confirmed(mut self, entries: Vec<SelectedEffect>) -> Self {
        let baseline = self.baseline;
        self.turns.credit(&self.evidence, &baseline.fit, &self.proposals);
        let fitted = |entries: &[SelectedEffect]| FitState::new(&self.evidence, &baseline.all, entries, &baseline.stated);
        let mut confirmed = confirm(&self.evidence, &self.turns, entries, fitted);
        confirmed.withheld.append(&mut self.confirmed.withheld);
        Self { confirmed, ..self }
    }
}
