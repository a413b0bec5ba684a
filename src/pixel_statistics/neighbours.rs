//! Correlation of the noise between neighbouring pixels: demosaicking, smoothing, compression.
//!
//! Offsets of rows and columns are taken off first: they are no noise that pixels share by processing. The plane taken out of every block makes neighbours
//! differ: for white noise with the hat matrix H of the fit E[r_i r_j] = −h_ij σ². That share, averaged over a full block, is taken off, and so is that of
//! the means of lines.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lines::{Estimate, FrameLines};
use super::sky_pixels::{BLOCK_PX, SkyPixels};

/// Lags in columns and rows.
const LAGS: [[isize; 2]; 6] = [[1, 0], [0, 1], [1, 1], [1, -1], [2, 0], [0, 2]];
/// Residuals are cut at so many standard deviations: stars that were not found are no correlation of the noise.
const CUT_SIGMAS: f64 = 3.0;

/// Correlation coefficients of pixels at six lags.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NeighbourCorrelation {
    /// One column apart.
    pub column: Estimate,
    /// One row apart.
    pub row: Estimate,
    /// Diagonally, down to the right.
    pub diagonal: Estimate,
    /// Diagonally, up to the right.
    pub antidiagonal: Estimate,
    /// Two columns apart.
    pub two_columns: Estimate,
    /// Two rows apart.
    pub two_rows: Estimate,
}

/// Frames whose neighbours share more of their noise were processed: 0.3 to 0.5 along the axes where colours were interpolated, 0.1 to 0.4 where frames
/// were resampled, above 0.5 on the diagonals where they were smoothed. Raw frames of dense skies reach 0.1 by stars that were not found.
const MIN_PROCESSED: f64 = 0.15;

impl NeighbourCorrelation {
    /// Whether neighbours along both axes, or on both diagonals, share more of their noise than any sky makes them: frames that were demosaicked,
    /// smoothed, resampled or sharpened. A read-out that remembers acts along one axis.
    pub(crate) fn is_of_processing(&self) -> bool {
        let along_both = self.column.value.abs().min(self.row.value.abs());
        let diagonally = self.diagonal.value.abs().min(self.antidiagonal.value.abs());
        along_both.max(diagonally) > MIN_PROCESSED
    }

    /// In the order of the fields.
    #[must_use]
    pub fn all(&self) -> [Estimate; 6] {
        [self.column, self.row, self.diagonal, self.antidiagonal, self.two_columns, self.two_rows]
    }

    fn from_all([column, row, diagonal, antidiagonal, two_columns, two_rows]: [Estimate; 6]) -> Self {
        Self { column, row, diagonal, antidiagonal, two_columns, two_rows }
    }

    /// Of a frame.
    pub(super) fn of_frame(sky: &SkyPixels, lines: &FrameLines) -> Option<Self> {
        let sigma = sky.sigma_dn().filter(|sigma| *sigma > 0.0)?;
        let cut = (CUT_SIGMAS * sigma) as f32;
        let (rest_dn, of_lines) = without_lines(sky, lines);
        let lag = |[dx, dy]: [isize; 2]| -> Option<Estimate> {
            let (mut product, mut first, mut second, mut count) = (0.0, 0.0, 0.0, 0_usize);
            for block in &sky.blocks {
                let [left, top] = block.place.map(|place| place * BLOCK_PX);
                let rows = top..top + BLOCK_PX - dy.unsigned_abs();
                for y in rows {
                    let (own, other) = if dy < 0 { (y + dy.unsigned_abs(), y) } else { (y, y + dy.unsigned_abs()) };
                    let line = |y: usize| &rest_dn[y * sky.width_px + left..y * sky.width_px + left + BLOCK_PX];
                    let reach = dx.unsigned_abs();
                    for (a, b) in line(own).iter().zip(&line(other)[reach..]) {
                        if a.abs() < cut && b.abs() < cut {
                            let (a, b) = (f64::from(*a), f64::from(*b));
                            (product, first, second, count) = (product + a * b, first + a * a, second + b * b, count + 1);
                        }
                    }
                }
            }
            let norm = (first * second).sqrt();
            (count > 256 && norm > 0.0).then(|| Estimate {
                value: product / norm + fitted_share([dx, dy]) + of_lines([dx, dy]),
                sigma: 1.0 / (count as f64).sqrt(),
            })
        };
        let mut all = [Estimate::default(); 6];
        for (estimate, of) in all.iter_mut().zip(LAGS) {
            *estimate = lag(of)?;
        }
        Some(Self::from_all(all))
    }

    /// Of all frames.
    pub(super) fn pooled(frames: &[Self]) -> Option<Self> {
        let mut all = [Estimate::default(); 6];
        for (k, estimate) in all.iter_mut().enumerate() {
            *estimate = Estimate::pooled(&frames.iter().map(|frame| frame.all()[k]).collect::<Vec<_>>())?;
        }
        Some(Self::from_all(all))
    }
}

/// Residuals without the means of rows and columns, row by row, and how much less neighbours of one line share by that.
fn without_lines(sky: &SkyPixels, lines: &FrameLines) -> (Vec<f32>, impl Fn([isize; 2]) -> f64 + use<>) {
    /// A plane has taken two of the degrees of freedom of a block's lines.
    const LEFT_BY_PLANE: f64 = 1.0 - 2.0 / BLOCK_PX as f64;
    let or_zero = |mean: Option<&f32>| mean.copied().filter(|mean| mean.is_finite()).unwrap_or(0.0);
    let rest: Vec<f32> = sky
        .residual_dn
        .chunks(sky.width_px.max(1))
        .enumerate()
        .flat_map(|(y, row)| {
            let of_row = or_zero(lines.row_means.get(y));
            row.iter().zip(&lines.column_means).map(move |(value, of_column)| value - of_row - or_zero(Some(of_column)))
        })
        .collect();
    let known = rest.iter().filter(|value| !value.is_nan()).count() as f64;
    let told = |means: &[f32]| means.iter().filter(|mean| mean.is_finite()).count() as f64;
    let [by_rows, by_columns] = [told(&lines.row_means), told(&lines.column_means)].map(|lines| LEFT_BY_PLANE * lines / known.max(1.0));
    let share = move |[dx, dy]: [isize; 2]| match (dx, dy) {
        (_, 0) => by_rows,
        (0, _) => by_columns,
        _ => 0.0,
    };
    (rest, share)
}

/// Mean element of the hat matrix of the plane's fit between pixels of a full block that are so far apart, over the mean of what it leaves of one.
fn fitted_share([dx, dy]: [isize; 2]) -> f64 {
    let side = BLOCK_PX as f64;
    let count = side * side;
    let spread = side * side * (side * side - 1.0) / 12.0;
    // Mean of x·x' over pairs of one line that are `lag` apart, the middle of the block at zero.
    let along = |lag: usize| {
        let places = (0..BLOCK_PX - lag).map(|k| (k as f64 - (side - 1.0) / 2.0) * ((k + lag) as f64 - (side - 1.0) / 2.0));
        places.sum::<f64>() / (BLOCK_PX - lag) as f64
    };
    let shared = 1.0 / count + (along(dx.unsigned_abs()) + along(dy.unsigned_abs())) / spread;
    shared / (1.0 - 3.0 / count)
}
