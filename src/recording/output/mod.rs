//! Atomic output: files and folders are made under another name and renamed at the end, so that they are whole or absent.

mod partial;
mod results;

use std::fs;
use std::path::{Path, PathBuf};

use thiserror::Error;

use partial::{PartialFile, PartialFolder};

pub use partial::abandon;
pub use results::{ResultFolder, check_file};

/// Marks a folder as made by this program, so that it may be replaced on request.
const MARK: &str = ".boresight";

/// Why output could not be written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OutputError {
    /// The operating system refused.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// The folder is a file.
    #[error("{}: is a file, not a folder; choose another name for the output folder", path.display())]
    NotAFolder {
        /// The path asked for.
        path: PathBuf,
    },
    /// There is a result already.
    #[error("{}: holds an earlier result; choose another folder, or add --force to replace it", path.display())]
    Exists {
        /// The folder asked for.
        path: PathBuf,
    },
    /// There is a result of the same verb already.
    #[error("{}: holds an earlier result of `{verb}`; choose another folder, or add --force to replace it", path.display())]
    Earlier {
        /// The folder asked for.
        path: PathBuf,
        /// The verb.
        verb: &'static str,
    },
    /// There is a file already.
    #[error("{}: is there already; choose another name, or add --force to replace it", path.display())]
    FileExists {
        /// The file asked for.
        path: PathBuf,
    },
    /// The file is a folder.
    #[error("{}: is a folder; name a file in it", path.display())]
    NotAFile {
        /// The path asked for.
        path: PathBuf,
    },
    /// The folder holds something of the user's.
    #[error("{}: is not empty and was not made by boresight, so it is not replaced; choose another folder", path.display())]
    Foreign {
        /// The folder asked for.
        path: PathBuf,
    },
    /// An image cannot be written as it was given.
    #[error("{}: {pixels} pixels do not fill {width_px} × {height_px}", path.display())]
    PixelCount {
        /// The file.
        path: PathBuf,
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
        /// Pixels that were given.
        pixels: usize,
    },
    /// An encoder gave up.
    #[error("{}: cannot be encoded: {message}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// The encoder's words.
        message: String,
    },
    /// A recording that could not be read back.
    #[error("the recording cannot be written so that it can be read: {0}")]
    Unreadable(#[from] Box<super::RecordingError>),
}

fn write_error(path: &Path) -> impl Fn(std::io::Error) -> OutputError + '_ {
    move |source| OutputError::Write { path: path.to_owned(), source }
}

/// The folder that a path lies in.
fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Writes a file whole or not at all, and replaces the one of that name. Missing folders above it are made.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    let error = write_error(path);
    results::note(path)?;
    partial::make(parent(path)).map_err(&error)?;
    let mut file = PartialFile::in_folder(parent(path)).map_err(&error)?;
    file.write_all(bytes).map_err(&error)?;
    file.keep_as(path).map_err(&error)
}

/// A file that is written piece by piece. Dropped before [`Self::finish`], it leaves nothing behind.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    building: PartialFile,
}

impl OutputFile {
    /// Begins a file; missing folders above it are made.
    pub fn create(path: &Path) -> Result<Self, OutputError> {
        let error = write_error(path);
        partial::make(parent(path)).map_err(&error)?;
        let building = PartialFile::in_folder(parent(path)).map_err(&error)?;
        Ok(Self { path: path.to_owned(), building })
    }

    /// Gives the file its name when the disk has it, and waits until the disk has the name too: after this, it outlasts a power failure.
    pub fn finish(self) -> Result<(), OutputError> {
        let Self { path, building } = self;
        let error = write_error(&path);
        building.sync().map_err(&error)?;
        building.keep_as(&path).map_err(&error)?;
        // Folders cannot be opened everywhere; where they can, their names are waited for.
        fs::File::open(parent(&path)).map_or(Ok(()), |folder| folder.sync_all()).map_err(&error)
    }
}

impl std::io::Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.building.write_all(bytes).map(|()| bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A folder in the making. Dropped before [`Self::finish`], it leaves nothing behind.
#[derive(Debug)]
pub struct OutputDirectory {
    target: PathBuf,
    building: PartialFolder,
}

impl OutputDirectory {
    /// Begins a folder that will be `target`, which must be absent, empty or, with `force`, made by this program.
    pub fn create(target: &Path, force: bool) -> Result<Self, OutputError> {
        let error = write_error(target);
        let target = if target.exists() { target.canonicalize().map_err(&error)? } else { target.to_owned() };
        check_replaceable(&target, force)?;
        partial::make(parent(&target)).map_err(&error)?;
        let building = PartialFolder::in_folder(parent(&target)).map_err(&error)?;
        fs::write(building.path().join(MARK), format!("boresight {}, whole folder\n", env!("CARGO_PKG_VERSION"))).map_err(&error)?;
        Ok(Self { target, building })
    }

    /// Where to write until the folder is finished.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.building.path()
    }

    /// Gives the folder its name; what stood there before is removed.
    pub fn finish(self) -> Result<PathBuf, OutputError> {
        let Self { target, building } = self;
        building.keep_as(&target, parent(&target)).map_err(write_error(&target))?;
        Ok(target)
    }
}

/// Whether a folder was made by this program as a whole, and not one into which it wrote files beside others.
fn is_whole(folder: &Path) -> bool {
    fs::read_to_string(folder.join(MARK)).is_ok_and(|text| text.lines().next().is_some_and(|line| !line.ends_with(results::LISTED)))
}

fn check_replaceable(target: &Path, force: bool) -> Result<(), OutputError> {
    let path = target.to_owned();
    if !target.exists() {
        return Ok(());
    }
    if !target.is_dir() {
        return Err(OutputError::NotAFolder { path });
    }
    let empty = fs::read_dir(target).map_err(write_error(target))?.next().is_none();
    match (empty, is_whole(target), force) {
        (true, ..) | (false, true, true) => Ok(()),
        (false, true, false) => Err(OutputError::Exists { path }),
        (false, false, _) => Err(OutputError::Foreign { path }),
    }
}
