//! How to diagnose, and what is given beside the control points.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::{PARAMETER_NAMES, Term};

/// How to diagnose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DiagnoseOptions {
    /// Simulated recordings without any effect for the omnibus test, at least; more are drawn where the decision is near.
    pub nulls: usize,
    /// Family-wise probability of a false finding in a recording.
    pub alpha: f64,
    /// Random half-splits of the frames for the split-half validation of the p-values; none unless asked for.
    pub half_nights: usize,
    /// Seed of nulls and permutations.
    pub seed: u64,
    /// Ids of the effects that the model contains; those of the sky are in the points' directions.
    pub physics: Vec<String>,
    /// Terms behind the lens that the model contains, with their parameters.
    pub terms: Vec<Term>,
    /// Parameters of the camera that are free in the baseline.
    pub solve: Vec<String>,
    /// Leave out stars without known proper motion.
    pub proper_motion_only: bool,
    /// Image conditions of the recording, where it has pixels: the columns of effects on pixels are then rendered and measured.
    pub looks: Option<ImageConditions>,
}

/// Image conditions: what has to be known to render the stars of a recording as they are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ImageConditions {
    /// Width of the typical image (Gaussian σ before the pixel integrates it), px.
    pub psf_sigma_px: f64,
    /// Level of the sky, electrons per pixel.
    pub background_e: f64,
    /// Noise of a pixel of the sky (standard deviation), electrons.
    pub noise_e: f64,
}

impl Default for DiagnoseOptions {
    fn default() -> Self {
        Self {
            nulls: 1000,
            alpha: 3e-4,
            half_nights: 0,
            seed: 0,
            physics: Vec::new(),
            terms: Vec::new(),
            solve: PARAMETER_NAMES.map(str::to_owned).to_vec(),
            proper_motion_only: false,
            looks: None,
        }
    }
}

/// Numbers of a frame that a mismatch may follow, by name: `temperature`, and every extra number of the manifest under its own name.
pub type Telemetry = Vec<BTreeMap<String, f64>>;
