//! Suite.
mod answers;
mod attitudes;
mod components;
mod conventions;
mod error;
mod failures;
mod faults;
mod frames;
mod images;
mod intervals;
mod judge;
mod looks;
mod metric;
mod own;
mod plan;
mod result;
mod run;
mod runner;
mod sample;
mod samples;
mod score;
mod smallest;
mod suite_file;
mod switches;
mod system;
mod verdict;
mod when;

inner!(answers::{AnswerFile, AnswerStatus, AnsweredCamera, AnsweredStar, TrackerAnswer, read_answers, usual_conventions});
inner!(attitudes::DesignPlace);
inner!(components::{pooled, strata});
inner!(conventions::{Agreement, Conventions, PixelOrigin, QuaternionOrder, RotationWay, SignedAxes, WrittenAttitude, agreements});
inner!(error::SuiteError);
inner!(faults::SystemFault);
inner!(intervals::{Bounded, Risk});
inner!(looks::{looks, spent});
inner!(metric::{Metric, listed, names});
inner!(plan::{PlannedCase, PlannedRequirement, SuitePlan});
inner!(result::{
    BaselineResult, CaseResult, CaseValueResult, MeasuredMetric, RequirementResult, SmallestFailure, SpentSeconds, SuiteResult, TEST_FORMAT, WorseMetric,
    WorstFrame,
});
inner!(failures::{FailureFrame, folder_name});
inner!(run::{SuiteOptions, SuiteProgress, SuiteRun, run_suite});
inner!(sample::{Sample, Stratum, Unit});
inner!(suite_file::{AnswerForm, RequirementLevel, SUITE_FORMAT, SuiteFile, SystemImage, SystemMode});
inner!(verdict::{ErrorRates, Limit, RequirementVerdict, SampleKind, fewest_frames, frames_to_decide, verdict});
