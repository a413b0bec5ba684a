//! What every conversion stands on: exact correspondences over the frame, least squares on them, and how far they are met.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::ExchangeError;
use super::view::View;
use crate::camera::Model;
use crate::coordinates::{CameraAxes, Direction, PixelPoint};

/// Points along each side of the grid that is fitted.
pub(super) const FIT_SIDE: usize = 33;
/// Points along each side of the grid on which a fit is judged; all but a few lie between those that were fitted.
pub(super) const CHECK_SIDE: usize = 65;
/// "Beyond the frame" reaches this share of its sides further on every side.
const BORDER: f64 = 0.1;
/// More coefficients are taken until the largest residual over the frame is below this, px.
pub(super) const GOOD_PX: f64 = 1e-3;

/// A point of the frame and the direction, in camera axes, of the light that falls there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    /// Column and row.
    pub(super) pixel_px: [f64; 2],
    /// Unit vector.
    pub(super) direction: [f64; 3],
}

/// How far one camera's points lie from another's at the same directions, px of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Residual {
    /// 2-D rms over the frame, from edge to edge.
    pub rms_px: f64,
    /// Largest over the frame.
    pub max_px: f64,
    /// Largest within a tenth of the frame's sides beyond its edges; absent where one of the two has no image there.
    pub beyond_max_px: Option<f64>,
}

/// `side` × `side` points from edge to edge of the frame (−0.5 to width − 0.5), row by row.
pub(super) fn frame_points(size_px: [usize; 2], side: usize, border: f64) -> Vec<[f64; 2]> {
    let at = |k: usize, length: usize| {
        let share = k as f64 / (side - 1) as f64;
        (share * (1.0 + 2.0 * border) - border) * length as f64 - 0.5
    };
    (0..side * side).map(|k| [at(k % side, size_px[0]), at(k / side, size_px[1])]).collect()
}

/// The camera's own correspondences over the frame, and if it has them there over [`BORDER`] beyond: so that what is fitted stays near it
/// there too.
pub(super) fn pairs(model: &Model, side: usize) -> Result<Vec<Pair>, ExchangeError> {
    pairs_of(&View::of_camera(model), side)
}

/// The same of a camera that may be under a sky.
pub(super) fn pairs_of(view: &View<'_>, side: usize) -> Result<Vec<Pair>, ExchangeError> {
    pairs_to(view, side, BORDER).or_else(|_| pairs_to(view, side, 0.0))
}

fn pairs_to(view: &View<'_>, side: usize, border: f64) -> Result<Vec<Pair>, ExchangeError> {
    let size = [view.model().camera().width_px, view.model().camera().height_px];
    let pair = |pixel_px: [f64; 2]| {
        let direction = view.direction(pixel_px);
        // A direction whose image is another point is beyond a fold.
        let back = direction.and_then(|xyz| view.pixel(xyz));
        let same = back.is_some_and(|back| (back[0] - pixel_px[0]).hypot(back[1] - pixel_px[1]) < 1e-6);
        let [x_px, y_px] = pixel_px;
        let folds = || match view.attitude() {
            None => ExchangeError::Folds { what: "the calibrated camera".to_owned(), x_px, y_px },
            Some(_) => ExchangeError::NoPlace { x_px, y_px },
        };
        direction.filter(|_| same).map(|direction| Pair { pixel_px, direction }).ok_or_else(folds)
    };
    frame_points(size, side, border).into_iter().map(pair).collect()
}

/// The residual of `predict` (direction → pixel) against the directions that `source` gives to the points of the frame.
pub(super) fn residual(
    size_px: [usize; 2],
    source: impl Fn([f64; 2]) -> Option<[f64; 3]>,
    predict: impl Fn([f64; 3]) -> Option<[f64; 2]>,
) -> Residual {
    let distance = |pixel: [f64; 2]| {
        let there = source(pixel).and_then(&predict).filter(|there| there.iter().all(|v| v.is_finite()))?;
        Some((there[0] - pixel[0]).hypot(there[1] - pixel[1]))
    };
    let inside: Vec<f64> =
        frame_points(size_px, CHECK_SIDE, 0.0).into_iter().map(|pixel| distance(pixel).unwrap_or(f64::INFINITY)).collect();
    let mean_square = inside.iter().map(|d| d * d).sum::<f64>() / inside.len() as f64;
    let outside = |pixel: &[f64; 2]| (0..2).any(|k| pixel[k] < -0.5 || pixel[k] > size_px[k] as f64 - 0.5);
    let beyond: Option<Vec<f64>> = frame_points(size_px, FIT_SIDE, BORDER).into_iter().filter(outside).map(distance).collect();
    Residual {
        rms_px: mean_square.sqrt(),
        max_px: inside.into_iter().fold(0.0, f64::max),
        beyond_max_px: beyond.map(|all| all.into_iter().fold(0.0, f64::max)),
    }
}

/// The direction of a pixel as [`residual`] asks for it.
pub(super) fn directions(model: &Model) -> impl Fn([f64; 2]) -> Option<[f64; 3]> + '_ {
    let context = model.reference_context();
    move |[x_px, y_px]| model.direction(PixelPoint { x_px, y_px }, &context).map(|direction| direction.xyz)
}

/// The pixel of a direction as [`residual`] asks for it.
pub(super) fn pixels(model: &Model) -> impl Fn([f64; 3]) -> Option<[f64; 2]> + '_ {
    let context = model.reference_context();
    move |xyz| model.pixel(&Direction::<CameraAxes>::from_unit(xyz), &context).map(|point| [point.x_px, point.y_px])
}

/// Residuals and their derivatives with respect to the free parameters.
pub(super) struct Linearised {
    pub(super) residuals: DVector<f64>,
    pub(super) columns: DMatrix<f64>,
}

/// Levenberg and Marquardt's method: the values of the free parameters that make the sum of squares least. `linearise` gives `None`
/// where the values make no sense; such a step is taken back.
pub(super) fn least_squares(
    start: Vec<f64>,
    what: &'static str,
    linearise: impl Fn(&[f64]) -> Option<Linearised>,
) -> Result<Vec<f64>, ExchangeError> {
    const STEPS: usize = 100;
    const REJECTED: usize = 14;
    let no_fit = || ExchangeError::NoFit { what };
    let mut values = start;
    let mut now = linearise(&values).ok_or_else(no_fit)?;
    let mut damping: f64 = 1e-14;
    let mut rejected = 0;
    for _ in 0..STEPS {
        let cost = now.residuals.norm_squared();
        if !cost.is_finite() {
            return Err(no_fit());
        }
        let step = damped_step(&now, damping).ok_or_else(no_fit)?;
        let moved: Vec<f64> = values.iter().zip(step.iter()).map(|(value, change)| value - change).collect();
        match linearise(&moved).filter(|next| next.residuals.norm_squared() <= cost) {
            Some(next) => {
                let gain = cost - next.residuals.norm_squared();
                values = moved;
                now = next;
                damping = (damping * 0.1).max(1e-14);
                rejected = 0;
                if gain <= 1e-13 * cost || cost < 1e-26 {
                    break;
                }
            }
            None if rejected < REJECTED => {
                rejected += 1;
                damping = (damping * 30.0).max(1e-12);
            }
            None => break, // no step makes it less: the last bits
        }
    }
    Ok(values)
}

/// The step of the damped linear problem, by QR of the columns scaled to length one; two parameters that do the same share it.
fn damped_step(at: &Linearised, damping: f64) -> Option<DVector<f64>> {
    let (rows, count) = at.columns.shape();
    let lengths: Vec<f64> = at.columns.column_iter().map(|column| column.norm()).map(|n| if n > 0.0 { n } else { 1.0 }).collect();
    let scaled = DMatrix::from_fn(rows + count, count, |row, column| match row.checked_sub(rows) {
        None => at.columns[(row, column)] / lengths[column],
        Some(below) if below == column => damping.sqrt(),
        Some(_) => 0.0,
    });
    let mut right = DVector::zeros(rows + count);
    right.rows_mut(0, rows).copy_from(&at.residuals);
    let qr = scaled.qr();
    qr.q_tr_mul(&mut right);
    let solution = qr.unpack_r().solve_upper_triangular(&right.rows(0, count).into_owned())?;
    let step = DVector::from_iterator(count, solution.iter().zip(&lengths).map(|(value, length)| value / length));
    step.iter().all(|value| value.is_finite()).then_some(step)
}

/// Coefficients of the monomials xᵖ·yᵠ whose sum is nearest to `targets` at `points`, in the units of both; the points may be of any size.
pub(super) fn polynomial(
    exponents: &[(i32, i32)],
    points: &[[f64; 2]],
    targets: &[f64],
    what: &'static str,
) -> Result<Vec<f64>, ExchangeError> {
    let unit = points.iter().flatten().fold(0.0, |most: f64, value| most.max(value.abs()));
    let columns = DMatrix::from_fn(points.len(), exponents.len(), |row, column| {
        let [x, y] = points[row].map(|value| value / unit);
        x.powi(exponents[column].0) * y.powi(exponents[column].1)
    });
    let residuals = -DVector::from_row_slice(targets);
    let mut total = DVector::zeros(exponents.len());
    // A second pass on what the first left takes away its rounding.
    for _ in 0..2 {
        let left = &residuals + &columns * &total;
        total -= damped_step(&Linearised { residuals: left, columns: columns.clone() }, 0.0).ok_or(ExchangeError::NoFit { what })?;
    }
    Ok(total.iter().zip(exponents).map(|(value, (p, q))| value / unit.powi(p + q)).collect())
}
