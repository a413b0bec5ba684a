//! The way of the data as the verbs walk it: recording → detections → identifications → control points.

use std::time::Instant;

use anyhow::{Context, Result, bail};
use boresight::camera::SkyChain;
use boresight::catalog::Catalog;
use boresight::coordinates::{Apparent, Direction};
use boresight::detect::{DetectOptions, Detections, detect};
use boresight::effects::Observation;
use boresight::identify::{ASSUMED_EPOCH_YR, Identification, IdentifyOptions, Index, Solution, identify};
use boresight::provenance::Provenance;
use boresight::recording::{OpenOptions, Recording, SkippedFrame};
use rayon::prelude::*;

use super::options::{InputArgs, SkyArgs, SkyChoice};
use super::{output, star_list};

/// A recording with its measured frames.
pub(crate) struct Measured {
    /// The recording.
    pub(crate) recording: Recording,
    /// The frames that could be read, in order.
    pub(crate) frames: Vec<MeasuredFrame>,
    /// Those that could not (only with `--keep-going`).
    pub(crate) skipped: Vec<SkippedFrame>,
}

/// A frame whose stars are measured.
pub(crate) struct MeasuredFrame {
    /// Index into the recording's frames.
    pub(crate) index: usize,
    /// Its file, or its number.
    pub(crate) name: String,
    /// Its stars.
    pub(crate) detections: Detections,
    /// How long it took to measure, wall time.
    pub(crate) seconds: f64,
}

/// A frame whose identification was tried.
pub(crate) struct IdentifiedFrame {
    /// The answer.
    pub(crate) identification: Identification,
    /// The physics in force.
    pub(crate) sky: SkyChain,
    /// The direction from which every catalogue star's light arrived.
    pub(crate) directions: Vec<Direction<Apparent>>,
    /// How long it took, measuring included, wall time.
    pub(crate) seconds: f64,
}

impl Measured {
    /// Whether the time of every frame is known.
    pub(crate) fn times_are_known(&self) -> bool {
        self.frames.iter().all(|frame| self.recording.frames[frame.index].time_utc.is_some())
    }

    /// Electrons per DN of a frame's detections: the camera's. Where a list of stars stands in the image's place, `None` unless it tells
    /// the electrons of all of them.
    pub(crate) fn gain_e_per_dn(&self, frame: &MeasuredFrame) -> Option<f64> {
        match self.recording.stars.as_ref().and_then(|list| list.frames.get(frame.index)) {
            Some(stars) => stars.iter().all(|star| star.flux_e.is_some()).then(|| star_list::gain_e_per_dn(&self.recording)),
            None => self.recording.camera.gain_e_per_dn,
        }
    }
}

impl IdentifiedFrame {
    /// The solution, if there is one.
    pub(crate) fn solution(&self) -> Option<&Solution> {
        match &self.identification {
            Identification::Identified(solution) => Some(solution),
            Identification::NotIdentified { .. } => None,
        }
    }
}

/// Opens what is named on the command line.
pub(crate) fn open(input: &InputArgs) -> Result<Recording> {
    let recording = Recording::open_with(&input.inputs, OpenOptions { keep_going: input.keep_going })?;
    for note in &recording.notes {
        tracing::warn!("{note}");
    }
    Ok(recording)
}

/// Provenance of a result that was made of this recording.
pub(crate) fn provenance(recording: &Recording, sky: Option<&SkyArgs>) -> Result<Provenance> {
    let mut provenance = output::provenance();
    for file in recording.input_files() {
        provenance.add_input(&file)?;
    }
    if let Some(path) = sky.and_then(|sky| sky.catalog.as_ref()) {
        provenance.add_input(path)?;
    }
    Ok(provenance)
}

/// Finds and measures the stars of every frame.
pub(crate) fn measure(recording: Recording) -> Result<Measured> {
    let options = DetectOptions {
        gain_e_per_dn: recording.camera.gain_e_per_dn,
        read_noise_e: recording.camera.read_noise_e,
        ..DetectOptions::default()
    };
    let bar = output::progress("measuring", recording.frames.len());
    let results: Vec<Result<Result<MeasuredFrame, SkippedFrame>>> = (0..recording.frames.len())
        .into_par_iter()
        .map(|index| {
            let start = Instant::now();
            let name = recording.frame_name(index);
            if let Some(stars) = recording.stars.as_ref().and_then(|list| list.frames.get(index)) {
                let detections = star_list::detections(&recording, stars);
                return Ok(Ok(MeasuredFrame { index, name, detections, seconds: start.elapsed().as_secs_f64() }));
            }
            let frame = match recording.load_frame_or_skip(index)? {
                Ok(frame) => frame,
                Err(skipped) => return Ok(Err(skipped)),
            };
            let detections = detect(&frame, &options).with_context(|| name.clone())?;
            bar.inc(1);
            Ok(Ok(MeasuredFrame { index, name, detections, seconds: start.elapsed().as_secs_f64() }))
        })
        .collect();
    bar.finish_and_clear();
    let mut skipped = recording.skipped.clone();
    let mut frames = Vec::new();
    for result in results {
        match result? {
            Ok(frame) => frames.push(frame),
            Err(frame) => skipped.push(frame),
        }
    }
    if frames.is_empty() {
        bail!("none of the {} frames can be read: {}", skipped.len(), skipped.first().map_or("there is none", |frame| &frame.reason));
    }
    for frame in &skipped {
        tracing::warn!("skipped {}: {}", frame.file, frame.reason);
    }
    Ok(Measured { recording, frames, skipped })
}

/// What the recording knows of the circumstances of its frames.
pub(crate) fn circumstances(recording: &Recording) -> Result<Vec<Observation>> {
    recording.observations().map_err(|(frame, error)| anyhow::Error::new(error).context(recording.frame_name(frame)))
}

/// Identifies every frame. Frames that resist alone are tried once more with the focal length that the others agree on.
pub(crate) fn identify_frames(
    measured: &Measured,
    catalog: &Catalog,
    physics: &SkyChoice,
    options: &IdentifyOptions,
) -> Result<Vec<IdentifiedFrame>> {
    let index = Index::new(catalog);
    let known = circumstances(&measured.recording)?;
    let bar = output::progress("identifying", measured.frames.len());
    let mut frames = measured
        .frames
        .par_iter()
        .map(|frame| -> Result<IdentifiedFrame> {
            let start = Instant::now();
            let sky = sky_chain(&known, frame, physics)?;
            let directions = sky.apparent_all(catalog);
            let identification = identify(&frame.detections, catalog, &index, &directions, options);
            bar.inc(1);
            Ok(IdentifiedFrame { identification, sky, directions, seconds: frame.seconds + start.elapsed().as_secs_f64() })
        })
        .collect::<Result<Vec<_>>>()?;
    bar.finish_and_clear();
    if measured.recording.common_size().is_ok() {
        retry(measured, catalog, &index, options, &mut frames);
    }
    Ok(frames)
}

/// The frames of a star list whose own identifications are taken: nothing is searched for.
pub(crate) fn take_identifications(measured: &Measured, catalog: &Catalog, physics: &SkyChoice) -> Result<Vec<IdentifiedFrame>> {
    let known = circumstances(&measured.recording)?;
    measured
        .frames
        .iter()
        .map(|frame| {
            let sky = sky_chain(&known, frame, physics)?;
            let identification = Identification::NotIdentified { reason: "The list's own identifications are taken.".to_owned() };
            Ok(IdentifiedFrame { identification, directions: sky.apparent_all(catalog), sky, seconds: frame.seconds })
        })
        .collect()
}

/// The physics in force during a frame.
fn sky_chain(known: &[Observation], frame: &MeasuredFrame, choice: &SkyChoice) -> Result<SkyChain> {
    let mut observation = known[frame.index];
    if observation.epoch_yr.is_none() && choice.assumes_time {
        observation.epoch_yr = Some(ASSUMED_EPOCH_YR);
    }
    SkyChain::new(&choice.physics, observation).with_context(|| frame.name.clone())
}

/// The effects in force in all frames, and a sentence if some act in a part of them only.
pub(crate) fn physics_in_force(frames: &[IdentifiedFrame]) -> (Vec<&'static str>, Option<String>) {
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

/// Tries the frames that were not identified with the median focal length of those that were.
fn retry(measured: &Measured, catalog: &Catalog, index: &Index, options: &IdentifyOptions, frames: &mut [IdentifiedFrame]) {
    let mut lengths: Vec<f64> = frames.iter().filter_map(|frame| Some(frame.solution()?.camera.focal_length_px)).collect();
    if lengths.is_empty() || lengths.len() == frames.len() {
        return;
    }
    lengths.sort_by(f64::total_cmp);
    let options = IdentifyOptions {
        nominal_focal_length_px: Some(lengths[lengths.len() / 2]),
        focal_length_tolerance: 0.01,
        search_beyond_tolerance: false,
        ..options.clone()
    };
    frames.par_iter_mut().zip(&measured.frames).filter(|(frame, _)| frame.solution().is_none()).for_each(|(frame, measured)| {
        let second = identify(&measured.detections, catalog, index, &frame.directions, &options);
        if matches!(second, Identification::Identified(_)) {
            frame.identification = second;
        }
    });
}
