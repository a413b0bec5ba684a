//! ControlPoints → Calibration: the camera from star images whose stars are known.
//!
//! [`Method::Bundle`] adjusts camera and attitudes jointly, from single stars, and is what one wants. Two methods on pairs of stars need
//! no attitude: the published [`Method::VariableWeights`] and, for comparison, [`Method::LeastSquares`]. What a solution is worth is found at the level of stars, with one free attitude for each frame:
//! residuals, held-out residuals and covariance (pairs share stars and give no valid covariance).
//!
//! A new method is a file with a function from frames of stars to a camera and weights (CONTRIBUTING.md lists what else to touch);
//! everything after it (residuals, covariance, held-out frames, the result) is shared.

mod bundle;
mod calibration;
mod compare;
mod geometry;
mod held_out;
mod joint;
mod least_squares;
mod lit;
mod map;
mod pairs;
mod reidentify;
mod residuals;
mod select;
mod sequential;
mod star_level;
mod summary;
mod systematics;
#[cfg(feature = "bench")]
pub mod trial;
mod uncertainty;
mod variable_weights;

use serde::{Deserialize, Serialize};

pub use calibration::{
    AttitudeSigma, Calibration, Candidate, Combination, FORMAT, FrameResult, Iteration, LeftOpen, LeftOutCount, MapSigma, Method,
    ModelSelection, NoiseFound, ParameterEstimate, PointResult, Reidentified, Status,
};
pub use compare::{Comparison, MapChange, ParameterDifference, compare, map_change};
pub use lit::LitCircle;
pub use map::{Map, MapPoint, MappingError, map, map_sigma};
pub use select::LeftOutReason;
pub use sequential::{Drift, OnChange, ParameterChange, SEQUENTIAL_FORMAT, Sequential, SequentialError, UpdateOptions, UpdateReport};
pub use systematics::{Surroundings, Systematic};
inner!(joint::{BundleImage, BundleSolution, Column, FixedNoise, MAX_FRAME_PARAMETERS});
inner!(map::{map_difference, mapping_error_of_models_px, mapping_error_px});
inner!(reidentify::{MeasuredStarImage, calibrate_identifying_anew});
inner!(residuals::residuals_px);

pub(crate) use bundle::optimal_rotation;

use crate::camera::{Camera, PARAMETER_COUNT, PARAMETER_NAMES, Term};
use crate::effects::ids;
use crate::identify::ControlPoints;
use geometry::Scaling;
use pairs::FrameStars;
use variable_weights::{Limits, PairSolution};

/// How to calibrate. The defaults are those of the reference method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterPrior {
    /// The parameter: x0, …, p2, or `effect.parameter`.
    pub name: String,
    /// Its value, in its own unit.
    pub value: f64,
    /// Standard error of that value.
    pub sigma: f64,
}

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// Nothing to work with.
    #[error(
        "{usable} of {offered} control points are usable, in {frames} frames: at least one frame with three identified stars is needed, ten frames with ten stars each for a good calibration"
    )]
    TooFewPoints {
        /// Points offered.
        offered: usize,
        /// Points left after selection.
        usable: usize,
        /// Frames left.
        frames: usize,
    },
    /// As many unknowns as equations.
    #[error(
        "{pairs} pairs of stars cannot determine {parameters} camera parameters: add frames or identify more stars, or solve for fewer parameters"
    )]
    TooFewPairs {
        /// Pairs.
        pairs: usize,
        /// Parameters.
        parameters: usize,
    },
    /// Residuals without degrees of freedom.
    #[error(
        "{stars} star images in {frames} frames leave no degree of freedom after {frames} attitudes and {parameters} camera parameters: add frames or identify more stars"
    )]
    NoDegreesOfFreedom {
        /// Star images used.
        stars: usize,
        /// Frames.
        frames: usize,
        /// Parameters.
        parameters: usize,
    },
    /// A control point is not a number.
    #[error(
        "control point {index} (frame {frame}, HIP {hip}) holds a number that is not finite in {field}: remove the point or measure it again"
    )]
    NotFinite {
        /// Index of the point.
        index: usize,
        /// Its frame.
        frame: usize,
        /// Its star.
        hip: u32,
        /// Which of its values.
        field: &'static str,
    },
    /// No parameter of that name.
    #[error("there is no parameter {given:?} to solve for; did you mean {nearest}? (`boresight effects` lists them all)")]
    UnknownParameter {
        /// As given.
        given: String,
        /// The nearest name.
        nearest: String,
    },
    /// A parameter that cannot be solved here.
    #[error("{name} cannot be solved for: {reason}")]
    NotSolvable {
        /// The parameter or effect.
        name: String,
        /// Why not.
        reason: String,
    },
    /// No start.
    #[error(
        "in none of {frames} frames ({images} star images) do three star images agree on an attitude: the identifications are wrong, or the ground values of the camera too far off"
    )]
    NoConsensus {
        /// Star images.
        images: usize,
        /// Frames.
        frames: usize,
    },
    /// The starting camera makes no sense.
    #[error(
        "the ground value {name} = {value} of the camera cannot be used to start from: give a finite value (frame sizes and focal length above 0)"
    )]
    BadNominal {
        /// The parameter.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The starting camera has no map over its frame.
    #[error("the distortion of the ground values folds over inside the frame: start from k1 = p1 = p2 = 0 instead")]
    NominalFolds,
    /// An option is out of range.
    #[error("{name} = {value} is out of range: {allowed}")]
    BadOption {
        /// The option.
        name: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The stars leave the map open.
    #[error(
        "the star images do not determine the camera: a change of its mapping by 1 px (rms over the frame) in {combination} moves them by only {share:.5} px; take frames with stars all over the image, not in a line or in one corner"
    )]
    Uncovered {
        /// The parameters in question.
        combination: String,
        /// Movement of the star images for 1 px.
        share: f64,
    },
    /// The normal equations have no solution.
    #[error(
        "the stars do not tell {combination} apart from what else is free (attitudes included): the normal equations are singular; add frames or hold one of these parameters at its ground value"
    )]
    Singular {
        /// The parameters in question.
        combination: String,
    },
    /// The iteration ran away.
    #[error(
        "the iteration ran away (focal length {focal_length_px} px at step {iteration}): too many identifications are wrong, the ground values are too far off, or the field is too narrow for all parameters (then solve f and k1 only)"
    )]
    Diverged {
        /// At which solution.
        iteration: usize,
        /// The focal length there.
        focal_length_px: f64,
    },
    /// Frames of different size.
    #[error("the two calibrations are of frames of {first:?} and {second:?} pixels: only calibrations of the same frame can be compared")]
    DifferentFrames {
        /// Width and height of the first.
        first: [usize; 2],
        /// Of the second.
        second: [usize; 2],
    },
    /// Maps with nothing in common.
    #[error(
        "the two cameras see different parts of the sky at the same pixels (one of them is mirrored or folds over inside the frame): there is no rotation to compare them by"
    )]
    NotComparable,
}

/// Whether the joint method can solve for what this name means: a parameter of the reference model, an effect, or `effect.parameter`.
pub fn check_parameter_name(name: &str) -> Result<(), CalibrateError> {
    bundle::check_name(name)
}

/// Calibrates a camera.
///
/// ```no_run
/// use boresight::calibrate::{CalibrateOptions, calibrate};
/// use boresight::camera::Physics;
/// use boresight::catalog::Catalog;
/// use boresight::identify::IdentifyOptions;
/// use boresight::pipeline::{self, MeasureOptions};
/// use boresight::recording::Recording;
///
/// let measured = pipeline::measure(Recording::open(&["night"])?, &MeasureOptions::default(), || ())?;
/// let catalog = Catalog::embedded();
/// let identified = pipeline::identify_frames(&measured, catalog, &Physics::Known.into(), &IdentifyOptions::default(), || ())?;
/// let points = pipeline::control_points(&measured, &identified, catalog, None, false)?.points;
/// for parameter in calibrate(&points, &CalibrateOptions::default())?.parameters {
///     println!("{} = {} ± {} {}", parameter.name, parameter.value, parameter.sigma, parameter.unit);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn calibrate(control_points: &ControlPoints, options: &CalibrateOptions) -> Result<Calibration, CalibrateError> {
    check_points(control_points, options)?;
    let nominal = control_points.nominal;
    let selection = select::select(control_points, options);
    let usable: usize = selection.frames.iter().map(|frame| frame.stars.len()).sum();
    if usable == 0 {
        return Err(CalibrateError::TooFewPoints { offered: control_points.points.len(), usable, frames: selection.frames.len() });
    }
    if options.method == Method::Bundle {
        return bundle::calibrate(control_points, options, &selection);
    }
    let for_bundle = [
        ("priors", !options.priors.is_empty()),
        ("select_model", options.select_model),
        ("extend_model", options.extend_model),
        ("projection", options.projection != ids::PINHOLE),
        ("terms", !options.terms.is_empty()),
    ];
    if let Some((name, _)) = for_bundle.into_iter().find(|(_, given)| *given) {
        return Err(CalibrateError::BadOption {
            name,
            value: options.method.name().to_owned(),
            allowed: "only the method bundle can use it",
        });
    }
    let scaling = Scaling::of(&nominal, free_of_reference_model(options)?);
    let coverage = uncertainty::Coverage::of(&selection.frames, &nominal, &scaling)?.checked()?;
    let solution = solve_pairs(&selection.frames, &nominal, &scaling, options)?;
    summary::summarise(control_points, options, &selection, &scaling, &coverage, &solution)
}

/// The solver of the method.
fn solve_pairs(
    frames: &[FrameStars],
    nominal: &Camera,
    scaling: &Scaling,
    options: &CalibrateOptions,
) -> Result<PairSolution, CalibrateError> {
    let limits = Limits { f_threshold: Some(options.f_threshold), epsilon_px: options.epsilon_px, max_iterations: options.max_iterations };
    match options.method {
        Method::VariableWeights => variable_weights::solve(frames, nominal, scaling, &limits).or_else(|error| match error {
            CalibrateError::Diverged { .. } | CalibrateError::Singular { .. } => {
                variable_weights::solve_in_stages(frames, nominal, scaling, &limits).unwrap_or(Err(error))
            }
            _ => Err(error),
        }),
        Method::LeastSquares | Method::Bundle => least_squares::solve(frames, nominal, scaling, &limits),
    }
}

/// Checks what was given.
fn check_points(control_points: &ControlPoints, options: &CalibrateOptions) -> Result<(), CalibrateError> {
    let camera = &control_points.nominal;
    let sizes = [("width_px", camera.width_px as f64), ("height_px", camera.height_px as f64), ("f", camera.focal_length_px)];
    if let Some((name, value)) = sizes.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
        return Err(CalibrateError::BadNominal { name, value });
    }
    if let Some((name, value)) = PARAMETER_NAMES.into_iter().zip(camera.parameters()).find(|(_, value)| !value.is_finite()) {
        return Err(CalibrateError::BadNominal { name, value });
    }
    if geometry::folds_over(camera) {
        return Err(CalibrateError::NominalFolds);
    }
    for (index, point) in control_points.points.iter().enumerate() {
        let fields: [(&[f64], &'static str); 5] = [
            (&[point.x_px], "x_px"),
            (&[point.y_px], "y_px"),
            (&point.direction.xyz, "direction"),
            (&point.covariance_px2, "covariance_px2"),
            (&[point.catalog_sigma_rad], "catalog_sigma_rad"),
        ];
        if let Some((_, field)) = fields.into_iter().find(|(values, _)| values.iter().any(|value| !value.is_finite())) {
            return Err(CalibrateError::NotFinite { index, frame: point.frame, hip: point.hip, field });
        }
    }
    let positive = [("f_threshold", options.f_threshold), ("epsilon_px", options.epsilon_px)];
    if let Some((name, value)) = positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
        return Err(CalibrateError::BadOption { name, value: value.to_string(), allowed: "a finite number above 0" });
    }
    if options.max_iterations == 0 {
        return Err(CalibrateError::BadOption { name: "max_iterations", value: "0".to_owned(), allowed: "1 or more" });
    }
    Ok(())
}

/// Which parameters of the reference model are solved.
fn free_of_reference_model(options: &CalibrateOptions) -> Result<[bool; PARAMETER_COUNT], CalibrateError> {
    let mut free = [false; PARAMETER_COUNT];
    for name in &options.solve {
        let unknown = || CalibrateError::BadOption { name: "solve", value: name.clone(), allowed: "x0, y0, f, k1, p1, p2" };
        free[PARAMETER_NAMES.iter().position(|known| known == name).ok_or_else(unknown)?] = true;
    }
    if !free.contains(&true) {
        return Err(CalibrateError::BadOption { name: "solve", value: "nothing".to_owned(), allowed: "x0, y0, f, k1, p1, p2" });
    }
    Ok(free)
}
