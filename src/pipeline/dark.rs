//! Dark frames: subtracted from the frames, with hot pixels masked. Without darks, pixels that stay in place while the stars move are masked.

use std::path::{Path, PathBuf};

use super::MeasuredFrame;
use crate::detect::Detection;
use crate::frame::Frame;
use crate::recording::{FrameSize, Recording, RecordingError};
use crate::statistics::order::ascending;
use crate::statistics::{mad_sigma, median, median_in_place};

/// Why a dark cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DarkError {
    /// A file cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Darks of several sizes.
    #[error("{}: this dark is of {found}, the first of {first}; darks are of one camera: leave the others out", file.display())]
    Sizes {
        /// The file.
        file: PathBuf,
        /// Its size.
        found: FrameSize,
        /// That of the first.
        first: FrameSize,
    },
    /// A dark of another size than the frame.
    #[error("the frame is of {frame}, the dark of {dark}: give darks of the same camera, with the same binning and window")]
    OtherSize {
        /// Of the frame.
        frame: FrameSize,
        /// Of the dark.
        dark: FrameSize,
    },
}

/// A pixel is hot where the dark is so many σ above the others, and bad.
const HOT_SIGMA: f64 = 8.0;
/// The scatter of the dark is at least this, DN: that of rounding.
const MIN_SIGMA_DN: f64 = 0.5;

/// The master dark: the median of dark frames, pixel by pixel.
#[derive(Clone, Debug)]
pub struct Dark {
    size: FrameSize,
    /// Dark less its median over the frame, whole counts: the level stays in the frames, so that their bias and top keep their meaning.
    pattern_dn: Vec<f32>,
    hot: Vec<bool>,
    /// Dark frames that it is of.
    frames: usize,
    files: Vec<PathBuf>,
}

impl Dark {
    /// From an image, or a folder of images (or a recording).
    pub fn read(path: &Path) -> Result<Self, DarkError> {
        let recording = Recording::open(&[path])?;
        let mut frames: Vec<Frame> = Vec::with_capacity(recording.frames.len());
        let mut undefined = None;
        for index in 0..recording.frames.len() {
            let masked = recording.load_masked(index)?;
            undefined = merged(undefined, masked.undefined);
            let frame = masked.frame;
            if let Some(first) = frames.first().map(size).filter(|first| *first != size(&frame)) {
                return Err(DarkError::Sizes { file: recording.frame_name(index).into(), found: size(&frame), first });
            }
            frames.push(frame);
        }
        let files = recording.input_files();
        let mut dark = Self { files, ..Self::of(&frames) };
        // what a dark does not tell of a pixel cannot be taken off it
        for (hot, undefined) in dark.hot.iter_mut().zip(undefined.iter().flatten()) {
            *hot |= undefined;
        }
        Ok(dark)
    }

    /// From dark frames of one size.
    #[must_use]
    pub fn of(frames: &[Frame]) -> Self {
        let pixels = frames.first().map_or(0, |frame| frame.pixels_dn.len());
        let mut column = Vec::with_capacity(frames.len());
        let master: Vec<f64> = (0..pixels)
            .map(|i| {
                column.clear();
                column.extend(frames.iter().map(|frame| f64::from(frame.pixels_dn[i])));
                median_in_place(&mut column).unwrap_or(0.0)
            })
            .collect();
        let level = median(&master).unwrap_or(0.0);
        let sigma = mad_sigma(&master).unwrap_or(0.0).max(MIN_SIGMA_DN);
        Self {
            size: frames.first().map_or(FrameSize { width_px: 0, height_px: 0 }, size),
            pattern_dn: master.iter().map(|dark| (dark - level).round() as f32).collect(),
            hot: master.iter().map(|dark| dark - level > HOT_SIGMA * sigma).collect(),
            frames: frames.len(),
            files: Vec::new(),
        }
    }

    /// Takes the pattern off a frame; full pixels stay full.
    pub fn subtract(&self, frame: &mut Frame) -> Result<(), DarkError> {
        if size(frame) != self.size {
            return Err(DarkError::OtherSize { frame: size(frame), dark: self.size });
        }
        let full = frame.saturation_dn;
        for (pixel, dark) in frame.pixels_dn.iter_mut().zip(&self.pattern_dn).filter(|(pixel, _)| **pixel < full) {
            *pixel -= dark;
        }
        Ok(())
    }

    /// Which pixels are hot, row by row.
    #[must_use]
    pub fn hot(&self) -> &[bool] {
        &self.hot
    }

    /// The files that it was made of.
    #[must_use]
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// What it is, in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let hot = self.hot.iter().filter(|hot| **hot).count();
        format!("the median of {} dark frames is taken off; {hot} hot pixels are left out", self.frames)
    }
}

/// The pixels that are marked in either.
fn merged(one: Option<Vec<bool>>, other: Option<Vec<bool>>) -> Option<Vec<bool>> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.iter().zip(&other).map(|(one, other)| *one || *other).collect()),
        (one, other) => one.or(other),
    }
}

fn size(frame: &Frame) -> FrameSize {
    FrameSize { width_px: frame.width_px, height_px: frame.height_px }
}

/// Takes out what shows in the same place of most frames while the stars move: hot pixels in groups, glow, dust. Says how many, if any.
///
/// Where most of what is seen stays in its place the camera does not move against the sky, and nothing is taken.
pub(super) fn drop_fixed(frames: &mut [MeasuredFrame]) -> Option<String> {
    const MIN_FRAMES: usize = 5;
    const SHARE_OF_FRAMES: f64 = 0.7;
    /// So near is the same place, px.
    const SAME_PX: f64 = 0.5;
    /// Of the brightest of each frame at most this share may stay in place.
    const BRIGHTEST: usize = 20;
    const MAX_STAYING: f64 = 0.3;
    let sizes_differ = frames.windows(2).any(|f| size_of(&f[0]) != size_of(&f[1]));
    if frames.len() < MIN_FRAMES || sizes_differ {
        return None;
    }
    let sorted: Vec<Vec<[f64; 2]>> = frames
        .iter()
        .map(|frame| {
            let mut places: Vec<[f64; 2]> = frame.detections.stars.iter().map(|star| [star.x_px, star.y_px]).collect();
            ascending(&mut places, |a| a[0]);
            places
        })
        .collect();
    let stays = |star: &Detection| {
        let seen = |places: &Vec<[f64; 2]>| {
            let from = places.partition_point(|p| p[0] < star.x_px - SAME_PX);
            places[from..].iter().take_while(|p| p[0] <= star.x_px + SAME_PX).any(|p| (p[1] - star.y_px).abs() <= SAME_PX)
        };
        sorted.iter().filter(|places| seen(places)).count() as f64 >= SHARE_OF_FRAMES * sorted.len() as f64
    };
    let marks: Vec<Vec<bool>> = frames.iter().map(|frame| frame.detections.stars.iter().map(stays).collect()).collect();
    let count = |marks: &[bool]| marks.iter().filter(|stays| **stays).count();
    let bright = |marks: &Vec<bool>| marks[..marks.len().min(BRIGHTEST)].to_vec();
    let (staying, all) = marks.iter().map(bright).fold((0, 0), |(s, a), m| (s + count(&m), a + m.len()));
    let dropped: usize = marks.iter().map(|m| count(m)).sum();
    if dropped == 0 || staying as f64 > MAX_STAYING * all as f64 {
        return None;
    }
    for (frame, marks) in frames.iter_mut().zip(&marks) {
        let mut marks = marks.iter();
        frame.detections.stars.retain(|_| marks.next() != Some(&true));
    }
    Some(format!("{dropped} detections that stay in their places while the stars move are left out"))
}

fn size_of(frame: &MeasuredFrame) -> (usize, usize) {
    (frame.detections.width_px, frame.detections.height_px)
}
