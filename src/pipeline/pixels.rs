//! The pass over all pixels that is made while frames are measured: where their stars lie, and what is kept of each frame.

use std::sync::{Mutex, OnceLock, PoisonError};

use super::MeasuredFrame;
use crate::detect::{Detection, Detections};
use crate::frame::Frame;
use crate::pixel_statistics::{
    CountStatistics, FrameStatistics, ImageFrame, KnownCamera, PixelStatistics, SkyFrame, StarDisc, SummedImage, is_compared,
};
use crate::recording::Recording;
use crate::statistics::median_in_place;

/// A star's light is left out to where its Gaussian falls to this share of the noise,
const DIMMEST_SHARE: f64 = 0.1;
/// times this, for real images have wings, and so many px more.
const WINGS: f64 = 1.6;
const WINGS_PX: f64 = 2.0;
/// Of a full star the Gaussian tells little: its disc is so many times larger.
const FULL: f64 = 2.0;
/// No disc is larger than this share of the frame's smaller side.
const LARGEST_SHARE: f64 = 0.25;

/// Of a frame as read and its stars. `frames`: how many the recording has.
pub(super) fn frame_statistics(
    recording: &Recording,
    (index, frame): (usize, &Frame),
    detections: &Detections,
    bad: Option<&[bool]>,
) -> Option<FrameStatistics> {
    let stars = discs(detections);
    FrameStatistics::of(&SkyFrame {
        number: index,
        frame,
        stars: &stars,
        bad,
        exposure_s: recording.frames[index].exposure_s,
        is_compared: is_compared(index, recording.frames.len(), frame.pixels_dn.len()),
    })
}

/// Light and shape of a frame's star images by sums, under a weight of their typical width.
pub(super) fn star_images(frame: &Frame, detections: &Detections, bad: Option<&[bool]>) -> Vec<SummedImage> {
    let is_clean = |star: &&Detection| !star.flags.saturated && !star.flags.edge && !star.flags.blended && star.width_px > 0.0;
    let mut widths: Vec<f64> = detections.stars.iter().filter(is_clean).map(|star| star.width_px).collect();
    let Some(sigma_px) = median_in_place(&mut widths) else { return Vec::new() };
    let stars = discs(detections);
    let frame = ImageFrame { frame, stars: &stars, bad, sigma_px, noise_dn: detections.noise_dn };
    frame.star_images().into_iter().flatten().collect()
}

/// Of all frames measured.
pub(super) fn pixel_statistics(
    recording: &Recording,
    frames: &[MeasuredFrame],
    all: Vec<FrameStatistics>,
    counts: Option<CountStatistics>,
) -> Option<PixelStatistics> {
    let mut widths: Vec<f64> = frames
        .iter()
        .flat_map(|frame| &frame.detections.stars)
        .filter(|star| !star.flags.saturated && !star.flags.edge && !star.flags.blended && star.width_px > 0.0)
        .map(|star| star.width_px)
        .collect();
    let known = KnownCamera { bias_dn: recording.camera.bias_dn, psf_sigma_px: median_in_place(&mut widths) };
    (!all.is_empty()).then(|| PixelStatistics::of(all, counts, &known))
}

/// Discs that hold the light of a frame's stars.
fn discs(detections: &Detections) -> Vec<StarDisc> {
    let largest_px = LARGEST_SHARE * detections.width_px.min(detections.height_px) as f64;
    let disc = |star: &Detection| {
        let sigma = star.width_px.max(0.5);
        let peak_dn = star.flux_dn / (std::f64::consts::TAU * sigma * sigma);
        let ratio = peak_dn / (DIMMEST_SHARE * detections.noise_dn.max(f64::MIN_POSITIVE));
        let reach = sigma * (2.0 * ratio.max(1.0).ln()).sqrt();
        let radius_px = (WINGS * reach + WINGS_PX) * if star.flags.saturated { FULL } else { 1.0 };
        StarDisc { x_px: star.x_px, y_px: star.y_px, radius_px: radius_px.min(largest_px) }
    };
    detections.stars.iter().map(disc).collect()
}

/// The histograms of the counts of all frames, as they are filled.
#[derive(Debug, Default)]
pub(super) struct Counts {
    /// Step of the counts of the first frame.
    unit_dn: OnceLock<f64>,
    all: Mutex<Option<CountStatistics>>,
}

impl Counts {
    /// With a frame as it was read. `first` reads the first one.
    pub(super) fn add(&self, frame: &Frame, bad: Option<&[bool]>, first: impl FnOnce() -> Option<Frame>) {
        // Of the first frame whichever comes first: the answer is the same with any number of threads.
        let unit_dn = *self.unit_dn.get_or_init(|| first().map_or(1.0, |first| CountStatistics::step_dn(&first)));
        let mut own = CountStatistics::new(unit_dn);
        own.add(frame, bad);
        let mut all = self.all.lock().unwrap_or_else(PoisonError::into_inner);
        match all.as_mut() {
            Some(all) => all.merge(&own),
            None => *all = Some(own),
        }
    }

    /// All of them.
    pub(super) fn take(self) -> Option<CountStatistics> {
        self.all.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}
