//! The stages of a diagnosis, in their order.

use std::time::Instant;

use super::diagnosis::Diagnosis;
use super::error::DiagnoseError;
use super::images::{ImageMeasurements, add_images};
use super::options::{DiagnoseOptions, Telemetry};
use super::stages::{Baseline, Judged, Reported, Screened, Selected, Solved, Validated};
use super::step::Step;
use crate::identify::ControlPoints;

/// Diagnoses the control points of a recording. `telemetry` by frame; may be empty.
pub fn diagnose(points: &ControlPoints, telemetry: &Telemetry, options: &DiagnoseOptions) -> Result<Diagnosis, DiagnoseError> {
    diagnose_with_progress(points, telemetry, options, &|_| ())
}

/// The same, calling `on_step` as each step begins.
pub fn diagnose_with_progress(
    points: &ControlPoints,
    telemetry: &Telemetry,
    options: &DiagnoseOptions,
    on_step: &dyn Fn(Step),
) -> Result<Diagnosis, DiagnoseError> {
    let started = Instant::now();
    on_step(Step::Baseline);
    let baseline = Baseline::new(points, telemetry, options)?;
    on_step(Step::Omnibus);
    let screened = Screened::new(&baseline);
    let known = screened.omitted_nature(&baseline);
    let baseline = baseline.with_known(known)?;
    on_step(Step::Attribution);
    let selected = Selected::new(&baseline, &screened);
    on_step(Step::Proof);
    let validated = Validated::new(&baseline, &screened, selected);
    on_step(Step::Solution);
    let solved = Solved::new(validated)?;
    on_step(Step::Remainder);
    let solved = solved.with_remainder()?;
    on_step(Step::Adequacy);
    let judged = Judged::new(&solved);
    on_step(Step::Findings);
    let mut diagnosis = Reported::new(&judged)?.diagnosis(on_step);
    diagnosis.seconds = started.elapsed().as_secs_f64();
    Ok(diagnosis)
}

/// The same with what was measured of the images beside the stars' places: brightness, shape, noise and background are held against the model too.
pub fn diagnose_recording(
    points: &ControlPoints,
    telemetry: &Telemetry,
    images: &ImageMeasurements<'_>,
    options: &DiagnoseOptions,
    on_step: &dyn Fn(Step),
) -> Result<Diagnosis, DiagnoseError> {
    let started = Instant::now();
    let mut diagnosis = diagnose_with_progress(points, telemetry, options, on_step)?;
    add_images(&mut diagnosis, images, options);
    diagnosis.seconds = started.elapsed().as_secs_f64();
    Ok(diagnosis)
}
