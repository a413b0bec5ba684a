//! ControlPoints → Diagnosis: is physics missing, where, which, how large, what else could it be, does the fit improve, what is left.

mod adequacy;
mod channels;
mod clusters;
mod covariates;
mod cross_validation;
mod crossfit;
mod descent;
mod diagnosis;
mod evidence;
mod final_fit;
mod findings;
mod folds;
mod frame_nuisance;
mod holdout;
mod hypotheses;
mod linear_system;
mod located;
mod noise;
mod null_distribution;
mod omitted_nature;
mod omnibus;
mod ordinary;
mod patterns;
mod permutation;
mod plausible_size;
mod profile;
mod proposals;
mod quality;
mod refine;
mod rendered_columns;
mod residual_field;
mod resimulate;
mod resolved;
mod rivals;
mod run;
mod scan;
mod split_half;
mod statuses;
mod step;
mod stepwise;
mod unexplained;
mod untimed;
mod wild_bootstrap;
mod wording;

pub use channels::{ByChannel, Channel, ChannelMeasure, ChannelReport, ChannelVerdict, Channels, Detectable};
pub use diagnosis::*;
pub use step::Step;
inner!(profile::PREDICTED);

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::calibrate::CalibrateError;
use crate::identify::ControlPoints;

/// How to diagnose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiagnoseOptions {
    /// Simulated recordings without any effect for the omnibus test, at least; more are drawn where the decision is near.
    pub nulls: usize,
    /// Probability, all questions counted, of seeing a mismatch where there is none.
    pub alpha: f64,
    /// Random halves of the frames that are held against one another to try the p-values on this recording; none unless asked for.
    pub half_nights: usize,
    /// Seed of nulls and permutations.
    pub seed: u64,
    /// Ids of the effects that the model contains; those of the sky are in the points' directions.
    pub physics: Vec<String>,
    /// Terms behind the lens that the model contains, with their parameters.
    pub terms: Vec<crate::camera::Term>,
    /// Parameters of the camera that are free in the baseline.
    pub solve: Vec<String>,
    /// Leave out stars without known proper motion.
    pub proper_motion_only: bool,
    /// How the stars of the recording look, where it has pixels: the columns of effects on pixels are then rendered and measured.
    pub looks: Option<ImageConditions>,
}

/// How the stars of a recording look: what has to be known to render them as they are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
            solve: crate::camera::PARAMETER_NAMES.map(str::to_owned).to_vec(),
            proper_motion_only: false,
            looks: None,
        }
    }
}

/// Why there is no diagnosis.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DiagnoseError {
    /// The baseline cannot be fitted.
    #[error("the camera that the recording is held against cannot be fitted: {0}")]
    Baseline(#[from] CalibrateError),
    /// Too little to judge.
    #[error("{images} star images in {frames} frames are too few to judge anything beside attitudes and camera: give more frames")]
    TooFew {
        /// Star images.
        images: usize,
        /// Frames.
        frames: usize,
    },
}

/// Numbers of a frame that a mismatch may follow, by name: `temperature`, and every extra number of the manifest under its own name.
pub type Telemetry = Vec<BTreeMap<String, f64>>;

/// Diagnoses the control points of a recording. `telemetry` by frame; may be empty.
pub fn diagnose(points: &ControlPoints, telemetry: &Telemetry, options: &DiagnoseOptions) -> Result<Diagnosis, DiagnoseError> {
    run::diagnose(points, telemetry, options, &|_| ())
}

/// The same, telling `tell` each step as it begins.
pub fn diagnose_with_progress(
    points: &ControlPoints,
    telemetry: &Telemetry,
    options: &DiagnoseOptions,
    tell: &dyn Fn(Step),
) -> Result<Diagnosis, DiagnoseError> {
    run::diagnose(points, telemetry, options, tell)
}
