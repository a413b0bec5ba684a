//! Measurement of a recording's frames, and what becomes of them together: the image learnt from all, the sky between the stars.

use std::time::{Duration, Instant};

use super::dark::{Dark, drop_fixed};
use super::elsewhere::elsewhere;
use super::frame_pass::{MeasuredOne, Pass};
use super::pixels::{Counts, StoppedField, pixel_statistics};
use super::{Measured, MeasuredFrame, PipelineError, star_list};
use crate::detect::{PsfReport, PsfStar, learn};
use crate::frame::MaskedFrame;
use crate::recording::{Recording, RecordingError, SkippedFrame};

/// How the frames of a recording are measured.
#[derive(Clone, Debug, Default)]
pub struct MeasureOptions {
    /// What is taken for a star's place.
    pub centroid: Centroid,
    /// What the camera shows in the dark.
    pub dark: Option<Dark>,
    /// The signal-to-noise ratio from which on a maximum counts as a star; `None`: as few false ones as stated.
    pub detection_threshold: Option<f64>,
    /// What measuring and identifying a frame may take together; measuring comes to an end at half of it.
    pub time_limit: Option<Duration>,
    /// Whether the pixels between the stars are looked at too.
    pub pixels: bool,
    /// Whether the pixels of some stars are kept, so that the image of a star can be learnt at the places that the sky predicts; with `pixels` they are.
    pub keeps_stars: bool,
    /// Whether a list's stars are let go as they are measured, where nobody takes identifications from them: of very many frames they are half of the memory.
    pub lets_lists_go: bool,
}

/// What is taken for a star's place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Centroid {
    /// Maximum likelihood under a Gaussian integrated over the pixels.
    #[default]
    Gaussian,
    /// The same under the image that the recording's own stars show, where held-out stars prefer it.
    Empirical,
    /// Moments in a Gaussian window: quick.
    Windowed,
}

/// Finds and measures the stars of every frame; `done` is called after each.
pub fn measure(recording: Recording, options: &MeasureOptions, done: impl Fn() + Sync) -> Result<Measured, PipelineError> {
    measure_frames(recording, Recording::load_frame_or_skip, options, done)
}

/// The same for frames whose pixels come from elsewhere: `load` gives those of an index, or says why they are to be left out.
pub fn measure_frames<F: Into<MaskedFrame>>(
    mut recording: Recording,
    load: impl Fn(&Recording, usize) -> Result<Result<F, SkippedFrame>, RecordingError> + Sync,
    options: &MeasureOptions,
    done: impl Fn() + Sync,
) -> Result<Measured, PipelineError> {
    /// Stars of a frame that the image is learnt from, at most, and of all frames for the image at the places of the sky, about.
    const KEPT: usize = 300;
    const KEPT_IN_ALL: usize = 1500;
    if recording.stars.is_some() {
        return measured_lists(recording, options, done);
    }
    let learns = options.centroid == Centroid::Empirical;
    let load = |recording: &Recording, index| load(recording, index).map(|loaded| loaded.map(Into::into));
    let counts = Counts::default();
    let stop = options.pixels.then(|| StoppedField::of(&recording, |index| Some(load(&recording, index).ok()?.ok()?.frame))).flatten();
    let pass = Pass {
        recording: &recording,
        load: &load,
        options,
        counts: options.pixels.then_some(&counts),
        stop: stop.as_ref(),
        psf: None,
        keep: if learns { KEPT } else { 0 },
        keep_for_sky: if options.pixels || options.keeps_stars { KEPT_IN_ALL } else { 0 },
    };
    let mut measured = pass.all(&done)?;
    let (mut psf, mut own_image) = (None, None);
    if learns {
        let kept: Vec<PsfStar> = measured.iter_mut().flatten().flat_map(|one| std::mem::take(&mut one.kept)).collect();
        let (found, report) = learn(&kept);
        if let Some(found) = &found {
            measured = Pass { psf: Some(found), keep: 0, counts: None, ..pass }.all(&|| ())?;
        }
        psf = Some(report);
        own_image = found;
    }
    recording.notes.extend(psf.as_ref().map(PsfReport::sentence));
    let mut skipped = recording.skipped.clone();
    let mut frames = Vec::new();
    let mut undefined = Undefined::default();
    let mut unfinished = Vec::new();
    let mut statistics = Vec::new();
    for result in measured {
        match result {
            Ok(one) => {
                undefined.add(&one);
                unfinished.extend(one.is_unfinished.then(|| one.frame.name.clone()));
                frames.push(one.frame);
                statistics.extend(one.statistics);
            }
            Err(frame) => skipped.push(frame),
        }
    }
    for sentence in [undefined.sentence(), unfinished_sentence(&unfinished, options)].into_iter().flatten() {
        tracing::warn!("{sentence}");
        recording.notes.push(sentence);
    }
    if frames.is_empty() {
        let reason = skipped.first().map_or_else(|| "there is none".to_owned(), |frame| frame.reason.clone());
        return Err(PipelineError::NoFrames { skipped: skipped.len(), reason });
    }
    for frame in &skipped {
        tracing::warn!("skipped {}: {}", frame.file, frame.reason);
    }
    recording.notes.extend(drop_fixed(&mut frames));
    let mut pixels = pixel_statistics(&recording, &frames, statistics, counts.take(), stop.as_ref());
    if let Some(pixels) = &mut pixels {
        pixels.elsewhere = elsewhere(&frames, options.dark.as_ref(), |index| load(&recording, index).ok()?.ok());
    }
    Ok(Measured { recording, frames, skipped, psf, centroid: options.centroid, own_image, pixels, star_noise: None })
}

/// A list's stars in the place of measured ones.
fn measured_lists(mut recording: Recording, options: &MeasureOptions, done: impl Fn()) -> Result<Measured, PipelineError> {
    let mut lists = recording.stars.take().unwrap_or_default();
    let mut frames = Vec::with_capacity(lists.frames.len());
    for (index, stars) in lists.frames.iter_mut().enumerate().take(recording.frames.len()) {
        let start = Instant::now();
        let detections = star_list::detections(&recording, stars);
        if options.lets_lists_go {
            *stars = Vec::new();
        }
        let (name, seconds) = (recording.frame_name(index), start.elapsed().as_secs_f64());
        frames.push(MeasuredFrame { index, name, detections, images: Vec::new(), kept: Vec::new(), seconds });
        done();
    }
    recording.stars = Some(lists);
    let skipped = recording.skipped.clone();
    for frame in &skipped {
        tracing::warn!("skipped {}: {}", frame.file, frame.reason);
    }
    if frames.is_empty() {
        let reason = skipped.first().map_or_else(|| "there is none".to_owned(), |frame| frame.reason.clone());
        return Err(PipelineError::NoFrames { skipped: skipped.len(), reason });
    }
    Ok(Measured { recording, frames, skipped, psf: None, centroid: options.centroid, own_image: None, pixels: None, star_noise: None })
}

/// Pixels without a value in all frames.
#[derive(Default)]
struct Undefined {
    pixels: usize,
    frames: usize,
    /// The frame with most of them.
    most: Option<(usize, String)>,
}

impl Undefined {
    fn add(&mut self, one: &MeasuredOne) {
        if one.undefined > 0 {
            self.pixels += one.undefined;
            self.frames += 1;
            if self.most.as_ref().is_none_or(|(most, _)| one.undefined > *most) {
                self.most = Some((one.undefined, one.frame.name.clone()));
            }
        }
    }

    fn sentence(&self) -> Option<String> {
        let (most, name) = self.most.as_ref()?;
        let Self { pixels, frames, .. } = self;
        let of = if *frames == 1 { name.clone() } else { format!("{frames} frames (most of them, {most}, of {name})") };
        Some(format!("{pixels} pixels of {of} have no value (NaN, infinite or BLANK) and take no part"))
    }
}

/// What is said of frames in which more looks like stars than was measured.
fn unfinished_sentence(names: &[String], options: &MeasureOptions) -> Option<String> {
    let first = names.first()?;
    let of = if names.len() == 1 { first.clone() } else { format!("{} frames (the first is {first})", names.len()) };
    let limit = if options.time_limit.is_some() { "the work or the time" } else { "the work" };
    Some(format!(
        "{of}: more looks like stars than {limit} allowed to one frame can measure, so some are missing or less well measured; \
         leaves, letters, lamps and clouds do that: crop the frame to the sky"
    ))
}
