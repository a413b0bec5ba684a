//! Calibrates the camera of a recording: `cargo run --release --example calibrate -- RECORDING`
#![allow(clippy::print_stdout, reason = "a command")]

use boresight::calibrate::{CalibrateOptions, calibrate};
use boresight::camera::Physics;
use boresight::catalog::Catalog;
use boresight::identify::IdentifyOptions;
use boresight::pipeline::{self, MeasureOptions};
use boresight::recording::Recording;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let recording = Recording::open(&std::env::args().skip(1).collect::<Vec<_>>())?;
    let catalog = Catalog::embedded();
    let measured = pipeline::measure(recording, &MeasureOptions::default(), || ())?;
    let options =
        IdentifyOptions { nominal_focal_length_px: measured.recording.camera.nominal_focal_length_px(), ..IdentifyOptions::default() };
    let identified = pipeline::identify_frames(&measured, catalog, &Physics::Known.into(), &options, || ())?;
    let prepared = pipeline::control_points(&measured, &identified, catalog, None, false)?;
    let calibration = calibrate(&prepared.points, &CalibrateOptions::default())?;
    for parameter in &calibration.parameters {
        println!("{} = {} ± {} {}", parameter.name, parameter.value, parameter.sigma, parameter.unit);
    }
    Ok(())
}
