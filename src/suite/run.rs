//! A suite from its first frame to its result.

use super::error::SuiteError;
use super::failures::{FailureFrame, failure_frames, folder_name, one_frame};
use super::judge::{Look, case_value, requirements};
use super::looks::looks;
use super::metric::AnswerNeeds;
use super::plan::{PlannedCase, SuitePlan};
use super::result::{CaseResult, CaseValueResult, RequirementResult, SmallestFailure};
use super::runner::{CaseRun, Runner};
use super::samples::CaseScores;
use super::smallest::{Failing, smallest};
use super::verdict::{RequirementVerdict, SampleKind};
use crate::catalog::Catalog;

/// The first look of `frames = "auto"`.
const FIRST_LOOK: usize = 50;

/// Who is told how far a suite is.
pub trait SuiteProgress {
    /// A case at a value of its sweep begins; so many frames at most.
    fn begin(&self, name: &str, words: &str, frames: usize);
    /// So many frames are done.
    fn frames(&self, count: usize);
    /// All of them.
    fn end(&self);
}

/// What a suite showed, and the frames of its failures.
#[derive(Debug, Default)]
pub struct SuiteRun {
    /// The results.
    pub cases: Vec<CaseResult>,
    /// The worst frames of what failed.
    pub failures: Vec<FailureFrame>,
    /// Scenes of the smallest failures, with their files within the folder of the result.
    pub scenes: Vec<(String, String)>,
}

/// What of a suite is run, and how.
#[derive(Clone, Debug, Default)]
pub struct SuiteOptions {
    /// Cases whose names hold one of these; all, if it is empty.
    pub only: Vec<String>,
    /// Whether failures are kept and made small.
    pub keeps_failures: bool,
}

/// Runs the cases.
pub fn run_suite(
    plan: &SuitePlan,
    catalog: &Catalog,
    options: &SuiteOptions,
    progress: &dyn SuiteProgress,
) -> Result<SuiteRun, SuiteError> {
    let mut runner = Runner::new(plan, catalog);
    let is_meant = |case: &&PlannedCase| options.only.is_empty() || options.only.iter().any(|name| case.name.contains(name.as_str()));
    let mut all = SuiteRun::default();
    for case in plan.cases.iter().filter(is_meant) {
        let mut values = Vec::new();
        for value in 0..case.values() {
            let (mut result, scores) = value_of(&mut runner, case, value, progress)?;
            if options.keeps_failures && !result.worst.is_empty() {
                all.failures.extend(failure_frames(&runner, case, (value, &result.words), &scores, &mut result.worst)?);
            }
            values.push((result, worst_numbers(&scores)));
        }
        let small = if options.keeps_failures { small(&mut runner, case, &values, &mut all.scenes)? } else { None };
        all.cases.push(CaseResult {
            name: case.name.clone(),
            line: case.line,
            sweep: case.sweep.as_ref().map(|sweep| sweep.name.clone()),
            values: values.into_iter().map(|(value, _)| value).collect(),
            smallest_failure: small,
        });
    }
    Ok(all)
}

/// Frames without a right answer.
fn worst_numbers(scores: &CaseScores) -> Vec<usize> {
    scores.frames.iter().filter(|frame| !frame.is_right).map(|frame| frame.number).take(50).collect()
}

/// Makes the first failure of a case small. One that the system under test shows as a crash or by wrong conventions has no cause in the scene.
fn small(
    runner: &mut Runner<'_>,
    case: &PlannedCase,
    values: &[(CaseValueResult, Vec<usize>)],
    scenes: &mut Vec<(String, String)>,
) -> Result<Option<SmallestFailure>, SuiteError> {
    let failed =
        |value: &CaseValueResult| value.requirements.iter().find(|own| own.verdict == RequirementVerdict::Fail).map(|own| own.line);
    let Some((index, line)) = values.iter().enumerate().find_map(|(index, (value, _))| Some((index, failed(value)?))) else {
        return Ok(None);
    };
    let Some(requirement) = case.requirements.iter().find(|own| own.line == line) else { return Ok(None) };
    if !matches!(requirement.metric.kind, SampleKind::Share | SampleKind::Quantile(_) | SampleKind::Mean | SampleKind::Square)
        || matches!(requirement.metric.needs, AnswerNeeds::Diagnosis | AnswerNeeds::Sequence)
    {
        return Ok(None);
    }
    let is_good = |at: &usize| {
        values
            .get(*at)
            .is_some_and(|(value, _)| value.requirements.iter().any(|own| own.line == line && own.verdict == RequirementVerdict::Pass))
    };
    let good = index.checked_sub(1).filter(is_good).or_else(|| Some(index + 1).filter(is_good));
    let (value, worst) = &values[index];
    let failing = Failing { requirement, value: index, good, worst: worst.clone(), frames: value.frames };
    let Some((mut found, tables)) = smallest(runner, case, &failing)? else { return Ok(None) };
    let number = value.worst.first().map_or(0, |worst| worst.frame);
    let path = format!("failures/{}/scene.toml", folder_name(&case.name));
    scenes.push((path.clone(), one_frame(case, &tables, number)));
    found.scene = Some(path);
    Ok(Some(found))
}

fn value_of(
    runner: &mut Runner<'_>,
    case: &PlannedCase,
    value: usize,
    progress: &dyn SuiteProgress,
) -> Result<(CaseValueResult, CaseScores), SuiteError> {
    let numbers = frames_of_looks(case, case.frames_there_are(value)?);
    progress.begin(&case.name, &case.value_words(value), numbers.last().copied().unwrap_or(0));
    let mut run = CaseRun::default();
    let plan = runner.plan;
    let decided = decided(plan, (case, value), &numbers, &mut run, &mut |run, upto| {
        runner.extend(case, value, run, upto, &|count| progress.frames(count))
    })?;
    progress.end();
    let result = case_value(plan, case, value, &run, decided);
    Ok((result, run.scores))
}

/// After how many frames a case is looked at; `there_are` so many at most.
pub(super) fn frames_of_looks(case: &PlannedCase, there_are: usize) -> Vec<usize> {
    if let Some(frames) = case.frames {
        return vec![frames.min(there_are)];
    }
    // Whole fields and nights at each look.
    let unit = case.attitudes.frames_per_field().max(case.night_frames);
    let whole = |frames: usize| (frames.div_ceil(unit) * unit).min(there_are);
    let mut all: Vec<usize> = looks(FIRST_LOOK, case.max_frames).into_iter().map(whole).collect();
    all.dedup();
    all
}

/// The requirements at a value of the sweep, by frames that `add` makes up to the number of each look until all are decided.
pub(super) fn decided(
    plan: &SuitePlan,
    (case, value): (&PlannedCase, usize),
    numbers: &[usize],
    run: &mut CaseRun,
    add: &mut dyn FnMut(&mut CaseRun, usize) -> Result<(), SuiteError>,
) -> Result<Vec<RequirementResult>, SuiteError> {
    // A requirement that was decided at a look stays so: its error is spent.
    let mut decided: Vec<RequirementResult> = Vec::new();
    for (index, upto) in numbers.iter().enumerate() {
        add(run, *upto)?;
        let now = requirements(plan, case, value, &run.scores, Look { index, count: numbers.len() });
        decided = if decided.is_empty() {
            now
        } else {
            let kept = |(before, now): (RequirementResult, RequirementResult)| {
                if before.verdict == RequirementVerdict::Undecided { now } else { before }
            };
            decided.into_iter().zip(now).map(kept).collect()
        };
        if decided.iter().all(|own| own.verdict != RequirementVerdict::Undecided) {
            break;
        }
    }
    Ok(decided)
}
