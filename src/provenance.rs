//! What every result says of its own making: version, command, input hashes, seed, adapter.

use serde::{Deserialize, Serialize};

/// How a result came about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the program.
    pub version: String,
    /// The command line as given.
    pub command: Vec<String>,
    /// Every file read: path and SHA-256.
    pub inputs: Vec<InputHash>,
    /// Seed, where chance played a part.
    pub seed: Option<u64>,
    /// GPU adapter and driver, or "cpu"; `None` where nothing was rendered.
    pub adapter: Option<String>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputHash {
    /// Path as given.
    pub path: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
}
