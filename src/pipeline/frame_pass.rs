//! One walk over the frames of a recording: each is read, its stars found and measured, its sky summed up.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use super::measure::{Centroid, MeasureOptions};
use super::pixels::{Counts, StoppedField, frame_statistics, star_images};
use super::{MeasuredFrame, PipelineError};
use crate::detect::{Aids, DetectOptions, Detection, Detections, EmpiricalPsf, PsfStar, detect_aided, detect_windowed};
use crate::frame::MaskedFrame;
use crate::parallel;
use crate::pixel_statistics::FrameStatistics;
use crate::recording::{Recording, RecordingError, SkippedFrame};
use crate::statistics::order::sort_by;

/// Frames with fewer stars are looked at a second time.
const FEW: usize = 30;
/// A frame as measured, or why it is left out.
pub(super) type OneMeasured = Result<MeasuredOne, SkippedFrame>;

/// A frame as measured, with the stars kept.
pub(super) struct MeasuredOne {
    pub(super) frame: MeasuredFrame,
    pub(super) kept: Vec<PsfStar>,
    /// What its sky tells, where that is asked for.
    pub(super) statistics: Option<FrameStatistics>,
    /// Pixels without a value.
    pub(super) undefined: usize,
    /// Whether more looks like stars than was measured.
    pub(super) is_unfinished: bool,
}

/// One walk over all frames.
pub(super) struct Pass<'a, L> {
    pub(super) recording: &'a Recording,
    pub(super) load: &'a L,
    pub(super) options: &'a MeasureOptions,
    /// Where the histograms of the counts are gathered, where they are asked for.
    pub(super) counts: Option<&'a Counts>,
    /// The end of the field, beyond which no pixel says anything of the sky.
    pub(super) stop: Option<&'a StoppedField>,
    pub(super) psf: Option<&'a EmpiricalPsf>,
    /// Stars of a frame whose pixels are kept for the image that is used in measuring.
    pub(super) keep: usize,
    /// The same of all frames, for the image at the places of the sky.
    pub(super) keep_for_sky: usize,
}

impl<L> Pass<'_, L> {
    /// Stars of a frame that are kept for the image at the places of the sky: of so many frames that a few of each are enough, every so many-th is asked.
    fn kept_for_sky(&self, index: usize) -> usize {
        /// Fewer stars of a frame do not tell its attitude's own share of the places.
        const MIN_STARS: usize = 12;
        let frames = self.recording.frames.len().max(1);
        let stride = (frames * MIN_STARS).div_ceil(self.keep_for_sky.max(1)).max(1);
        if index.is_multiple_of(stride) { (self.keep_for_sky * stride).div_ceil(frames) } else { 0 }
    }
}

impl<L> Pass<'_, L>
where
    L: Fn(&Recording, usize) -> Result<Result<MaskedFrame, SkippedFrame>, RecordingError> + Sync,
{
    pub(super) fn all(&self, done: &(impl Fn() + Sync)) -> Result<Vec<OneMeasured>, PipelineError> {
        parallel::try_map_numbers(self.recording.frames.len(), |index| self.one(index, done))
    }

    fn one(&self, index: usize, done: &(impl Fn() + Sync)) -> Result<OneMeasured, PipelineError> {
        let start = Instant::now();
        let name = self.recording.frame_name(index);
        let masked = match (self.load)(self.recording, index)? {
            Ok(frame) => frame,
            Err(skipped) => return Ok(Err(skipped)),
        };
        let undefined = masked.count_undefined();
        let MaskedFrame { mut frame, undefined: mut bad } = masked;
        frame.lower_saturation_to_step();
        if let Some(counts) = self.counts {
            // As read: what a dark takes off is no code.
            let first = || (self.load)(self.recording, 0).ok()?.ok().map(|first| first.frame);
            counts.add(&frame, StoppedField::unusable(self.stop, &frame, bad.as_deref()).as_deref(), first);
        }
        let lowest_read_dn = frame.lowest_dn();
        let failed = |source| PipelineError::Detect { frame: name.clone(), source };
        if let Some(dark) = &self.options.dark {
            dark.subtract(&mut frame).map_err(|source| PipelineError::Dark { frame: name.clone(), source })?;
        }
        let camera = &self.recording.camera;
        let options = DetectOptions {
            gain_e_per_dn: camera.gain_e_per_dn,
            read_noise_e: camera.read_noise_e,
            detection_threshold: self.options.detection_threshold,
            ..DetectOptions::default()
        };
        let deadline = self.options.time_limit.and_then(|limit| start.checked_add(limit / 2));
        if let Some(dark) = &self.options.dark {
            match &mut bad {
                Some(bad) => bad.iter_mut().zip(dark.hot()).for_each(|(bad, hot)| *bad |= hot),
                None => bad = Some(dark.hot().to_vec()),
            }
        }
        let bad = bad.as_deref();
        let is_unfinished = AtomicBool::new(false);
        let for_sky = self.kept_for_sky(index);
        let (detections, kept) = match self.options.centroid {
            Centroid::Windowed => {
                // A window keeps no fits: the stars that show the image are fitted for it.
                let aids = Aids { bad, keep: for_sky, deadline, ..Aids::default() };
                let kept = if for_sky > 0 { detect_aided(&frame, &options, &aids).map_err(&failed)?.1 } else { Vec::new() };
                (detect_windowed(&frame, &options, bad).map_err(failed)?, kept)
            }
            Centroid::Gaussian | Centroid::Empirical => {
                let keep = self.keep.max(for_sky);
                let aids = Aids { psf: self.psf, bad, keep, deadline, is_unfinished: Some(&is_unfinished) };
                let (mut detections, kept) = detect_aided(&frame, &options, &aids).map_err(failed)?;
                // Where there are few a second look costs little, and sees some that the first does not.
                if detections.stars.len() < FEW {
                    add_missing(&mut detections, detect_windowed(&frame, &options, bad).map_err(failed)?);
                }
                (detections, kept)
            }
        };
        let unusable = StoppedField::unusable(self.stop, &frame, bad);
        let unusable = unusable.as_deref();
        let statistics =
            self.options.pixels.then(|| frame_statistics(self.recording, (index, &frame, lowest_read_dn), &detections, unusable)).flatten();
        let images = if self.options.pixels { star_images(&frame, &detections, unusable) } else { Vec::new() };
        done();
        let own = kept.iter().take(for_sky).cloned().collect();
        let frame = MeasuredFrame { index, name, detections, images, kept: own, seconds: start.elapsed().as_secs_f64() };
        Ok(Ok(MeasuredOne { frame, kept, statistics, undefined, is_unfinished: is_unfinished.into_inner() }))
    }
}

/// Adds to the stars of a frame those that the quick way finds and that are not there yet, if they stand out of the noise as clearly.
fn add_missing(detections: &mut Detections, quick: Detections) {
    /// Nearer than this they are the same, px.
    const SAME_PX: f64 = 3.0;
    /// Of maxima of noise one in a million is so bright.
    const CLEARLY: f64 = 5.0;
    /// A picture in which it finds so many is one of something else, and so is what fits so badly as no star does.
    const MAX_STARS: usize = 100;
    const MAX_CHI2: f64 = 4.0;
    if quick.stars.len() > MAX_STARS {
        return;
    }
    let noise = (quick.noise_dn / detections.noise_dn).min(1.0);
    let is_missing = |star: &Detection| {
        let near = |other: &Detection| (other.x_px - star.x_px).hypot(other.y_px - star.y_px) < SAME_PX;
        star.snr() * noise > CLEARLY && star.chi2_per_dof < MAX_CHI2 && !detections.stars.iter().any(near)
    };
    let missing: Vec<Detection> = quick.stars.into_iter().filter(|star| is_missing(star)).collect();
    detections.stars.extend(missing);
    sort_by(&mut detections.stars, |a, b| b.flux_dn.total_cmp(&a.flux_dn).then(a.y_px.total_cmp(&b.y_px)).then(a.x_px.total_cmp(&b.x_px)));
}
