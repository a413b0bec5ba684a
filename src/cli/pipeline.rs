//! Data flow of the verbs, with progress and a report of what was read.

use std::time::Duration;

use anyhow::Result;
use boresight::catalog::Catalog;
use boresight::identify::IdentifyOptions;
use boresight::pipeline::{self, MeasureOptions, SkyChoice};
use boresight::provenance::Provenance;
use boresight::recording::Recording;

use super::options::{InputArgs, MeasureArgs, SkyArgs};
use super::output;

pub(crate) use boresight::pipeline::{IdentifiedFrame, Measured, MeasuredFrame, physics_in_force, take_identifications};

/// Opens what is named on the command line.
pub(crate) fn open(input: &InputArgs) -> Result<Recording> {
    let clock = output::Clock::new();
    let mut recording = Recording::open_with(&input.inputs, input.told.open_options(input.keep_going))?;
    input.told.tell(&mut recording)?;
    tracing::info!("{} frames opened in {clock}", recording.frames.len());
    for note in &recording.notes {
        tracing::warn!("{note}");
    }
    Ok(recording)
}

/// Provenance of a result that was made of this recording.
pub(crate) fn provenance(recording: &Recording, sky: Option<&SkyArgs>) -> Result<Provenance> {
    let mut provenance = output::provenance();
    provenance.add_inputs(&recording.input_files())?;
    if let Some(path) = sky.and_then(|sky| sky.catalog.as_ref()) {
        provenance.add_input(path)?;
    }
    Ok(provenance)
}

/// Finds and measures the stars of every frame; those above a signal-to-noise ratio, if one is asked for.
pub(crate) fn measure(recording: Recording, detection_threshold: Option<f64>) -> Result<Measured> {
    measure_by(recording, &MeasureOptions { detection_threshold, ..MeasureOptions::default() })
}

/// The same as asked for; darks go into the provenance.
pub(crate) fn measure_as(
    recording: Recording,
    args: &MeasureArgs,
    time_limit: Option<Duration>,
    provenance: &mut Provenance,
) -> Result<Measured> {
    measure_told(recording, &args.options(time_limit)?, provenance)
}

/// The same, of lists the stars alone: who identified them is not asked.
pub(crate) fn measure_stars(
    recording: Recording,
    args: &MeasureArgs,
    time_limit: Option<Duration>,
    provenance: &mut Provenance,
) -> Result<Measured> {
    measure_told(recording, &MeasureOptions { lets_lists_go: true, ..args.options(time_limit)? }, provenance)
}

/// The same with the pixels of some stars kept, for the image that they show.
pub(crate) fn measure_keeping_stars(
    recording: Recording,
    args: &MeasureArgs,
    time_limit: Option<Duration>,
    provenance: &mut Provenance,
) -> Result<Measured> {
    measure_told(recording, &MeasureOptions { keeps_stars: true, ..args.options(time_limit)? }, provenance)
}

/// The same with the pixels between the stars.
pub(crate) fn measure_with_pixels(
    recording: Recording,
    args: &MeasureArgs,
    time_limit: Option<Duration>,
    provenance: &mut Provenance,
) -> Result<Measured> {
    measure_told(recording, &MeasureOptions { pixels: true, ..args.options(time_limit)? }, provenance)
}

fn measure_told(mut recording: Recording, options: &MeasureOptions, provenance: &mut Provenance) -> Result<Measured> {
    if let Some(dark) = &options.dark {
        for file in dark.files() {
            provenance.add_input(file)?;
        }
        recording.notes.push(dark.sentence());
    }
    let before = recording.notes.len();
    let measured = measure_by(recording, options)?;
    for note in measured.recording.notes.iter().skip(before) {
        tracing::info!("{note}");
    }
    Ok(measured)
}

fn measure_by(recording: Recording, options: &MeasureOptions) -> Result<Measured> {
    let (bar, clock) = (output::progress("measuring", recording.frames.len()), output::Clock::new());
    let measured = pipeline::measure(recording, options, || bar.inc(1));
    bar.finish_and_clear();
    let measured = measured?;
    let stars: usize = measured.frames.iter().map(|frame| frame.detections.stars.len()).sum();
    tracing::info!("{} frames measured in {clock}: {stars} star images", measured.frames.len());
    for frame in &measured.frames {
        let found = &frame.detections;
        tracing::debug!(
            "{}: {} star images, background {:.1} DN, noise {:.2} DN, {:.2} s",
            frame.name,
            found.stars.len(),
            found.background_dn,
            found.noise_dn,
            frame.seconds
        );
    }
    Ok(measured)
}

/// Identifies every frame.
pub(crate) fn identify_frames(
    measured: &Measured,
    catalog: &Catalog,
    physics: &SkyChoice,
    options: &IdentifyOptions,
) -> Result<Vec<IdentifiedFrame>> {
    if let Some(f_px) = options.nominal_focal_length_px {
        tracing::info!("identifying with the focal length that is given, {f_px:.1} px");
    } else {
        tracing::info!("identifying without a focal length: all fields are tried");
    }
    let (bar, clock) = (output::progress("identifying", measured.frames.len()), output::Clock::new());
    let identified = pipeline::identify_frames(measured, catalog, physics, options, || bar.inc(1));
    bar.finish_and_clear();
    let identified = identified?;
    let solved = || identified.iter().filter_map(IdentifiedFrame::solution);
    let (effects, _) = physics_in_force(&identified);
    let stars: usize = solved().map(|solution| solution.matches.len()).sum();
    tracing::info!(
        "{} of {} frames identified in {clock}: {stars} stars named; physics in force: {}",
        solved().count(),
        identified.len(),
        output::listed(&effects)
    );
    for (frame, of) in measured.frames.iter().zip(&identified) {
        if let Some(solution) = of.solution() {
            tracing::debug!(
                "{}: {} stars, f = {:.1} px ({}), rms {:.3} px, probability of a false match {:.0e}, {:.2} s",
                frame.name,
                solution.matches.len(),
                solution.camera.focal_length_px,
                solution.projection.id(),
                solution.rms_px,
                solution.false_match_probability,
                of.seconds
            );
        } else {
            tracing::debug!("{}: not identified, {:.2} s", frame.name, of.seconds);
        }
    }
    Ok(identified)
}
