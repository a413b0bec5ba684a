//! Scores become results: verdicts of requirements, metrics that are always told, faults, and the worst frames.

use super::answers::AnswerStatus;
use super::faults::{faults, untold};
use super::looks::spent;
use super::metric::Metric;
use super::plan::{PlannedCase, PlannedRequirement, SuitePlan};
use super::result::{CaseValueResult, MeasuredMetric, RequirementResult, WorstFrame};
use super::runner::CaseRun;
use super::samples::CaseScores;
use super::score::ScoredFrame;
use super::verdict::{ErrorRates, RequirementVerdict, frames_to_decide, verdict};
use crate::statistics::order::sort_by;
use crate::units::ARCSEC_RAD;

/// A look at a case among those that its error is spent over.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    pub(super) index: usize,
    pub(super) count: usize,
}

/// Metrics that are told whether they are required or not.
const ALWAYS: [&str; 4] = ["acquisition.correct_rate", "acquisition.false_rate", "attitude.cross_boresight_arcsec.p95", "latency_s.p50"];
/// Worst frames that are kept.
const KEPT: usize = 3;

/// The error rates of a requirement at a look. That of a false FAIL is divided among all requirements of the suite.
fn errors(plan: &SuitePlan, requirement: &PlannedRequirement, look: Look) -> ErrorRates {
    let risk = 1.0 - requirement.confidence;
    spent(ErrorRates { false_pass: risk, false_fail: risk / plan.judged() as f64 }, look.index, look.count)
}

/// The results of the requirements that apply at a value of the sweep.
pub(super) fn requirements(plan: &SuitePlan, case: &PlannedCase, value: usize, scores: &CaseScores, look: Look) -> Vec<RequirementResult> {
    case.requirements.iter().filter(|own| case.applies(own, value)).map(|own| requirement(plan, own, scores, look)).collect()
}

fn requirement(plan: &SuitePlan, own: &PlannedRequirement, scores: &CaseScores, look: Look) -> RequirementResult {
    let errors = errors(plan, own, look);
    let sample = scores.sample(&own.metric);
    let bounded = sample.as_ref().and_then(|sample| sample.bounds(own.limit.risk(errors)));
    let found = bounded.as_ref().map_or(RequirementVerdict::Undecided, |bounded| verdict(bounded, own.limit));
    let frames = scores.frames.len();
    let more = sample
        .as_ref()
        .filter(|_| found == RequirementVerdict::Undecided && bounded.is_some())
        .and_then(|sample| frames_to_decide(sample, own.limit, errors, frames));
    let mut reasons = Vec::new();
    match (found, &bounded) {
        (RequirementVerdict::Undecided, None) => reasons.push(nothing(&own.metric, scores)),
        (RequirementVerdict::Undecided, Some(bounded)) => reasons.push(match more {
            Some(more) => {
                let side = if own.limit.holds(bounded.value) { "" } else { " (and then it fails rather than passes)" };
                format!("undecided: needs about {} more frames{side}", more.saturating_sub(frames).max(1))
            }
            None => "undecided: the value is at the limit, and no number of frames decides it".to_owned(),
        }),
        _ => {}
    }
    let measured = sample.zip(bounded).map(|(sample, bounded)| measured(&own.name, &own.metric, sample.units(), &bounded));
    RequirementResult {
        metric: own.name.clone(),
        line: own.line,
        limit: own.limit,
        confidence: own.confidence,
        level: own.level,
        verdict: found,
        measured,
        frames_to_decide: more,
        reasons,
    }
}

/// Why a metric has no sample.
fn nothing(metric: &Metric, scores: &CaseScores) -> String {
    use super::metric::AnswerNeeds;
    let right = scores.frames.iter().filter(|frame| frame.is_right).count();
    match metric.needs {
        AnswerNeeds::Attitude | AnswerNeeds::Design if right == 0 => {
            "nothing to judge: no answer is right (acquisition.correct_rate says how many are)".to_owned()
        }
        AnswerNeeds::Design => "nothing to judge: too few fields have answers to all of their frames".to_owned(),
        AnswerNeeds::Centroids => "nothing to judge: the answers hold no centroids (write centroids.csv beside the answer)".to_owned(),
        AnswerNeeds::Names => {
            "nothing to judge: the answers hold no centroids with ids (write centroids.csv with the column id)".to_owned()
        }
        AnswerNeeds::Camera => {
            "nothing to judge: the answers hold no camera with what this needs (write camera.json beside the answer)".to_owned()
        }
        AnswerNeeds::Sequence => "nothing to judge: no answer was lost and found again".to_owned(),
        _ => "nothing to judge: the answers hold nothing of it".to_owned(),
    }
}

fn measured(name: &str, metric: &Metric, units: usize, bounded: &super::intervals::Bounded) -> MeasuredMetric {
    let finite = |bound: f64| bound.is_finite().then_some(bound);
    MeasuredMetric {
        metric: name.to_owned(),
        unit: metric.unit.to_owned(),
        value: bounded.value,
        lower: finite(bounded.lower),
        upper: finite(bounded.upper),
        units,
    }
}

/// The whole result of a case at a value of its sweep.
pub(super) fn case_value(
    plan: &SuitePlan,
    case: &PlannedCase,
    value: usize,
    run: &CaseRun,
    mut requirements: Vec<RequirementResult>,
) -> CaseValueResult {
    let scores = &run.scores;
    let faults = run.camera.as_ref().map(|camera| faults(scores, &plan.conventions, camera)).unwrap_or_default();
    let is_bad = |own: &RequirementResult| {
        own.verdict == RequirementVerdict::Fail || own.verdict == RequirementVerdict::Undecided && own.measured.is_none()
    };
    let any_bad = requirements.iter().any(is_bad);
    let is_foreign = plan.file.system.is_some();
    let untold = if any_bad && faults.is_empty() && is_foreign { untold(scores) } else { None };
    for own in requirements.iter_mut().filter(|own| is_bad(own)) {
        own.reasons.extend(faults.iter().map(|fault| fault.sentence.clone()));
        own.reasons.extend(untold.clone());
    }
    let risk = super::intervals::Risk { lower: 0.025, upper: 0.025 };
    let told = ALWAYS.iter().filter_map(|name| {
        let metric = Metric::find(name).ok()?;
        let sample = scores.sample(&metric)?;
        Some(measured(name, &metric, sample.units(), &sample.bounds(risk)?))
    });
    CaseValueResult {
        value: case.sweep.as_ref().and_then(|sweep| serde_json::to_value(&sweep.values[value]).ok()),
        words: case.value_words(value),
        frames: scores.frames.len(),
        measured: told.collect(),
        requirements,
        faults,
        untold,
        worst: if any_bad { worst(scores) } else { Vec::new() },
        seconds: run.seconds,
    }
}

/// The frames with the worst answers: crashes and wrong attitudes first, then none, then the largest errors.
pub(super) fn worst(scores: &CaseScores) -> Vec<WorstFrame> {
    let badness = |frame: &ScoredFrame| match (frame.status, frame.is_right) {
        (AnswerStatus::Crashed | AnswerStatus::TimedOut | AnswerStatus::Unreadable, _) => 4e9,
        (AnswerStatus::Solved, false) => 2e9 + frame.error.map_or(1e8, |error| error.cross_rad),
        (AnswerStatus::None | AnswerStatus::Error, _) => 1e9,
        (AnswerStatus::Solved, true) => frame.error.map_or(0.0, |error| error.cross_rad),
    };
    let mut order: Vec<&ScoredFrame> = scores.frames.iter().collect();
    sort_by(&mut order, |a, b| badness(b).total_cmp(&badness(a)).then(a.number.cmp(&b.number)));
    order.into_iter().take(KEPT).map(told).collect()
}

fn told(frame: &ScoredFrame) -> WorstFrame {
    let words = frame.words.as_ref().map_or_else(String::new, |words| format!(": {words}"));
    let answer = match (frame.status, frame.is_right, &frame.error) {
        (AnswerStatus::Solved, true, Some(error)) => format!("right, {:.1}\" off", error.cross_rad / ARCSEC_RAD),
        (AnswerStatus::Solved, _, Some(error)) => {
            format!("wrong: {:.4}° across and {:.4}° about the boresight off", error.cross_rad.to_degrees(), error.about_rad.to_degrees())
        }
        (AnswerStatus::Solved, _, None) => "wrong: no rotation under the declared conventions".to_owned(),
        (AnswerStatus::None, ..) => format!("none{words}"),
        (AnswerStatus::Error, ..) => format!("an error of its own{words}"),
        (AnswerStatus::Crashed, ..) => format!("crashed{words}"),
        (AnswerStatus::TimedOut, ..) => format!("none in time{words}"),
        (AnswerStatus::Unreadable, ..) => format!("unreadable{words}"),
    };
    let [ra, dec, roll] = frame.truth.pointing_rad().map(f64::to_degrees);
    WorstFrame {
        frame: frame.number,
        answer,
        cross_boresight_arcsec: frame.error.map(|error| error.cross_rad / ARCSEC_RAD),
        radec_roll_deg: [ra.rem_euclid(360.0), dec, roll.rem_euclid(360.0)],
        folder: None,
    }
}
