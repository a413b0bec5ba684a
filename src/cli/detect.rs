//! `boresight detect`: finds the stars in images and measures them.

use anyhow::Result;
use boresight::catalog::Catalog;
use boresight::detect::{DetectResult, DetectedFrame, FORMAT};
use clap::Args;

use super::options::{InputArgs, MeasureArgs, OutputArgs};
use super::{Answer, identify_files, output, pipeline};

/// Arguments of `detect`.
#[derive(Debug, Args)]
pub(crate) struct DetectArgs {
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    measure: MeasureArgs,
    #[command(flatten)]
    output: OutputArgs,
}

/// Measures, and prints a line a frame.
pub(crate) fn detect(args: &DetectArgs) -> Result<Answer> {
    let _folder = args.output.open("detect")?;
    let recording = pipeline::open(&args.input)?;
    let mut provenance = pipeline::provenance(&recording, None)?;
    let measured = pipeline::measure_stars(recording, &args.measure, None, &mut provenance)?;
    let frames = measured
        .frames
        .iter()
        .map(|frame| DetectedFrame { file: &frame.name, detections: &frame.detections, seconds: frame.seconds })
        .collect();
    let object = DetectResult {
        format: FORMAT,
        frames,
        skipped: &measured.skipped,
        notes: &measured.recording.notes,
        psf: measured.psf,
        provenance,
    };
    if let Some(directory) = &args.output.output {
        identify_files::write_detections(directory, &measured.frames, &object.provenance)?;
        let catalog = Catalog::embedded();
        for frame in &measured.frames {
            identify_files::write_regions(directory, frame, &identify_files::marks(frame, None, catalog))?;
            identify_files::write_picture(&identify_files::frame_path(directory, frame, "png"), &measured, frame, None, catalog)?;
        }
    }
    output::deliver("detect", &object, args.output.json, args.output.output.as_deref(), || {
        let rows: Vec<Vec<String>> = object
            .frames
            .iter()
            .map(|frame| {
                let stars = &frame.detections.stars;
                vec![
                    frame.file.to_owned(),
                    stars.len().to_string(),
                    stars.first().map_or_else(String::new, |star| format!("{:.0}", star.snr())),
                    format!("{:.1}", frame.detections.background_dn),
                    format!("{:.2}", frame.detections.noise_dn),
                ]
            })
            .collect();
        boresight::report::table(&["frame", "stars", "best SNR", "background/DN", "noise/DN"], &rows)
    })?;
    Ok(Answer::Yes)
}
