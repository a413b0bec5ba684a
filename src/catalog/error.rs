//! What can be wrong with a catalogue.

use std::path::PathBuf;

/// A catalogue that cannot be used, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CatalogError {
    /// The file cannot be read.
    #[error("catalogue {path} cannot be read ({reason}); check the path and its permissions", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        #[source]
        reason: std::io::Error,
    },
    /// The file is not a comma-separated table.
    #[error("catalogue {path}, line {line}: {problem}", path = path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// What is wrong there, and the remedy.
        problem: String,
    },
    /// A column that the program does not know.
    #[error("catalogue {path}: column `{column}` is unknown; {remedy}", path = path.display())]
    UnknownColumn {
        /// The file.
        path: PathBuf,
        /// Its header.
        column: String,
        /// The nearest known column, or all of them.
        remedy: String,
    },
    /// Two columns with the same meaning.
    #[error("catalogue {path}: columns `{first}` and `{second}` both mean `{meaning}`; keep one of them", path = path.display())]
    RepeatedColumn {
        /// The file.
        path: PathBuf,
        /// Header of the first.
        first: String,
        /// Header of the second.
        second: String,
        /// The column's usual name.
        meaning: &'static str,
    },
    /// A column that must be there is not.
    #[error("catalogue {path}: column `{column}` is missing (found: {found}); add it", path = path.display())]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// The column's usual name.
        column: &'static str,
        /// The headers that are there.
        found: String,
    },
    /// A value that cannot be right.
    #[error("catalogue {path}, line {line}, column `{column}`: `{value}` {problem}", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The column's header.
        column: String,
        /// The value as it stands there.
        value: String,
        /// What is wrong with it, and the remedy.
        problem: String,
    },
    /// A table of another program that cannot be right.
    #[error("catalogue {path} {problem}", path = path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and the remedy.
        problem: String,
    },
    /// A table without stars.
    #[error("catalogue {path} holds no star; add at least one row below the header", path = path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A packed catalogue that was damaged or made by another version.
    #[error("packed catalogue {name} is damaged at {place}; make it again (`boresight catalog import`; the embedded one: `make catalog`)")]
    Damaged {
        /// Which one.
        name: String,
        /// Where.
        place: &'static str,
    },
    /// A star that the packed form cannot hold.
    #[error("star {hip} cannot be packed: its {quantity} is out of range; leave it out")]
    OutOfRange {
        /// The star's number.
        hip: u32,
        /// Which of its values.
        quantity: &'static str,
    },
}
