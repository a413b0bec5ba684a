//! Concealed recordings: made, sealed, diagnosed and scored.
//!
//! [`generate`] hides something (or nothing) in star lists that it makes from equations of its own. The truth goes into a folder of its own
//! and is sealed by hashes before anything is diagnosed; what is diagnosed never opens it. The scorer then breaks the seal and counts.
//!
//! There are three tiers. (a) Star lists, many. (b) Frames of pixels (the families `pixel-…`): the stars of such lists are painted, and the whole
//! program is tried, from finding stars in an unknown attitude to the verdict. Each painted recording has a twin in star lists, the same
//! world with the same thing hidden and normal errors in the place of pixels, so that the tiers are compared one by one. In both what is
//! hidden is a displacement of star images: effects that act on pixels (S-curve, even and odd columns, transfer of charge, overshoot) are
//! painted by where they put a star, not by what they do to its shape. (c) Frames with an image, a sky and a detector of the generator's own (the
//! families `image-…`, [`generate::images`]): what is hidden is hidden in the pixels, and brightness, shape and noise are diagnosed too.

mod answer;
pub mod generate;
mod held_out;
mod images;
mod judge;
mod lasso;
mod pixels;
mod record;
mod result;
mod rivals;
mod run;
mod score;
mod seal;

use std::path::{Path, PathBuf};

use thiserror::Error;

pub use answer::{Answer, AnswerFinding, AnswerParameter, AnswerProposal, answers, append};
pub use held_out::{HeldOutStudy, Proposals, held_out_study};
pub use images::{image_answer, image_recording, image_request, write_images};
pub use lasso::{Lasso, lasso};
pub use pixels::{Centres, Painted, PixelAnswer, painted, pixel_answer, pixel_recording, write_pixels};
pub use record::{control_points, recording, telemetry};
pub use result::{BlindResult, HeldOutResult, ImageScoreResult, ScoreResult, StepResult};
pub use rivals::{RivalFits, rival_fits};
pub use run::{answer, make, run};
pub use score::{
    Agreement, ConfuserScore, HeldOutChi2, HeldOutScore, ImageLadder, ImageNullScore, ImagePairScore, ImageRung, ImageScore, Ladder, Names,
    NullScore, OffLibraryScore, PixelScore, Pulls, Rate, Rung, SCORE_FORMAT, Score, WayOfPixels, image_markdown, image_score, joined,
    markdown, score,
};
pub use seal::{Seal, is_sealed, open, seal};

use generate::{FAMILIES, Truth};

/// What can go wrong with the files of a benchmark.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BlindError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] crate::recording::OutputError),
    /// A file is not what it should be.
    #[error("{}: {message}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// The folder holds recordings of another seed.
    #[error("{}: holds recordings of seed {sealed}, not {asked}; give another folder", directory.display())]
    OtherSeed {
        /// The folder.
        directory: PathBuf,
        /// Its seed.
        sealed: u64,
        /// The seed asked for.
        asked: u64,
    },
    /// A truth is not what was sealed.
    #[error("{}: {reason}; the seal is broken", path.display())]
    Broken {
        /// The truth.
        path: PathBuf,
        /// How.
        reason: &'static str,
    },
    /// Scores that are to be joined are of different studies.
    #[error("the scores are of different studies ({one}; {other}); score each by itself")]
    OtherStudy {
        /// Seed and program of the first.
        one: String,
        /// Of another.
        other: String,
    },
    /// Scores that are to be joined hold the same recording.
    #[error("recording {index} of {family} is in two scores and would count twice; leave one of them out")]
    Twice {
        /// The family.
        family: &'static str,
        /// The index in it.
        index: u32,
    },
    /// Nothing is sealed.
    #[error("{}: no seal; run `boresight blind generate` first", directory.display())]
    NoSeal {
        /// The folder.
        directory: PathBuf,
    },
}

/// Every answer of a folder with its truth, the seal checked.
pub fn opened(directory: &Path) -> Result<Vec<(Truth, Answer)>, BlindError> {
    let sealed = Seal::read(directory)?.ok_or_else(|| BlindError::NoSeal { directory: directory.to_owned() })?;
    let mut pairs = Vec::new();
    for family in FAMILIES {
        for answer in answers(directory, family)? {
            pairs.push((open(directory, &sealed, family, answer.index)?, answer));
        }
    }
    Ok(pairs)
}
