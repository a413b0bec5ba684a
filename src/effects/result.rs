//! What `boresight effects` says: the result, as it stands in files.

use schemars::JsonSchema;
use serde::Serialize;

use crate::provenance::Provenance;

/// The name of the file format.
pub const LIST_FORMAT: &str = "boresight-effects/1";

/// The effects of this build, or the one that was asked for with its page.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct EffectList {
    /// [`LIST_FORMAT`].
    pub format: &'static str,
    /// The effects.
    pub effects: Vec<ListedEffect>,
    /// The page, where one effect was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<String>,
    /// How this came about.
    pub provenance: Provenance,
}

/// One effect of the list.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ListedEffect {
    /// Its id.
    pub id: String,
    /// What it acts on, in words.
    pub acts_on: &'static str,
    /// Its parameters.
    pub parameters: Vec<ListedParameter>,
}

/// A parameter of an effect.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct ListedParameter {
    /// Its name.
    pub name: &'static str,
    /// Its unit; empty where it has none.
    pub unit: &'static str,
}
