//! What is found when a dataset is held against what it says of itself.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::catalog::Catalog;
use crate::dataset::frame_key::ShardKey;
use crate::dataset::plan::DatasetPlan;
use crate::provenance::Provenance;
use crate::render::PsfTables;

/// The name of the format.
pub const VERIFY_FORMAT: &str = "boresight-verify/1";

/// What was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct VerifyResult {
    /// Always `boresight-verify/1`.
    pub format: String,
    /// Whether nothing is wrong.
    pub is_right: bool,
    /// What is wrong, a sentence for each fault.
    pub faults: Vec<VerifyFault>,
    /// What could not be looked at, and why.
    pub not_checked: Vec<String>,
    /// Shards that were read and hashed.
    pub shards: u64,
    /// Bytes of them.
    pub bytes: u64,
    /// Frames of them.
    pub frames: u64,
    /// Frames that were made again.
    pub frames_rendered: u64,
    /// Bright lone stars that were measured.
    pub stars_measured: u64,
    /// Median of measured less labelled place: columns and rows; absent with too few stars.
    #[serde(default)]
    pub offset_px: Option<[f64; 2]>,
    /// Its standard error.
    #[serde(default)]
    pub standard_error_px: Option<[f64; 2]>,
    /// How it was made.
    pub provenance: Provenance,
}

/// A fault of a dataset.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct VerifyFault {
    /// What was looked at.
    pub check: VerifyCheck,
    /// What is wrong, in one sentence.
    pub fault: String,
}

/// What is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum VerifyCheck {
    /// Whether files are there and have their hashes.
    Files,
    /// Whether archives hold the samples that they should.
    Samples,
    /// Whether tables say what labels say.
    Tables,
    /// Whether frames made again have the same bytes.
    Frames,
    /// Whether light is where labels say.
    Labels,
    /// Whether masks and distances are those of the labels.
    Masks,
    /// Whether splits share nothing.
    Splits,
}

/// What a frame can be made again with.
pub(super) struct Remake<'a> {
    pub(super) plan: &'a DatasetPlan,
    pub(super) catalog: &'a Catalog,
    pub(super) psfs: &'a PsfTables,
}

/// What splits are compared by.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SeenFrame {
    pub(super) key: u64,
    pub(super) shard: ShardKey,
    pub(super) camera: u64,
    pub(super) seed: u64,
    /// Seconds of the clock TAI; `None`: it has no time.
    pub(super) time_s: Option<f64>,
    pub(super) boresight: [f64; 3],
    pub(super) pixels_sha256: String,
}
