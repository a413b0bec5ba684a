//! The joint method from control points to the result.

use super::{selection, solve, summary};
use crate::calibrate::select::Selection;
use crate::calibrate::{CalibrateError, CalibrateOptions, Calibration};
use crate::identify::ControlPoints;

/// Calibrates.
pub(in crate::calibrate) fn calibrate(
    points: &ControlPoints,
    options: &CalibrateOptions,
    selection: &Selection,
) -> Result<Calibration, CalibrateError> {
    let started = std::time::Instant::now();
    let (solved, chosen) = if options.select_model || options.extend_model {
        let (solved, report) = selection::select(points, options, selection)?;
        (solved, Some(report))
    } else {
        (solve(points, options, selection)?, None)
    };
    let mut result = summary::summarise(points, options, selection, &solved)?;
    result.selection = chosen;
    result.seconds = started.elapsed().as_secs_f64();
    Ok(result)
}
