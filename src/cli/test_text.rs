//! The table of a suite, for people.

use boresight::report::table;
use boresight::suite::{CaseResult, RequirementLevel, RequirementVerdict, SuiteResult, measured_words, requirement_words};

use super::calibrate_text::wrapped;

/// The table, what is wrong, and the verdict last: where eyes end.
pub(super) fn text(object: &SuiteResult) -> String {
    let mut all = String::new();
    for case in &object.cases {
        all += &of_case(case);
    }
    if let Some(baseline) = &object.baseline {
        all += &format!("against {}: {} metrics became worse\n", baseline.file, baseline.worse.len());
        for worse in &baseline.worse {
            all += &wrapped("  worse:", &worse.sentence, "  worse: ".len());
        }
        for missing in &baseline.missing {
            all += &wrapped("  note:", &format!("{missing} was there before and is not in this suite"), "  note: ".len());
        }
    }
    let [met, broken, undecided] = object.counts();
    all + &format!(
        "{}: {} against {}, {met} requirements met, {broken} broken, {undecided} undecided (seed {})\n",
        object.verdict.word(),
        object.system,
        object.suite,
        object.seed
    )
}

fn of_case(case: &CaseResult) -> String {
    let mut text = format!("{}\n", case.name);
    let mut rows: Vec<Vec<String>> = Vec::new();
    for value in &case.values {
        for own in &value.requirements {
            let level = if own.level == RequirementLevel::Minimum { String::new() } else { format!(" ({})", own.level.word()) };
            let mut row = vec![own.verdict.word().to_owned()];
            if case.sweep.is_some() {
                row.push(value.words.clone());
            }
            row.extend([format!("{}{level}", requirement_words(own)), measured_words(own), value.frames.to_string()]);
            rows.push(row);
        }
    }
    let header: &[&str] = if case.sweep.is_some() {
        &["verdict", "at", "requirement", "measured, with bounds", "frames"]
    } else {
        &["verdict", "requirement", "measured, with bounds", "frames"]
    };
    if rows.is_empty() {
        text += "  nothing is required\n";
    } else {
        text += &table(header, &rows);
    }
    let mut said: Vec<&str> = Vec::new();
    for value in &case.values {
        let at = if value.words.is_empty() { String::new() } else { format!("{}: ", value.words) };
        for own in value.requirements.iter().filter(|own| own.verdict != RequirementVerdict::Pass) {
            for reason in own.reasons.iter().filter(|reason| !said.contains(&reason.as_str())).collect::<Vec<_>>() {
                text += &wrapped("  why:", &format!("{at}{reason}"), "  why: ".len());
                said.push(reason);
            }
        }
        for worst in &value.worst {
            let folder = worst.folder.as_ref().map_or_else(String::new, |folder| format!(" ({folder})"));
            text += &wrapped("  frame", &format!("{}: {}{folder}", worst.frame, worst.answer), "  frame ".len());
        }
    }
    if let Some(small) = &case.smallest_failure {
        text += &wrapped("  smallest:", &small.sentence, "  smallest: ".len());
    }
    text + "\n"
}
