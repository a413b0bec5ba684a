//! Third stage: the effects that all star images together propose.

use super::{Baseline, Screened};
use crate::diagnose::fit_state::SelectedEffect;
use crate::diagnose::stepwise::select;

/// What stepwise selection on all images proposes; nothing where nothing is missing.
pub(in crate::diagnose) struct Selected {
    pub(in crate::diagnose) proposals: Vec<SelectedEffect>,
}

impl Selected {
    /// Selects.
    pub(in crate::diagnose) fn new(baseline: &Baseline, screened: &Screened) -> Self {
        if !screened.significant {
            return Self { proposals: Vec::new() };
        }
        let (proposals, _) = select(&baseline.evidence, &baseline.all, &baseline.stated, screened.threshold);
        Self { proposals }
    }
}
