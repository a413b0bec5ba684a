//! What `boresight catalog import` says: the result, as it stands in files.

use schemars::JsonSchema;
use serde::Serialize;

use super::ImportReport;
use crate::provenance::Provenance;

/// The name of the file format.
pub const IMPORT_FORMAT: &str = "boresight-catalog-import/1";

/// A catalogue that was made.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct CatalogImportResult {
    /// [`IMPORT_FORMAT`].
    pub format: &'static str,
    /// What was read and joined.
    #[serde(flatten)]
    pub report: ImportReport,
    /// The catalogue written.
    pub file: String,
    /// Its length.
    pub bytes: usize,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// How it came about.
    pub provenance: Provenance,
}
