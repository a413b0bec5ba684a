//! `boresight map`: pixel → direction of a calibration on a grid.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use boresight::calibrate::{Calibration, MapResult, map as map_of};
use boresight::guard::guarded;
use clap::Args;

use super::options::{OutputArgs, heading};
use super::{Answer, output};

/// Arguments of `map`.
#[derive(Debug, Args)]
pub(crate) struct MapArgs {
    /// A calibration: calibrate.json, as `boresight calibrate … -o DIR` writes it
    #[arg(value_name = "CALIBRATION")]
    calibration: PathBuf,
    /// Points along each side of the frame
    #[arg(long, value_name = "N", default_value_t = 9, value_parser = clap::value_parser!(u16).range(1..=2000), help_heading = heading::OUTPUT)]
    grid: u16,
    #[command(flatten)]
    output: OutputArgs,
}

/// Reads a calibration file.
pub(crate) fn read_calibration(path: &Path) -> Result<Calibration> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: the calibration cannot be read", path.display()))?;
    let calibration: Calibration = guarded(|| serde_json::from_str(&text))?.with_context(|| {
        format!("{}: this is no calibration; give a calibrate.json as `boresight calibrate … -o DIR` writes it", path.display())
    })?;
    anyhow::ensure!(
        calibration.format == boresight::calibrate::FORMAT,
        "{}: the format is {:?}, but this program reads {:?}",
        path.display(),
        calibration.format,
        boresight::calibrate::FORMAT
    );
    Ok(calibration.with_stored_columns())
}

/// Prints the map.
pub(crate) fn map(args: &MapArgs) -> Result<Answer> {
    let _folder = args.output.open("map")?;
    let calibration = read_calibration(&args.calibration)?;
    let mut provenance = output::provenance();
    provenance.add_input(&args.calibration)?;
    let object = MapResult { map: map_of(&calibration, usize::from(args.grid)), provenance };
    output::deliver("map", &object, args.output.json, args.output.output.as_deref(), || {
        let rows: Vec<Vec<String>> = object
            .map
            .points
            .iter()
            .map(|point| {
                let [x, y, z] = point.direction;
                [point.x_px, point.y_px].map(|v| format!("{v:.3}")).into_iter().chain([x, y, z].map(|v| format!("{v:.10}"))).collect()
            })
            .collect();
        boresight::report::table(&["x_px", "y_px", "direction x", "y", "z"], &rows)
    })?;
    Ok(Answer::Yes)
}
