//! Correlation of the noise between neighbouring pixels: demosaicking, smoothing, compression.
//!
//! The plane taken out of every block makes neighbours differ: for white noise with the hat matrix H of the fit E[r_i r_j] = −h_ij σ². That
//! share, averaged over a full block, is taken off.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lines::Estimate;
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

/// Neighbours along rows and columns alike share no more of their noise than this by stars that were not found.
const MAX_SHARED: f64 = 0.02;

impl NeighbourCorrelation {
    /// Whether neighbours along both axes share more of their noise than any sky makes them: frames that were demosaicked, smoothed, resampled or sharpened.
    /// Offsets of lines, and a read-out that remembers, act along one axis.
    pub(crate) fn is_of_processing(&self) -> bool {
        self.column.value.abs().min(self.row.value.abs()) > MAX_SHARED
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
    pub(super) fn of_frame(sky: &SkyPixels) -> Option<Self> {
        let sigma = sky.sigma_dn().filter(|sigma| *sigma > 0.0)?;
        let cut = (CUT_SIGMAS * sigma) as f32;
        let lag = |[dx, dy]: [isize; 2]| -> Option<Estimate> {
            let (mut product, mut first, mut second, mut count) = (0.0, 0.0, 0.0, 0_usize);
            for block in &sky.blocks {
                let [left, top] = block.place.map(|place| place * BLOCK_PX);
                let rows = top..top + BLOCK_PX - dy.unsigned_abs();
                for y in rows {
                    let (own, other) = if dy < 0 { (y + dy.unsigned_abs(), y) } else { (y, y + dy.unsigned_abs()) };
                    let line = |y: usize| &sky.residual_dn[y * sky.width_px + left..y * sky.width_px + left + BLOCK_PX];
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
            (count > 256 && norm > 0.0)
                .then(|| Estimate { value: product / norm + fitted_share([dx, dy]), sigma: 1.0 / (count as f64).sqrt() })
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
