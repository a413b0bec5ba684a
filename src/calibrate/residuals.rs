//! Residuals of a calibration's stars under any camera, for pictures of before and after.

use super::Calibration;
use super::pairs::Star;
use super::star_level::fit_attitude;
use crate::camera::Camera;
use crate::coordinates::PixelPoint;

/// Measured minus predicted position of every control point (in the order of [`Calibration::points`]) with this camera, each
/// frame's attitude fitted anew to the points that the calibration used. `None` for points left out, and where the camera
/// has no image of the star.
#[must_use]
pub fn residuals_px(calibration: &Calibration, camera: &Camera) -> Vec<Option<[f64; 2]>> {
    let mut residuals = vec![None; calibration.points.len()];
    for frame in &calibration.per_frame {
        let of_frame = calibration.points.iter().zip(&calibration.control_points.points).enumerate();
        let entered = of_frame.filter(|(_, (result, _))| result.frame == frame.frame && result.left_out.is_none());
        let (stars, used): (Vec<Star>, Vec<bool>) = entered
            .map(|(point, (result, control))| {
                let pixel = PixelPoint { x_px: control.x_px, y_px: control.y_px };
                (Star { point, pixel, direction: control.direction.xyz }, result.weight > 0.5)
            })
            .unzip();
        if let Some(fit) = fit_attitude(camera, &stars, &used) {
            for (star, residual) in stars.iter().zip(fit.residuals_px) {
                residuals[star.point] = residual;
            }
        }
    }
    residuals
}
