//! ControlPoints → Calibration: the camera from star images whose stars are known.
//!
//! [`Method::Bundle`]: robust bundle adjustment of camera and attitudes. The default. Two methods on pairs of stars need no attitude: the published
//! [`Method::VariableWeights`] and, for comparison, [`Method::LeastSquares`]. Every solution is assessed on single stars, with one free attitude
//! for each frame: residuals, held-out residuals and covariance (pairs share stars and give no valid covariance).
//!
//! A new method is a file with a function from frames of stars to a camera and weights (CONTRIBUTING.md lists what else to touch);
//! everything after it (residuals, covariance, held-out frames, the result) is shared.

mod bundle;
mod calibration;
mod check;
mod compare;
mod coverage;
mod error;
mod files;
mod geometry;
mod held_out;
mod joint;
mod least_squares;
mod lit;
mod map;
mod options;
mod pair_methods;
mod pairs;
mod reidentify;
mod residuals;
mod result;
mod select;
mod sequential;
mod solve;
mod star_level;
mod summary;
mod systematics;
#[cfg(feature = "bench")]
pub mod trial;
mod uncertainty;
mod variable_weights;

pub use calibration::{
    AttitudeSigma, Calibration, Candidate, Combination, FORMAT, FrameResult, Iteration, LeftOpen, LeftOutCount, MapSigma, ModelSelection,
    NoiseFound, ParameterEstimate, PointResult, Reidentified, Status, Systematic,
};
pub use compare::{Comparison, MapChange, ParameterDifference, compare, map_change};
pub use error::CalibrateError;
pub use lit::LitCircle;
pub use map::{Map, MapPoint, MappingError, map, map_sigma};
pub use options::{AttitudeModel, CalibrateOptions, Method, ParameterPrior};
pub use select::LeftOutReason;
pub use sequential::{Drift, OnChange, ParameterChange, SEQUENTIAL_FORMAT, Sequential, SequentialError, UpdateOptions, UpdateReport};
pub use solve::{calibrate, check_parameter_name};
pub use systematics::Surroundings;
inner!(files::{
    CalibrateResult, CompareResult, DetectorNumber, DetectorNumbers, DifferenceLimit, MapResult, MisidentifiedPoint, SolvedCamera, UnsolvedCamera, UpdateResult,
});
inner!(compare::FORMAT as COMPARE_FORMAT);
inner!(map::FORMAT as MAP_FORMAT);
inner!(joint::{BundleImage, BundleSolution, Column, FixedNoise, MAX_FRAME_PARAMETERS});
inner!(map::{map_difference, mapping_error_of_models_px, mapping_error_px});
inner!(reidentify::{MeasuredStarImage, calibrate_identifying_anew});
inner!(residuals::residuals_px);

pub(crate) use bundle::optimal_rotation;
