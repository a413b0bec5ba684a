//! Measurement and identification of a recording's frames.

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::dark::{Dark, drop_fixed};
use super::elsewhere::elsewhere;
use super::pixels::{Counts, StoppedField, frame_statistics, pixel_statistics, star_images};
use super::{Measured, MeasuredFrame, PipelineError, SkyChoice, star_list};
use crate::camera::SkyChain;
use crate::catalog::Catalog;
use crate::coordinates::{Apparent, Attitude, Direction};
use crate::detect::{Aids, DetectOptions, Detection, Detections, EmpiricalPsf, PsfReport, PsfStar, detect_aided, detect_windowed, learn};
use crate::effects::Observation;
use crate::frame::MaskedFrame;
use crate::identify::{
    ASSUMED_EPOCH_YR, AttitudePrior, Identification, IdentifyOptions, Index, Projection, Refusal, Solution, common_projection, identify,
};
use crate::pixel_statistics::FrameStatistics;
use crate::recording::{Recording, RecordingError, SkippedFrame};
use crate::statistics::median;
use crate::units::DEG_RAD;

/// How far a camera may have turned from the nearest frame that is identified, where its attitude is taken for a hint.
const TURNED_RAD: f64 = 10.0 * DEG_RAD;

/// Frames with fewer stars are looked at a second time.
const FEW: usize = 30;
/// By so much the focal length of another frame of the same camera may differ: of any, and of one as wide as this (half a side over f).
const SAME: f64 = 0.01;
const SAME_OF_WIDE: f64 = 0.12;
const WIDE: f64 = 0.36;

/// A frame whose identification was tried.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct IdentifiedFrame {
    /// The answer.
    pub identification: Identification,
    /// The physics in force.
    pub sky: SkyChain,
    /// How long it took, measuring included, wall time, s.
    pub seconds: f64,
}

impl IdentifiedFrame {
    /// The direction from which a catalogue star's light arrived. It is not kept: those of all stars in all frames would fill the memory.
    #[must_use]
    pub fn direction(&self, catalog: &Catalog, star: usize) -> Direction<Apparent> {
        self.sky.apparent(&catalog.stars[star], catalog.epoch_yr)
    }

    /// The solution, if there is one.
    #[must_use]
    pub fn solution(&self) -> Option<&Solution> {
        match &self.identification {
            Identification::Identified(solution) => Some(solution),
            Identification::NotIdentified { .. } => None,
        }
    }
}

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
        keep_for_sky: if options.pixels { KEPT_IN_ALL } else { 0 },
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
    Ok(Measured { recording, frames, skipped, psf, centroid: options.centroid, own_image, pixels })
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
    Ok(Measured { recording, frames, skipped, psf: None, centroid: options.centroid, own_image: None, pixels: None })
}

/// A frame as measured, or why it is left out.
type OneMeasured = Result<One, SkippedFrame>;

/// A frame as measured, with the stars kept.
struct One {
    frame: MeasuredFrame,
    kept: Vec<PsfStar>,
    /// What its sky tells, where that is asked for.
    statistics: Option<FrameStatistics>,
    /// Pixels without a value.
    undefined: usize,
    /// Whether more looks like stars than was measured.
    is_unfinished: bool,
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
    fn add(&mut self, one: &One) {
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

/// One walk over all frames.
struct Pass<'a, L> {
    recording: &'a Recording,
    load: &'a L,
    options: &'a MeasureOptions,
    /// Where the histograms of the counts are gathered, where they are asked for.
    counts: Option<&'a Counts>,
    /// The end of the field, beyond which no pixel says anything of the sky.
    stop: Option<&'a StoppedField>,
    psf: Option<&'a EmpiricalPsf>,
    /// Stars of a frame whose pixels are kept for the image that is used in measuring.
    keep: usize,
    /// The same of all frames, for the image at the places of the sky.
    keep_for_sky: usize,
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
    fn all(&self, done: &(impl Fn() + Sync)) -> Result<Vec<OneMeasured>, PipelineError> {
        (0..self.recording.frames.len()).into_par_iter().map(|index| self.one(index, done)).collect()
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
        if let Some(counts) = self.counts {
            // As read: what a dark takes off is no code.
            let first = || (self.load)(self.recording, 0).ok()?.ok().map(|first| first.frame);
            counts.add(&frame, StoppedField::unusable(self.stop, &frame, bad.as_deref()).as_deref(), first);
        }
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
        let statistics = self.options.pixels.then(|| frame_statistics(self.recording, (index, &frame), &detections, unusable)).flatten();
        let images = if self.options.pixels { star_images(&frame, &detections, unusable) } else { Vec::new() };
        done();
        let own = kept.iter().take(for_sky).cloned().collect();
        let frame = MeasuredFrame { index, name, detections, images, kept: own, seconds: start.elapsed().as_secs_f64() };
        Ok(Ok(One { frame, kept, statistics, undefined, is_unfinished: is_unfinished.into_inner() }))
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
    detections.stars.sort_by(|a, b| b.flux_dn.total_cmp(&a.flux_dn).then(a.y_px.total_cmp(&b.y_px)).then(a.x_px.total_cmp(&b.x_px)));
}

/// What the recording knows of the circumstances of its frames.
pub fn circumstances(recording: &Recording) -> Result<Vec<Observation>, PipelineError> {
    recording.observations().map_err(|(frame, source)| PipelineError::Observer { frame: recording.frame_name(frame), source })
}

/// Identifies every frame; `done` is called after each. Frames that resist alone are tried once more with the focal length that the others
/// agree on.
pub fn identify_frames(
    measured: &Measured,
    catalog: &Catalog,
    physics: &SkyChoice,
    options: &IdentifyOptions,
    done: impl Fn() + Sync,
) -> Result<Vec<IdentifiedFrame>, PipelineError> {
    let index = Index::new(catalog);
    if options.time_limit.is_some() {
        index.build(); // on nobody's time
    }
    let known = circumstances(&measured.recording)?;
    let (mut frames, searched): (Vec<IdentifiedFrame>, Vec<Duration>) = measured
        .frames
        .par_iter()
        .map(|frame| -> Result<(IdentifiedFrame, Duration), PipelineError> {
            let start = Instant::now();
            let sky = sky_chain(&known, frame, physics)?;
            let directions = sky.apparent_all(catalog);
            let search = Instant::now();
            let measuring = Duration::try_from_secs_f64(frame.seconds).unwrap_or_default();
            let options = IdentifyOptions { time_spent: measuring, ..options.clone() };
            let identification = identify(&frame.detections, catalog, &index, &directions, &options);
            let searched = measuring + search.elapsed();
            done();
            Ok((IdentifiedFrame { identification, sky, seconds: frame.seconds + start.elapsed().as_secs_f64() }, searched))
        })
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .unzip();
    if measured.recording.common_size().is_ok() {
        retry(measured, catalog, &index, options, &mut frames, &searched);
    }
    Ok(frames)
}

/// The frames of a star list whose own identifications are taken: nothing is searched for.
pub fn take_identifications(measured: &Measured, physics: &SkyChoice) -> Result<Vec<IdentifiedFrame>, PipelineError> {
    let known = circumstances(&measured.recording)?;
    measured
        .frames
        .iter()
        .map(|frame| {
            let sky = sky_chain(&known, frame, physics)?;
            let identification = Identification::NotIdentified { reason: Refusal::Preidentified, hypotheses: 0 };
            Ok(IdentifiedFrame { identification, sky, seconds: frame.seconds })
        })
        .collect()
}

/// The physics in force during a frame.
fn sky_chain(known: &[Observation], frame: &MeasuredFrame, choice: &SkyChoice) -> Result<SkyChain, PipelineError> {
    let mut observation = known[frame.index];
    if observation.epoch_yr.is_none() && choice.assumes_time {
        observation.epoch_yr = Some(ASSUMED_EPOCH_YR);
    }
    SkyChain::new(&choice.physics, observation).map_err(|source| PipelineError::Physics { frame: frame.name.clone(), source })
}

/// The effects in force in all frames, and a sentence if some act in a part of them only.
#[must_use]
pub fn physics_in_force(frames: &[IdentifiedFrame]) -> (Vec<&'static str>, Option<String>) {
    let of = |frame: &IdentifiedFrame| frame.sky.ids();
    let mut all = frames.first().map_or_else(Vec::new, of);
    let mut some = Vec::new();
    for id in frames.iter().flat_map(of) {
        if !some.contains(&id) && !frames.iter().all(|frame| of(frame).contains(&id)) {
            some.push(id);
        }
    }
    all.retain(|id| !some.contains(id));
    let warning = (!some.is_empty()).then(|| {
        format!("{} could be computed for some of the frames only and is applied there alone: give all frames a time", some.join(", "))
    });
    (all, warning)
}

/// Tries the frames that were not identified with the median focal length of those that were: everywhere, then around the attitude of the
/// nearest of them, where fewer hypotheses are to be refuted. Each frame in the time that its first search has left of its limit.
fn retry(
    measured: &Measured,
    catalog: &Catalog,
    index: &Index,
    options: &IdentifyOptions,
    frames: &mut [IdentifiedFrame],
    searched: &[Duration],
) {
    let solved: Vec<(usize, Attitude)> =
        (0..).zip(&*frames).filter_map(|(number, frame)| frame.solution().map(|solution| (number, solution.attitude))).collect();
    if solved.len() == frames.len() {
        return;
    }
    let solutions = || frames.iter().filter_map(IdentifiedFrame::solution);
    let projection = common_projection(solutions().map(|solution| solution.projection));
    let of_most = solutions().filter(|solution| solution.projection == projection);
    let focal_lengths_px: Vec<f64> = of_most.map(|solution| solution.camera.focal_length_px).collect();
    let Some(focal_length_px) = median(&focal_lengths_px) else { return };
    let options = |tolerance: f64| IdentifyOptions {
        projection: Some(projection),
        nominal_focal_length_px: Some(focal_length_px),
        focal_length_tolerance: tolerance,
        search_beyond_tolerance: false,
        ..options.clone()
    };
    // Of a wide field focal length and distortion stand in for each other: another frame of the same camera has another of both.
    let half_px =
        measured.frames.iter().map(|frame| frame.detections.width_px.max(frame.detections.height_px)).max().unwrap_or(0) as f64 / 2.0;
    let is_wide = projection == Projection::Pinhole && half_px > WIDE * focal_length_px;
    let tolerances: &[f64] = if is_wide { &[SAME, SAME_OF_WIDE] } else { &[SAME] };
    let all = frames.par_iter_mut().enumerate().zip(&measured.frames).zip(searched);
    all.filter(|(((_, frame), _), _)| frame.solution().is_none()).for_each(|(((number, frame), measured), searched)| {
        let begin = Instant::now();
        let nearest = solved.iter().min_by_key(|(other, _)| other.abs_diff(number));
        let around = nearest.map(|(_, attitude)| AttitudePrior::attitude(attitude, TURNED_RAD));
        let hypotheses = |identification: &Identification| match identification {
            Identification::Identified(_) => 0,
            Identification::NotIdentified { hypotheses, .. } => *hypotheses,
        };
        let mut hypotheses_before = hypotheses(&frame.identification);
        let directions = frame.sky.apparent_all(catalog);
        // Who says where the camera points is not asked to believe another frame.
        let asked = options(SAME);
        let places = || [asked.near].into_iter().chain(around.filter(|_| asked.near.is_none()).map(Some));
        for (tolerance, near) in tolerances.iter().flat_map(|tolerance| places().map(move |near| (*tolerance, near))) {
            let time_spent = *searched + begin.elapsed();
            if left_of(asked.time_limit, time_spent).is_some_and(|left| left.is_zero()) {
                break;
            }
            let options = IdentifyOptions { hypotheses_before, near, time_spent, ..options(tolerance) };
            let again = identify(&measured.detections, catalog, index, &directions, &options);
            if matches!(again, Identification::Identified(_)) {
                frame.identification = again;
                break;
            }
            hypotheses_before += hypotheses(&again);
        }
        frame.seconds += begin.elapsed().as_secs_f64();
    });
}

/// What is left of a limit, where there is one.
fn left_of(limit: Option<Duration>, spent: Duration) -> Option<Duration> {
    limit.map(|limit| limit.saturating_sub(spent))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_search_has_what_the_first_left() {
        let ms = Duration::from_millis;
        assert_eq!(left_of(None, ms(900)), None);
        assert_eq!(left_of(Some(ms(100)), ms(30)), Some(ms(70)));
        assert_eq!(left_of(Some(ms(100)), ms(100)), Some(ms(0)));
        assert_eq!(left_of(Some(ms(100)), ms(130)), Some(ms(0)));
    }
}
