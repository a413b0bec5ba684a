//! Other ways to mend the same recordings, without naming anything: k2 and k3 with clipped outliers, a polynomial of the seventh degree, and
//! LASSO on a list of columns. All start from the joint calibration, are fitted on the frames that the diagnosis did not set aside, and are
//! judged on those that it did, attitudes refitted.

use serde::{Deserialize, Serialize};

use super::lasso::lasso;
use crate::calibrate::{CalibrateOptions, calibrate, residuals_px};
use crate::identify::ControlPoints;

/// Held-out χ² per degree of freedom, with the declared errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RivalFits {
    /// x0, y0, f, k1, p1, p2 alone.
    pub baseline: f64,
    /// With k2 and k3, outliers beyond 3.5σ clipped.
    pub radial_clipped: f64,
    /// With all displacements of up to the seventh degree in x and y.
    pub polynomial: f64,
    /// LASSO on the same library.
    pub lasso: Option<f64>,
    /// What LASSO names.
    pub lasso_names: Option<Vec<String>>,
}

/// A row pair: a star image that the linear fits use.
struct Row {
    frame: usize,
    x: f64,
    y: f64,
    residual: [f64; 2],
    sigma: f64,
}

/// Outliers are clipped beyond this many standard errors.
const CLIP: f64 = 3.5;
/// Degree of the polynomial.
const DEGREE: i32 = 7;
/// Ridge that keeps what cannot be determined from growing.
const RIDGE: f64 = 1e-9;

/// The rivals on control points whose model contains the effects `known`, judged on these frames. `None` if there is no calibration to start from.
#[must_use]
pub fn rival_fits(points: &ControlPoints, known: &[String], held_out: &[usize]) -> Option<RivalFits> {
    let options = CalibrateOptions { held_out: false, leave_out_imprecise: false, ..CalibrateOptions::default() };
    let calibration = calibrate(points, &options).ok()?;
    let camera = calibration.camera;
    let half = camera.width_px as f64 / 2.0;
    let [x0, y0] = camera.principal_point_px;
    let rows: Vec<Row> = residuals_px(&calibration, &camera)
        .into_iter()
        .zip(&calibration.control_points.points)
        .filter_map(|(residual, point)| {
            let sigma = point.covariance_px2[0].sqrt().hypot(camera.focal_length_px * point.catalog_sigma_rad);
            // What identification would reject: far beyond anything that is looked for.
            let residual = residual.filter(|r| r[0].hypot(r[1]) < 30.0 * sigma + 1.0)?;
            Some(Row { frame: point.frame, x: (point.x_px - x0) / half, y: (point.y_px - y0) / half, residual, sigma })
        })
        .collect();
    let f = camera.focal_length_px / half;
    let (test, train): (Vec<Row>, Vec<Row>) = rows.into_iter().partition(|row| held_out.contains(&row.frame));
    let base = |row: &Row| -> Vec<[f64; 2]> {
        let (x, y) = (row.x, row.y);
        let r2 = x * x + y * y;
        vec![[1.0, 0.0], [0.0, 1.0], [x, y], [r2 * x, r2 * y], [r2 + 2.0 * x * x, 2.0 * x * y], [2.0 * x * y, r2 + 2.0 * y * y]]
    };
    let radial = |row: &Row| -> Vec<[f64; 2]> {
        let r2 = row.x * row.x + row.y * row.y;
        let mut columns = base(row);
        columns.extend([[r2 * r2 * row.x, r2 * r2 * row.y], [r2.powi(3) * row.x, r2.powi(3) * row.y]]);
        columns
    };
    let polynomial = |row: &Row| -> Vec<[f64; 2]> {
        let term = |i: i32, j: i32| legendre(i, row.x) * legendre(j, row.y);
        let terms = (0..=DEGREE).flat_map(|total| (0..=total).map(move |j| (total - j, j)));
        terms.flat_map(|(i, j)| [[term(i, j), 0.0], [0.0, term(i, j)]]).collect()
    };
    let judge = |columns: &dyn Fn(&Row) -> Vec<[f64; 2]>, clip: bool| -> Option<f64> {
        let solution = fit(&train, columns, f, clip)?;
        chi2_per_dof(&test, columns, f, &solution)
    };
    let lasso = lasso(points, known, held_out);
    Some(RivalFits {
        baseline: judge(&base, false)?,
        radial_clipped: judge(&radial, true)?,
        polynomial: judge(&polynomial, false)?,
        lasso: lasso.as_ref().map(|lasso| lasso.held_out),
        lasso_names: lasso.map(|lasso| lasso.names),
    })
}

/// Legendre polynomial, by its recurrence.
fn legendre(degree: i32, x: f64) -> f64 {
    let (mut before, mut now) = (1.0, x);
    if degree == 0 {
        return before;
    }
    for n in 1..degree {
        let n = f64::from(n);
        (before, now) = (now, ((2.0 * n + 1.0) * x * now - n * before) / (n + 1.0));
    }
    now
}

/// Columns of a frame's attitude, lengths in half widths.
fn turns(row: &Row, f: f64) -> [[f64; 2]; 3] {
    let (x, y) = (row.x, row.y);
    [[x * y / f, f + y * y / f], [f + x * x / f, x * y / f], [y, -x]]
}

/// By frame: the rows of the frame.
fn by_frame(rows: &[Row]) -> Vec<Vec<&Row>> {
    let mut frames: Vec<Vec<&Row>> = Vec::new();
    for row in rows {
        match frames.last_mut() {
            Some(frame) if frame[0].frame == row.frame => frame.push(row),
            _ => frames.push(vec![row]),
        }
    }
    frames
}

/// Whitened columns and right side of a frame's rows, attitude taken out (three orthonormal columns).
fn reduced(frame: &[&Row], columns: &dyn Fn(&Row) -> Vec<[f64; 2]>, f: f64) -> Vec<Vec<f64>> {
    let whiten =
        |field: &dyn Fn(&Row) -> [f64; 2]| -> Vec<f64> { frame.iter().flat_map(|row| field(row).map(|value| value / row.sigma)).collect() };
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for turn in 0..3 {
        let mut column = whiten(&|row| turns(row, f)[turn]);
        let before = dot(&column, &column);
        clean(&mut column, &basis);
        let length = dot(&column, &column).sqrt();
        if length * length > 1e-14 * before {
            basis.push(column.into_iter().map(|value| value / length).collect());
        }
    }
    let count = frame.first().map_or(0, |row| columns(row).len());
    let mut whole: Vec<Vec<f64>> = vec![Vec::with_capacity(2 * frame.len()); count + 1];
    for row in frame {
        for (k, column) in columns(row).iter().enumerate() {
            whole[k].extend(column.map(|value| value / row.sigma));
        }
        whole[count].extend(row.residual.map(|value| value / row.sigma));
    }
    for column in &mut whole {
        clean(column, &basis);
    }
    whole
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn clean(column: &mut [f64], basis: &[Vec<f64>]) {
    for unit in basis {
        let share = dot(column, unit);
        for (value, direction) in column.iter_mut().zip(unit) {
            *value -= share * direction;
        }
    }
}

/// The coefficients that fit the rows best.
fn fit(rows: &[Row], columns: &dyn Fn(&Row) -> Vec<[f64; 2]>, f: f64, clip: bool) -> Option<Vec<f64>> {
    let count = columns(rows.first()?).len();
    let mut kept: Vec<bool> = vec![true; rows.len()];
    let mut solution = vec![0.0; count];
    for _ in 0..if clip { 4 } else { 1 } {
        let mut matrix = nalgebra::DMatrix::<f64>::zeros(count, count);
        let mut right = nalgebra::DVector::<f64>::zeros(count);
        let chosen: Vec<&Row> = rows.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(row, _)| row).collect();
        for frame in chosen.chunk_by(|a, b| a.frame == b.frame).filter(|frame| frame.len() >= 3) {
            let whole = reduced(frame, columns, f);
            for i in 0..count {
                for j in 0..=i {
                    matrix[(i, j)] += dot(&whole[i], &whole[j]);
                }
                right[i] += dot(&whole[i], &whole[count]);
            }
        }
        for i in 0..count {
            for j in 0..i {
                matrix[(j, i)] = matrix[(i, j)];
            }
        }
        let largest = matrix.diagonal().max();
        for i in 0..count {
            matrix[(i, i)] += RIDGE * largest;
        }
        solution = matrix.cholesky()?.solve(&right).iter().copied().collect();
        if clip {
            let left = remainders(rows, columns, f, &solution);
            kept = left.iter().map(|r| r[0].hypot(r[1]) < CLIP * std::f64::consts::SQRT_2).collect();
        }
    }
    Some(solution)
}

/// What is left of each row, in standard errors, attitudes refitted.
fn remainders(rows: &[Row], columns: &dyn Fn(&Row) -> Vec<[f64; 2]>, f: f64, solution: &[f64]) -> Vec<[f64; 2]> {
    let mut left = Vec::with_capacity(rows.len());
    for frame in by_frame(rows) {
        let whole = reduced(&frame, columns, f);
        let count = solution.len();
        for k in 0..frame.len() {
            left.push([0, 1].map(|axis| {
                let at = 2 * k + axis;
                whole[count][at] - (0..count).map(|c| solution[c] * whole[c][at]).sum::<f64>()
            }));
        }
    }
    left
}

fn chi2_per_dof(rows: &[Row], columns: &dyn Fn(&Row) -> Vec<[f64; 2]>, f: f64, solution: &[f64]) -> Option<f64> {
    let chi2: f64 = remainders(rows, columns, f, solution).iter().map(|r| r[0] * r[0] + r[1] * r[1]).sum();
    let dof: usize = by_frame(rows).iter().map(|frame| (2 * frame.len()).saturating_sub(3)).sum();
    (dof > 0).then(|| chi2 / dof as f64)
}
