//! Why there is no calibration.

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
