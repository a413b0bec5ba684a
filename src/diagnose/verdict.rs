//! The verdict of a diagnosis, and what a number is that cannot be stated exactly.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a number that cannot be told exactly is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Bound {
    /// The number itself is not larger.
    #[serde(rename = "upper bound")]
    Upper,
}

/// The answer to "is something missing?", in the channels that were looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Nothing is missing in what was looked at: the omnibus test is not significant, and an effect of ordinary size could have shown.
    Consistent,
    /// What is missing has a name (or a set of names that cannot be told apart here), and the rest is consistent.
    Explained,
    /// Something is missing that no effect of the registry explains.
    Unexplained,
    /// Nothing shows, and no effect of ordinary size could have shown.
    Undecided,
}
