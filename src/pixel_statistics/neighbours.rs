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

/// Of the means of lines a plane has taken two degrees of freedom of those of every block already.
const LEFT_BY_PLANE: f64 = 1.0 - 2.0 / BLOCK_PX as f64;
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
        let mut products = [Products::default(); 6];
        let mut known = 0_usize;
        for block in &sky.blocks {
            let [left, top] = block.place.map(|place| place * BLOCK_PX);
            let mut rest_dn = [[0.0_f32; BLOCK_PX]; BLOCK_PX];
            for (y, row) in rest_dn.iter_mut().enumerate() {
                for (x, rest) in row.iter_mut().enumerate() {
                    let at = [left + x, top + y];
                    *rest = sky.residual_dn[at[1] * sky.width_px + at[0]] - lines.of_pixel(at);
                    known += usize::from(!rest.is_nan());
                }
            }
            for (products, lag) in products.iter_mut().zip(LAGS) {
                products.add(&rest_dn, lag, cut);
            }
        }
        let mut all = [Estimate::default(); 6];
        for ((estimate, products), lag) in all.iter_mut().zip(products).zip(LAGS) {
            let of_lines = LEFT_BY_PLANE * lines.told_along(lag) as f64 / known.max(1) as f64;
            *estimate = products.correlation(fitted_share(lag) + of_lines)?;
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

/// Sums over the pairs of pixels at one lag.
#[derive(Clone, Copy, Debug, Default)]
struct Products {
    product: f64,
    squares: [f64; 2],
    count: usize,
}

impl Products {
    /// Adds the pairs of a block of which both are below the cut.
    fn add(&mut self, rest_dn: &[[f32; BLOCK_PX]; BLOCK_PX], [dx, dy]: [isize; 2], cut: f32) {
        let reach = [dx, dy].map(isize::unsigned_abs);
        for y in 0..BLOCK_PX - reach[1] {
            let (own, other) = if dy < 0 { (y + reach[1], y) } else { (y, y + reach[1]) };
            for (a, b) in rest_dn[own].iter().zip(&rest_dn[other][reach[0]..]) {
                if a.abs() < cut && b.abs() < cut {
                    let (a, b) = (f64::from(*a), f64::from(*b));
                    self.product += a * b;
                    self.squares = [self.squares[0] + a * a, self.squares[1] + b * b];
                    self.count += 1;
                }
            }
        }
    }

    /// The correlation, with what was taken out of neighbours put back; nothing of few pairs.
    fn correlation(&self, taken: f64) -> Option<Estimate> {
        let norm = (self.squares[0] * self.squares[1]).sqrt();
        (self.count > 256 && norm > 0.0).then(|| Estimate { value: self.product / norm + taken, sigma: 1.0 / (self.count as f64).sqrt() })
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
