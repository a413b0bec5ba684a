//! JUnit XML, as Jenkins, GitLab, colcon and nextest read it: a testsuite for each case and value of its sweep, a testcase for each requirement.

use std::time::Duration;

use quick_junit::{NonSuccessKind, Property, Report, TestCase, TestCaseStatus, TestSuite};

use super::result::{CaseResult, CaseValueResult, RequirementResult, SuiteResult};
use super::suite_file::RequirementLevel;
use super::verdict::RequirementVerdict;

/// The report. An undecided requirement is a failure, or where `undecided_passes` a skipped test; so is one of another level than minimum that is not met.
#[must_use]
pub fn junit(result: &SuiteResult, undecided_passes: bool) -> String {
    let mut report = Report::new(&*result.suite);
    for case in &result.cases {
        for value in &case.values {
            report.add_test_suite(suite(result, case, value, undecided_passes));
        }
    }
    // The writer fails on streams alone, and this one is memory. Jenkins' schema counts skipped tests by testsuite alone; a `<` that begins no element
    // is escaped.
    let text = report.to_string().unwrap_or_default();
    let Some((head, rest)) = text.split_once("<testsuites ") else { return text };
    let Some((root, rest)) = rest.split_once('>') else { return text };
    let kept: Vec<&str> = root.split_inclusive("\" ").filter(|attribute| !attribute.starts_with("skipped=")).collect();
    format!("{head}<testsuites {}>{rest}", kept.concat())
}

fn suite(result: &SuiteResult, case: &CaseResult, value: &CaseValueResult, undecided_passes: bool) -> TestSuite {
    let name = if value.words.is_empty() { case.name.clone() } else { format!("{} ({})", case.name, value.words) };
    let mut suite = TestSuite::new(&*name);
    let spent = value.seconds.rendering + value.seconds.answering + value.seconds.scoring;
    suite.set_time(Duration::try_from_secs_f64(spent).unwrap_or_default());
    for (key, text) in [("system", result.system.clone()), ("seed", result.seed.to_string()), ("frames", value.frames.to_string())] {
        suite.add_property(Property::new(key, text));
    }
    for requirement in &value.requirements {
        suite.add_test_case(test_case(&name, case, value, requirement, undecided_passes));
    }
    suite
}

fn test_case(suite: &str, case: &CaseResult, value: &CaseValueResult, own: &RequirementResult, undecided_passes: bool) -> TestCase {
    let is_minimum = own.level == RequirementLevel::Minimum;
    let status = match own.verdict {
        RequirementVerdict::Pass => TestCaseStatus::success(),
        RequirementVerdict::Undecided if undecided_passes || !is_minimum => skipped(own),
        _ if !is_minimum => skipped(own),
        _ => {
            let mut status = TestCaseStatus::non_success(NonSuccessKind::Failure);
            status.set_message(first_line(own)).set_type(own.verdict.word().to_lowercase()).set_description(details(case, value, own));
            status
        }
    };
    let mut test = TestCase::new(requirement_words(own), status);
    test.set_classname(suite);
    let number = |value: Option<f64>| value.map_or_else(|| "none".to_owned(), |value| format!("{value}"));
    let measured = own.measured.as_ref();
    // As output and not as properties: Jenkins' schema has properties of suites alone.
    let told = [
        ("verdict", own.verdict.word().to_owned()),
        ("level", own.level.word().to_owned()),
        ("confidence", own.confidence.to_string()),
        ("value", number(measured.map(|own| own.value))),
        ("lower", number(measured.and_then(|own| own.lower))),
        ("upper", number(measured.and_then(|own| own.upper))),
        ("units", measured.map_or(0, |own| own.units).to_string()),
        ("frames", value.frames.to_string()),
        ("line", own.line.to_string()),
    ];
    test.set_system_out(told.map(|(key, text)| format!("{key} = {text}\n")).concat());
    test
}

fn skipped(own: &RequirementResult) -> TestCaseStatus {
    let mut status = TestCaseStatus::skipped();
    status.set_message(first_line(own));
    status
}

/// A requirement in words: `acquisition.correct_rate ≥ 0.99`.
#[must_use]
pub fn requirement_words(own: &RequirementResult) -> String {
    format!("{} {} {}", own.metric, own.limit.sign(), own.limit.value())
}

/// The measured value with its bounds in words.
#[must_use]
pub fn measured_words(own: &RequirementResult) -> String {
    let Some(measured) = &own.measured else { return "nothing measured".to_owned() };
    let unit = if measured.unit.is_empty() { String::new() } else { format!(" {}", measured.unit) };
    let bound = |bound: Option<f64>, none: &str| bound.map_or_else(|| none.to_owned(), number);
    format!("{} [{}, {}]{unit}", number(measured.value), bound(measured.lower, "−∞"), bound(measured.upper, "∞"))
}

/// A number of four digits.
#[must_use]
pub fn number(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || !value.is_finite() {
        format!("{value}")
    } else if !(1e-3..1e5).contains(&size) {
        format!("{value:.3e}")
    } else {
        let digits = (3 - size.log10().floor() as i32).clamp(0, 6) as usize;
        let text = format!("{value:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    }
}

fn first_line(own: &RequirementResult) -> String {
    let reason = own.reasons.first().map_or_else(String::new, |reason| format!("; {reason}"));
    format!("{}: {}{reason}", own.verdict.word(), measured_words(own))
}

fn details(case: &CaseResult, value: &CaseValueResult, own: &RequirementResult) -> String {
    let mut lines =
        vec![format!("{}: {}, measured {} in {} frames", own.verdict.word(), requirement_words(own), measured_words(own), value.frames)];
    lines.extend(own.reasons.iter().map(|reason| format!("- {reason}")));
    if let Some(small) = &case.smallest_failure {
        lines.push(format!("- {}", small.sentence));
        lines.extend(small.scene.iter().map(|scene| format!("- reproduced by {scene}")));
    }
    for worst in &value.worst {
        let folder = worst.folder.as_ref().map_or_else(String::new, |folder| format!(" ({folder})"));
        lines.push(format!("- frame {}: {}{folder}", worst.frame, worst.answer));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_have_four_digits() {
        let all = [0.0, 1.0, 0.98765, 12.3456, 1234.56, 1.23e-5, 123_456.0, -3.5].map(number);
        assert_eq!(all, ["0", "1", "0.9877", "12.35", "1235", "1.230e-5", "1.235e5", "-3.5"]);
    }
}
