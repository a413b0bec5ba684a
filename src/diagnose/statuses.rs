//! Status of every effect of the registry: found, not found with a limit, not observable, or not applicable.

use super::cross_validation::Withheld;
use super::diagnosis::{EffectState, EffectStatus, Finding, FoundParameter, Limit};
use super::final_fit::{FinalFit, difference};
use super::findings::Context;
use super::fit_state::{AGREES, FitState, SelectedEffect, UNOBSERVABLE, amplitude, cosine, survival};
use super::hypotheses::Hypothesis;
use super::linear_system::Whitened;
use crate::statistics::significance::{deviations, neg_ln_chi2_sf};

/// An effect of which a smaller share is left is not observable where one of usual size would not be seen at
const WEAKLY: f64 = 0.1;
/// so many standard errors.
const SEEN: f64 = 5.0;
/// Of an effect whose score has a smaller probability by chance it is not said that it was not found or would not show.
const SIGNIFICANT: f64 = 1e-4;
/// What another effect explains too has at least this cosine with it.
const ALIKE: f64 = 0.5;

/// A size in the model is not that of the recording below this probability: that of [`AGREES`] standard errors.
const DIFFERS: f64 = 2.7e-3;

/// Whether any parameter of an effect would be seen if it were of usual size.
fn usual_shows(hypothesis: &Hypothesis, stand: &FitState, white: &[Whitened]) -> bool {
    hypothesis.fitted.iter().zip(white).any(|(index, column)| {
        let sigma = amplitude(stand, column).map_or(f64::INFINITY, |[_, sigma]| sigma);
        SEEN * sigma < hypothesis.effect.parameters()[*index].typical.abs()
    })
}

/// What the recording says of an effect that the model contains with `size`: the change that it asks for with its error, and the probability
/// of so much by chance.
fn in_force(size: f64, [change, sigma]: [f64; 2], p_value: Option<f64>) -> String {
    if p_value.is_some_and(|p| p < DIFFERS) || change.abs() > AGREES * sigma {
        let p = p_value.map_or_else(String::new, |p| format!(" (p = {p:.1e})"));
        format!("in the model; its size there is not that of the recording{p}, and no name stands for the difference")
    } else if AGREES * sigma < size.abs() {
        "in the model; its size there is confirmed within the errors".to_owned()
    } else {
        "in the model; the recording is too weak to measure its size".to_owned()
    }
}

/// Significant, and yet no name: no limit can be given of what is there.
fn withhold(status: &mut EffectStatus, reason: String, held_out_delta_chi2: Option<f64>) {
    status.status = EffectState::Withheld;
    status.upper_limit_95 = None;
    status.held_out_delta_chi2 = held_out_delta_chi2;
    status.reason = reason;
}

impl Context<'_> {
    /// The status of every effect of the registry.
    pub(super) fn effects(
        &self,
        solved: &FinalFit,
        found: &[Finding],
        kept: &[SelectedEffect],
        withheld: &[Withheld],
    ) -> Vec<EffectStatus> {
        let all = vec![true; self.evidence.images.len()];
        let stand = FitState::new(self.evidence, &all, kept, &solved.stand.noise);
        let statuses = Statuses { context: self, stand, found, withheld };
        (0..self.evidence.hypotheses.len()).map(|index| statuses.of(index)).collect()
    }
}

/// What the status of an effect follows from.
struct Statuses<'a> {
    context: &'a Context<'a>,
    /// All images with what was found, under the noise of the solution.
    stand: FitState,
    found: &'a [Finding],
    withheld: &'a [Withheld],
}

impl Statuses<'_> {
    /// The status of a hypothesis.
    fn of(&self, index: usize) -> EffectStatus {
        let (evidence, stand) = (self.context.evidence, &self.stand);
        let hypothesis = &evidence.hypotheses[index];
        let mut status = EffectStatus {
            id: hypothesis.id().to_owned(),
            status: EffectState::NotFound,
            p_value: None,
            p_value_is: None,
            score_sigma: None,
            held_out_delta_chi2: None,
            survival: None,
            parameters: Vec::new(),
            upper_limit_95: None,
            reason: String::new(),
        };
        if let Some(reason) = &hypothesis.missing {
            status.status = EffectState::NotApplicable;
            status.reason.clone_from(reason);
            return status;
        }
        // At its best variant, beside what was found.
        let entry = |variant: usize| SelectedEffect { hypothesis: index, variant };
        let scored = (0..hypothesis.variants.len()).map(|variant| (variant, stand.score(&stand.white(evidence, &[entry(variant)]))));
        let best = scored.max_by(|a, b| a.1.0.total_cmp(&b.1.0));
        let Some((variant, (t, rank))) = best else { return status };
        // Beside camera and attitudes alone, and in their units: with other noise nothing would be taken up in full.
        status.survival = Some(survival(self.context.base, &self.context.base.white(evidence, &[entry(variant)])));
        if let Some(finding) = self.found.iter().find(|finding| finding.id == hypothesis.id()) {
            status.status = EffectState::Found;
            status.p_value = Some(finding.p_value);
            status.score_sigma = Some(finding.score_sigma);
            status.parameters.clone_from(&finding.parameters);
            return status;
        }
        if rank > 0 {
            let searched = hypothesis.variants.len() as f64;
            let surprise = (neg_ln_chi2_sf(rank as f64, t) - 0.5 * searched.ln()).max(0.0);
            status.p_value = Some((-surprise).exp());
            status.score_sigma = Some(deviations(surprise));
        }
        let white = stand.white(evidence, &[entry(variant)]);
        if !white.iter().any(|column| stand.fit.length_squared(column) > 0.0) {
            status.status = EffectState::NotObservable;
            "what it depends on does not vary or is not known: it moves no star image here".clone_into(&mut status.reason);
            return status;
        }
        self.size(&mut status, entry(variant), &white);
        self.judge(&mut status, entry(variant), &white);
        status
    }

    /// Size of the first parameter, with a limit; the other parameters are free beside it.
    fn size(&self, status: &mut EffectStatus, entry: SelectedEffect, white: &[Whitened]) {
        let hypothesis = &self.context.evidence.hypotheses[entry.hypothesis];
        let start = &hypothesis.variants[entry.variant].start;
        let first = hypothesis.fitted[0];
        let spec = &hypothesis.effect.parameters()[first];
        let measured = match white {
            [alone] => amplitude(&self.stand, alone),
            [one, others @ ..] => amplitude(&self.stand.beside(self.stand.more.iter().chain(others).cloned().collect()), one),
            [] => None,
        };
        let Some([change, sigma]) = measured else { return };
        let value = start[first] + change - difference(hypothesis.effect.facts(), start, first);
        status.parameters.push(FoundParameter { name: spec.name.to_owned(), value, sigma, unit: spec.unit.to_owned() });
        if sigma <= spec.range.1 - spec.range.0 {
            let value = value.abs() + 1.645 * sigma;
            status.upper_limit_95 = Some(Limit { name: spec.name.to_owned(), value, unit: spec.unit.to_owned() });
        }
        if hypothesis.in_force {
            status.reason = in_force(start[first], [change, sigma], status.p_value);
        }
    }

    /// What is said of an effect that was not found.
    fn judge(&self, status: &mut EffectStatus, entry: SelectedEffect, white: &[Whitened]) {
        let hypothesis = &self.context.evidence.hypotheses[entry.hypothesis];
        let is_significant = status.p_value.is_some_and(|p| p < SIGNIFICANT);
        let of: Vec<&str> =
            self.found.iter().filter(|own| own.indistinguishable_from.contains(&status.id)).map(|own| own.id.as_str()).collect();
        if !of.is_empty() {
            status.status = EffectState::Indistinguishable;
            status.reason = format!("explains about as much as {}", of.join(", "));
        } else if status.survival.is_some_and(|survival| survival < UNOBSERVABLE) {
            status.status = EffectState::NotObservable;
            "attitudes and camera parameters take it up".clone_into(&mut status.reason);
        } else if !is_significant
            && status.survival.is_some_and(|survival| survival < WEAKLY)
            && !usual_shows(hypothesis, &self.stand, white)
        {
            status.status = EffectState::NotObservable;
            "attitudes and camera parameters take up most of it, and of one of usual size the rest would not show"
                .clone_into(&mut status.reason);
        } else if let Some(own) = self.withheld.iter().find(|own| own.entry.hypothesis == entry.hypothesis) {
            withhold(status, own.against.join("; "), own.held_out_delta_chi2);
        } else if is_significant {
            withhold(status, self.not_proposed(entry), None);
        }
    }

    /// Why an effect that is significant by itself was never proposed: another one withheld explains the same, or none of so many.
    fn not_proposed(&self, entry: SelectedEffect) -> String {
        let (evidence, stand) = (self.context.evidence, &self.stand);
        let own = stand.white(evidence, &[entry]);
        let alike = self
            .withheld
            .iter()
            .map(|other| (cosine(&stand.fit, &own, &stand.white(evidence, &[other.entry])), other))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(cosine, _)| *cosine >= ALIKE);
        match alike {
            Some((cosine, other)) => {
                let id = evidence.hypotheses[other.entry.hypothesis].id();
                format!("{id} explains the same better (cosine {cosine:.2}) and is withheld itself")
            }
            None => "the choice among all effects did not take it: what it follows is explained better otherwise, or not enough for so many effects tried".to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A size in the model is called confirmed only where it is measured and agrees.
    #[test]
    fn a_size_in_the_model_is_confirmed_or_not() {
        let confirmed = |text: &str| text.contains("confirmed");
        assert!(confirmed(&in_force(1.0, [0.1, 0.2], Some(0.6))));
        assert!(!confirmed(&in_force(1.0, [0.8, 0.2], Some(2e-5))));
        assert!(!confirmed(&in_force(1.0, [0.1, 0.2], Some(2e-5))), "another of its parameters may differ");
        assert!(in_force(1.0, [0.1, 2.0], Some(0.9)).contains("too weak"));
    }
}
