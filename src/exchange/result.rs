//! What `boresight export` and `boresight import` say: the results, as they stand in files.

use schemars::JsonSchema;
use serde::Serialize;

use super::{Exported, Imported};
use crate::provenance::Provenance;

/// What `boresight export` says.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ExportResult {
    /// The camera in the foreign format.
    #[serde(flatten)]
    pub exported: Exported,
    /// The files written; none if the format does not hold the camera.
    pub files: Vec<String>,
    /// How the files came about.
    pub provenance: Provenance,
}

/// What `boresight import` says.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ImportResult {
    /// The camera in our model.
    #[serde(flatten)]
    pub imported: Imported,
    /// How the file came about.
    pub provenance: Provenance,
}
