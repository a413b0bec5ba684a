//! What control points and options have to be before anything is solved.

use super::error::CalibrateError;
use super::geometry;
use super::options::CalibrateOptions;
use crate::camera::{PARAMETER_COUNT, PARAMETER_NAMES};
use crate::identify::ControlPoints;

/// Checks what was given.
pub(super) fn check_points(control_points: &ControlPoints, options: &CalibrateOptions) -> Result<(), CalibrateError> {
    let camera = &control_points.nominal;
    let sizes = [("width_px", camera.width_px as f64), ("height_px", camera.height_px as f64), ("f", camera.focal_length_px)];
    if let Some((name, value)) = sizes.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
        return Err(CalibrateError::BadNominal { name, value });
    }
    if let Some((name, value)) = PARAMETER_NAMES.into_iter().zip(camera.parameters()).find(|(_, value)| !value.is_finite()) {
        return Err(CalibrateError::BadNominal { name, value });
    }
    if geometry::folds_over(camera) {
        return Err(CalibrateError::NominalFolds);
    }
    for (index, point) in control_points.points.iter().enumerate() {
        let fields: [(&[f64], &'static str); 5] = [
            (&[point.x_px], "x_px"),
            (&[point.y_px], "y_px"),
            (&point.direction.xyz, "direction"),
            (&point.covariance_px2, "covariance_px2"),
            (&[point.catalog_sigma_rad], "catalog_sigma_rad"),
        ];
        if let Some((_, field)) = fields.into_iter().find(|(values, _)| values.iter().any(|value| !value.is_finite())) {
            return Err(CalibrateError::NotFinite { index, frame: point.frame, hip: point.hip, field });
        }
    }
    let positive = [("f_threshold", options.f_threshold), ("epsilon_px", options.epsilon_px)];
    if let Some((name, value)) = positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
        return Err(CalibrateError::BadOption { name, value: value.to_string(), allowed: "a finite number above 0" });
    }
    if options.max_iterations == 0 {
        return Err(CalibrateError::BadOption { name: "max_iterations", value: "0".to_owned(), allowed: "1 or more" });
    }
    Ok(())
}

/// Which parameters of the reference model are solved.
pub(super) fn free_of_reference_model(options: &CalibrateOptions) -> Result<[bool; PARAMETER_COUNT], CalibrateError> {
    let mut free = [false; PARAMETER_COUNT];
    for name in &options.solve {
        let unknown = || CalibrateError::BadOption { name: "solve", value: name.clone(), allowed: "x0, y0, f, k1, p1, p2" };
        free[PARAMETER_NAMES.iter().position(|known| known == name).ok_or_else(unknown)?] = true;
    }
    if !free.contains(&true) {
        return Err(CalibrateError::BadOption { name: "solve", value: "nothing".to_owned(), allowed: "x0, y0, f, k1, p1, p2" });
    }
    Ok(free)
}
