//! A failure is made small: the sweep is bisected for where it begins, and effects are switched off one by one while it still fails (delta debugging:
//! Zeller & Hildebrandt, IEEE Trans. Softw. Eng. 28, 183, 2002; one pass over single switches, which is enough where causes do not hide each other).

use toml::{Table, Value};

use super::error::SuiteError;
use super::intervals::Risk;
use super::plan::{PlannedCase, PlannedRequirement};
use super::result::SmallestFailure;
use super::runner::{CaseRun, Runner};
use super::scene_tables::put;
use super::switches::{Switch, switches};
use super::verdict::SampleKind;

/// Frames of a trial, and how often a sweep is halved.
const TRIAL_FRAMES: usize = 24;
const HALVINGS: usize = 5;

/// Where to begin.
pub(super) struct Failing<'f> {
    pub(super) requirement: &'f PlannedRequirement,
    /// Which value of the sweep fails.
    pub(super) value: usize,
    /// A value beside it that does not.
    pub(super) good: Option<usize>,
    /// Frames that fail, the worst first.
    pub(super) worst: Vec<usize>,
    pub(super) frames: usize,
}

/// A trial of changed tables.
struct Trials<'t, 'a> {
    runner: &'t mut Runner<'a>,
    case: &'t PlannedCase,
    requirement: &'t PlannedRequirement,
    numbers: Vec<usize>,
    count: usize,
}

impl Trials<'_, '_> {
    /// Whether the frames still fail with these tables; tables that are no scene any more do not.
    fn fails(&mut self, tables: &Table) -> Result<bool, SuiteError> {
        self.count += 1;
        let mut run = CaseRun::default();
        let numbers = self.numbers.clone();
        for range in numbers.chunk_by(|a, b| a + 1 == *b) {
            let Ok(batch) = self.case.batch_of(tables, range[0]..range[range.len() - 1] + 1) else { return Ok(false) };
            self.runner.batch(self.case, &batch, &mut run)?;
        }
        let none = Risk { lower: 0.5, upper: 0.5 };
        let value = run.scores.sample(&self.requirement.metric).and_then(|sample| sample.bounds(none)).map(|bounded| bounded.value);
        Ok(value.is_some_and(|value| !self.requirement.limit.holds(value)))
    }
}

/// Makes a failure of a scene small; also the tables that are left. `None`: the few frames of a trial do not show it.
pub(super) fn smallest(
    runner: &mut Runner<'_>,
    case: &PlannedCase,
    failing: &Failing<'_>,
) -> Result<Option<(SmallestFailure, Table)>, SuiteError> {
    let of_table = |message| SuiteError::Parse { path: case.name.clone(), message };
    let Some(mut tables) = case.tables(failing.value).map_err(of_table)? else { return Ok(None) };
    // Shares: frames that failed, and as many others. Other metrics: the first frames, so that none is chosen for its error.
    let mut numbers: Vec<usize> = match failing.requirement.metric.kind {
        SampleKind::Share => failing.worst.iter().copied().take(TRIAL_FRAMES / 2).chain(0..failing.frames.min(TRIAL_FRAMES / 2)).collect(),
        _ => (0..failing.frames.min(case.attitudes.frames_per_field().max(TRIAL_FRAMES))).collect(),
    };
    numbers.sort_unstable();
    numbers.dedup();
    let mut trials = Trials { runner, case, requirement: failing.requirement, numbers, count: 0 };
    if !trials.fails(&tables)? {
        return Ok(None);
    }
    let fails_between = between(&mut trials, case, failing)?;
    // At the value that failed, and not at the edge, where every trifle decides.
    let (mut superfluous, mut needed): (Vec<Switch>, Vec<Switch>) = (Vec::new(), Vec::new());
    for switch in switches(&tables) {
        let without = switch.off(&tables);
        if trials.fails(&without)? {
            tables = without;
            superfluous.push(switch);
        } else {
            needed.push(switch);
        }
    }
    let names = |all: &[Switch]| all.iter().map(|own| own.name.clone()).collect::<Vec<_>>();
    let (superfluous, needed) = (names(&superfluous), names(&needed));
    let found = SmallestFailure {
        sentence: sentence(case, failing, fails_between, &needed, !superfluous.is_empty()),
        metric: failing.requirement.name.clone(),
        fails_between,
        superfluous,
        needed,
        scene: None,
        trials: trials.count,
    };
    Ok(Some((found, tables)))
}

/// Halves the step of the sweep from good to bad.
fn between(trials: &mut Trials<'_, '_>, case: &PlannedCase, failing: &Failing<'_>) -> Result<Option<[f64; 2]>, SuiteError> {
    let Some(sweep) = &case.sweep else { return Ok(None) };
    let number = |value: usize| match &sweep.values[value] {
        Value::Float(number) => Some(*number),
        Value::Integer(number) => Some(*number as f64),
        _ => None,
    };
    let (Some(mut good), Some(mut bad)) = (failing.good.and_then(number), number(failing.value)) else { return Ok(None) };
    for _ in 0..HALVINGS {
        let middle = f64::midpoint(good, bad);
        let of_table = |message| SuiteError::Parse { path: case.name.clone(), message };
        let Some(mut tables) = case.tables(failing.value).map_err(of_table)? else { return Ok(None) };
        if put(&sweep.path, &mut tables, &Value::Float(middle)).is_err() {
            return Ok(None);
        }
        if trials.fails(&tables)? { bad = middle } else { good = middle }
    }
    Ok(Some([good, bad]))
}

fn sentence(case: &PlannedCase, failing: &Failing<'_>, between: Option<[f64; 2]>, needed: &[String], any_off: bool) -> String {
    let from = match (between, &case.sweep) {
        (Some([good, bad]), Some(sweep)) => format!(" from {} = {bad:.4} on (good at {good:.4})", sweep.name),
        (None, Some(_)) => format!(" at {}", case.value_words(failing.value)),
        _ => String::new(),
    };
    let with = match needed {
        [] if any_off => ", with every effect switched off that can be".to_owned(),
        [] => String::new(),
        [one] => format!(", with {one} alone"),
        [all @ .., last] => format!(", with {} and {last} alone", all.join(", ")),
    };
    format!("{} fails{from}{with}", failing.requirement.name)
}
