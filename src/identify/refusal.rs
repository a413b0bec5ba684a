//! Why a frame is not identified.

use std::fmt::{Display, Formatter};

use crate::units::DEG_RAD;

/// Why a frame is not identified; as text, one sentence for people. A program matches the cause.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The index was made of another catalogue.
    #[error("The index was made of a catalogue of {in_index} stars, but this one has {in_catalog}: make it of this one.")]
    OtherIndex {
        /// Stars of the catalogue that the index was made of.
        in_index: usize,
        /// Stars of the catalogue given.
        in_catalog: usize,
    },
    /// Directions of another number of stars.
    #[error("There are {directions} directions for {in_catalog} catalogue stars: give one for each, or none.")]
    OtherDirections {
        /// Directions given.
        directions: usize,
        /// Stars of the catalogue.
        in_catalog: usize,
    },
    /// A frame without pixels.
    #[error("The frame has {width_px}×{height_px} pixels: there is nothing in it.")]
    EmptyFrame {
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
    },
    /// A frame that no camera has.
    #[error("The frame has {width_px}×{height_px} pixels: no camera has more than {most_px} a side, correct its size.")]
    FrameTooLarge {
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
        /// The longest side that is taken, px.
        most_px: usize,
    },
    /// The angle about the prior attitude is none.
    #[error("The attitude is searched within {} degrees of the one given: give a number above 0 and not above 180.", .within_rad / DEG_RAD)]
    PriorAngle {
        /// The angle given, rad.
        within_rad: f64,
    },
    /// A direction of the prior attitude is no unit vector.
    #[error("The attitude given has the direction {direction:?}: give the components of a vector of length 1.")]
    PriorDirection {
        /// The direction given, ICRS axes.
        direction: [f64; 3],
    },
    /// A parity that is neither.
    #[error("The parity is {parity}: give 1, −1 for mirrored images, or none for either.")]
    Parity {
        /// The parity given.
        parity: i8,
    },
    /// A probability out of range.
    #[error(
        "Matches that chance brings about with a probability below {probability} are asked for: give a number above 0 and not above 1."
    )]
    Probability {
        /// The probability given.
        probability: f64,
    },
    /// A focal length that gives no field of a camera.
    #[error(
        "The nominal focal length of {focal_length_px} px gives {width_px}×{height_px} pixels a field outside 0.5 to 150 degrees: correct it, or give none."
    )]
    FocalLength {
        /// The focal length given, px.
        focal_length_px: f64,
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
    },
    /// A tolerance out of range.
    #[error("The tolerance of the focal length is {tolerance}: give a number from 0 to 10.")]
    Tolerance {
        /// The tolerance given.
        tolerance: f64,
    },
    /// Widths of field out of order or range.
    #[error("The widths of field to search are {} to {} degrees: give two in order, from 0.5 to 150.", range_rad[0] / DEG_RAD, range_rad[1] / DEG_RAD)]
    FieldWidths {
        /// The widths given, rad.
        range_rad: [f64; 2],
    },
    /// Too few star images for a match.
    #[error(
        "{usable} usable star image{} of {detected} detected: fewer than the {needed} that a match needs; expose longer or lower the detection threshold.",
        if *usable == 1 { "" } else { "s" }
    )]
    TooFewStars {
        /// Star images that the search can use.
        usable: usize,
        /// Star images detected.
        detected: usize,
        /// Star images that a match needs.
        needed: usize,
    },
    /// The time was up first.
    #[error("No match within the time limit of {limit_s:.3} s, with {usable} star images: allow more time or give the focal length.")]
    TimeLimit {
        /// The limit, s.
        limit_s: f64,
        /// Star images that the search could use.
        usable: usize,
    },
    /// Everything was tried.
    #[error("{0}")]
    NoMatch(NoMatch),
    /// The accepted hypothesis did not hold over the whole frame.
    #[error("Only {matches} stars remained when the accepted hypothesis was fitted to the whole frame: too few to trust it.")]
    TooFewMatches {
        /// Stars that remained.
        matches: usize,
    },
    /// A fisheye's lens was lost on the way outwards.
    #[error(
        "{around_middle} stars around the middle of the frame fit a fisheye, but only {matches} of the whole frame do: its lens could not be followed outwards."
    )]
    FisheyeLost {
        /// Stars around the middle that fit.
        around_middle: usize,
        /// Stars of the whole frame that fit.
        matches: usize,
    },
    /// The frame was not searched: the identifications of its list are taken.
    #[error("The list's own identifications are taken.")]
    Preidentified,
    /// The frame has many times the stars that the sky has there.
    #[error("The frame has many more detections than the sky has stars there.")]
    Overfull,
}

/// A search that ended without a match.
#[derive(Clone, Debug, PartialEq)]
pub struct NoMatch {
    /// Hypotheses that were tried.
    pub hypotheses: u64,
    /// Star images that the search could use.
    pub usable: usize,
    /// Within this angle of a prior attitude, rad.
    pub within_rad: Option<f64>,
    /// The least bound on the probability of a false match.
    pub least_bound: f64,
    /// The bound that is asked for.
    pub asked: f64,
    /// Whether the search was cut short.
    pub was_cut: bool,
}

impl Display for NoMatch {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let near = self.within_rad.map_or_else(String::new, |rad| format!(" within {:.1}° of the attitude given", rad / DEG_RAD));
        let cut = if self.was_cut { " (search cut short)" } else { "" };
        write!(
            f,
            "None of {} hypotheses{near} brings the {} star images together with the catalogue better than chance would (the best by chance with a probability of {:.1e} at most, below {:.0e} is asked){cut}.",
            self.hypotheses, self.usable, self.least_bound, self.asked
        )
    }
}
