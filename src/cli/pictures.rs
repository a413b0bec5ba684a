//! Pictures of results.

use std::path::Path;

use anyhow::Result;
use boresight::calibrate::{Calibration, residuals_px};
use boresight::camera::Camera;
use boresight::report;

/// Residual vectors with the camera before (as the recording declares it) and after the calibration, side by side.
pub(crate) fn residuals(path: &Path, calibration: &Calibration) -> Result<()> {
    let panel = |title: &str, camera: &Camera| {
        let residuals = residuals_px(calibration, camera);
        let vectors: Vec<report::Vector> = calibration
            .points
            .iter()
            .zip(residuals)
            .filter_map(|(point, residual)| {
                let [dx_px, dy_px] = residual?;
                Some(report::Vector {
                    x_px: calibration.stored_column_px(point.x_px),
                    y_px: point.y_px,
                    dx_px: dx_px * f64::from(calibration.parity),
                    dy_px,
                    rejected: point.weight <= 0.5,
                })
            })
            .collect();
        report::VectorPanel { title: title.to_owned(), vectors }
    };
    let (before, after) = (&calibration.control_points.nominal, &calibration.camera);
    let panels = [&panel("before (camera as declared)", before), &panel("after", after)];
    let size = (after.width_px, after.height_px);
    Ok(report::residual_vectors(path, "Residuals of the stars, one free attitude a frame", size, panels)?)
}
