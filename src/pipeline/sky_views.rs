//! Where the cells of each frame's mesh of the sky lie, for the models of the sky's light.

use super::Measured;
use crate::camera::circumstances;
use crate::coordinates::{Attitude, PixelPoint};
use crate::diagnose::SkyView;
use crate::dual::dot;
use crate::effects::sky::glow::Circumstances;
use crate::identify::ControlPoints;
use crate::pixel_statistics::SkyMesh;
use crate::units::ARCSEC_RAD;

/// Extinction at a good site, magnitudes per air mass; that of a scene where nothing is told (K. Krisciunas and B. E. Schaefer, PASP 103, 1033, 1991).
const EXTINCTION_MAG_PER_AIRMASS: f64 = 0.172;

/// Of every frame that has an attitude and a mesh. `parity` −1 where the files' images are mirrored.
#[must_use]
pub fn sky_views(measured: &Measured, points: &ControlPoints, parity: i8) -> Vec<SkyView> {
    let meshes = measured.pixels.iter().flat_map(|pixels| &pixels.sky);
    meshes.filter_map(|mesh| view(measured, points, parity, mesh)).collect()
}

fn view(measured: &Measured, points: &ControlPoints, parity: i8, mesh: &SkyMesh) -> Option<SkyView> {
    let attitude: &Attitude = points.attitudes.get(mesh.frame)?.as_ref()?;
    let [width_px, height_px] = mesh.size_px.map(|side| side as f64);
    let direction = |[x, y]: [f64; 2]| -> [f64; 3] {
        let x = if parity < 0 { width_px - 1.0 - x } else { x };
        attitude.apparent_from_camera(&points.nominal.direction(PixelPoint { x_px: x, y_px: y })).xyz
    };
    let places: Vec<[f64; 2]> = (0..mesh.cells.len())
        .map(|number| {
            let grid = [number % mesh.shape[0], number / mesh.shape[0]];
            let middle = |axis: usize, side: f64| (grid[axis] as f64 + 0.5) / mesh.shape[axis] as f64 * side - 0.5;
            match mesh.cells[number] {
                Some(cell) => {
                    [(0, width_px), (1, height_px)].map(|(axis, side)| cell.at[axis] * mesh.half_diagonal_px() + 0.5 * (side - 1.0))
                }
                None => [middle(0, width_px), middle(1, height_px)],
            }
        })
        .collect();
    let pixel_arcsec2 = |[x, y]: &[f64; 2]| {
        let across = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|axis| a[axis] - b[axis]);
        let along_x = across(direction([x + 0.5, *y]), direction([x - 0.5, *y]));
        let along_y = across(direction([*x, y + 0.5]), direction([*x, y - 0.5]));
        // Area of a parallelogram, by the lengths of its sides and their angle.
        let square = dot(along_x, along_x) * dot(along_y, along_y) - dot(along_x, along_y).powi(2);
        square.max(0.0).sqrt() / (ARCSEC_RAD * ARCSEC_RAD)
    };
    let observation = points.observation(mesh.frame);
    let time = measured.recording.frames.get(mesh.frame)?.time_utc;
    let known = circumstances(time, &observation);
    let zenith = known.zenith.filter(|_| !observation.zenith_is_guessed);
    Some(SkyView {
        frame: mesh.frame,
        pixel_arcsec2: places.iter().map(pixel_arcsec2).collect(),
        directions: places.into_iter().map(direction).collect(),
        circumstances: Circumstances { zenith, extinction_mag_per_airmass: EXTINCTION_MAG_PER_AIRMASS, ..known },
        is_timed: time.is_some(),
    })
}
