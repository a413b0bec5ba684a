//! Why a dataset cannot be made.

use std::path::PathBuf;

use thiserror::Error;

use crate::imaging::ImagingError;
use crate::recording::OutputError;
use crate::scene::SceneError;

/// Why a dataset cannot be made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A file cannot be read.
    #[error("{path}: cannot be read ({source})")]
    Read {
        /// The file.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file is no TOML, or has a key or a type that a recipe does not know.
    #[error("{path}: {message}")]
    Parse {
        /// The file.
        path: String,
        /// Line, key and remedy.
        message: String,
    },
    /// A value cannot be meant.
    #[error("{path}: {key} = {value} {remedy}")]
    Value {
        /// The file.
        path: String,
        /// The key.
        key: String,
        /// The value given.
        value: String,
        /// What is allowed.
        remedy: String,
    },
    /// The scene of a frame cannot be rendered.
    #[error("{path}: {place}: {source}")]
    Scene {
        /// The recipe.
        path: String,
        /// Which draw or which frame.
        place: String,
        /// What is wrong with it.
        source: Box<SceneError>,
    },
    /// A frame cannot be rendered.
    #[error("{path}: frame {key}: {source}")]
    Imaging {
        /// The recipe.
        path: String,
        /// The frame.
        key: u64,
        /// What is wrong with it.
        source: ImagingError,
    },
    /// The folder holds a dataset of another recipe.
    #[error(
        "{}: holds a dataset of another recipe (or another scene, catalogue or version of the program); choose another folder, or add --force to make it anew",
        path.display()
    )]
    OtherRecipe {
        /// The folder.
        path: PathBuf,
    },
    /// A shard is not what its mark says.
    #[error("{}: has {found} bytes and not the {stated} of its mark; remove both, and the shard is made anew", path.display())]
    ShardSize {
        /// The shard.
        path: PathBuf,
        /// Bytes that the mark states.
        stated: u64,
        /// Bytes that it has.
        found: u64,
    },
    /// An encoder gave up.
    #[error("frame {key}: cannot be encoded: {message}")]
    Encode {
        /// The frame.
        key: u64,
        /// The encoder's words.
        message: String,
    },
    /// A table cannot be made.
    #[error("{file}: cannot be made: {message}")]
    Table {
        /// The table.
        file: String,
        /// The writer's words.
        message: String,
    },
    /// Shards are missing.
    #[error(
        "{}: {missing} of {all} shards are not made, the first is {first}; make them with `boresight dataset RECIPE.toml -o {}`, then finish",
        path.display(),
        path.display()
    )]
    Missing {
        /// The folder.
        path: PathBuf,
        /// How many.
        missing: usize,
        /// Of how many.
        all: usize,
        /// The first of them.
        first: String,
    },
    /// A folder is no dataset.
    #[error("{path}: {message}")]
    NoDataset {
        /// The folder, or a file of it.
        path: String,
        /// What it lacks, and the remedy.
        message: String,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}
