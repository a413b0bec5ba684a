//! The stages of a diagnosis, in their order.

use std::sync::Arc;
use std::time::Instant;

use super::adequacy::{amplitude_veto, concentration, disagreement, superseded, vetoes};
use super::channels::{ChannelReport, ChannelVerdict, Channels, Detectable};
use super::cross_validation::{Confirmed, Withheld, confirm};
use super::crossfit::CrossFit;
use super::diagnosis::{Diagnosis, EffectState, FORMAT, Finding, Fit, Located, Verdict};
use super::evidence::Evidence;
use super::final_fit::{FinalFit, solve_again};
use super::findings;
use super::located::located;
use super::noise::NoiseModel;
use super::null_distribution::independent;
use super::omitted_nature::too_weak_to_show;
use super::omnibus::{Omnibus, omnibus};
use super::ordinary::detectable;
use super::patterns::Named;
use super::permutation::{Permutations, permute};
use super::proposals::{left_out, proposed};
use super::quality::{noise_state, quality, residual_rows, stars_used, unused};
use super::refine::{place, refine};
use super::rendered_columns::{self, Rendered};
use super::resimulate::{DIFFERS, Resimulated, resimulate};
use super::resolved::{bound, least_p, told};
use super::scan::Scan;
use super::split_half::half_nights;
use super::stepwise::{FitState, SelectedEffect, select};
use super::untimed::follow;
use super::wild_bootstrap::{WildBootstrap, wild_bootstrap};
use super::{DiagnoseError, DiagnoseOptions, Step, Telemetry, unexplained, wording};
use crate::calibrate::{BundleSolution, CalibrateOptions};
use crate::camera::{Model, Term};
use crate::identify::ControlPoints;
use crate::statistics::significance::neg_ln_chi2_sf;

/// A covariate is named of a channel below this probability.
const LOCATES_P: f64 = 0.01;
/// Fewer numbers beyond the parameters say nothing.
const MIN_DEGREES: f64 = 20.0;

/// See [`super::diagnose`].
pub(super) fn diagnose(
    points: &ControlPoints,
    telemetry: &Telemetry,
    options: &DiagnoseOptions,
    tell: &dyn Fn(Step),
) -> Result<Diagnosis, DiagnoseError> {
    let started = Instant::now();
    tell(Step::Baseline);
    let night = Night::new(points, telemetry, options)?;
    tell(Step::Omnibus);
    let alarm = night.alarm();
    let beside =
        if alarm.sounds(options) { too_weak_to_show(&night.evidence, &night.all, &night.begin, alarm.threshold) } else { Vec::new() };
    let holding = DiagnoseOptions {
        physics: options.physics.iter().cloned().chain(beside.iter().map(|term| term.effect.clone())).collect(),
        ..options.clone()
    };
    let night = night.holding(&beside, &holding)?;
    tell(Step::Attribution);
    let proposals = if alarm.sounds(options) { night.proposals(&alarm) } else { Vec::new() };
    tell(Step::Proof);
    let mut case = Case::new(&night, &alarm, proposals);
    tell(Step::Solution);
    case.solve()?;
    tell(Step::Remainder);
    case.ask_what_is_left()?;
    tell(Step::Adequacy);
    let judged = case.judged();
    tell(Step::Findings);
    let mut diagnosis = case.told(&judged, tell)?;
    diagnosis.seconds = started.elapsed().as_secs_f64();
    Ok(diagnosis)
}

/// The recording as the diagnosis works on it.
struct Night<'a> {
    points: &'a ControlPoints,
    telemetry: &'a Telemetry,
    options: &'a DiagnoseOptions,
    /// The effects that the model was asked to contain.
    asked: Vec<String>,
    /// What stands in the model beside, at its known size.
    beside: Vec<Term>,
    joint: BundleSolution,
    evidence: Evidence,
    /// All images.
    all: Vec<bool>,
    begin: NoiseModel,
    /// All images fitted with attitudes and camera alone.
    base: FitState,
}

/// What the omnibus test says, and what follows from it for a single effect.
struct Alarm {
    test: Omnibus,
    /// Independent hypotheses that the family amounts to.
    hypotheses: f64,
    /// Surprise that an effect needs.
    threshold: f64,
    /// Covariates that the residuals follow.
    located: Vec<Located>,
}

impl Alarm {
    fn sounds(&self, options: &DiagnoseOptions) -> bool {
        self.test.p_value < options.alpha
    }
}

impl<'a> Night<'a> {
    fn new(points: &'a ControlPoints, telemetry: &'a Telemetry, options: &'a DiagnoseOptions) -> Result<Self, DiagnoseError> {
        let solve = CalibrateOptions {
            solve: options.solve.clone(),
            leave_out_imprecise: false,
            proper_motion_only: options.proper_motion_only,
            held_out: false,
            physics: options.physics.clone(),
            terms: options.terms.clone(),
            ..CalibrateOptions::default()
        };
        let joint = BundleSolution::solve(points, &solve)?;
        let columns = Rendered::new(&Evidence::without_hypotheses(&joint), &joint, points, options.looks.as_ref());
        let evidence = Evidence::at(&joint, points, telemetry, options, Arc::new(columns));
        let all = vec![true; evidence.images.len()];
        let begin = NoiseModel::stated(evidence.frame_factors.clone());
        let base = FitState::new(&evidence, &all, &[], &begin);
        if base.fit.degrees < MIN_DEGREES {
            return Err(DiagnoseError::TooFew { images: evidence.images.len(), frames: evidence.frames.len() });
        }
        let (asked, beside) = (options.physics.clone(), Vec::new());
        Ok(Self { points, telemetry, options, asked, beside, joint, evidence, all, begin, base })
    }

    /// The same with effects in the model at their known sizes; `options` name them.
    fn holding<'b>(self, beside: &[Term], options: &'b DiagnoseOptions) -> Result<Night<'b>, DiagnoseError>
    where
        'a: 'b,
    {
        if beside.is_empty() {
            return Ok(self);
        }
        let joint = solve_again(&self.joint, options, &self.evidence, &self.base, beside, &[])?;
        let evidence = Evidence::at(&joint, self.points, self.telemetry, options, self.evidence.rendered.clone());
        let base = FitState::new(&evidence, &self.all, &[], &self.begin);
        Ok(Night { options, beside: beside.to_vec(), joint, evidence, base, ..self })
    }

    /// Asks all questions of all images, and chance too.
    fn alarm(&self) -> Alarm {
        let (evidence, base, options) = (&self.evidence, &self.base, self.options);
        let scan = Scan::new(evidence, &base.noise, &base.sheet, &base.fit, |_| true);
        let test = omnibus(evidence, base, &scan, options, (1, options.alpha));
        let hypotheses = independent(&test.chance.hypotheses);
        let deals = if test.p_value < options.alpha { permute(evidence, base, &scan, options.seed) } else { Permutations::default() };
        let located = located(evidence, base, &scan, &test.chance, &deals);
        Alarm { hypotheses, threshold: (2.0 * hypotheses / options.alpha).ln(), located, test }
    }

    /// What all images propose.
    fn proposals(&self, alarm: &Alarm) -> Vec<SelectedEffect> {
        select(&self.evidence, &self.all, &self.begin, alarm.threshold).0
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings = self.joint.notes().to_vec();
        warnings.extend(rendered_columns::left_out(&self.evidence, self.options.looks.as_ref()));
        if !self.beside.is_empty() {
            let ids: Vec<&str> = self.beside.iter().map(|term| term.effect.as_str()).collect();
            warnings.push(format!(
                "the model holds {} at the size that place and time tell, beside other effects of nature that were left out: by itself it is too weak to show here",
                ids.join(", ")
            ));
        }
        warnings
    }
}

/// What is found, as it grows.
struct Case<'a> {
    night: &'a Night<'a>,
    alarm: &'a Alarm,
    /// With searches made finer about what was proposed.
    refined: Evidence,
    /// Choice and size made anew in turns that leave images out.
    tried: CrossFit,
    /// All that all images proposed.
    proposals: Vec<SelectedEffect>,
    confirmed: Confirmed,
    solved: FinalFit,
    /// Questions beside all that is confirmed; none where nothing shows.
    rest: Option<(Scan, Omnibus)>,
}

/// What speaks against the names.
struct Judged {
    with_all: FitState,
    signs: Vec<WildBootstrap>,
    anew: Option<Resimulated>,
    /// Entries that do not stand, and why.
    vetoes: Vec<(usize, Vec<String>)>,
}

impl<'a> Case<'a> {
    /// Proposals, their searches made finer, and which of them images that took part in nothing confirm.
    fn new(night: &'a Night<'a>, alarm: &'a Alarm, mut proposals: Vec<SelectedEffect>) -> Self {
        let asked = (alarm.threshold, alarm.hypotheses);
        let tried = CrossFit::new(&night.evidence, &night.joint, night.points, &night.begin, asked);
        let mut refined = night.evidence.clone();
        refine(&mut refined, &night.joint, &mut proposals, &night.all, &night.begin);
        let solved = FinalFit::unchanged(&night.joint, &refined, &night.base);
        let mut case = Self { night, alarm, refined, tried, proposals, confirmed: Confirmed::default(), solved, rest: None };
        case.confirm(case.proposals.clone());
        case
    }

    /// Confirms entries; those withheld before stay so.
    fn confirm(&mut self, entries: Vec<SelectedEffect>) {
        self.tried.credit(&self.refined, &self.night.base, &self.proposals);
        let stand = |entries: &[SelectedEffect]| FitState::new(&self.refined, &self.night.all, entries, &self.night.begin);
        let before = std::mem::take(&mut self.confirmed.withheld);
        self.confirmed = confirm(&self.refined, &self.tried, entries, stand);
        self.confirmed.withheld.extend(before);
    }

    /// Solves anew with everything that is confirmed free, and with the search made finer beside it alone.
    fn solve(&mut self) -> Result<(), DiagnoseError> {
        let night = self.night;
        if self.confirmed.entries.len() < self.proposals.len() {
            refine(&mut self.refined, &night.joint, &mut self.confirmed.entries, &night.all, &night.begin);
        }
        place(&mut self.refined, &night.joint, &mut self.confirmed.entries, &night.all, &night.begin);
        follow(&mut self.refined, &night.joint, &mut self.confirmed.entries, &night.all, &night.begin);
        self.solved = if self.confirmed.entries.is_empty() {
            FinalFit::unchanged(&night.joint, &self.refined, &night.base)
        } else {
            self.solved_with(&self.confirmed.entries, None)?
        };
        Ok(())
    }

    fn solved_with(&self, entries: &[SelectedEffect], nearer: Option<&Model>) -> Result<FinalFit, DiagnoseError> {
        let night = self.night;
        FinalFit::new(&night.joint, night.points, night.telemetry, night.options, &self.refined, entries, nearer)
    }

    /// The test of what is left. Where something is, effects that were hidden behind what was not confirmed are proposed too, and held to the
    /// same proof. Where nothing shows nothing can be left: it is not asked for.
    fn ask_what_is_left(&mut self) -> Result<(), DiagnoseError> {
        let night = self.night;
        if !self.alarm.sounds(night.options) {
            return Ok(());
        }
        let asked = |solved: &FinalFit, stream: u64| {
            let scan = solved.scan();
            let test = solved.omnibus(&scan, night.options, stream);
            (scan, test)
        };
        let rest = if self.confirmed.entries.is_empty() { (self.solved.scan(), self.alarm.test.clone()) } else { asked(&self.solved, 2) };
        let something = rest.1.p_value < night.options.alpha;
        self.rest = Some(rest);
        if !something {
            return Ok(());
        }
        let rejected: Vec<usize> = self.confirmed.withheld.iter().map(|own| own.entry.hypothesis).collect();
        let mut more = self.solved.more(&self.refined, &self.confirmed.entries, &rejected, self.alarm.threshold);
        let before = self.confirmed.entries.len();
        if more.len() == before {
            return Ok(());
        }
        refine(&mut self.refined, &night.joint, &mut more, &night.all, &night.begin);
        self.proposals.extend(&more[before..]);
        self.confirm(more);
        self.solve()?;
        self.rest = Some(asked(&self.solved, 3));
        Ok(())
    }

    fn anew(&self, entries: &[SelectedEffect], solved: &FinalFit) -> Option<Resimulated> {
        let (night, chance) = (self.night, &self.alarm.test.chance);
        (!entries.is_empty()).then(|| resimulate(&night.joint, &self.refined, entries, solved, chance, night.options)).flatten()
    }

    /// Which names do not stand.
    fn judged(&self) -> Judged {
        let least = least_p(self.alarm.test.chance.nulls);
        let (night, refined, entries, options) = (self.night, &self.refined, &self.confirmed.entries, self.night.options);
        let with_all = if entries.is_empty() { night.base.clone() } else { FitState::new(refined, &night.all, entries, &night.begin) };
        let remains = self.rest.as_ref().is_some_and(|(_, test)| test.p_value < options.alpha);
        let is_free = |index: usize| entries.iter().all(|entry| entry.hypothesis != index);
        let linear_scan =
            (remains && !entries.is_empty()).then(|| Scan::new(refined, &with_all.noise, &with_all.sheet, &with_all.fit, is_free));
        let signs: Vec<_> = (0..entries.len()).map(|k| wild_bootstrap(refined, &with_all, entries, k, options.seed)).collect();
        let anew = self.anew(entries, &self.solved);
        let against = |k: usize| {
            let statistic = findings::statistic(refined, &with_all, entries, k).0;
            let mut against = Vec::new();
            if let Some((scan, _)) = &self.rest {
                let named = Named { evidence: refined, stand: &with_all, entries, solved: &self.solved, k };
                against.extend(vetoes(&named, scan, statistic));
            }
            against.extend(concentration(refined, night.points, &with_all, entries, k));
            against.extend(amplitude_veto(refined, &with_all, entries, k, &self.solved));
            against.extend(disagreement(&signs[k]));
            if let Some(p) = anew.as_ref().and_then(|anew| anew.own_p.get(k)).filter(|p| **p < DIFFERS) {
                against.push(format!("the recording simulated anew with it does not look the same ({})", told(*p, least)));
            }
            if let Some(scan) = &linear_scan {
                against.extend(superseded(refined, &with_all, scan, entries, k, self.alarm.threshold));
            }
            against
        };
        let vetoes = (0..entries.len()).map(|k| (k, against(k))).filter(|(_, against)| !against.is_empty()).collect();
        Judged { with_all, signs, anew, vetoes }
    }

    /// Everything as the result has it.
    fn told(&self, judged: &Judged, tell: &dyn Fn(Step)) -> Result<Diagnosis, DiagnoseError> {
        let (night, alarm, refined, options) = (self.night, self.alarm, &self.refined, self.night.options);
        let entries = &self.confirmed.entries;
        let mut warnings = night.warnings();
        let is_vetoed = |k: &usize| judged.vetoes.iter().any(|(vetoed, _)| vetoed == k);
        let standing: Vec<usize> = (0..entries.len()).filter(|k| !is_vetoed(k)).collect();
        let kept: Vec<SelectedEffect> = standing.iter().map(|k| entries[*k]).collect();
        let vetoed = judged.vetoes.iter().map(|(k, against)| Withheld {
            entry: entries[*k],
            against: against.clone(),
            held_out_delta_chi2: self.confirmed.proofs.get(*k).map(|proof| proof.gain.delta_chi2),
        });
        let withheld: Vec<Withheld> = vetoed.chain(self.confirmed.withheld.iter().cloned()).collect();
        for own in &self.confirmed.withheld {
            let id = refined.hypotheses[own.entry.hypothesis].id();
            warnings.push(format!("{id} is proposed by all star images together and not claimed: {}", own.against.join("; ")));
        }
        let own_anew = judged.anew.as_ref().map_or_else(Vec::new, |anew| anew.own_p.clone());
        let context = findings::Context {
            evidence: refined,
            joint: &night.joint,
            points: night.points,
            base: &night.base,
            with_all: &judged.with_all,
            entries,
            proofs: &self.confirmed.proofs,
            signs: &judged.signs,
            tried: &self.tried,
            resimulated: &own_anew,
            hypotheses: alarm.hypotheses,
        };
        let found: Vec<Finding> = standing.iter().map(|k| context.finding(*k, &self.solved, options)).collect();
        let everything = if kept == *entries { judged.with_all.clone() } else { FitState::new(refined, &night.all, &kept, &night.begin) };
        let own_test = (!judged.vetoes.is_empty()).then(|| {
            let is_free = |index: usize| kept.iter().all(|entry| entry.hypothesis != index);
            let scan = Scan::new(refined, &everything.noise, &everything.sheet, &everything.fit, is_free);
            omnibus(refined, &everything, &scan, options, (4, options.alpha))
        });
        let rest = own_test.as_ref().or(self.rest.as_ref().map(|(_, test)| test));
        // The camera that is handed on holds what is reported, and nothing that lost its name.
        let as_reported = match (judged.vetoes.is_empty(), kept.is_empty()) {
            (true, _) => None,
            (false, true) => Some(FinalFit::unchanged(&night.joint, refined, &night.base)),
            (false, false) => Some(self.solved_with(&kept, Some(self.solved.joint.model()))?),
        };
        let anew = match &as_reported {
            None => judged.anew.as_ref().filter(|_| !kept.is_empty()).map(|anew| anew.p_value),
            Some(solved) => self.anew(&kept, solved).map(|anew| anew.p_value),
        };
        let reported = as_reported.as_ref().unwrap_or(&self.solved);
        let left = rest.filter(|rest| rest.p_value < options.alpha);
        let unknown = left.map(|rest| unexplained::unknown(refined, &everything, &withheld, rest, &night.joint));
        let detectable = detectable(refined, &everything, &night.base, &kept, alarm.threshold);
        let channels = channels(alarm, (found.is_empty(), unknown.is_some()), detectable);
        let verdict = channels.verdict();
        let least = least_p(alarm.test.chance.nulls);
        if let Some(p) = anew.filter(|p| verdict == Verdict::Explained && *p < DIFFERS) {
            warnings.push(format!(
                "a recording simulated anew with what was found differs from this one by more than chance would have it ({}): something small may be left",
                told(p, least)
            ));
        }
        let fit = Fit {
            baseline: quality(refined, &night.base, &self.solved.stand.noise, &self.tried, &[]),
            after: quality(refined, &everything, &self.solved.stand.noise, &self.tried, &kept),
        };
        if options.half_nights > 0 {
            tell(Step::HalfNights);
        }
        let half_nights = half_nights(&self.solved, options);
        if options.half_nights > 0 && half_nights.is_none() {
            let frames = refined.frames.len();
            warnings.push(format!("--split-half was not answered: {frames} frames have too few different halves"));
        }
        let left_p = rest.map(|rest| rest.p_value);
        let mut diagnosis = Diagnosis {
            format: FORMAT.to_owned(),
            scope: channels.scope(),
            verdict,
            physics: night.asked.clone(),
            effects: context.effects(&self.solved, &found, &kept, &withheld),
            profiles: context.profiles(&self.solved, &standing, &found),
            findings: found,
            proposed: proposed(refined, &self.tried, &everything, &kept, &self.proposals, &withheld),
            unknown: unknown.into_iter().collect(),
            fit,
            channels,
            stars_used: stars_used(refined, night.points, &everything),
            located: alarm.located.clone(),
            noise: noise_state(&self.solved.stand),
            left_out: left_out(refined, &self.tried),
            nulls: alarm.test.chance.nulls,
            resimulated_p_value: anew,
            left_p_value: left_p,
            half_nights,
            effective_hypotheses: alarm.hypotheses,
            summary: Vec::new(),
            warnings,
            camera: Some(reported.joint.model().clone()),
            zeniths: reported.zeniths(),
            unused: unused(refined, night.points, &everything, options),
            residuals: residual_rows(refined, &night.base, &everything, night.points),
            seconds: 0.0,
            provenance: None,
        };
        // What turns alone proposed has its held-out figure too.
        for effect in diagnosis.effects.iter_mut().filter(|own| own.status == EffectState::Withheld && own.held_out_delta_chi2.is_none()) {
            effect.held_out_delta_chi2 = diagnosis.proposed.iter().find(|own| own.id == effect.id).map(|own| own.held_out_delta_chi2);
        }
        diagnosis.summary = wording::summary(&diagnosis, left_p.unwrap_or(1.0));
        bound(&mut diagnosis);
        Ok(diagnosis)
    }
}

/// What is said of each channel: nothing beside the places is held against the model yet.
fn channels(alarm: &Alarm, (nothing_found, something_left): (bool, bool), detectable: Vec<Detectable>) -> Channels {
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
            p_value: Some(alarm.test.p_value),
            p_value_is: None,
            located_by: alarm.located.iter().filter(|own| own.p_value < LOCATES_P).map(|own| own.covariate.clone()).collect(),
            reason: wording::reason(verdict, &alarm.test.largest, &detectable),
            detectable,
        },
        flux: not_held("the brightness of the stars is"),
        shape: not_held("width, elongation and skewness of the images are"),
        stamp: not_held("what is left of each image is"),
        noise: not_held("variances, codes, rows, columns and defects of the pixels are"),
        background: not_held("the sky between the stars is"),
    }
}

/// p-value of a statistic of so many degrees of freedom.
pub(super) fn p_of(t: f64, rank: usize) -> f64 {
    (-neg_ln_chi2_sf(rank as f64, t)).exp()
}

/// p-value once all hypotheses are counted.
pub(super) fn family(p: f64, hypotheses: f64) -> f64 {
    -(hypotheses * (-p).ln_1p()).exp_m1()
}
