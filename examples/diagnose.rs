//! Says which physics a model leaves out of a recording: `cargo run --release --example diagnose -- RECORDING`
#![allow(clippy::print_stdout, reason = "a command")]

use boresight::camera::Physics;
use boresight::catalog::Catalog;
use boresight::diagnose::{DiagnoseOptions, diagnose};
use boresight::identify::IdentifyOptions;
use boresight::pipeline::{self, DiagnosisInput, MeasureOptions, SkyChoice};
use boresight::recording::Recording;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let recording = Recording::open(&std::env::args().skip(1).collect::<Vec<_>>())?;
    let catalog = Catalog::embedded();
    let mut measured = pipeline::measure(recording, &MeasureOptions::default(), || ())?;
    let options =
        IdentifyOptions { nominal_focal_length_px: measured.recording.camera.nominal_focal_length_px(), ..IdentifyOptions::default() };
    // The model holds proper motion alone: what else nature and the camera do is to be found.
    let choice = SkyChoice { physics: Physics::List(vec!["proper-motion".to_owned()]), assumes_time: true };
    let identified = pipeline::identify_frames(&measured, catalog, &choice, &options, || ())?;
    let prepared = pipeline::control_points(&measured, &identified, catalog, None, false)?;
    let input = DiagnosisInput { catalog, choice: &choice, max_magnitude: None, trusted: false };
    let request = pipeline::diagnosis_request(&mut measured, &identified, &prepared, &input, DiagnoseOptions::default())?;
    let diagnosis = diagnose(&request.points, &request.telemetry, &request.options)?;
    for sentence in &diagnosis.summary {
        println!("{sentence}");
    }
    Ok(())
}
