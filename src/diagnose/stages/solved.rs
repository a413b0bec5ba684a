//! Fifth stage: everything solved with the confirmed effects in force, and the test of what is left.

use super::Validated;
use crate::camera::Model;
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::final_fit::FinalFit;
use crate::diagnose::fit_state::SelectedEffect;
use crate::diagnose::omnibus::Omnibus;
use crate::diagnose::refine::{place, refine};
use crate::diagnose::scan::Scan;
use crate::diagnose::untimed::follow;

/// Streams of the simulations that answer the test of what is left, the first time and with more effects.
const STREAM: u64 = 2;
const STREAM_WITH_MORE: u64 = 3;

/// All images solved without linearisation.
pub(in crate::diagnose) struct Solved<'a> {
    pub(in crate::diagnose) validated: Validated<'a>,
    pub(in crate::diagnose) fit: FinalFit,
    /// Questions beside all that is confirmed, and their answer; none where nothing is missing.
    pub(in crate::diagnose) left: Option<(Scan, Omnibus)>,
}

impl<'a> Solved<'a> {
    /// Solves anew with everything that is confirmed free, and with the searches made finer beside it alone.
    pub(in crate::diagnose) fn new(mut validated: Validated<'a>) -> Result<Self, DiagnoseError> {
        let baseline = validated.baseline;
        let (evidence, entries) = (&mut validated.evidence, &mut validated.confirmed.entries);
        if entries.len() < validated.proposals.len() {
            refine(evidence, &baseline.joint, entries, &baseline.all, &baseline.stated);
        }
        place(evidence, &baseline.joint, entries, &baseline.all, &baseline.stated);
        follow(evidence, &baseline.joint, entries, &baseline.all, &baseline.stated);
        let fit = solve(&validated, &validated.confirmed.entries, None)?;
        Ok(Self { validated, fit, left: None })
    }

    /// The effects confirmed.
    pub(in crate::diagnose) fn entries(&self) -> &[SelectedEffect] {
        &self.validated.confirmed.entries
    }

    /// Everything solved with some of the effects alone, under a zenith that was searched for from where this solution has it.
    pub(in crate::diagnose) fn with_only(&self, entries: &[SelectedEffect]) -> Result<FinalFit, DiagnoseError> {
        solve(&self.validated, entries, Some(self.fit.joint.model()))
    }

    /// Tests what is left. Where something is, effects that were hidden behind what was not confirmed are proposed too, and held to the same
    /// proof. Where nothing is missing nothing can be left: it is not asked for.
    pub(in crate::diagnose) fn with_remainder(mut self) -> Result<Self, DiagnoseError> {
        let (baseline, screened) = (self.validated.baseline, self.validated.screened);
        if !screened.significant {
            return Ok(self);
        }
        let left = if self.entries().is_empty() { (self.fit.scan(), screened.test.clone()) } else { self.ask(STREAM) };
        let something = left.1.p_value < baseline.options.alpha;
        self.left = Some(left);
        if !something {
            return Ok(self);
        }
        let rejected: Vec<usize> = self.validated.confirmed.withheld.iter().map(|own| own.entry.hypothesis).collect();
        let more = self.fit.more(&self.validated.evidence, self.entries(), &rejected, screened.threshold);
        if more.len() == self.entries().len() {
            return Ok(self);
        }
        let mut solved = Self::new(self.validated.with_more(more))?;
        solved.left = Some(solved.ask(STREAM_WITH_MORE));
        Ok(solved)
    }

    fn ask(&self, stream: u64) -> (Scan, Omnibus) {
        let scan = self.fit.scan();
        let test = self.fit.omnibus(&scan, &self.validated.baseline.options, stream);
        (scan, test)
    }
}

fn solve(validated: &Validated, entries: &[SelectedEffect], nearer: Option<&Model>) -> Result<FinalFit, DiagnoseError> {
    let baseline = validated.baseline;
    if entries.is_empty() {
        return Ok(FinalFit::unchanged(&baseline.joint, &validated.evidence, &baseline.fit));
    }
    FinalFit::new(&baseline.joint, baseline.points, baseline.telemetry, &baseline.options, &validated.evidence, entries, nearer)
}
