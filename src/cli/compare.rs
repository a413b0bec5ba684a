//! `boresight compare`: are two calibrations of the same camera?

use std::path::PathBuf;

use anyhow::Result;
use boresight::calibrate::{CompareResult, DifferenceLimit, compare as compare_calibrations};
use clap::Args;

use super::calibrate_text::wrapped;
use super::map::read_calibration;
use super::options::{OutputArgs, heading};
use super::{Answer, output, pictures};

/// Arguments of `compare`.
#[derive(Debug, Args)]
pub(crate) struct CompareArgs {
    /// The first calibration (calibrate.json)
    #[arg(value_name = "A")]
    first: PathBuf,
    /// The second; differences are second minus first
    #[arg(value_name = "B")]
    second: PathBuf,
    /// Exit code 3 if the two maps differ by more than this anywhere in the frame
    #[arg(long, value_name = "PX", value_parser = super::identify::positive, allow_negative_numbers = true, help_heading = heading::STATISTICS)]
    max_px: Option<f64>,
    #[command(flatten)]
    output: OutputArgs,
}

/// Compares, and prints the differences.
pub(crate) fn compare(args: &CompareArgs) -> Result<Answer> {
    let _folder = args.output.open("compare")?;
    let (first, second) = (read_calibration(&args.first)?, read_calibration(&args.second)?);
    let mut provenance = output::provenance();
    provenance.add_input(&args.first)?;
    provenance.add_input(&args.second)?;
    let comparison = compare_calibrations(&first, &second)?;
    let limit = args.max_px.map(|max_px| DifferenceLimit { max_px, is_kept: comparison.max_px <= max_px });
    let object = CompareResult { comparison, limit, provenance };
    if let Some(directory) = &args.output.output {
        pictures::difference(&directory.join("difference.png"), [&first, &second], &object.comparison)?;
    }
    output::deliver("compare", &object, args.output.json, args.output.output.as_deref(), || text(&object))?;
    Ok(if limit.is_none_or(|limit| limit.is_kept) { Answer::Yes } else { Answer::No })
}

fn text(object: &CompareResult) -> String {
    let comparison = &object.comparison;
    let rows: Vec<Vec<String>> = comparison
        .parameters
        .iter()
        .map(|parameter| {
            let significance = parameter.difference / parameter.sigma;
            vec![
                parameter.name.clone(),
                format!("{:.4e}", parameter.difference),
                format!("{:.1e}", parameter.sigma),
                format!("{significance:+.1} σ"),
                parameter.unit.clone(),
            ]
        })
        .collect();
    let mut text = boresight::report::table(&["parameter", "second − first", "σ", "", "unit"], &rows);
    text += &format!(
        "\nmapping differs by {:.4} px rms over the frame, {:.4} px at most, after the best rotation\n",
        comparison.rms_px, comparison.max_px
    );
    if let Some(DifferenceLimit { max_px, is_kept }) = object.limit {
        text += &format!("{} {max_px} px\n", if is_kept { "this is within the limit of" } else { "THIS IS BEYOND THE LIMIT of" });
    }
    if let Some(p) = comparison.p_value {
        text += &format!("probability of so large a difference if the camera did not change: {}\n", pictures::probability(p));
    }
    for warning in &comparison.warnings {
        text += &wrapped("note:", warning, "note: ".len());
    }
    text
}
