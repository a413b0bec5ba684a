//! `boresight compare`: are two calibrations of the same camera?

use std::path::PathBuf;

use anyhow::{Context, Result};
use boresight::calibrate::{Comparison, compare as compare_calibrations};
use boresight::provenance::Provenance;
use clap::Args;
use serde::Serialize;

use super::calibrate_text::wrapped;
use super::map::read_calibration;
use super::options::OutputArgs;
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
    #[command(flatten)]
    output: OutputArgs,
}

#[derive(Serialize)]
struct CompareObject {
    #[serde(flatten)]
    comparison: Comparison,
    provenance: Provenance,
}

/// Compares, and prints the differences.
pub(crate) fn compare(args: &CompareArgs) -> Result<Answer> {
    let (first, second) = (read_calibration(&args.first)?, read_calibration(&args.second)?);
    let mut provenance = output::provenance();
    provenance.add_input(&args.first)?;
    provenance.add_input(&args.second)?;
    let object = CompareObject { comparison: compare_calibrations(&first, &second)?, provenance };
    if let Some(directory) = &args.output.output {
        std::fs::create_dir_all(directory).with_context(|| format!("creating {}", directory.display()))?;
        pictures::difference(&directory.join("difference.png"), [&first, &second], &object.comparison)?;
    }
    output::deliver("compare", &object, args.output.json, args.output.output.as_deref(), || text(&object.comparison))?;
    Ok(Answer::Yes)
}

fn text(comparison: &Comparison) -> String {
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
    if let Some(p) = comparison.p_value {
        text += &format!("probability of so large a difference if the camera did not change: {}\n", pictures::probability(p));
    }
    for warning in &comparison.warnings {
        text += &wrapped("note:", warning, "note: ".len());
    }
    text
}
