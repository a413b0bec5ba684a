//! Annotations and the summary of a step of GitHub Actions. GitHub shows ten annotations a step, and no summary of more than a MiB: the worst come first,
//! and what goes beyond is told as a number.

use super::junit::{measured_words, requirement_words};
use super::result::{CaseResult, CaseValueResult, RequirementResult, SuiteResult};
use super::suite_file::RequirementLevel;
use super::verdict::RequirementVerdict;
use crate::statistics::order::sort_by_key;

/// What GitHub shows.
const MAX_ANNOTATIONS: usize = 10;
/// Less than GitHub's limit, in bytes.
const MAX_SUMMARY_BYTES: usize = 900_000;

type Row<'r> = (&'r CaseResult, &'r CaseValueResult, &'r RequirementResult);

/// Every requirement with its case, the worst first.
fn rows(result: &SuiteResult) -> Vec<Row<'_>> {
    let mut all: Vec<Row<'_>> = Vec::new();
    for case in &result.cases {
        for value in &case.values {
            all.extend(value.requirements.iter().map(|own| (case, value, own)));
        }
    }
    let rank = |(_, _, own): &Row<'_>| {
        let level = match own.level {
            RequirementLevel::Minimum => 0,
            RequirementLevel::Design => 1,
            RequirementLevel::Stretch => 2,
        };
        let verdict = match own.verdict {
            RequirementVerdict::Fail => 0,
            RequirementVerdict::Undecided => 1,
            RequirementVerdict::Pass => 2,
        };
        (u8::from(verdict == 2), level, verdict)
    };
    sort_by_key(&mut all, rank);
    all
}

/// Text of a workflow command (actions/toolkit, `command.ts`).
fn escaped(text: &str) -> String {
    text.replace('%', "%25").replace('\r', "%0D").replace('\n', "%0A")
}

fn title(case: &CaseResult, value: &CaseValueResult) -> String {
    let words = if value.words.is_empty() { String::new() } else { format!(" ({})", value.words) };
    escaped(&format!("{}{words}", case.name)).replace(':', "%3A").replace(',', "%2C")
}

/// The annotations, a line each, at the requirement's line of the suite.
#[must_use]
pub fn annotations(result: &SuiteResult) -> String {
    let bad: Vec<Row<'_>> = rows(result).into_iter().filter(|(_, _, own)| own.verdict != RequirementVerdict::Pass).collect();
    let shown = if bad.len() > MAX_ANNOTATIONS { MAX_ANNOTATIONS - 1 } else { bad.len() };
    let file = escaped(&result.suite).replace(':', "%3A").replace(',', "%2C");
    let mut text = String::new();
    for (case, value, own) in &bad[..shown] {
        let kind = match (own.level, own.verdict) {
            (RequirementLevel::Minimum, RequirementVerdict::Fail) => "error",
            (RequirementLevel::Minimum, _) => "warning",
            _ => "notice",
        };
        let reasons = own.reasons.iter().flat_map(|reason| ["\n", reason]).collect::<String>();
        let message = escaped(&format!("{}: {}, measured {}{reasons}", own.verdict.word(), requirement_words(own), measured_words(own)));
        text += &format!("::{kind} file={file},line={},title={}::{message}\n", own.line, title(case, value));
    }
    if bad.len() > shown {
        text += &format!("::warning file={file}::{} more requirements are not met; the summary of the job lists them\n", bad.len() - shown);
    }
    text
}

/// The summary, Markdown.
#[must_use]
pub fn summary(result: &SuiteResult) -> String {
    let [met, broken, undecided] = result.counts();
    let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
    let mut text = format!(
        "## boresight test: {}\n\n`{}` against `{}`: {met} requirements met, {broken} broken, {undecided} undecided (seed {}).\n\n\
         | verdict | case | requirement | measured, with one-sided bounds | frames | why |\n|---|---|---|---|---|---|\n",
        result.verdict.word(),
        result.system,
        result.suite,
        result.seed
    );
    let all = rows(result);
    for (place, (case, value, own)) in all.iter().enumerate() {
        let level = if own.level == RequirementLevel::Minimum { String::new() } else { format!(" ({})", own.level.word()) };
        let words = if value.words.is_empty() { String::new() } else { format!(" ({})", value.words) };
        let row = format!(
            "| {}{level} | {}{} | {} | {} | {} | {} |\n",
            own.verdict.word(),
            cell(&case.name),
            cell(&words),
            cell(&requirement_words(own)),
            measured_words(own),
            value.frames,
            cell(&own.reasons.join(" ")),
        );
        if text.len() + row.len() > MAX_SUMMARY_BYTES {
            text += &format!("\n{} more rows are left out.\n", all.len() - place);
            break;
        }
        text += &row;
    }
    for small in result.cases.iter().filter_map(|case| case.smallest_failure.as_ref()) {
        if text.len() < MAX_SUMMARY_BYTES {
            text += &format!("\nSmallest failure: {}\n", small.sentence);
        }
    }
    text
}
