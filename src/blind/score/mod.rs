//! The figures of merit: answers against truths.

mod count;
mod images;
mod images_held_out;
mod images_joined;
mod images_table;
mod ladder;
mod pixels;
mod table;
mod wilson;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use images::{ImageLadder, ImageNullScore, ImagePairScore, ImageRung, ImageScore, Names, image_score};
pub use images_held_out::HeldOutChi2;
pub use images_joined::joined;
pub use images_table::image_markdown;
pub use ladder::{Ladder, Rung};
pub use pixels::{Agreement, PixelScore, WayOfPixels};
pub use table::markdown;
pub use wilson::Rate;

use super::answer::Answer;
use super::generate::Truth;

/// The format of the score.
pub const SCORE_FORMAT: &str = "boresight-blind/1";

/// Nulls of a kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NullScore {
    /// The kind.
    pub label: String,
    /// An effect was named.
    pub named: Rate,
    /// Something was said to be missing, named or not.
    pub alarmed: Rate,
}

/// Effects that look like others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConfuserScore {
    /// The hidden effect.
    pub label: String,
    /// The effect that looks most like it, of those that are tried.
    pub rival: String,
    /// Mean cosine.
    pub cos: f64,
    /// Signal-to-noise ratio.
    pub snr: f64,
    /// The first name was right.
    pub named: Rate,
    /// The right one was among the names given.
    pub in_set: Rate,
    /// How often the right name is to be expected: Φ(SNR·√((1 − cos)/2)).
    pub expected: f64,
}

/// What is in no library.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OffLibraryScore {
    /// Its name.
    pub label: String,
    /// Signal-to-noise ratio.
    pub snr: f64,
    /// Found to be missing.
    pub found: Rate,
    /// Given a name without reservation.
    pub misnamed: Rate,
    /// The first covariate was a right one, of those found.
    pub located: Rate,
}

/// Deviations of parameters in standard errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Pulls {
    /// The parameter, or what is pooled.
    pub label: String,
    /// How many.
    pub count: usize,
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Share within one standard error (68.3 %).
    pub within_1: Rate,
    /// Share within 1.96 standard errors (95 %).
    pub within_2: Rate,
}

/// Held-out χ² per degree of freedom, means over the recordings of an effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HeldOutScore {
    /// The effect.
    pub label: String,
    /// Recordings.
    pub count: usize,
    /// Camera and attitudes alone.
    pub before: f64,
    /// With the effects that the diagnosis names.
    pub after: Option<f64>,
    /// k2, k3, clipped outliers.
    pub radial_clipped: Option<f64>,
    /// Polynomial of the seventh degree.
    pub polynomial: Option<f64>,
    /// LASSO on the same library.
    pub lasso: Option<f64>,
}

/// All figures of merit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Score {
    /// [`SCORE_FORMAT`].
    pub format: String,
    /// Version of the program that answered.
    pub version: String,
    /// Seed.
    pub seed: u64,
    /// Answers counted.
    pub answers: usize,
    /// Recordings without an answer, with the first reason.
    pub unanswered: usize,
    /// First reason.
    pub unanswered_reason: Option<String>,
    /// Nulls, plain and by trap.
    pub nulls: Vec<NullScore>,
    /// All plain nulls, all hard ones.
    pub null_totals: [Option<NullScore>; 2],
    /// Ladders by effect.
    pub ladders: Vec<Ladder>,
    /// Effects that the program knows, together.
    pub all_ladders: Ladder,
    /// From 4 × what is just seen, nothing alike (cos < 0.9): the first name is right.
    pub named: Rate,
    /// Some effect was named: the truth is among the names.
    pub in_set: Rate,
    /// Mean number of names of the findings.
    pub set_size: Option<f64>,
    /// From 4 × what is just seen, nothing alike: told to be indistinguishable from something all the same.
    pub needless: Rate,
    /// Something is alike (cos > 0.95) and the signal is below 15: told to be indistinguishable from it.
    pub cannot_tell: Rate,
    /// What is taken up: nothing is named.
    pub absorbed_quiet: Rate,
    /// What is taken up: the effect is said not to be observable.
    pub absorbed_told: Rate,
    /// Two at once: exactly the two are named.
    pub two_exact: Rate,
    /// Two at once: names that are wrong, per recording.
    pub two_false: Option<f64>,
    /// One effect from 4 × what is just seen: exactly it is named by the diagnosis.
    pub exact: Rate,
    /// The same by LASSO.
    pub lasso_exact: Rate,
    /// A null in which LASSO names something.
    pub lasso_null: Rate,
    /// Two at once: exactly the two are named by LASSO.
    pub lasso_two: Rate,
    /// Known effects left out at their natural size, by effect: first name right.
    pub natural: Vec<(String, Rate)>,
    /// Confusers.
    pub confusers: Vec<ConfuserScore>,
    /// What is in no library.
    pub off_library: Vec<OffLibraryScore>,
    /// Totals of that at SNR ≥ 15, without what truly equals an effect of the library: not misnamed, found.
    pub off_library_totals: [Rate; 2],
    /// From 2 × what is just seen: the covariate named first is a right one.
    pub located: Rate,
    /// Pulls by parameter.
    pub pulls: Vec<Pulls>,
    /// All pulls.
    pub all_pulls: Pulls,
    /// Held-out χ², from 4 × what is just seen.
    pub held_out: Vec<HeldOutScore>,
    /// Median and largest time of a diagnosis, s.
    pub seconds: [f64; 2],
    /// The figures of frames of pixels, which are not in those above.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels: Option<Box<PixelScore>>,
}

/// Scores answers against their truths; those about what is hidden in pixels are passed over ([`image_score`]).
#[must_use]
pub fn score(pairs: &[(Truth, Answer)]) -> Score {
    let pairs = pairs.iter().filter(|(truth, _)| !truth.family.is_of_images());
    let (painted, listed): (Vec<_>, Vec<_>) = pairs.cloned().partition(|(truth, _)| truth.family.of_lists().is_some());
    let mut score = count::score(&listed);
    if let Some((truth, answer)) = painted.first() {
        // Where there are no star lists, version and seed are known all the same.
        (score.seed, score.version) = (truth.seed, answer.version.clone());
        score.pixels = Some(Box::new(pixels::score(&painted)));
    }
    score
}
