//! `[[effects]]`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[[effects]]`: an effect in force.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EffectTable {
    /// Its id; `boresight effects` lists them.
    pub id: String,
    /// Its parameters by name; those that are left out have the value at which they do nothing. (A pixel effect takes those that `[detector]`
    /// has under the same name from there; a light of the sky has its typical value.)
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
}
