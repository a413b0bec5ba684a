//! Output that is there whole or not at all: files and folders are made under another name and renamed at the end.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempDir};
use thiserror::Error;

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

/// Names and rights of what is built under another name: the user's own default rights, not the private ones of scratch files.
fn builder(prefix: &str, mode: u32) -> Builder<'_, 'static> {
    let mut builder = Builder::new();
    builder.prefix(prefix).suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(mode));
    }
    #[cfg(not(unix))]
    let _ = mode;
    builder
}

/// Writes a file whole or not at all, and replaces the one of that name. Missing folders above it are made.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    let error = write_error(path);
    fs::create_dir_all(parent(path)).map_err(&error)?;
    let mut file = builder(".boresight-", 0o666).tempfile_in(parent(path)).map_err(&error)?;
    file.write_all(bytes).map_err(&error)?;
    file.persist(path).map_err(|persist| error(persist.error))?;
    Ok(())
}

/// A folder in the making. Dropped before [`Self::finish`], it leaves nothing behind.
#[derive(Debug)]
pub struct OutputDirectory {
    target: PathBuf,
    building: TempDir,
}

impl OutputDirectory {
    /// Begins a folder that will be `target`, which must be absent, empty or, with `force`, made by this program.
    pub fn create(target: &Path, force: bool) -> Result<Self, OutputError> {
        let error = write_error(target);
        let target = if target.exists() { target.canonicalize().map_err(&error)? } else { target.to_owned() };
        check_replaceable(&target, force)?;
        fs::create_dir_all(parent(&target)).map_err(&error)?;
        let building = builder(".boresight-", 0o777).tempdir_in(parent(&target)).map_err(&error)?;
        fs::write(building.path().join(MARK), format!("{}\n", env!("CARGO_PKG_VERSION"))).map_err(&error)?;
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
        let error = write_error(&target);
        let former = if target.exists() {
            let aside = builder(".boresight-", 0o777).tempdir_in(parent(&target)).map_err(&error)?;
            fs::rename(&target, aside.path().join("former")).map_err(&error)?;
            Some(aside)
        } else {
            None
        };
        if let Err(source) = fs::rename(building.path(), &target) {
            if let Some(aside) = former {
                let aside = aside.keep(); // not removed before what it holds stands in its place again
                fs::rename(aside.join("former"), &target).and_then(|()| fs::remove_dir(aside)).map_err(&error)?;
            }
            return Err(error(source));
        }
        let _ = building.keep(); // it lives on under its new name
        if let Some(aside) = former {
            aside.close().map_err(&error)?;
        }
        drop(error);
        Ok(target)
    }
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
    match (empty, target.join(MARK).is_file(), force) {
        (true, ..) | (false, true, true) => Ok(()),
        (false, true, false) => Err(OutputError::Exists { path }),
        (false, false, _) => Err(OutputError::Foreign { path }),
    }
}
