//! The diagnosis from end to end, stage by stage.

use std::sync::Arc;
use std::time::Instant;

use super::adequacy::{amplitude_veto, concentration, disagreement, superseded, vetoes};
use super::attribute::{Entry, Stand, select};
use super::chance::independent;
use super::confirm::{Confirmed, Withheld, confirm};
use super::crossfit::CrossFit;
use super::diagnosis::{ChannelTest, Channels, Diagnosis, FORMAT, Finding, Fit, HalfNights, Located, Verdict};
use super::evidence::Evidence;
use super::findings;
use super::halves::half_nights;
use super::located::located;
use super::noise::NoiseModel;
use super::omnibus::{Omnibus, omnibus};
use super::permute::{Deals, deal};
use super::proposals::{left_out, proposed};
use super::quality::{noise_state, quality, residual_rows, stars_used};
use super::refine::{place, refine};
use super::rendered::{self, Rendered};
use super::resimulate::{DIFFERS, Resimulated, resimulate};
use super::scan::Scan;
use super::signs::{SignTest, sign_test};
use super::solved::Solved;
use super::{DiagnoseError, DiagnoseOptions, Step, Telemetry, left, words};
use crate::calibrate::{CalibrateOptions, Joint};
use crate::identify::ControlPoints;
use crate::statistics::significance::chi_squared_surprise;

/// Fewer numbers beyond the parameters say nothing.
const FEWEST_DEGREES: f64 = 20.0;

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
    joint: Joint,
    evidence: Evidence,
    /// All images.
    all: Vec<bool>,
    begin: NoiseModel,
    /// All images fitted with attitudes and camera alone.
    base: Stand,
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
        let joint = Joint::solve(points, &solve)?;
        let columns = Rendered::new(&Evidence::without_hypotheses(&joint), &joint, points, options.looks.as_ref());
        let evidence = Evidence::at(&joint, points, telemetry, options, Arc::new(columns));
        let all = vec![true; evidence.images.len()];
        let begin = NoiseModel::stated(evidence.frame_factors.clone());
        let base = Stand::new(&evidence, &all, &[], &begin);
        if base.fit.degrees < FEWEST_DEGREES {
            return Err(DiagnoseError::TooFew { images: evidence.images.len(), frames: evidence.frames.len() });
        }
        Ok(Self { points, telemetry, options, joint, evidence, all, begin, base })
    }

    /// Asks all questions of all images, and chance too.
    fn alarm(&self) -> Alarm {
        let (evidence, base, options) = (&self.evidence, &self.base, self.options);
        let scan = Scan::new(evidence, &base.noise, &base.sheet, &base.fit, |_| true);
        let test = omnibus(evidence, base, &scan, options, (1, options.alpha));
        let hypotheses = independent(&test.chance.hypotheses);
        let deals = if test.p_value < options.alpha { deal(evidence, base, &scan, options.seed) } else { Deals::default() };
        let located = located(evidence, base, &scan, &test.chance, &deals);
        Alarm { hypotheses, threshold: (2.0 * hypotheses / options.alpha).ln(), located, test }
    }

    /// What all images propose.
    fn proposals(&self, alarm: &Alarm) -> Vec<Entry> {
        select(&self.evidence, &self.all, &self.begin, alarm.threshold).0
    }

    fn warnings(&self) -> Vec<String> {
        let mut warnings = self.joint.notes().to_vec();
        warnings.extend(rendered::left_out(&self.evidence, self.options.looks.as_ref()));
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
    proposals: Vec<Entry>,
    confirmed: Confirmed,
    solved: Solved,
    /// Questions beside all that is confirmed; none where nothing shows.
    rest: Option<(Scan, Omnibus)>,
}

/// What speaks against the names.
struct Judged {
    with_all: Stand,
    signs: Vec<SignTest>,
    anew: Option<Resimulated>,
    /// Entries that do not stand, and why.
    vetoes: Vec<(usize, Vec<String>)>,
}

/// The names that stand, by place among the confirmed entries and as entries; what does not stand; everything fitted with them.
struct Names {
    standing: Vec<usize>,
    kept: Vec<Entry>,
    withheld: Vec<Withheld>,
    everything: Stand,
}

impl<'a> Case<'a> {
    /// Proposals, their searches made finer, and which of them images that took part in nothing confirm.
    fn new(night: &'a Night<'a>, alarm: &'a Alarm, mut proposals: Vec<Entry>) -> Self {
        let asked = (alarm.threshold, alarm.hypotheses);
        let tried = CrossFit::new(&night.evidence, &night.joint, night.points, &night.begin, asked);
        let mut refined = night.evidence.clone();
        refine(&mut refined, &night.joint, &mut proposals, &night.all, &night.begin);
        let solved = Solved::unchanged(&night.joint, &refined, &night.base);
        let mut case = Self { night, alarm, refined, tried, proposals, confirmed: Confirmed::default(), solved, rest: None };
        case.confirm(case.proposals.clone());
        case
    }

    /// Confirms entries; those withheld before stay so.
    fn confirm(&mut self, entries: Vec<Entry>) {
        self.tried.credit(&self.refined, &self.night.base, &self.proposals);
        let stand = |entries: &[Entry]| Stand::new(&self.refined, &self.night.all, entries, &self.night.begin);
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
        self.solved = if self.confirmed.entries.is_empty() {
            Solved::unchanged(&night.joint, &self.refined, &night.base)
        } else {
            self.solved_with(&self.confirmed.entries)?
        };
        Ok(())
    }

    fn solved_with(&self, entries: &[Entry]) -> Result<Solved, DiagnoseError> {
        let night = self.night;
        Solved::new(&night.joint, night.points, night.telemetry, night.options, &self.refined, entries)
    }

    /// The test of what is left. Where something is, effects that were hidden behind what was not confirmed are proposed too, and held to the
    /// same proof. Where nothing shows nothing can be left: it is not asked for.
    fn ask_what_is_left(&mut self) -> Result<(), DiagnoseError> {
        let night = self.night;
        if !self.alarm.sounds(night.options) {
            return Ok(());
        }
        let asked = |solved: &Solved, stream: u64| {
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
        let rejected: Vec<usize> = self.confirmed.withheld.iter().map(|(entry, _)| entry.hypothesis).collect();
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

    fn anew(&self, entries: &[Entry], solved: &Solved) -> Option<Resimulated> {
        let (night, chance) = (self.night, &self.alarm.test.chance);
        (!entries.is_empty()).then(|| resimulate(&night.joint, &self.refined, entries, solved, chance, night.options)).flatten()
    }

    /// Which names do not stand.
    fn judged(&self) -> Judged {
        let (night, refined, entries, options) = (self.night, &self.refined, &self.confirmed.entries, self.night.options);
        let with_all = if entries.is_empty() { night.base.clone() } else { Stand::new(refined, &night.all, entries, &night.begin) };
        let remains = self.rest.as_ref().is_some_and(|(_, test)| test.p_value < options.alpha);
        let is_free = |index: usize| entries.iter().all(|entry| entry.hypothesis != index);
        let linear_scan =
            (remains && !entries.is_empty()).then(|| Scan::new(refined, &with_all.noise, &with_all.sheet, &with_all.fit, is_free));
        let signs: Vec<_> = (0..entries.len()).map(|k| sign_test(refined, &with_all, entries, k, options.seed)).collect();
        let anew = self.anew(entries, &self.solved);
        let against = |k: usize| {
            let statistic = findings::statistic(refined, &with_all, entries, k).0;
            let mut against = Vec::new();
            if let Some((scan, _)) = &self.rest {
                against.extend(vetoes(&self.solved.evidence, &self.solved.stand, scan, &self.solved.entries, k, statistic));
            }
            against.extend(concentration(refined, night.points, &with_all, entries, k));
            against.extend(amplitude_veto(refined, &with_all, entries, k, &self.solved));
            against.extend(disagreement(&signs[k]));
            if let Some(p) = anew.as_ref().and_then(|anew| anew.own_p.get(k)).filter(|p| **p < DIFFERS) {
                against.push(format!("the recording simulated anew with it does not look the same (p = {p:.1e})"));
            }
            if let Some(scan) = &linear_scan {
                against.extend(superseded(refined, &with_all, scan, entries, k, self.alarm.threshold));
            }
            against
        };
        let vetoes = (0..entries.len()).map(|k| (k, against(k))).filter(|(_, against)| !against.is_empty()).collect();
        Judged { with_all, signs, anew, vetoes }
    }

    /// Which names stand, and everything with them alone.
    fn names(&self, judged: &Judged) -> Names {
        let entries = &self.confirmed.entries;
        let is_vetoed = |k: &usize| judged.vetoes.iter().any(|(vetoed, _)| vetoed == k);
        let standing: Vec<usize> = (0..entries.len()).filter(|k| !is_vetoed(k)).collect();
        let kept: Vec<Entry> = standing.iter().map(|k| entries[*k]).collect();
        let vetoed = judged.vetoes.iter().map(|(k, against)| (entries[*k], against.clone()));
        let withheld = vetoed.chain(self.confirmed.withheld.iter().cloned()).collect();
        let everything =
            if kept == *entries { judged.with_all.clone() } else { Stand::new(&self.refined, &self.night.all, &kept, &self.night.begin) };
        Names { standing, kept, withheld, everything }
    }

    /// The test of what is left beside the names that stand.
    fn rest_beside(&self, names: &Names) -> Option<Omnibus> {
        if names.kept.len() == self.confirmed.entries.len() {
            return self.rest.as_ref().map(|(_, test)| test.clone());
        }
        let (stand, options) = (&names.everything, self.night.options);
        let is_free = |index: usize| names.kept.iter().all(|entry| entry.hypothesis != index);
        let scan = Scan::new(&self.refined, &stand.noise, &stand.sheet, &stand.fit, is_free);
        Some(omnibus(&self.refined, stand, &scan, options, (4, options.alpha)))
    }

    /// How well the recording simulated with the names that stand looks like the real one.
    fn simulated_with(&self, names: &Names, judged: &Judged) -> Result<Option<f64>, DiagnoseError> {
        let p = |anew: &Resimulated| anew.p_value;
        Ok(if names.kept.is_empty() {
            None
        } else if names.kept.len() == self.confirmed.entries.len() {
            judged.anew.as_ref().map(p)
        } else {
            self.anew(&names.kept, &self.solved_with(&names.kept)?).as_ref().map(p)
        })
    }

    fn warnings(&self, verdict: Verdict, anew: Option<f64>) -> Vec<String> {
        let mut warnings = self.night.warnings();
        for (entry, against) in &self.confirmed.withheld {
            let id = self.refined.hypotheses[entry.hypothesis].id();
            warnings.push(format!("{id} is proposed by all star images together and not claimed: {}", against.join("; ")));
        }
        if let Some(p) = anew.filter(|p| verdict == Verdict::Explained && *p < DIFFERS) {
            warnings.push(format!(
                "a recording simulated anew with what was found differs from this one by more than chance would have it (p = {p:.1e}): something small may be left"
            ));
        }
        warnings
    }

    /// The p-values of random halves, where they are asked for.
    fn halves(&self, tell: &dyn Fn(Step), warnings: &mut Vec<String>) -> Option<HalfNights> {
        if self.night.options.half_nights == 0 {
            return None;
        }
        tell(Step::HalfNights);
        let halves = half_nights(&self.solved, self.night.options);
        if halves.is_none() {
            let frames = self.refined.frames.len();
            warnings.push(format!("--half-nights was not answered: {frames} frames have too few different halves"));
        }
        halves
    }

    /// Everything as the result has it.
    fn told(&self, judged: &Judged, tell: &dyn Fn(Step)) -> Result<Diagnosis, DiagnoseError> {
        let (night, alarm, refined, options) = (self.night, self.alarm, &self.refined, self.night.options);
        let names = self.names(judged);
        let (kept, everything) = (&names.kept, &names.everything);
        let own_anew = judged.anew.as_ref().map_or_else(Vec::new, |anew| anew.own_p.clone());
        let context = findings::Context {
            evidence: refined,
            joint: &night.joint,
            points: night.points,
            base: &night.base,
            with_all: &judged.with_all,
            entries: &self.confirmed.entries,
            proofs: &self.confirmed.proofs,
            signs: &judged.signs,
            tried: &self.tried,
            resimulated: &own_anew,
            hypotheses: alarm.hypotheses,
        };
        let found: Vec<Finding> = names.standing.iter().map(|k| context.finding(*k, &self.solved, options)).collect();
        let rest = self.rest_beside(&names);
        let anew = self.simulated_with(&names, judged)?;
        let first = self.tried.folds.all.first();
        let left = rest.as_ref().filter(|rest| rest.p_value < options.alpha);
        let unknown = left.map(|rest| left::unknown(refined, everything, &names.withheld, rest, &night.joint, first));
        let verdict = match (found.is_empty(), unknown.is_some()) {
            (_, true) => Verdict::Unexplained,
            (false, false) => Verdict::Explained,
            (true, false) => Verdict::Consistent,
        };
        let mut warnings = self.warnings(verdict, anew);
        let half_nights = self.halves(tell, &mut warnings);
        let noise = &self.solved.stand.noise;
        let largest = if alarm.test.largest.is_empty() { "nothing".to_owned() } else { alarm.test.largest.clone() };
        let left_p = rest.as_ref().map(|rest| rest.p_value);
        let mut diagnosis = Diagnosis {
            format: FORMAT.to_owned(),
            verdict,
            physics: options.physics.clone(),
            effects: context.effects(&self.solved, &found, kept),
            profiles: context.profiles(&names.standing, &found),
            findings: found,
            proposed: proposed(refined, &self.tried, everything, kept, &self.proposals, &names.withheld),
            unknown,
            fit: Fit {
                baseline: quality(refined, &night.base, noise, &self.tried, &[]),
                after: quality(refined, everything, noise, &self.tried, kept),
            },
            channels: Channels { astrometry: Some(ChannelTest { p_value: alarm.test.p_value, largest }), ..Channels::default() },
            stars_used: stars_used(refined, night.points, everything),
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
            camera: Some(self.solved.joint.model().clone()),
            residuals: residual_rows(refined, &night.base, everything, night.points),
            seconds: 0.0,
            provenance: None,
        };
        diagnosis.summary = words::summary(&diagnosis, left_p.unwrap_or(1.0));
        Ok(diagnosis)
    }
}

/// p-value of a statistic of so many degrees of freedom.
pub(super) fn p_of(t: f64, rank: usize) -> f64 {
    (-chi_squared_surprise(rank as f64, t)).exp()
}

/// p-value once all hypotheses are counted.
pub(super) fn family(p: f64, hypotheses: f64) -> f64 {
    -(hypotheses * (-p).ln_1p()).exp_m1()
}
