//! A bin of what residuals are held against: the data of the pictures.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A bin of a profile: displacements and the model in px (of the star images their own unit), both as attitudes, camera and all other effects leave them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[non_exhaustive]
pub struct ProfileBin {
    /// Mean of what the residuals are held against.
    pub at: f64,
    /// What is seen there: of displacements by the effect's own pattern.
    pub mean: f64,
    /// Standard error of that mean.
    pub sigma: f64,
    /// Mean of the model there.
    pub model: f64,
    /// Star images in it.
    pub stars: usize,
}
