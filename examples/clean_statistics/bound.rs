//! The Cramér–Rao bound of a night.

use boresight::calibrate::trial::TrialNight;
use boresight::coordinates::PixelPoint;

use super::columns::{Columns, FrameNormal, Matrix6, inverse};

/// Points along each side of the grid over which the bound of the mapping is averaged, edge to edge.
const GRID: u32 = 33;
/// The Cramér–Rao bound of a night: covariance of the parameters, and mean square error of the mapping over the frame after the best
/// rotation.
pub(crate) fn bound(night: &TrialNight, solved: &[usize], sigma_px: f64) -> Option<(Matrix6, f64)> {
    let mut information = Matrix6::zeros();
    for (frame, attitude) in night.attitudes.iter().enumerate() {
        let mut normal = FrameNormal::new();
        for point in night.control_points.points.iter().filter(|point| point.frame == frame) {
            let image = night.truth.pixel(&attitude.camera_from_apparent(&point.direction))?;
            normal.add(&Columns::at(&night.truth, image)?);
        }
        information += normal.camera - normal.cross * normal.gain()?;
    }
    let covariance = inverse(&information, std::array::from_fn(|k| solved.contains(&k)))? * (sigma_px * sigma_px);
    let along = |index: u32, length: usize| (length as f64 - 1.0) * f64::from(index) / f64::from(GRID - 1);
    let grid = (0..GRID * GRID)
        .map(|index| PixelPoint { x_px: along(index % GRID, night.truth.width_px), y_px: along(index / GRID, night.truth.height_px) });
    let columns: Vec<Columns> = grid.map(|pixel| Columns::at(&night.truth, pixel)).collect::<Option<_>>()?;
    let mut whole = FrameNormal::new();
    for columns in &columns {
        whole.add(columns);
    }
    let gain = whole.gain()?;
    let square = columns.iter().map(|columns| {
        let map = columns.camera - columns.rotation * gain;
        (map * covariance * map.transpose()).trace()
    });
    Some((covariance, square.sum::<f64>() / columns.len() as f64))
}
