//! What became worse than in an earlier result.

use std::path::Path;

use serde::Deserialize;

use super::error::SuiteError;
use super::junit::number;
use super::result::{BaselineResult, CaseResult, MeasuredMetric, TEST_FORMAT, WorseMetric};
use super::verdict::RequirementLimit;

/// What is read of an earlier result.
#[derive(Deserialize)]
struct Earlier {
    format: String,
    cases: Vec<EarlierCase>,
}

#[derive(Deserialize)]
struct EarlierCase {
    name: String,
    values: Vec<EarlierValue>,
}

#[derive(Deserialize)]
struct EarlierValue {
    words: String,
    requirements: Vec<EarlierRequirement>,
}

#[derive(Deserialize)]
struct EarlierRequirement {
    metric: String,
    measured: Option<MeasuredMetric>,
}

/// Holds results against those of a file. A metric is worse if its value lies on the wrong side of the earlier bounds, and the earlier value on the
/// good side of its own.
pub fn compared(path: &Path, cases: &[CaseResult]) -> Result<BaselineResult, SuiteError> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|source| SuiteError::Read { path: name.clone(), source })?;
    let wrong = |message: String| SuiteError::Parse { path: name.clone(), message };
    let earlier: Earlier = serde_json::from_str(&text).map_err(|error| wrong(format!("is no result of `boresight test`: {error}")))?;
    if earlier.format != TEST_FORMAT {
        return Err(wrong(format!(
            "format = {:?} is no result of `boresight test`; give its results.json ({TEST_FORMAT})",
            earlier.format
        )));
    }
    let mut found = BaselineResult { file: name.clone(), worse: Vec::new(), missing: Vec::new() };
    for case in &earlier.cases {
        for value in &case.values {
            for own in &value.requirements {
                let now = cases
                    .iter()
                    .filter(|other| other.name == case.name)
                    .flat_map(|other| &other.values)
                    .filter(|other| other.words == value.words);
                let now = now.flat_map(|value| &value.requirements).find(|other| other.metric == own.metric);
                match (now, &own.measured) {
                    (None, _) => found.missing.push(place(&case.name, &value.words, &own.metric)),
                    (Some(now), Some(before)) => {
                        if let Some(worse) = now.measured.as_ref().and_then(|measured| worse(before, measured, now.limit)) {
                            let place = place(&case.name, &value.words, &own.metric);
                            let (case, words, metric) = (case.name.clone(), value.words.clone(), own.metric.clone());
                            found.worse.push(WorseMetric {
                                case,
                                words,
                                metric,
                                before: before.value,
                                now: worse,
                                sentence: format!("{place}: {} before, {} now", number(before.value), number(worse)),
                            });
                        }
                    }
                    _ => {}
                }
            }
        }
    }
    Ok(found)
}

fn place(case: &str, words: &str, metric: &str) -> String {
    let words = if words.is_empty() { String::new() } else { format!(" ({words})") };
    format!("{case}{words}: {metric}")
}

/// The value, if it is worse by more than both intervals.
fn worse(before: &MeasuredMetric, now: &MeasuredMetric, limit: RequirementLimit) -> Option<f64> {
    let is_worse = match limit {
        RequirementLimit::AtMost(_) => {
            before.upper.is_some_and(|upper| now.value > upper) && now.lower.is_some_and(|lower| lower > before.value)
        }
        RequirementLimit::AtLeast(_) => {
            before.lower.is_some_and(|lower| now.value < lower) && now.upper.is_some_and(|upper| upper < before.value)
        }
    };
    is_worse.then_some(now.value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(value: f64, half: f64) -> MeasuredMetric {
        MeasuredMetric {
            metric: String::new(),
            unit: String::new(),
            value,
            lower: Some(value - half),
            upper: Some(value + half),
            units: 10,
        }
    }

    #[test]
    fn only_what_lies_beyond_both_intervals_is_worse() {
        let at_most = RequirementLimit::AtMost(5.0);
        assert_eq!(worse(&measured(1.0, 0.2), &measured(1.5, 0.2), at_most), Some(1.5));
        assert_eq!(worse(&measured(1.0, 0.2), &measured(1.15, 0.02), at_most), None);
        assert_eq!(worse(&measured(1.0, 0.2), &measured(1.5, 0.6), at_most), None);
        assert_eq!(worse(&measured(1.0, 0.2), &measured(0.5, 0.1), at_most), None);
        assert_eq!(worse(&measured(0.99, 0.005), &measured(0.9, 0.01), RequirementLimit::AtLeast(0.9)), Some(0.9));
    }
}
