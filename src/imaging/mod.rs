//! Runs the pixel effects on the GPU, or their twins on the CPU.
//!
//! ```text
//!   star images (f64 px, electrons)
//!      │  integer pixel + f32 fraction, lists per tile          tiles
//!      ▼
//!   point spread        expected electrons of the stars, upon   GPU: collect.wgsl   CPU: SeparablePsf::add, Psf2d::add_plane
//!      │                those of the sky
//!   pixel effects       Light → Charge → Readout → Digital      GPU: one program    CPU: row by row
//!      │                                                        made for the job
//!   passes              charge that moves between pixels        GPU: a program each  CPU: lines or rows on all cores
//!      ▼                (none, or some with pixel effects between them)
//!   electrons (f32) or counts (u16)
//! ```
//! An [`Imager`] is made once for a camera and asked for frame after frame. A frame is a function of the configuration, its stars and its
//! index alone: any can be made by itself, and its bytes do not depend on threads. GPU and CPU agree as [`twin_check()`] measures.

mod binning;
mod collect_on_gpu;
mod compose;
mod doctor;
mod join_on_gpu;
mod marks;
mod mosaic;
mod noise_free;
mod on_cpu;
mod on_gpu;
mod passes_on_gpu;
mod plan;
mod plane;
mod stamp;
mod tiles;
mod twin_check;

pub use binning::{Binning, BinningPlace};
pub use doctor::{DOCTOR_FORMAT, DoctorResult, ListedAdapter, TwinCheck, TwinDifferences};
pub use plan::EffectSetting;

inner!(crate::effects::pixel::Stage);
pub use crate::gpu::{Backend, GpuError};
inner!(binning::{BinnedImager, BinnedNoiseFree});
inner!(compose::{Output, PassProgram, chain_program, collect_plane_program, collect_program, join_program, mosaic_program, pass_programs, uniforms_name});
inner!(mosaic::FilterLight);
inner!(noise_free::{NoiseFree, StampLight});
inner!(plane::{PlaneLight, PointSource});
inner!(stamp::Stamp);
inner!(twin_check::{TwinReport, compare_counts, twin_check});

use crate::gpu::{BINDING_BYTES, Gpu, LOOP_BUDGET, Need};
use binning::Joining;
use on_gpu::GpuImager;
use plan::Plan;

/// What can go wrong while imaging.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImagingError {
    /// A frame without pixels, or with too many.
    #[error("a frame of {width_px} × {height_px} px cannot be imaged: each side must be 1 … 65535 px")]
    BadSize {
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
    },
    /// More light than is rendered in any time that somebody waits.
    #[error(
        "exposure {index} asks for {places:.1e} points of starlight, each on {area_px} pixels, and at most {most:.0e} pixels are lit in this way: choose a brighter sky.faintest_magnitude, a longer focal length, less jitter, a shorter exposure or a smaller psf.reach_px"
    )]
    TooMuchLight {
        /// Which exposure.
        index: usize,
        /// Stars, times the points along their ways, times those of jitter.
        places: f64,
        /// Pixels that a point lights.
        area_px: usize,
        /// The product that is allowed.
        most: f64,
    },
    /// An id that no effect has.
    #[error("no {kind} has the id {id:?}; known: {known}")]
    UnknownEffect {
        /// Point spread or pixel effect.
        kind: &'static str,
        /// The id given.
        id: String,
        /// The ids there are.
        known: String,
    },
    /// The same effect twice.
    #[error("the pixel effect {id} is switched on twice; give it once")]
    EffectTwice {
        /// Which.
        id: &'static str,
    },
    /// A parameter that the effect does not have, or one that was not given.
    #[error("the pixel effect {id} {problem} the parameter {parameter:?}; its parameters are: {known}")]
    BadParameterName {
        /// Effect.
        id: &'static str,
        /// "does not have" or "needs".
        problem: &'static str,
        /// Parameter.
        parameter: String,
        /// The names there are.
        known: String,
    },
    /// A parameter outside its range.
    #[error("{parameter} = {value} of the pixel effect {id} lies outside {low} … {high}")]
    OutOfRange {
        /// Effect.
        id: &'static str,
        /// Parameter.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// Lowest value allowed.
        low: f64,
        /// Highest.
        high: f64,
    },
    /// A star that cannot be drawn.
    #[error("the star image number {index} (counted from 0) has {what} = {value}, which cannot be drawn; correct or remove it")]
    BadStar {
        /// Its index.
        index: usize,
        /// Which of its numbers.
        what: &'static str,
        /// The number.
        value: f64,
    },
    /// An exposure time that is none.
    #[error("an exposure of {exposure_s} s cannot be imaged: it must be finite and not negative")]
    BadExposure {
        /// The time.
        exposure_s: f64,
    },
    /// Light of the sky that does not fit the frame.
    #[error("the light of the sky has {given} values, but the frame has {expected} pixels; give one finite value for each, or none")]
    BadSky {
        /// As many there were.
        given: usize,
        /// Pixels of the frame.
        expected: usize,
    },
    /// A frame that is no whole number of joined pixels.
    #[error("a frame of {width_px} × {height_px} px cannot be joined {factor} × {factor}: both sides must be multiples of that")]
    BadBinning {
        /// Columns.
        width_px: usize,
        /// Rows.
        height_px: usize,
        /// Pixels along each side of a joined one.
        factor: usize,
    },
    /// What no GPU does.
    #[error("{what} is rendered on the CPU alone: choose --backend cpu")]
    OnCpuAlone {
        /// A key of the scene.
        what: &'static str,
    },
    /// Counts asked of a chain without a converter.
    #[error("counts were asked for, but the converter (adc) is not switched on; add it or ask for electrons")]
    NoConverter,
    /// The GPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// A star in the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedStar {
    /// Column, (0, 0) = centre of the first pixel.
    pub x_px: f64,
    /// Row, downwards.
    pub y_px: f64,
    /// Expected electrons over the exposure.
    pub electrons: f64,
    /// Width σ of its image.
    pub sigma_px: f64,
}

/// One exposure.
#[derive(Clone, Copy, Debug)]
pub struct FrameExposure<'a> {
    /// The stars; their order is the order in which light is added, so it counts for the last bit.
    pub stars: &'a [PlacedStar],
    /// Expected electrons of the sky over the exposure, row by row, on which the stars' light is put; empty: none.
    pub sky_e: &'a [f32],
    /// Exposure time (the stars' electrons hold it already).
    pub exposure_s: f64,
    /// Index in the series: with the seed, the key of the noise.
    pub frame_index: u32,
    /// Temperature of the detector; `None`: that at which its parameters were measured.
    pub temperature_c: Option<f64>,
}

/// What stays the same from frame to frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagingConfig {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// The key of all noise.
    pub seed: u64,
    /// Id of the point spread.
    pub point_spread: String,
    /// The pixel effects that are switched on, in any order: they act in the order of the registry.
    pub effects: Vec<EffectSetting>,
}

/// A frame of counts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image16 {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Counts, row by row, the first row on top.
    pub pixels_dn: Vec<u16>,
}

impl Image16 {
    /// As a frame of a recording.
    #[must_use]
    pub fn to_frame(&self, saturation_dn: f32) -> crate::frame::Frame {
        let pixels_dn = self.pixels_dn.iter().map(|count| f32::from(*count)).collect();
        crate::frame::Frame { width_px: self.width_px, height_px: self.height_px, pixels_dn, saturation_dn }
    }
}

/// Sizes at which work is split. The defaults are what every implementation of WebGPU grants; tests set them small.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplitLimits {
    /// Entries of a tile's list that one dispatch goes through.
    pub entries_per_dispatch: u32,
    /// Bytes of one buffer.
    pub buffer_bytes: u64,
}

impl Default for SplitLimits {
    fn default() -> Self {
        Self { entries_per_dispatch: LOOP_BUDGET, buffer_bytes: BINDING_BYTES }
    }
}

#[derive(Debug)]
enum Runner {
    Cpu,
    Gpu(Box<GpuImager>),
}

/// Makes frames of one camera.
#[derive(Debug)]
pub struct Imager {
    plan: Plan,
    runner: Runner,
}

impl Imager {
    /// Checks the configuration and opens the backend.
    pub fn new(backend: Backend, config: &ImagingConfig) -> Result<Self, ImagingError> {
        Self::with_limits(backend, config, SplitLimits::default())
    }

    /// The same, with work split at other sizes.
    pub fn with_limits(backend: Backend, config: &ImagingConfig, limits: SplitLimits) -> Result<Self, ImagingError> {
        Self::for_joining(backend, config, limits, 1)
    }

    /// The same for frames whose pixels may be joined at the end, so many along each side.
    fn for_joining(backend: Backend, config: &ImagingConfig, limits: SplitLimits, factor: usize) -> Result<Self, ImagingError> {
        let plan = Plan::new(config)?;
        let gpu = match backend {
            Backend::Cpu => None,
            Backend::Gpu => Some(Gpu::open(Need::Any)?),
            Backend::Auto => match Gpu::open(Need::Hardware) {
                Ok(gpu) => Some(gpu),
                Err(GpuError::NoAdapter { .. } | GpuError::NotBuilt) => None,
                Err(error) => {
                    tracing::warn!("{error}; the CPU is used");
                    None
                }
            },
        };
        let runner = match gpu {
            Some(gpu) => Runner::Gpu(Box::new(GpuImager::new(gpu, &plan, limits, factor))),
            None => Runner::Cpu,
        };
        Ok(Self { plan, runner })
    }

    /// On what frames are made, for the provenance of results: the adapter and its driver, or `cpu`.
    #[must_use]
    pub fn adapter(&self) -> String {
        match &self.runner {
            Runner::Cpu => "cpu".to_owned(),
            Runner::Gpu(gpu) => gpu.adapter(),
        }
    }

    /// The count of a full pixel; `None` without a converter.
    #[must_use]
    pub fn saturation_dn(&self) -> Option<f32> {
        self.plan.saturation_dn()
    }

    /// A frame as the detector gives it.
    pub fn expose(&self, exposure: &FrameExposure<'_>) -> Result<Image16, ImagingError> {
        self.expose_with(exposure, &[])
    }

    /// The same with light of plane point spreads besides.
    pub fn expose_with(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>]) -> Result<Image16, ImagingError> {
        let pixels_dn = self.counts(exposure, planes, None)?;
        Ok(Image16 { width_px: self.plan.width_px, height_px: self.plan.height_px, pixels_dn })
    }

    /// The same with electrons that reading adds to each pixel right before the converter, row by row. On the CPU alone.
    pub(crate) fn expose_on(
        &self,
        exposure: &FrameExposure<'_>,
        planes: &[PlaneLight<'_>],
        read_e: &[f32],
    ) -> Result<Image16, ImagingError> {
        let (width_px, height_px) = (self.plan.width_px, self.plan.height_px);
        if read_e.len() != width_px * height_px {
            return Err(ImagingError::BadSky { given: read_e.len(), expected: width_px * height_px });
        }
        if !self.plan.has_converter() {
            return Err(ImagingError::NoConverter);
        }
        let lit = self.plan.light(exposure, planes)?;
        match &self.runner {
            Runner::Cpu => Ok(Image16 { width_px, height_px, pixels_dn: on_cpu::counts(&self.plan, &lit, read_e, exposure) }),
            Runner::Gpu(_) => Err(ImagingError::OnCpuAlone { what: "detector.dark_frame" }),
        }
    }

    /// Counts, row by row, joined where that is asked for.
    fn counts(&self, exposure: &FrameExposure<'_>, planes: &[PlaneLight<'_>], joining: Option<Joining>) -> Result<Vec<u16>, ImagingError> {
        if !self.plan.has_converter() {
            return Err(ImagingError::NoConverter);
        }
        let lit = self.plan.light(exposure, planes)?;
        match &self.runner {
            Runner::Cpu => {
                let counts = on_cpu::counts(&self.plan, &lit, &[], exposure);
                Ok(joining.map(|joining| joining.binning.join_counts(&counts, self.plan.width_px)).unwrap_or(counts))
            }
            Runner::Gpu(gpu) => Ok(gpu.counts(&self.plan, &lit, exposure, joining)?),
        }
    }

    /// The frame's expected electrons, without noise, row by row: stars and the effects of [`Stage::Light`].
    pub fn expected_electrons(&self, exposure: &FrameExposure<'_>) -> Result<Vec<f32>, ImagingError> {
        self.electrons_after(Some(Stage::Light), exposure)
    }

    /// The frame after all effects up to and with a stage, row by row; with `None` the light of the stars alone. After [`Stage::Digital`] the
    /// numbers are counts.
    pub fn electrons_after(&self, stage: Option<Stage>, exposure: &FrameExposure<'_>) -> Result<Vec<f32>, ImagingError> {
        self.electrons_after_with(stage, exposure, &[])
    }

    /// The same with light of plane point spreads besides.
    pub fn electrons_after_with(
        &self,
        stage: Option<Stage>,
        exposure: &FrameExposure<'_>,
        planes: &[PlaneLight<'_>],
    ) -> Result<Vec<f32>, ImagingError> {
        self.electrons(stage, exposure, planes, None)
    }

    /// Electrons after a stage, row by row, joined where that is asked for.
    fn electrons(
        &self,
        stage: Option<Stage>,
        exposure: &FrameExposure<'_>,
        planes: &[PlaneLight<'_>],
        joining: Option<Joining>,
    ) -> Result<Vec<f32>, ImagingError> {
        let lit = self.plan.light(exposure, planes)?;
        match &self.runner {
            Runner::Cpu => {
                let native = on_cpu::electrons(&self.plan, stage, &lit, exposure);
                let join = |joining: Joining| joining.binning.join(&native, self.plan.width_px, joining.full_well_e);
                Ok(joining.map(join).unwrap_or(native))
            }
            Runner::Gpu(gpu) => Ok(gpu.electrons(&self.plan, stage, &lit, exposure, joining)?),
        }
    }

    /// The light that one source sends to the pixels of the frame, on the CPU, before any effect; `None` where none of it reaches the frame.
    pub fn stamp(&self, stars: &[PlacedStar], planes: &[PlaneLight<'_>]) -> Result<Option<Stamp>, ImagingError> {
        let lit = self.plan.light(&FrameExposure { stars, sky_e: &[], exposure_s: 0.0, frame_index: 0, temperature_c: None }, planes)?;
        Ok(stamp::stamp(&self.plan, lit))
    }
}
