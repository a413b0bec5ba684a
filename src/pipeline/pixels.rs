//! The pass over all pixels that is made while frames are measured: where their stars lie, and what is kept of each frame.

use std::borrow::Cow;
use std::sync::{Mutex, OnceLock, PoisonError};

use rayon::prelude::*;

use super::MeasuredFrame;
use crate::detect::{Detection, Detections};
use crate::frame::Frame;
use crate::pixel_statistics::{
    CountStatistics, FrameStatistics, ImageFrame, KnownCamera, PixelStatistics, SkyFrame, StarDisc, StopCircle, StopFrame, SummedImage,
    is_compared,
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

/// Widths of fainter stars scatter by their noise.
const BRIGHT_SNR: f64 = 20.0;
/// A tenth of the stars are narrower than the narrowest images.
const NARROWEST_SHARE: f64 = 0.1;

/// The end of a recording's field, and the pixels beyond it.
pub(super) struct StoppedField {
    found: StopCircle,
    unlit: Vec<bool>,
}

impl StoppedField {
    /// From a few frames, which `load` gives by their number: before the others are measured, since what lies beyond says nothing of any of them.
    pub(super) fn of(recording: &Recording, load: impl Fn(usize) -> Option<Frame> + Sync) -> Option<Self> {
        if recording.stars.is_some() {
            return None;
        }
        let numbers = StopCircle::looked_at(recording.frames.len());
        let frames: Vec<StopFrame> =
            numbers.into_par_iter().filter_map(|number| load(number).map(|frame| StopFrame::new(&frame))).collect();
        let found = StopCircle::of(&frames, recording.camera.bias_dn)?;
        Some(Self { unlit: found.unlit(), found })
    }

    /// The pixels of a frame that say nothing: bad ones, and those beyond the end of the field.
    pub(super) fn unusable<'b>(stop: Option<&Self>, frame: &Frame, bad: Option<&'b [bool]>) -> Option<Cow<'b, [bool]>> {
        let own = stop.filter(|stop| stop.found.size_px == [frame.width_px, frame.height_px]);
        match (own, bad) {
            (Some(stop), Some(bad)) => Some(bad.iter().zip(&stop.unlit).map(|(bad, unlit)| *bad || *unlit).collect()),
            (Some(stop), None) => Some(stop.unlit.clone().into()),
            (None, bad) => bad.map(Cow::Borrowed),
        }
    }
}

/// Of a frame and its stars. `lowest_read_dn`: its lowest count before a dark was taken off.
pub(super) fn frame_statistics(
    recording: &Recording,
    (index, frame, lowest_read_dn): (usize, &Frame, f32),
    detections: &Detections,
    bad: Option<&[bool]>,
) -> Option<FrameStatistics> {
    let stars = discs(detections);
    FrameStatistics::of(&SkyFrame {
        number: index,
        lowest_read_dn,
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
    let light = |star: &Detection| [star.flux_dn, if star.flags.saturated { f64::INFINITY } else { star.flux_sigma_dn }];
    let flux_dn: Vec<[f64; 2]> = detections.stars.iter().map(light).collect();
    let frame = ImageFrame { frame, stars: &stars, flux_dn: &flux_dn, bad, sigma_px, noise_dn: detections.noise_dn };
    let images = frame.star_images().into_iter().zip(&detections.stars);
    images.filter(|(_, star)| !star.flags.is_unresolved).filter_map(|(image, _)| image).collect()
}

/// Of all frames measured.
pub(super) fn pixel_statistics(
    recording: &Recording,
    frames: &[MeasuredFrame],
    all: Vec<FrameStatistics>,
    counts: Option<CountStatistics>,
    stop: Option<&StoppedField>,
) -> Option<PixelStatistics> {
    let camera = &recording.camera;
    let known = KnownCamera { bias_dn: camera.bias_dn, gain_e_per_dn: camera.gain_e_per_dn, narrowest_star_px: narrowest_star_px(frames) };
    (!all.is_empty()).then(|| PixelStatistics { field_stop: stop.map(|stop| stop.found), ..PixelStatistics::of(all, counts, &known) })
}

/// Width of the narrowest star images; the bright ones tell it, where there are any.
fn narrowest_star_px(frames: &[MeasuredFrame]) -> Option<f64> {
    const ENOUGH: usize = 10;
    let of = |least_snr: f64| -> Vec<f64> {
        let stars = frames.iter().flat_map(|frame| &frame.detections.stars);
        let is_clean = |star: &&Detection| !star.flags.saturated && !star.flags.edge && !star.flags.blended && star.snr() > least_snr;
        stars.filter(is_clean).map(short_axis_px).filter(|width| *width > 0.0).collect()
    };
    let bright = of(BRIGHT_SNR);
    let mut widths = if bright.len() < ENOUGH { of(0.0) } else { bright };
    widths.sort_by(f64::total_cmp);
    widths.get((NARROWEST_SHARE * widths.len() as f64) as usize).copied()
}

/// Width of a star image where it is narrowest: a trail is so only across.
fn short_axis_px(star: &Detection) -> f64 {
    let Some(moments) = &star.moments else { return star.width_px };
    let [xx, xy, yy] = moments.second_px2;
    let (mean, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let ratio = (mean - half) / (mean + half);
    if ratio > 0.0 && ratio < 1.0 { star.width_px * ratio.powf(0.25) } else { star.width_px }
}

/// Discs that hold the light of a frame's stars.
pub(super) fn discs(detections: &Detections) -> Vec<StarDisc> {
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
