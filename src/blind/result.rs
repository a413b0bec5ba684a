//! What the steps of `boresight blind` say: the results, as they stand in files.

use schemars::JsonSchema;
use serde::Serialize;

use super::generate::Family;
use super::{HeldOutStudy, ImageScore, SCORE_FORMAT, Score};
use crate::provenance::Provenance;

/// What `boresight blind` writes.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum BlindResult {
    /// `score`.
    Scored(Box<ScoreResult>),
    /// `score-images`.
    ScoredImages(Box<ImageScoreResult>),
    /// `held-out`.
    HeldOut(HeldOutResult),
    /// `generate` and `run`.
    Step(StepResult),
}

/// What `generate` and `run` did.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StepResult {
    /// [`SCORE_FORMAT`].
    pub format: &'static str,
    /// The family.
    pub family: Family,
    /// Truths sealed in all.
    pub sealed: usize,
    /// Recordings answered now.
    pub answered: usize,
    /// How this came about.
    pub provenance: Provenance,
}

impl StepResult {
    /// What was done to a family.
    #[must_use]
    pub fn new(family: Family, sealed: usize, answered: usize, provenance: Provenance) -> Self {
        Self { format: SCORE_FORMAT, family, sealed, answered, provenance }
    }
}

/// What `score` found.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ScoreResult {
    /// The figures.
    #[serde(flatten)]
    pub score: Score,
    /// How the file came about.
    pub provenance: Provenance,
}

/// What `score-images` found.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ImageScoreResult {
    /// [`SCORE_FORMAT`].
    pub format: &'static str,
    /// The figures.
    #[serde(flatten)]
    pub score: ImageScore,
    /// How the file came about.
    pub provenance: Provenance,
}

/// What `held-out` found.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct HeldOutResult {
    /// [`SCORE_FORMAT`].
    pub format: &'static str,
    /// The figures.
    #[serde(flatten)]
    pub study: HeldOutStudy,
    /// How this came about.
    pub provenance: Provenance,
}
