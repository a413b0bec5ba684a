//! What can be wrong with a suite, or with the way to its answers.

use thiserror::Error;

/// Why a suite cannot be run.
#[derive(Debug, Error)]
pub enum SuiteError {
    /// A file cannot be read.
    #[error("{path}: cannot be read ({source})")]
    Read {
        /// The file.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The suite says what it cannot mean.
    #[error("{path}: line {line}: {message}")]
    Suite {
        /// The file.
        path: String,
        /// The line.
        line: usize,
        /// What is wrong, and the remedy.
        message: String,
    },
    /// The file is no suite.
    #[error("{path}: {message}")]
    Parse {
        /// The file.
        path: String,
        /// Line, key and remedy.
        message: String,
    },
    /// A scene of a case.
    #[error("the case {case:?}: {source}")]
    Scene {
        /// The case.
        case: String,
        /// What is wrong with it.
        source: Box<crate::scene::SceneError>,
    },
    /// A recipe of a case.
    #[error("the case {case:?}: {source}")]
    Dataset {
        /// The case.
        case: String,
        /// What is wrong with it.
        source: Box<crate::dataset::DatasetError>,
    },
    /// Frames cannot be rendered.
    #[error("the case {case:?}: {source}")]
    Imaging {
        /// The case.
        case: String,
        /// Why.
        source: Box<crate::imaging::ImagingError>,
    },
    /// The own pipeline cannot go on.
    #[error("the case {case:?}: {source}")]
    Pipeline {
        /// The case.
        case: String,
        /// Why.
        source: Box<crate::pipeline::PipelineError>,
    },
    /// The program under test cannot be started.
    #[error("the system under test cannot be started: {program}: {source}; name a program that is there, or give its path")]
    Start {
        /// The program.
        program: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file for the system under test, or of the result, cannot be written.
    #[error("{path}: cannot be written ({source})")]
    Write {
        /// The file.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The same, by the writers of recordings.
    #[error(transparent)]
    Output(#[from] crate::recording::OutputError),
}
