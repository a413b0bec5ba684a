//! Suite: a star tracker, our own pipeline or any program, held against requirements on frames whose truth is known.
//!
//! ```text
//!   SUITE.toml ──► SuitePlan ──► frames, truth ──► system under test ──► answers ──► scores ──► verdicts ──► test.json, JUnit, page
//!     suite_file     plan          frames            own, system          answers     score      judge        junit, github, page
//! ```
//! Frames follow from suite, case and number alone (`attitudes`, `frames`), so that they are the same every time and can be made again one by one.
//! `intervals`, `sample` and `components` are the statistics, `verdict` and `looks` what is made of them. `faults` names what is wrong with a system,
//! `smallest` what of a scene a failure needs.

mod answers;
mod attitudes;
mod baseline;
mod components;
mod conventions;
mod error;
mod failures;
mod faults;
mod frames;
mod github;
mod guess;
mod images;
mod init;
mod intervals;
mod judge;
mod junit;
mod looks;
mod metric;
mod own;
mod page;
mod page_plot;
mod plan;
mod result;
mod run;
mod runner;
mod sample;
mod samples;
mod scene_tables;
mod score;
#[cfg(test)]
mod simulated_trackers;
mod smallest;
mod suite_file;
mod switches;
mod system;
mod verdict;
mod when;

inner!(answers::{AnswerFile, AnswerStatus, AnsweredCamera, AnsweredStar, TrackerAnswer, read_answers, usual_conventions});
inner!(attitudes::DesignPlace);
inner!(components::{Stratum, pooled, strata});
inner!(conventions::{ConventionAgreement, Conventions, PixelOrigin, QuaternionOrder, RotationWay, SignedAxes, WrittenAttitude, agreements});
inner!(error::SuiteError);
inner!(faults::SystemFault);
inner!(baseline::compared);
inner!(github::{annotations, summary});
inner!(guess::{GUESS_FRAMES, Guess, guess_conventions});
inner!(init::{SuiteSource, init_suite});
inner!(page::{FramePicture, page});
inner!(junit::{junit, measured_words, number, requirement_words});
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
inner!(sample::{MetricSample, Unit});
inner!(suite_file::{AnswerForm, RequirementLevel, SUITE_FORMAT, SuiteFile, SystemImage, SystemMode});
inner!(verdict::{ErrorRates, RequirementLimit, RequirementVerdict, SampleKind, fewest_frames, frames_to_decide, verdict});
