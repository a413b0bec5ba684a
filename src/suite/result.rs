//! The result of a suite, as it is written.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::faults::SystemFault;
use super::suite_file::RequirementLevel;
use super::verdict::{RequirementLimit, RequirementVerdict};
use crate::provenance::Provenance;

/// The name of the file format.
pub const TEST_FORMAT: &str = "boresight-test/1";

/// What a suite showed.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SuiteResult {
    /// [`TEST_FORMAT`].
    pub format: &'static str,
    /// The suite.
    pub suite: String,
    /// The system under test.
    pub system: String,
    /// The seed of attitudes and noise.
    pub seed: u64,
    /// Over all requirements of the level minimum.
    pub verdict: RequirementVerdict,
    /// The cases.
    pub cases: Vec<CaseResult>,
    /// What became worse than in an earlier result, where one was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub baseline: Option<BaselineResult>,
    /// How it came about.
    pub provenance: Provenance,
}

/// A case.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct CaseResult {
    /// Its name.
    pub name: String,
    /// Its line in the suite.
    pub line: usize,
    /// What was swept, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep: Option<String>,
    /// At each value of the sweep; without a sweep once.
    pub values: Vec<CaseValueResult>,
    /// How the case fails with least, where it fails.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub smallest_failure: Option<SmallestFailure>,
}

/// A case at a value of its sweep.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct CaseValueResult {
    /// The value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<serde_json::Value>,
    /// The same in words; empty without a sweep.
    pub words: String,
    /// Frames that were run.
    pub frames: usize,
    /// The requirements.
    pub requirements: Vec<RequirementResult>,
    /// What the answers showed, required or not.
    pub measured: Vec<MeasuredMetric>,
    /// What is wrong with the system under test.
    pub faults: Vec<SystemFault>,
    /// What such answers cannot show, where something failed and no fault was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub untold: Option<String>,
    /// The frames with the worst answers, the worst first.
    pub worst: Vec<WorstFrame>,
    /// CPU and waiting together, s.
    pub seconds: SpentSeconds,
}

/// Where the time went.
#[derive(Clone, Copy, Debug, Default, Serialize, JsonSchema)]
pub struct SpentSeconds {
    /// Rendering, wall time.
    pub rendering: f64,
    /// Handing over and waiting for answers, wall time.
    pub answering: f64,
    /// Scoring, wall time.
    pub scoring: f64,
}

/// A requirement at a value of the sweep.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct RequirementResult {
    /// The metric.
    pub metric: String,
    /// Its line in the suite.
    pub line: usize,
    /// What is required.
    pub limit: RequirementLimit,
    /// How sure a PASS is.
    pub confidence: f64,
    /// What hangs on it.
    pub level: RequirementLevel,
    /// The verdict.
    pub verdict: RequirementVerdict,
    /// The value with its one-sided bounds; absent: the answers hold nothing of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredMetric>,
    /// Frames in all that it takes until it is decided, about; absent: decided, or no number is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames_to_decide: Option<usize>,
    /// Why it is not met, or not decided, one sentence each.
    pub reasons: Vec<String>,
}

/// A metric with the bounds of its true value.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct MeasuredMetric {
    /// Its name.
    pub metric: String,
    /// Its unit; empty: none.
    pub unit: String,
    /// The value.
    pub value: f64,
    /// The lower bound; absent: none.
    pub lower: Option<f64>,
    /// The upper bound; absent: none.
    pub upper: Option<f64>,
    /// Independent units (frames, cameras, nights) that it rests on.
    pub units: usize,
}

/// A frame whose answer is among the worst.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct WorstFrame {
    /// Its number in the case.
    pub frame: usize,
    /// What the answer was.
    pub answer: String,
    /// The angle between the boresights, where there is an attitude.
    pub cross_boresight_arcsec: Option<f64>,
    /// Right ascension, declination and roll of the truth.
    pub radec_roll_deg: [f64; 3],
    /// Where its files lie, within the folder of the result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<String>,
}

/// How a case fails with least.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SmallestFailure {
    /// In a sentence.
    pub sentence: String,
    /// The requirement.
    pub metric: String,
    /// Between which values of the sweep it begins to fail: the last that is good, and the first that is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fails_between: Option<[f64; 2]>,
    /// What is switched off without a change.
    pub superfluous: Vec<String>,
    /// What is needed for it to fail.
    pub needed: Vec<String>,
    /// The scene that reproduces it, within the folder of the result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Trials that it took.
    pub trials: usize,
}

/// What became worse than in an earlier result.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct BaselineResult {
    /// The earlier result.
    pub file: String,
    /// Metrics that are worse by more than their bounds.
    pub worse: Vec<WorseMetric>,
    /// Metrics of it that are not in this result.
    pub missing: Vec<String>,
}

/// A metric that became worse.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct WorseMetric {
    /// The case.
    pub case: String,
    /// The value of the sweep in words.
    pub words: String,
    /// The metric.
    pub metric: String,
    /// Before.
    pub before: f64,
    /// Now.
    pub now: f64,
    /// In a sentence.
    pub sentence: String,
}

impl SuiteResult {
    /// The worst verdict of the requirements of the level minimum.
    #[must_use]
    pub fn verdict_of(cases: &[CaseResult]) -> RequirementVerdict {
        let all = || cases.iter().flat_map(|case| &case.values).flat_map(|value| &value.requirements);
        let has = |verdict| all().any(|own| own.level == RequirementLevel::Minimum && own.verdict == verdict);
        if has(RequirementVerdict::Fail) {
            RequirementVerdict::Fail
        } else if has(RequirementVerdict::Undecided) {
            RequirementVerdict::Undecided
        } else {
            RequirementVerdict::Pass
        }
    }

    /// How many requirements of the level minimum have each verdict: met, broken, undecided.
    #[must_use]
    pub fn counts(&self) -> [usize; 3] {
        let all = || self.cases.iter().flat_map(|case| &case.values).flat_map(|value| &value.requirements);
        [RequirementVerdict::Pass, RequirementVerdict::Fail, RequirementVerdict::Undecided]
            .map(|verdict| all().filter(|own| own.level == RequirementLevel::Minimum && own.verdict == verdict).count())
    }
}
