//! What `boresight preset` says: the result, as it stands in files.

use schemars::JsonSchema;
use serde::Serialize;

use crate::provenance::Provenance;

/// The name of the file format.
pub const PRESET_FORMAT: &str = "boresight-preset/1";

/// The presets, or the one that was asked for.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct PresetList {
    /// [`PRESET_FORMAT`].
    pub format: &'static str,
    /// The presets.
    pub presets: Vec<ListedPreset>,
    /// How this came about.
    pub provenance: Provenance,
}

/// One preset.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ListedPreset {
    /// Its name.
    pub name: &'static str,
    /// What it is.
    pub camera: &'static str,
    /// The scene itself, where one preset was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub toml: Option<&'static str>,
}
