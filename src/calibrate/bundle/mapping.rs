//! Effect of the shared parameters on the pixel → direction map: its uncertainty, and how much of it the star images determine.

use nalgebra::{DMatrix, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};

use super::normal::{FrameSums, Reduced, WIDTH};
use super::problem::{Attitudes, Problem, State};
use super::reference::Reference;
use crate::camera::{Model, PARAMETER_COUNT};
use crate::coordinates::PixelPoint;
use crate::parallel;

/// The map's columns at one pixel.
pub(in crate::calibrate) struct MapColumns {
    /// The pixel.
    pub(in crate::calibrate) pixel: PixelPoint,
    /// d(pixel)/d(parameter) by axis with the best rotation over the frame taken out, px per unit of the parameter.
    pub(in crate::calibrate) columns: [Vec<f64>; 2],
}

/// How the map over a grid of pixels answers to these parameters (a star of the reference colour, telemetry at its mean), once the best
/// rotation is taken out. `None` where the model has no usable map.
pub(in crate::calibrate) fn rotation_free_map(
    model: &Model,
    values: &[f64],
    free: &[usize],
    grid: &[PixelPoint],
) -> Option<Vec<MapColumns>> {
    let context = model.reference_context();
    let mut places = Vec::new();
    let mut normal = Matrix3::zeros();
    let mut cross = vec![Vector3::zeros(); free.len()];
    let mut add = |pixel: PixelPoint, columns: Vec<Vector2<f64>>, rotation: Matrix2x3<f64>| {
        normal += rotation.transpose() * rotation;
        for (sum, column) in cross.iter_mut().zip(&columns) {
            *sum += rotation.transpose() * column;
        }
        places.push((pixel, columns, rotation));
    };
    let plain = model.is_reference_behind_the_lens() && free.iter().all(|index| *index < PARAMETER_COUNT);
    let reference = plain.then(|| Reference::new(values));
    for pixel in grid.iter().copied() {
        if let Some(reference) = &reference {
            let point = reference.at([pixel.x_px, pixel.y_px])?;
            let turn = point.by_rotation(point.direction());
            let rotation = Matrix2x3::from_fn(|axis, about| turn[about][axis]);
            let columns: Vec<_> = free.iter().map(|index| -Vector2::from(point.by_parameter[*index])).collect();
            add(pixel, columns, rotation);
            continue;
        }
        // The corners of a fisheye's frame may see nothing.
        let Some(seen) = model.seen(values, free, [pixel.x_px, pixel.y_px], &context) else { continue };
        let by_pixel = SMatrix::<f64, 3, 2>::from_fn(|i, j| seen.by_pixel[i][j]);
        let inverse = (by_pixel.transpose() * by_pixel).try_inverse()? * by_pixel.transpose();
        let [x, y, z] = seen.direction;
        let rotation: Matrix2x3<f64> = inverse * Matrix3::new(0.0, z, -y, -z, 0.0, x, y, -x, 0.0);
        let columns: Vec<_> = seen.by_parameter.iter().map(|change| -(inverse * Vector3::from(*change))).collect();
        add(pixel, columns, rotation);
    }
    if places.len() * 4 < grid.len() {
        return None;
    }
    let factor = normal.cholesky()?;
    let gains: Vec<Vector3<f64>> = cross.iter().map(|sum| factor.solve(sum)).collect();
    let free_of_rotation = |(pixel, columns, rotation): (PixelPoint, Vec<Vector2<f64>>, Matrix2x3<f64>)| {
        let left: Vec<_> = columns.iter().zip(&gains).map(|(column, gain)| column - rotation * gain).collect();
        MapColumns { pixel, columns: [left.iter().map(|c| c.x).collect(), left.iter().map(|c| c.y).collect()] }
    };
    Some(places.into_iter().map(free_of_rotation).collect())
}

/// Standard error (2-D, px) of the map at each pixel of a grid, from the covariance of the parameters in their own units.
pub(in crate::calibrate) fn map_sigma_px(
    model: &Model,
    values: &[f64],
    free: &[usize],
    covariance: &DMatrix<f64>,
    grid: &[PixelPoint],
) -> Option<Vec<(PixelPoint, f64)>> {
    Some(sigma_px(&rotation_free_map(model, values, free, grid)?, covariance))
}

/// The same from the map's columns.
pub(in crate::calibrate) fn sigma_px(map: &[MapColumns], covariance: &DMatrix<f64>) -> Vec<(PixelPoint, f64)> {
    let of = |place: &MapColumns| {
        let variance: f64 = place
            .columns
            .iter()
            .map(|column| {
                let product = |row: usize| column.iter().enumerate().map(|(k, value)| covariance[(k, row)] * value).sum::<f64>();
                column.iter().enumerate().map(|(row, value)| value * product(row)).sum::<f64>()
            })
            .sum();
        (place.pixel, variance.max(0.0).sqrt())
    };
    map.iter().map(of).collect()
}

/// Of a change of the map by 1 px (rms over the frame, rotation out), how much the star images with weight see at least, attitudes
/// free; and the combination of parameters that makes this least visible change. `map`: the columns of the map over the frame.
pub(in crate::calibrate) fn coverage(
    problem: &Problem,
    state: &State,
    weights: &[Vec<f64>],
    scale: &[f64],
    map: &[MapColumns],
) -> (f64, Vec<f64>) {
    const NO_EFFECT: f64 = 1e-10;
    let n = problem.free.len();
    let local = if problem.attitudes == Attitudes::FixedToEarth { 0 } else { 3 };
    let of = |(exposure, weights): (usize, &Vec<f64>)| {
        let (mut seen, mut images) = (Reduced::zero(n), 0_usize);
        let mut sums = FrameSums::new(n, local);
        let mut rows = [[0.0; WIDTH]; 2];
        problem.linearise(state, exposure, |index, row| {
            if weights[index] > 0.5 {
                images += 1;
                for (axis, whole) in rows.iter_mut().enumerate() {
                    for (place, (column, scale)) in whole.iter_mut().zip(row.by_parameter[axis].iter().zip(scale)) {
                        *place = column / scale;
                    }
                    whole[n..n + local].copy_from_slice(&row.by_rotation[axis][..local]);
                    whole[n + local] = row.residual[axis];
                }
                sums.add_both(&rows);
            }
        });
        sums.eliminate(0.0, &mut seen);
        (seen.matrix, images)
    };
    let parts: Vec<_> = parallel::map_numbers(weights.len(), |number| of((number, &weights[number])));
    let (mut seen, mut images) = (DMatrix::<f64>::zeros(n, n), 0_usize);
    for (part, of_part) in parts {
        seen += part;
        images += of_part;
    }
    let mut gram = DMatrix::<f64>::zeros(n, n);
    for column in map.iter().flat_map(|place| &place.columns) {
        for i in 0..n {
            for j in 0..=i {
                gram[(i, j)] += column[i] * column[j];
            }
        }
    }
    // The lower triangle, scaled; the upper one is its mirror image.
    for i in 0..n {
        for j in 0..=i {
            gram[(i, j)] /= scale[i] * scale[j] * map.len() as f64;
            gram[(j, i)] = gram[(i, j)];
        }
    }
    let eigen = gram.symmetric_eigen();
    let smallest = NO_EFFECT * eigen.eigenvalues.max();
    let kept: Vec<usize> = (0..n).filter(|k| eigen.eigenvalues[*k] > smallest).collect();
    if kept.is_empty() {
        return (1.0, vec![0.0; n]);
    }
    let basis =
        DMatrix::from_fn(n, kept.len(), |row, column| eigen.eigenvectors[(row, kept[column])] / eigen.eigenvalues[kept[column]].sqrt());
    let reduced = (basis.transpose() * (seen / images.max(1) as f64) * &basis).symmetric_eigen();
    let (weakest, value) = reduced.eigenvalues.argmin();
    let direction = &basis * reduced.eigenvectors.column(weakest);
    (value.max(0.0).sqrt(), direction.iter().copied().collect())
}
