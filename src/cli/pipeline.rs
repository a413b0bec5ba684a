//! The way of the data as the verbs walk it, with progress shown and what was read told.

use std::time::Duration;

use anyhow::Result;
use boresight::catalog::Catalog;
use boresight::identify::IdentifyOptions;
use boresight::pipeline::{self, MeasureOptions, SkyChoice};
use boresight::provenance::Provenance;
use boresight::recording::{OpenOptions, Recording};

use super::options::{InputArgs, MeasureArgs, SkyArgs};
use super::output;

pub(crate) use boresight::pipeline::{IdentifiedFrame, Measured, MeasuredFrame, physics_in_force, take_identifications};

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

/// Finds and measures the stars of every frame; those above a signal-to-noise ratio, if one is asked for.
pub(crate) fn measure(recording: Recording, detection_threshold: Option<f64>) -> Result<Measured> {
    measure_by(recording, &MeasureOptions { detection_threshold, ..MeasureOptions::default() })
}

/// The same as asked for; darks go into the provenance.
pub(crate) fn measure_as(
    mut recording: Recording,
    args: &MeasureArgs,
    time_limit: Option<Duration>,
    provenance: &mut Provenance,
) -> Result<Measured> {
    let options = args.options(time_limit)?;
    if let Some(dark) = &options.dark {
        for file in dark.files() {
            provenance.add_input(file)?;
        }
        recording.notes.push(dark.sentence());
    }
    let before = recording.notes.len();
    let measured = measure_by(recording, &options)?;
    for note in measured.recording.notes.iter().skip(before) {
        tracing::info!("{note}");
    }
    Ok(measured)
}

fn measure_by(recording: Recording, options: &MeasureOptions) -> Result<Measured> {
    let bar = output::progress("measuring", recording.frames.len());
    let measured = pipeline::measure(recording, options, || bar.inc(1));
    bar.finish_and_clear();
    Ok(measured?)
}

/// Identifies every frame.
pub(crate) fn identify_frames(
    measured: &Measured,
    catalog: &Catalog,
    physics: &SkyChoice,
    options: &IdentifyOptions,
) -> Result<Vec<IdentifiedFrame>> {
    let bar = output::progress("identifying", measured.frames.len());
    let identified = pipeline::identify_frames(measured, catalog, physics, options, || bar.inc(1));
    bar.finish_and_clear();
    Ok(identified?)
}
