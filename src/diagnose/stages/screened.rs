//! Second stage: whether anything is missing at all, and where it shows.

use super::Baseline;
use crate::camera::Term;
use crate::diagnose::diagnosis::Located;
use crate::diagnose::located::located;
use crate::diagnose::null_distribution::independent;
use crate::diagnose::omitted_nature::too_weak_to_show;
use crate::diagnose::omnibus::{Omnibus, omnibus};
use crate::diagnose::permutation::{Permutations, permute};
use crate::diagnose::scan::Scan;
use crate::diagnose::stepwise::select;

/// What the omnibus test says, and what follows from it for a single effect.
pub(in crate::diagnose) struct Screened {
    pub(in crate::diagnose) test: Omnibus,
    /// Whether something is missing.
    pub(in crate::diagnose) significant: bool,
    /// Independent hypotheses that the family amounts to.
    pub(in crate::diagnose) hypotheses: f64,
    /// Surprise that an effect needs.
    pub(in crate::diagnose) threshold: f64,
    /// Covariates that the residuals follow.
    pub(in crate::diagnose) located: Vec<Located>,
}

impl Screened {
    /// Asks all questions of all images, and of simulated recordings without any effect.
    pub(in crate::diagnose) fn new(baseline: &Baseline) -> Self {
        let (evidence, fit, options) = (&baseline.evidence, &baseline.fit, &baseline.options);
        let scan = Scan::new(evidence, &fit.noise, &fit.system, &fit.fit, |_| true);
        let test = omnibus(evidence, fit, &scan, options, (1, options.alpha));
        let significant = test.p_value < options.alpha;
        let hypotheses = independent(&test.chance.hypotheses);
        let permutations = if significant { permute(evidence, fit, &scan, options.seed) } else { Permutations::default() };
        let located = located(evidence, fit, &scan, &test.chance, &permutations);
        Self { significant, hypotheses, threshold: (2.0 * hypotheses / options.alpha).ln(), located, test }
    }

    /// Effects of nature, at their known sizes, that are too weak to show and belong into the model beside others that show.
    pub(in crate::diagnose) fn omitted_nature(&self, baseline: &Baseline) -> Vec<Term> {
        if !self.significant {
            return Vec::new();
        }
        let (chosen, _) = select(&baseline.evidence, &baseline.all, &baseline.stated, self.threshold);
        too_weak_to_show(&baseline.evidence, &baseline.all, &baseline.stated, chosen, self.threshold)
    }
}
