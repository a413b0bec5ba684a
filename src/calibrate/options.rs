//! How to calibrate.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::{PARAMETER_NAMES, Term};
use crate::effects::ids;

/// How the camera is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Method {
    /// Camera and attitudes jointly, from the positions of single stars; robust.
    Bundle,
    /// The reference method: pairs of stars, iterated with variable weights.
    VariableWeights,
    /// Pairs of stars, all weights one.
    LeastSquares,
}

impl Method {
    /// Its name in files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Bundle => "bundle",
            Self::VariableWeights => "variable-weights",
            Self::LeastSquares => "least-squares",
        }
    }
}

/// How to calibrate. The defaults are those of the reference method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[allow(clippy::struct_excessive_bools, reason = "switches that have nothing to do with each other")]
pub struct CalibrateOptions {
    /// The method.
    pub method: Method,
    /// F: pairs whose T = u²/(σ̂0²·l) is above it are weighted down. 10.83 is χ² of one degree of freedom at 0.1 %.
    pub f_threshold: f64,
    /// The iteration ends at a step below this, px of mapping over the frame.
    pub epsilon_px: f64,
    /// The most solutions of the normal equations.
    pub max_iterations: usize,
    /// Names of the parameters to solve; the others keep their ground values. The methods on pairs solve those of the reference model
    /// only; the joint method any parameter of any displacement (`effect.parameter`), or an effect by its id.
    pub solve: Vec<String>,
    /// Let the data say which of f, x0, y0, k1, k2, k3, p1, p2, aspect and quadratic rest they support; joint method only.
    pub select_model: bool,
    /// Let the data say whether they support k2 and k3 beside the parameters named; joint method only.
    pub extend_model: bool,
    /// What is known of parameters beforehand; joint method only.
    pub priors: Vec<ParameterPrior>,
    /// Effects in force with their parameters, besides those of the sky that the directions contain; joint method only.
    pub terms: Vec<Term>,
    /// The projection; joint method only.
    pub projection: String,
    /// What the projection has beyond x0, y0 and f.
    pub projection_parameters: Vec<f64>,
    /// How the attitudes of the frames hang together; joint method only.
    pub attitudes: AttitudeModel,
    /// Leave out points whose predicted error makes an equally weighted solution worse.
    pub leave_out_imprecise: bool,
    /// Leave out points whose predicted error (per axis) is above this.
    pub max_position_sigma_px: Option<f64>,
    /// Leave out stars whose proper motion is not known.
    pub proper_motion_only: bool,
    /// Solve again without each frame (or tenth of the frames) for the held-out rms.
    pub held_out: bool,
    /// Ids of the effects that the star directions contain; only recorded here.
    pub physics: Vec<String>,
}

impl Default for CalibrateOptions {
    fn default() -> Self {
        Self {
            method: Method::Bundle,
            f_threshold: 10.83,
            epsilon_px: 1e-6,
            max_iterations: 100,
            solve: PARAMETER_NAMES.map(str::to_owned).to_vec(),
            select_model: false,
            extend_model: false,
            priors: Vec::new(),
            terms: Vec::new(),
            projection: ids::PINHOLE.to_owned(),
            projection_parameters: Vec::new(),
            attitudes: AttitudeModel::Auto,
            leave_out_imprecise: true,
            max_position_sigma_px: None,
            proper_motion_only: false,
            held_out: true,
            physics: Vec::new(),
        }
    }
}

/// How the attitudes of the frames hang together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AttitudeModel {
    /// As the recording says: one attitude to the ground and the Earth's rotation for a fixed mount; three rates beside each attitude where
    /// the rows are exposed one after the other and nobody says how the camera turned; else one attitude for each frame.
    #[default]
    Auto,
    /// One attitude for each frame, whatever the recording says.
    Free,
}

/// What is known of a parameter beforehand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ParameterPrior {
    /// The parameter: x0, …, p2, or `effect.parameter`.
    pub name: String,
    /// Its value, in its own unit.
    pub value: f64,
    /// Standard error of that value.
    pub sigma: f64,
}
