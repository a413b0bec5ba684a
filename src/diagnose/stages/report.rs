//! Last stage: what is reported, solved and tested by itself, and the result.

use super::Judged;
use crate::diagnose::channels::{ChannelReport, ChannelVerdict, Channels, Detectable};
use crate::diagnose::cross_validation::Withheld;
use crate::diagnose::diagnosis::{Diagnosis, EffectState, FORMAT, Finding, Fit};
use crate::diagnose::error::DiagnoseError;
use crate::diagnose::final_fit::FinalFit;
use crate::diagnose::findings;
use crate::diagnose::fit_state::{FitState, SelectedEffect};
use crate::diagnose::omnibus::{Omnibus, omnibus};
use crate::diagnose::ordinary::detectable;
use crate::diagnose::profile::profiles;
use crate::diagnose::proposals::{left_out, proposed};
use crate::diagnose::quality::{noise_state, quality, residual_rows, stars_used, unused};
use crate::diagnose::resimulate::DIFFERS;
use crate::diagnose::resolved::{bound, least_p, told};
use crate::diagnose::scan::Scan;
use crate::diagnose::split_half::half_nights;
use crate::diagnose::verdict::Verdict;
use crate::diagnose::{Step, unexplained, wording};

/// A covariate is named of a channel below this probability.
const LOCATES_P: f64 = 0.01;
/// Stream of the simulations that answer the test of what is left beside what is reported.
const STREAM: u64 = 4;

/// The model that is reported: of the confirmed effects those that stand.
pub(in crate::diagnose) struct Reported<'a> {
    judged: &'a Judged<'a>,
    /// Places of the effects among the confirmed ones, and themselves.
    standing: Vec<usize>,
    kept: Vec<SelectedEffect>,
    withheld: Vec<Withheld>,
    /// All images with what is kept, at the baseline's linearisation.
    fit: FitState,
    /// The test of what is left beside what is kept; none where nothing is missing.
    left: Option<Omnibus>,
    /// Everything solved with what is kept alone, where something lost its name.
    solved: Option<FinalFit>,
    /// Probability that the recording simulated with what is kept differs as much by chance.
    resimulated_p_value: Option<f64>,
}

impl<'a> Reported<'a> {
    /// Solves and tests the model that is reported.
    pub(in crate::diagnose) fn new(judged: &'a Judged<'a>) -> Result<Self, DiagnoseError> {
        let (validated, entries) = (&judged.solved.validated, judged.solved.entries());
        let (baseline, evidence) = (validated.baseline, &validated.evidence);
        let standing = judged.standing();
        let kept: Vec<SelectedEffect> = standing.iter().map(|k| entries[*k]).collect();
        let fit = if kept == entries { judged.with_all.clone() } else { FitState::new(evidence, &baseline.all, &kept, &baseline.stated) };
        let (left, solved) = if judged.vetoes.is_empty() {
            (judged.solved.left.as_ref().map(|(_, test)| test.clone()), None)
        } else {
            let is_free = |index: usize| kept.iter().all(|entry| entry.hypothesis != index);
            let scan = Scan::new(evidence, &fit.noise, &fit.system, &fit.fit, is_free);
            let test = omnibus(evidence, &fit, &scan, &baseline.options, (STREAM, baseline.options.alpha));
            // The camera that is handed on holds what is reported, and nothing that lost its name.
            (Some(test), Some(judged.solved.with_only(&kept)?))
        };
        let resimulated_p_value = match &solved {
            None => judged.resimulated.as_ref().filter(|_| !kept.is_empty()).map(|anew| anew.p_value),
            Some(solved) => judged.simulated_anew(&kept, solved).map(|anew| anew.p_value),
        };
        let withheld = judged.withheld();
        Ok(Self { judged, standing, kept, withheld, fit, left, solved, resimulated_p_value })
    }

    /// The result.
    pub(in crate::diagnose) fn diagnosis(&self, on_step: &dyn Fn(Step)) -> Diagnosis {
        let (solved, validated) = (self.judged.solved, &self.judged.solved.validated);
        let (baseline, screened, evidence) = (validated.baseline, validated.screened, &validated.evidence);
        let context = self.context();
        let found: Vec<Finding> = self.standing.iter().map(|k| context.finding(*k, &solved.fit, &baseline.options)).collect();
        let left = self.left.as_ref().filter(|left| left.p_value < baseline.options.alpha);
        let unknown = left.map(|left| unexplained::unknown(evidence, &self.fit, &self.withheld, left, &baseline.joint));
        let detectable = detectable(evidence, &self.fit, &baseline.fit, &self.kept, screened.threshold);
        let channels = self.channels((found.is_empty(), unknown.is_some()), detectable);
        let verdict = channels.verdict();
        let mut warnings = self.warnings(verdict);
        let half_nights = self.split_half(on_step, &mut warnings);
        let model = self.solved.as_ref().unwrap_or(&solved.fit);
        let mut diagnosis = Diagnosis {
            format: FORMAT.to_owned(),
            scope: channels.scope(),
            verdict,
            physics: baseline.physics.clone(),
            effects: context.effects(&solved.fit, &found, &self.kept, &self.withheld),
            profiles: profiles(&context, &solved.fit, &self.standing, &found),
            image_profiles: Vec::new(),
            shape_map: Vec::new(),
            findings: found,
            proposed: proposed(evidence, &validated.turns, &self.fit, &self.kept, &validated.proposals, &self.withheld),
            unknown: unknown.into_iter().collect(),
            fit: self.quality(),
            channels,
            stars_used: stars_used(evidence, baseline.points, &self.fit),
            located: screened.located.clone(),
            noise: noise_state(&solved.fit.stand),
            image: None,
            left_out: left_out(evidence, &validated.turns),
            nulls: screened.test.chance.nulls,
            resimulated_p_value: self.resimulated_p_value,
            left_p_value: self.left.as_ref().map(|left| left.p_value),
            half_nights,
            effective_hypotheses: screened.hypotheses,
            summary: Vec::new(),
            warnings,
            camera: Some(model.joint.model().clone()),
            zeniths: model.zeniths(),
            unused: unused(evidence, baseline.points, &self.fit, &baseline.options),
            residuals: residual_rows(evidence, &baseline.fit, &self.fit, baseline.points),
            seconds: 0.0,
            provenance: None,
        };
        held_out_of_turns(&mut diagnosis);
        diagnosis.summary = wording::summary(&diagnosis, diagnosis.left_p_value.unwrap_or(1.0));
        bound(&mut diagnosis);
        diagnosis
    }

    fn context(&self) -> findings::Context<'_> {
        let validated = &self.judged.solved.validated;
        let baseline = validated.baseline;
        findings::Context {
            evidence: &validated.evidence,
            joint: &baseline.joint,
            points: baseline.points,
            base: &baseline.fit,
            with_all: &self.judged.with_all,
            entries: &validated.confirmed.entries,
            proofs: &validated.confirmed.proofs,
            signs: &self.judged.signs,
            tried: &validated.turns,
            resimulated: self.judged.resimulated.as_ref().map_or(&[], |anew| &anew.own_p),
            hypotheses: validated.screened.hypotheses,
        }
    }

    /// How well baseline and reported model describe the star images.
    fn quality(&self) -> Fit {
        let validated = &self.judged.solved.validated;
        let noise = &self.judged.solved.fit.stand.noise;
        Fit {
            baseline: quality(&validated.evidence, &validated.baseline.fit, noise, &validated.turns, &[]),
            after: quality(&validated.evidence, &self.fit, noise, &validated.turns, &self.kept),
        }
    }

    fn warnings(&self, verdict: Verdict) -> Vec<String> {
        let validated = &self.judged.solved.validated;
        let mut warnings = validated.baseline.warnings();
        for own in &validated.confirmed.withheld {
            let id = validated.evidence.hypotheses[own.entry.hypothesis].id();
            warnings.push(format!("{id} is proposed by all star images together and not claimed: {}", own.against.join("; ")));
        }
        if let Some(p) = self.resimulated_p_value.filter(|p| verdict == Verdict::Explained && *p < DIFFERS) {
            warnings.push(format!(
                "a recording simulated anew with what was found differs from this one by more than chance would have it ({}): something small may be left",
                told(p, least_p(validated.screened.test.chance.nulls))
            ));
        }
        warnings
    }

    fn split_half(&self, on_step: &dyn Fn(Step), warnings: &mut Vec<String>) -> Option<crate::diagnose::HalfNights> {
        let options = &self.judged.solved.validated.baseline.options;
        if options.half_nights > 0 {
            on_step(Step::HalfNights);
        }
        let answer = half_nights(&self.judged.solved.fit, options);
        if options.half_nights > 0 && answer.is_none() {
            let frames = self.judged.solved.validated.evidence.frames.len();
            warnings.push(format!("--split-half was not answered: {frames} frames have too few different halves"));
        }
        answer
    }

    /// What is said of each channel: nothing beside the places is held against the model yet.
    fn channels(&self, (nothing_found, something_left): (bool, bool), detectable: Vec<Detectable>) -> Channels {
        let screened = self.judged.solved.validated.screened;
        let verdict = match (nothing_found, something_left) {
            (_, true) => ChannelVerdict::Unexplained,
            (false, false) => ChannelVerdict::Explained,
            (true, false) if detectable.iter().any(|own| own.would_show) => ChannelVerdict::Consistent,
            (true, false) => ChannelVerdict::Undecided,
        };
        let not_held = |what: &str| ChannelReport::not_looked_at(&format!("{what} not held against the model"));
        Channels {
            astrometry: ChannelReport {
                looked_at: true,
                verdict,
                p_value: Some(screened.test.p_value),
                p_value_is: None,
                located_by: screened.located.iter().filter(|own| own.p_value < LOCATES_P).map(|own| own.covariate.clone()).collect(),
                reason: wording::reason(verdict, &screened.test.largest, &detectable),
                detectable,
                ..ChannelReport::default()
            },
            flux: not_held("the brightness of the stars is"),
            shape: not_held("width, elongation and skewness of the images are"),
            stamp: not_held("what is left of each image is"),
            noise: not_held("variances, codes, rows, columns and defects of the pixels are"),
            background: not_held("the sky between the stars is"),
        }
    }
}

/// What turns alone proposed has its held-out figure too.
fn held_out_of_turns(diagnosis: &mut Diagnosis) {
    for effect in diagnosis.effects.iter_mut().filter(|own| own.status == EffectState::Withheld && own.held_out_delta_chi2.is_none()) {
        effect.held_out_delta_chi2 = diagnosis.proposed.iter().find(|own| own.id == effect.id).map(|own| own.held_out_delta_chi2);
    }
}
