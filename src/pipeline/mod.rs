//! Data flow of the verbs: recording → detections → identifications → control points → input of a diagnosis.
//!
//! The verbs of the program and the benchmark of concealed recordings share it; frames come from files or from memory.

mod crowding;
mod dark;
mod elsewhere;
mod frame_pass;
mod identified;
mod learnt_image;
mod measure;
mod one_camera;
mod overfull;
mod pixels;
mod prepare;
mod recording_conditions;
mod result;
mod run_limit;
mod sky_views;
mod star_list;
mod star_measurements;

use crate::calibrate::CalibrateError;
use crate::camera::{ObserverError, Physics, PhysicsError};
use crate::detect::{DetectError, Detection, Detections, EmpiricalPsf, PsfReport, PsfStar};
use crate::diagnose::DiagnoseError;
use crate::pixel_statistics::{PixelStatistics, StarTransfer, SummedImage};
use crate::recording::{Recording, RecordingError, SkippedFrame};

pub use dark::{Dark, DarkError};
pub use identified::{IdentifiedFrame, identify_frames};
pub use measure::{Centroid, MeasureOptions, measure, measure_frames};
pub use prepare::{DiagnosisInput, DiagnosisRequest, PreparedPoints, control_points, diagnosis_request, telemetry};
pub use recording_conditions::surroundings;
inner!(recording_conditions::{detector_numbers, image_conditions, looks_through_air, measured_noise, stamp_camera});
inner!(result::{CameraRow, ParameterRow, RUN_FORMAT, RunResult});
inner!(run_limit::{RunLimit, RunRequirement});
inner!(identified::{circumstances, physics_in_force, take_identifications});
inner!(learnt_image::take_phase_bias_off);
inner!(one_camera::{check_focal_lengths, check_sizes});
inner!(sky_views::sky_views);
inner!(star_measurements::star_measurements);
inner!(prepare::{known_behind_the_lens, star_images, with_name});

/// Why a recording does not lead to control points.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// A frame cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A frame cannot be measured.
    #[error("{frame}")]
    Detect {
        /// Its name.
        frame: String,
        /// Why.
        source: DetectError,
    },
    /// The dark frame is not of this camera.
    #[error("{frame}")]
    Dark {
        /// Its name.
        frame: String,
        /// Why.
        source: DarkError,
    },
    /// What a recording tells of a frame cannot be used.
    #[error("{frame}")]
    Observer {
        /// Its name.
        frame: String,
        /// Why.
        source: ObserverError,
    },
    /// An effect cannot be computed for a frame.
    #[error("{frame}")]
    Physics {
        /// Its name.
        frame: String,
        /// Why.
        source: PhysicsError,
    },
    /// An effect behind the lens cannot be computed.
    #[error(transparent)]
    BehindTheLens(#[from] PhysicsError),
    /// A diagnosis of a fisheye's frames.
    #[error("`diagnose` supports pinhole cameras only; these frames use {0}. Use `calibrate` instead.")]
    Fisheye(&'static str),
    /// Nothing can be read.
    #[error("none of the {skipped} frames can be read: {reason}")]
    NoFrames {
        /// Frames.
        skipped: usize,
        /// Why the first of them cannot.
        reason: String,
    },
    /// The frames are of several sizes, or were taken with several focal lengths.
    #[error("the frames are those of several cameras, and one camera is asked for: {groups}; give one camera's frames at a time")]
    SeveralCameras {
        /// What tells them apart, each with its files.
        groups: String,
    },
    /// Identifications are to be taken from a list, and there is none.
    #[error("only a star list names its stars; this recording holds images")]
    NoList,
    /// There is no camera to hold the recording against.
    #[error(transparent)]
    Baseline(#[from] DiagnoseError),
}

impl From<CalibrateError> for PipelineError {
    fn from(error: CalibrateError) -> Self {
        Self::Baseline(error.into())
    }
}

/// The physics of a model, and what becomes of it where no time is known.
#[derive(Clone, Debug, PartialEq)]
pub struct SkyChoice {
    /// The effects.
    pub physics: Physics,
    /// Whether stars without a known time are taken where they stood at an assumed one; else effects that need the time are refused.
    pub assumes_time: bool,
}

impl From<Physics> for SkyChoice {
    fn from(physics: Physics) -> Self {
        Self { assumes_time: physics == Physics::Known, physics }
    }
}

/// A recording with its measured frames.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The recording.
    pub recording: Recording,
    /// The frames that could be read, in order.
    pub frames: Vec<MeasuredFrame>,
    /// Those that could not (only where bad frames are skipped).
    pub skipped: Vec<SkippedFrame>,
    /// Which image the stars were fitted with, where an empirical one was asked for.
    pub psf: Option<PsfReport>,
    /// How their places were measured.
    pub centroid: Centroid,
    /// That image itself, where it was used.
    pub own_image: Option<EmpiricalPsf>,
    /// What the pixels between the stars tell of the detector, where that was asked for and there are pixels.
    pub pixels: Option<PixelStatistics>,
    /// How the noise of the stars grows with their light, once they are identified and where no gain is declared.
    pub star_noise: Option<StarTransfer>,
}

/// A frame whose stars are measured.
#[derive(Clone, Debug)]
pub struct MeasuredFrame {
    /// Index into the recording's frames.
    pub index: usize,
    /// Its file, or its number.
    pub name: String,
    /// Its stars.
    pub detections: Detections,
    /// Light and shape of its star images by sums, where the pixels are looked at.
    pub images: Vec<SummedImage>,
    /// The pixels of some of its clean stars, for the image that they show; where the pixels are looked at.
    pub kept: Vec<PsfStar>,
    /// How long it took to measure, wall time, s.
    pub seconds: f64,
}

impl Measured {
    /// Whether the time of every frame is known.
    #[must_use]
    pub fn times_are_known(&self) -> bool {
        self.frames.iter().all(|frame| self.recording.frames[frame.index].time_utc.is_some())
    }

    /// Stars with neither saturation nor an edge nor a neighbour in their stamps.
    fn clean_stars(&self) -> impl Iterator<Item = &Detection> {
        let stars = self.frames.iter().flat_map(|frame| &frame.detections.stars);
        stars.filter(|star| !star.flags.saturated && !star.flags.edge && !star.flags.blended)
    }

    /// Electrons per DN of a frame's detections: the camera's. Where a list of stars stands in the image's place, `None` unless it tells
    /// the electrons of all of them.
    #[must_use]
    pub fn gain_e_per_dn(&self, frame: &MeasuredFrame) -> Option<f64> {
        match self.recording.stars.as_ref().and_then(|list| list.frames.get(frame.index)) {
            Some(stars) => stars.iter().all(|star| star.flux_e.is_some()).then(|| star_list::gain_e_per_dn(&self.recording)),
            None => self.recording.camera.gain_e_per_dn,
        }
    }
}
