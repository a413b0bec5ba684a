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
mod result;
mod sky_views;
mod star_list;
mod star_measurements;

use crate::calibrate::{CalibrateError, Surroundings};
use crate::camera::{ObserverError, Physics, PhysicsError};
use crate::detect::{DetectError, Detection, Detections, EmpiricalPsf, PsfReport, PsfStar};
use crate::diagnose::{DiagnoseError, ImageConditions, MeasuredNoise};
use crate::pixel_statistics::{PixelStatistics, SummedImage};
use crate::recording::{Mount, Recording, RecordingError, SkippedFrame};
use crate::statistics::median_in_place;

pub use dark::{Dark, DarkError};
pub use identified::{IdentifiedFrame, identify_frames};
pub use measure::{Centroid, MeasureOptions, measure, measure_frames};
pub use prepare::{DiagnosisInput, DiagnosisRequest, PreparedPoints, control_points, diagnosis_request, telemetry};
inner!(result::{CameraRow, ParameterRow, RUN_FORMAT, RunResult});
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

/// Whether a camera looks through air: it is in space where its recording tells how it moves and knows of no ground.
#[must_use]
pub fn surroundings(recording: &Recording) -> Surroundings {
    let flies = recording.frames.iter().any(|frame| frame.velocity_km_s.is_some());
    let stands = recording.site.is_some() || recording.mount == Some(Mount::Fixed);
    if flies && !stands { Surroundings::Space } else { Surroundings::MayBeGround }
}

/// Whether a camera may look through air.
#[must_use]
pub fn looks_through_air(recording: &Recording) -> bool {
    surroundings(recording) == Surroundings::MayBeGround
}

/// How the stars of a recording look, to render them as they are; `None` where there are no pixels, or nobody says how many electrons a
/// count stands for.
#[must_use]
pub fn image_conditions(measured: &Measured) -> Option<ImageConditions> {
    let camera = &measured.recording.camera;
    let gain = camera.gain_e_per_dn.filter(|_| measured.recording.stars.is_none())?;
    let mut widths: Vec<f64> = measured.clean_stars().map(|star| star.width_px).filter(|width| *width > 0.0).collect();
    let mut noises: Vec<f64> = measured.frames.iter().map(|frame| frame.detections.noise_dn * gain).collect();
    let noise_e = median_in_place(&mut noises).filter(|noise| *noise > 0.0)?;
    // Where the level of no light is not known, the noise tells how much there is.
    let by_noise = (noise_e * noise_e - camera.read_noise_e.unwrap_or(0.0).powi(2)).max(0.0);
    let mut levels: Vec<f64> = measured
        .frames
        .iter()
        .map(|frame| camera.bias_dn.map_or(by_noise, |bias_dn| ((frame.detections.background_dn - bias_dn) * gain).max(0.0)))
        .collect();
    Some(ImageConditions { psf_sigma_px: median_in_place(&mut widths)?, background_e: median_in_place(&mut levels)?, noise_e })
}

/// The noise as the pixels show it: the stamps of the stars, and the photon-transfer relation of the background. Nothing for a list of stars.
#[must_use]
pub fn measured_noise(measured: &Measured) -> MeasuredNoise {
    if measured.recording.stars.is_some() {
        return MeasuredNoise::default();
    }
    let mut chi2: Vec<f64> = measured.clean_stars().map(|star| star.chi2_per_dof).filter(|value| value.is_finite()).collect();
    let camera = &measured.recording.camera;
    let declared = camera.gain_e_per_dn.zip(camera.bias_dn).zip(camera.read_noise_e);
    let mut ratios: Vec<f64> = declared.map_or_else(Vec::new, |((gain, bias_dn), read_noise_e)| {
        let of = |frame: &MeasuredFrame| {
            let electrons = ((frame.detections.background_dn - bias_dn) * gain).max(0.0);
            frame.detections.noise_dn * gain / (electrons + read_noise_e * read_noise_e).sqrt()
        };
        measured.frames.iter().map(of).filter(|ratio| ratio.is_finite() && *ratio > 0.0).collect()
    });
    MeasuredNoise { stamp_chi2_per_dof: median_in_place(&mut chi2), background_ratio: median_in_place(&mut ratios) }
}
