//! Frames → pixel statistics: what the sky between the stars tells of the detector.
//!
//! One pass over all pixels of all frames, made when the frames are measured. `sky_pixels` takes the stars and the local level out, and the rest
//! of every pixel serves all others: `photon_transfer` (gain), `lines` (banding, columns of two amplifiers, halves), `fixed_pattern` (unequal pixels,
//! hot, dead and jumping ones), `neighbours` (correlated noise), `events` (cosmic rays), `sky_mesh` (glow, stray light). Frames are independent; a few of
//! them, spread over the recording, are kept whole in eight bits for the comparison from frame to frame, so that memory does not grow with their
//! number. What lies beyond a stop in the field is no sky: `field_stop` looks for one in a few frames before that pass.
//! `star_images` sums the stars themselves; `elsewhere` is what they leave at other places: copies (`partner_places`) and `halos`.

mod code_widths;
mod codes;
mod compression;
mod compression_combs;
mod elsewhere;
mod events;
mod field_stop;
mod fixed_pattern;
mod halos;
mod joined_transfer;
mod line_pairs;
mod line_sums;
mod lines;
mod mosaic;
mod neighbours;
mod partner_places;
mod photon_transfer;
mod pixel_means;
mod ray_candidates;
mod sky_frame;
mod sky_mesh;
#[cfg(test)]
mod sky_mesh_tests;
mod sky_pixels;
mod star_chains;
mod star_images;
mod star_neighbours;
mod star_transfer;
mod stop_fit;
mod streak_way;
mod streaks;
#[cfg(test)]
mod test_random;
#[cfg(test)]
mod tests;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use code_widths::{CodeWidths, MissingCodes};
pub use codes::{CodeHistogram, CodeStatistics, EndPile};
pub use compression::{BlockDct, CompressionStatistics};
pub use compression_combs::CoefficientComb;
pub(crate) use elsewhere::ElsewhereFrame;
pub use events::CosmicRays;
pub(crate) use events::{MIN_RAY_FRAMES, MIN_STAR_SIGMA_PX};
pub use field_stop::StopCircle;
pub(crate) use field_stop::{MIN_STOP_FRAMES, StopFrame};
pub use fixed_pattern::{FixedPattern, PatternPair};
pub(crate) use halos::{FrameHalo, HALO_CONTROLS, HALO_RADII_PX, halo_share};
pub(crate) use line_pairs::LinePair;
pub(crate) use lines::KEPT_BY_PLANE;
pub use lines::{Estimate, FrameNoise, LineStatistics};
pub use neighbours::NeighbourCorrelation;
pub(crate) use partner_places::{CONTROLS, CopiesFrame, FoundStar, LOOKS, Partner, PartnerSum};
pub use photon_transfer::{PhotonTransfer, TransferPoint};
pub use pixel_means::{LineMeans, PixelHistogram, PixelMeans};
pub use sky_frame::{SkyFrame, StarDisc};
pub use sky_mesh::{SkyCell, SkyMesh};
pub use star_images::{ImageFrame, SplitVariance, SummedImage};
pub use star_transfer::StarTransfer;
pub(crate) use streaks::MIN_STREAK_FRAMES;
pub use streaks::{Streak, Streaks};

use crate::frame::Frame;
use crate::statistics::median;
use events::RayConditions;
use fixed_pattern::{BRIGHT_STARS, PatternFrame};
use lines::FrameLines;
use ray_candidates::{Deviations, RayFrame};
use sky_frame::sky_mask;
use sky_mesh::MeshFrame;
use sky_pixels::SkyPixels;
use streaks::StreakFrame;

/// Frames that are compared pixel by pixel, at most, and the bytes that they may take together.
const MAX_PATTERN_FRAMES: usize = 32;
const MAX_PATTERN_BYTES: usize = 256 << 20;
/// A sky that is fewer standard deviations above the count 0, and never below it, has lost a hundredth of its noise.
const MIN_LEVEL_SIGMAS: f64 = 2.3;
/// A pattern is there beyond so many standard errors.
const CLEARLY: f64 = 5.0;

/// What one frame tells.
#[derive(Clone, Debug)]
pub struct FrameStatistics {
    noise: FrameNoise,
    points: Vec<TransferPoint>,
    lines: FrameLines,
    neighbours: Option<NeighbourCorrelation>,
    mesh: Option<SkyMesh>,
    compared: Option<PatternFrame>,
    rays: RayFrame,
    streaks: StreakFrame,
    /// Whether the noise is cut off at the count 0.
    is_clipped: bool,
}

/// Whether a frame is one of those that are compared pixel by pixel: as many as memory allows, spread evenly.
#[must_use]
pub fn is_compared(number: usize, frames: usize, pixels: usize) -> bool {
    let most = (MAX_PATTERN_BYTES / pixels.max(1)).min(MAX_PATTERN_FRAMES);
    // Of the frames k·frames/most, whole parts.
    frames <= most || (most > 0 && (number * most).div_ceil(frames) < ((number + 1) * most).div_ceil(frames))
}

impl FrameStatistics {
    /// Of a frame; nothing where hardly any sky is seen.
    #[must_use]
    pub fn of(sky_frame: &SkyFrame<'_>) -> Option<Self> {
        let sky = SkyPixels::new(sky_frame.frame, &sky_mask(sky_frame));
        if sky.blocks.is_empty() {
            return None;
        }
        let mut lines = FrameLines::new(&sky);
        let levels: Vec<f64> = sky.blocks.iter().map(|block| block.level_dn).collect();
        let noise = FrameNoise {
            frame: sky_frame.number,
            exposure_s: sky_frame.exposure_s,
            level_dn: median(&levels)?,
            sigma_dn: sky.sigma_dn()?,
            row_variance_dn2: lines.rows,
            column_variance_dn2: lines.columns,
            parity_dn: lines.parity,
            middle_step_dn: lines.step,
        };
        let bright = sky_frame.stars.iter().take(BRIGHT_STARS).map(|star| [star.x_px as f32, star.y_px as f32]).collect();
        let compared =
            sky_frame.is_compared.then(|| PatternFrame::new(sky_frame.number, &sky, &lines, sky_frame.exposure_s, bright)).flatten();
        let is_clipped = noise.level_dn < MIN_LEVEL_SIGMAS * noise.sigma_dn && sky_frame.lowest_read_dn >= 0.0;
        // What is left of clipped noise grows with the level, whatever the gain.
        let points = if is_clipped { Vec::new() } else { photon_transfer::points(sky_frame.number, &sky.blocks, sky.shape) };
        let neighbours = NeighbourCorrelation::of_frame(&sky, &lines);
        let mesh_frame = MeshFrame {
            number: sky_frame.number,
            exposure_s: sky_frame.exposure_s,
            size_px: [sky.width_px, sky.height_px],
            noise_dn: noise.sigma_dn,
        };
        let mesh = SkyMesh::of(&mesh_frame, &sky.blocks, sky.shape).map(|mesh| mesh.with_lines([lines.rows, lines.columns]));
        let deviations = Deviations::of(sky_frame, &sky);
        let rays = RayFrame::of(sky_frame, &sky, &deviations);
        let streaks = StreakFrame::of(sky_frame, &sky, &deviations);
        if compared.is_none() {
            (lines.row_means, lines.column_means) = (Vec::new(), Vec::new());
            (lines.row_halves, lines.column_halves) = (Vec::new(), Vec::new());
        }
        Some(Self { noise, points, lines, neighbours, mesh, compared, rays, streaks, is_clipped })
    }
}

/// Histograms of the counts of all frames: of whole numbers, so that the order in which frames come makes no difference.
#[derive(Clone, Debug)]
pub struct CountStatistics {
    codes: CodeHistogram,
    blocks: BlockDct,
}

impl CountStatistics {
    /// For counts that come in steps of `unit_dn`.
    #[must_use]
    pub fn new(unit_dn: f64) -> Self {
        Self { codes: CodeHistogram::new(), blocks: BlockDct::new(unit_dn) }
    }

    /// With a frame as it was read; `bad` pixels say nothing.
    pub fn add(&mut self, frame: &Frame, bad: Option<&[bool]>) {
        let is_used = |index: usize| bad.is_none_or(|bad| !bad[index]);
        let is_below_full = |index: usize| is_used(index) && frame.pixels_dn[index] < frame.saturation_dn;
        let apart = if mosaic::is_mosaic(&frame.pixels_dn, frame.width_px, is_below_full) { 2 } else { 1 };
        self.codes.add_frame_by(apart, &frame.pixels_dn, is_used);
        self.blocks.add_frame(&frame.pixels_dn, frame.width_px, frame.height_px, is_below_full);
    }

    /// With those of other frames.
    pub fn merge(&mut self, other: &Self) {
        self.codes.merge(&other.codes);
        self.blocks.merge(&other.blocks);
    }

    /// Step of the counts of a frame, 1 where it is not told.
    #[must_use]
    pub fn step_dn(frame: &Frame) -> f64 {
        let mut codes = CodeHistogram::new();
        codes.add_frame(&frame.pixels_dn, |_| true);
        codes.statistics(1.0).step_dn.map_or(1.0, f64::from)
    }
}

/// What is known of the camera beforehand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnownCamera {
    /// The count of no light.
    pub bias_dn: Option<f64>,
    /// Electrons per count.
    pub gain_e_per_dn: Option<f64>,
    /// Width (Gaussian σ) of the narrowest star images.
    pub narrowest_star_px: Option<f64>,
}

/// What the pixels of a recording tell of its detector.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PixelStatistics {
    /// The frames that took part.
    pub by_frame: Vec<FrameNoise>,
    /// Level of their sky over the frame.
    #[serde(default)]
    pub sky: Vec<SkyMesh>,
    /// Variance against level.
    pub photon_transfer: Option<PhotonTransfer>,
    /// The points that the line goes through.
    pub transfer_points: Vec<TransferPoint>,
    /// Rows, columns and halves.
    pub lines: LineStatistics,
    /// Correlation between neighbours.
    pub neighbours: Option<NeighbourCorrelation>,
    /// What stays with the pixels.
    pub fixed_pattern: FixedPattern,
    /// Cosmic rays; nothing where star images are as sharp as they, or frames too few.
    pub cosmic_rays: Option<CosmicRays>,
    /// Straight lines of light in one frame alone; nothing where the stars themselves are drawn out.
    #[serde(default)]
    pub streaks: Option<Streaks>,
    /// A round end of the field.
    #[serde(default)]
    pub field_stop: Option<StopCircle>,
    /// What the converter did to the counts.
    pub codes: Option<CodeStatistics>,
    /// Traces of a compression in blocks.
    pub compression: Option<CompressionStatistics>,
    /// What bright stars leave at other places.
    #[serde(skip)]
    pub(crate) elsewhere: Vec<ElsewhereFrame>,
    /// Whether the noise of most frames is cut off at the count 0.
    #[serde(skip)]
    pub(crate) is_clipped: bool,
    /// Rows and columns of frames of different pointings, frame against frame.
    #[serde(skip)]
    pub(crate) line_pairs: Vec<LinePair>,
    /// Whether frames were left out of [`Self::by_frame`] later, and an exposure was not known among all.
    #[serde(skip)]
    pub(crate) is_untimed: bool,
    /// Means of rows, columns and pixels, for pictures.
    #[serde(skip)]
    pub means: PixelMeans,
}

fn are_timed(frames: &[FrameNoise]) -> bool {
    frames.iter().all(|frame| frame.exposure_s.is_some())
}

impl PixelStatistics {
    /// Why the variance of the pixels is not as light and reading made it, where that is so: it tells no gain then.
    pub(crate) fn altered_noise(&self) -> Option<&'static str> {
        if self.compression.as_ref().is_some_and(CompressionStatistics::is_told) {
            return Some("the frames are compressed, which takes noise away");
        }
        if self.is_clipped {
            return Some("the sky is so dark that its noise is cut off at the count 0");
        }
        let is_shared = self.neighbours.as_ref().is_some_and(NeighbourCorrelation::is_of_processing);
        is_shared.then_some("neighbouring pixels share their noise, as in frames that were demosaicked, smoothed or resampled")
    }

    /// Whether the exposures of all frames of the recording are known.
    pub(crate) fn are_timed(&self) -> bool {
        !self.is_untimed && are_timed(&self.by_frame)
    }

    /// Of all frames, in their order.
    #[must_use]
    pub fn of(frames: Vec<FrameStatistics>, counts: Option<CountStatistics>, known: &KnownCamera) -> Self {
        let mut codes = counts.as_ref().map(|counts| counts.codes.statistics(1.0));
        let step_dn = codes.as_ref().and_then(|codes| codes.step_dn).map_or(0.0, f64::from);
        let compression = counts.map(|counts| counts.blocks.statistics(step_dn));
        let by_frame: Vec<FrameNoise> = frames.iter().map(|frame| frame.noise).collect();
        let are_timed = are_timed(&by_frame);
        let points: Vec<TransferPoint> = frames.iter().flat_map(|frame| frame.points.iter().copied()).collect();
        let photon_transfer = PhotonTransfer::fitted(&points, step_dn);
        let neighbours = NeighbourCorrelation::pooled(&frames.iter().filter_map(|frame| frame.neighbours).collect::<Vec<_>>());
        let sky = frames.iter().filter_map(|frame| frame.mesh.clone()).collect();
        let mut lines = Vec::with_capacity(frames.len());
        let is_clipped = 2 * frames.iter().filter(|frame| frame.is_clipped).count() > frames.len();
        let (mut patterns, mut rays) = (Vec::new(), Vec::with_capacity(frames.len()));
        let mut of_streaks = Vec::with_capacity(frames.len());
        let compared = frames.iter().filter_map(|frame| Some((frame.compared.as_ref()?, &frame.lines))).collect();
        let line_pairs = line_pairs::line_pairs(compared);
        for frame in frames {
            lines.push(frame.lines);
            patterns.extend(frame.compared);
            rays.push(frame.rays);
            of_streaks.push(frame.streaks);
        }
        // Pixels are compared with themselves: frames of another size than the first are left out.
        let size_px = patterns.first().map(PatternFrame::size_px);
        patterns.retain(|own| Some(own.size_px()) == size_px);
        let gain_e_per_dn = known.gain_e_per_dn.or_else(|| photon_transfer.as_ref()?.gain_e_per_dn);
        let of_rays = |sigma_px| events::cosmic_rays(&rays, &patterns, &RayConditions { sigma_px, gain_e_per_dn });
        let cosmic_rays = known.narrowest_star_px.and_then(of_rays);
        let fixed_pattern = FixedPattern::of(&patterns, known.bias_dn, are_timed);
        if let Some(share) = fixed_pattern.share.filter(|share| share.deviation() > CLEARLY) {
            codes = codes.map(|codes| codes.beside_pattern(share.value));
        }
        let all = Self {
            by_frame,
            sky,
            photon_transfer,
            transfer_points: points,
            lines: LineStatistics::of(&lines),
            neighbours,
            fixed_pattern,
            means: PixelMeans::of(&lines, &patterns),
            cosmic_rays,
            streaks: streaks::streaks(&of_streaks),
            field_stop: None,
            codes,
            compression,
            elsewhere: Vec::new(),
            is_clipped,
            line_pairs,
            is_untimed: false,
        };
        if all.altered_noise().is_none() {
            return all;
        }
        Self { photon_transfer: all.photon_transfer.clone().map(PhotonTransfer::without_gain), ..all }
    }
}
