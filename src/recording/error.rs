//! What can be wrong with a recording, each in one sentence that names the place, the value and the remedy.

use std::fmt;
use std::path::PathBuf;

use thiserror::Error;

/// The kinds of image files that are read, for messages.
pub(super) const KINDS: &str = "FITS (.fits, .fit, .fts, .fz, .fits.gz), PNG, TIFF, JPEG, BMP or PGM";

/// Why a recording could not be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// A path that leads nowhere.
    #[error("{}: no such file or folder", path.display())]
    Missing {
        /// The path as given.
        path: PathBuf,
    },
    /// The operating system refused to read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// A fault in a manifest.
    #[error("{}, line {line}: {problem}", path.display())]
    Manifest {
        /// The manifest.
        path: PathBuf,
        /// Line of the fault, from 1.
        line: usize,
        /// The key at fault; empty where it is none.
        key: String,
        /// What is wrong, and the remedy.
        problem: String,
    },
    /// A fault in a star list.
    #[error("{}, line {line}: {problem}", path.display())]
    StarList {
        /// The star list.
        path: PathBuf,
        /// Line of the fault, from 1.
        line: usize,
        /// What is wrong, and the remedy.
        problem: String,
    },
    /// A star list of a kind that is not read.
    #[error("{}: Parquet star lists are not supported yet; convert to CSV ({place})", path.display())]
    Parquet {
        /// The star list.
        path: PathBuf,
        /// Where the manifest names it.
        place: ManifestKey,
    },
    /// A star list that is not there.
    #[error("{}: no such star list ({place})", path.display())]
    MissingStarList {
        /// The star list.
        path: PathBuf,
        /// Where the manifest names it.
        place: ManifestKey,
    },
    /// A folder or a manifest without frames.
    #[error("no frames found in {}: {hint}", path.display())]
    Empty {
        /// The folder or manifest.
        path: PathBuf,
        /// What was looked for.
        hint: String,
    },
    /// Paths that do not make one recording.
    #[error("{}: {problem}", path.display())]
    Inputs {
        /// The first path at fault.
        path: PathBuf,
        /// What is wrong, and the remedy.
        problem: String,
    },
    /// A frame that cannot be used.
    #[error("{}: {problem}{}", file.display(), place.as_ref().map_or_else(String::new, |place| format!(" ({place})")))]
    Frame {
        /// The frame's file.
        file: PathBuf,
        /// What is wrong with it.
        problem: Box<FrameProblem>,
        /// Where the manifest speaks of it.
        place: Option<ManifestKey>,
    },
    /// A frame of a star list has no pixels.
    #[error("frame {frame} of {} has no pixels: the recording is a star list; give images to a command that needs them", path.display())]
    NoPixels {
        /// The manifest.
        path: PathBuf,
        /// Number of the frame, from 0.
        frame: usize,
    },
    /// A frame number beyond the last.
    #[error("the recording has {frames} frames, there is no frame {frame} (frames count from 0)")]
    NoSuchFrame {
        /// The number asked for.
        frame: usize,
        /// How many there are.
        frames: usize,
    },
    /// Frames of several sizes where one camera is asked for.
    #[error("{} is {found} but {} is {expected}: frames of one camera have one size; give one camera's frames at a time", file.display(), first.display())]
    MixedSizes {
        /// The first frame.
        first: PathBuf,
        /// Its size.
        expected: FrameSize,
        /// The first frame of another size.
        file: PathBuf,
        /// Its size.
        found: FrameSize,
    },
}

/// Columns × rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameSize {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
}

impl fmt::Display for FrameSize {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} × {} px", self.width_px, self.height_px)
    }
}

/// A key in a manifest.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ManifestKey {
    /// The manifest.
    pub path: PathBuf,
    /// Line, from 1.
    pub line: usize,
    /// Key.
    pub key: &'static str,
}

impl fmt::Display for ManifestKey {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "key {:?} in {}, line {}", self.key, self.path.display(), self.line)
    }
}

/// What is wrong with a frame's file.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FrameProblem {
    /// It is not there.
    #[error("no such file")]
    Missing,
    /// It is a folder.
    #[error("is a folder, not an image")]
    Folder,
    /// The operating system refused to read it.
    #[error("cannot be read: {0}")]
    Read(std::io::Error),
    /// Its bytes are those of no image.
    #[error("is no image that can be read; frames are {KINDS}")]
    NotAnImage,
    /// Its bytes are those of a kind of file that is known and not read.
    #[error("is {kind}, which is not read; {remedy}")]
    OtherKind {
        /// What it is.
        kind: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A cube of which nobody says which plane is meant.
    #[error(
        "its {planes} planes may be {planes} exposures or colours, and its header does not say which; choose one with --plane 1 … {planes}{}",
        if *planes == 3 { ", or join them as colours with --plane colours" } else { "" }
    )]
    Cube {
        /// Planes.
        planes: usize,
    },
    /// A plane or page that is not there.
    #[error("there is no plane {plane}: the file holds {planes}")]
    NoSuchPlane {
        /// The plane asked for, from 1.
        plane: usize,
        /// How many there are.
        planes: usize,
    },
    /// No pixel has a value.
    #[error("none of its pixels has a value (all are NaN, infinite or BLANK); leave the frame out")]
    NothingDefined,
    /// Nothing in it.
    #[error("the file is empty; frames are {KINDS}")]
    EmptyFile,
    /// The decoder gave up.
    #[error("the {kind} file is damaged or of an unsupported kind: {message}")]
    Decode {
        /// PNG, TIFF, …
        kind: &'static str,
        /// What is wrong, and the remedy.
        message: String,
    },
    /// Fewer bytes than the header says.
    #[error("the {kind} file ends early: its header asks for {expected_bytes} bytes, {found_bytes} are there; copy the file again")]
    Truncated {
        /// FITS, …
        kind: &'static str,
        /// Bytes that the header asks for.
        expected_bytes: u64,
        /// Bytes that are there.
        found_bytes: u64,
    },
    /// It ends before its end mark.
    #[error("the {kind} file ends early: its end mark is not there; copy the file again")]
    NoEndMark {
        /// JPEG, …
        kind: &'static str,
    },
    /// Too few pixels to measure a star on.
    #[error("is {size}: too small, a frame has at least {minimum_px} × {minimum_px} px")]
    TooSmall {
        /// Its size.
        size: FrameSize,
        /// The least that is accepted.
        minimum_px: usize,
    },
    /// More pixels than can be meant.
    #[error("claims {size}: too large, a frame has at most {maximum_px} pixels")]
    TooLarge {
        /// Its size.
        size: FrameSize,
        /// The most that is accepted.
        maximum_px: usize,
    },
    /// Another size than the camera's.
    #[error("is {found}, but {expected_from} {expected}; give the frame's true size, or leave the frame out")]
    WrongSize {
        /// Its size.
        found: FrameSize,
        /// The size asked for.
        expected: FrameSize,
        /// Who asks for it: "the camera is", "frames/0000.fits is".
        expected_from: String,
    },
    /// A pixel that is no number.
    #[error("{count} of its pixels have no value (NaN, infinite or BLANK), the first at column {x}, row {y}; give them one before use")]
    NotFinite {
        /// How many.
        count: usize,
        /// Column of the first.
        x: usize,
        /// Row of the first.
        y: usize,
    },
    /// A FITS header that does not say what it must.
    #[error("FITS keyword {keyword}: {problem}")]
    FitsKeyword {
        /// The keyword.
        keyword: String,
        /// What is wrong, and the remedy.
        problem: String,
    },
    /// A FITS file that is no image.
    #[error("the FITS file cannot be used: {0}")]
    Fits(String),
    /// Time runs backwards.
    #[error("its time {time} is earlier than {previous} of the frame before; put the frames in order of time or correct the time")]
    TimeBackwards {
        /// Its time, UTC.
        time: String,
        /// The time before, UTC.
        previous: String,
    },
}
