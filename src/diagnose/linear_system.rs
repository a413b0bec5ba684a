//! The star images as one linear problem: whitened residuals, and columns of attitudes, camera and effects. [`super::linear_fit`] solves it.

use nalgebra::{DMatrix, DMatrixView};

/// Numbers of both axes of all star images: x, y, x, y, …
pub(super) type Whitened = Vec<f64>;

/// Columns whose rest is smaller than this share of them are taken for linear combinations of those before.
pub(super) const DEPENDENT: f64 = 1e-7;

/// The linear problem.
#[derive(Clone, Debug, Default)]
pub(super) struct WhitenedSystem {
    /// Place of each image's frame among the frames.
    pub(super) frame: Vec<usize>,
    /// Frames.
    pub(super) frames: usize,
    /// Whitened residuals at the point of linearisation.
    pub(super) residual: Whitened,
    /// Whitened columns of the frames' nuisance parameters.
    pub(super) own: Vec<Whitened>,
    /// Whitened columns of the camera's free parameters.
    pub(super) camera: Vec<Whitened>,
    /// ν; infinite for normal errors.
    pub(super) tail_degrees: f64,
}

impl WhitenedSystem {
    /// Star images.
    pub(super) fn images(&self) -> usize {
        self.frame.len()
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four sums at once: the compiler may not reorder one.
    let mut sums = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a4.remainder().iter().zip(b4.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in a4.zip(b4) {
        for k in 0..4 {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f64>() + rest
}

pub(super) fn subtract(from: &mut [f64], factor: f64, what: &[f64]) {
    for (a, b) in from.iter_mut().zip(what) {
        *a -= factor * b;
    }
}

/// A column on the images taken, zero elsewhere.
pub(super) fn masked(column: &[f64], take: &[bool]) -> Whitened {
    let mut own = column.to_vec();
    mask(&mut own, take);
    own
}

pub(super) fn mask(column: &mut [f64], take: &[bool]) {
    for (pair, _) in column.chunks_exact_mut(2).zip(take).filter(|(_, take)| !**take) {
        pair.fill(0.0);
    }
}

/// aᵀ·b. The library's own product with a transposed matrix is a loop of single products, many times slower.
pub(super) fn products(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    const FEW: usize = 5;
    // Of few rows the library takes another way, which reads beyond the end of a view with strides.
    if a.ncols() <= FEW || b.ncols() <= FEW || a.nrows() <= FEW {
        let columns = |matrix: &DMatrix<f64>, k: usize| matrix.nrows() * k..matrix.nrows() * (k + 1);
        return DMatrix::from_fn(a.ncols(), b.ncols(), |i, j| dot(&a.as_slice()[columns(a, i)], &b.as_slice()[columns(b, j)]));
    }
    let turned = DMatrixView::from_slice_with_strides(a.as_slice(), a.ncols(), a.nrows(), a.nrows(), 1);
    turned * b
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of any shape, those with few rows too.
    #[test]
    fn products_are_those_of_the_columns() {
        for (rows, columns) in [(3, 8), (0, 7), (40, 9), (12, 2)] {
            let a = DMatrix::from_fn(rows, columns, |i, j| (i * 7 + j * 3) as f64 % 5.0 - 1.5);
            let b = DMatrix::from_fn(rows, columns + 1, |i, j| (i * 2 + j * 5) as f64 % 7.0 - 2.0);
            let found = products(&a, &b);
            for i in 0..columns {
                for j in 0..=columns {
                    let sum: f64 = (0..rows).map(|k| a[(k, i)] * b[(k, j)]).sum();
                    assert!((found[(i, j)] - sum).abs() < 1e-12, "{rows} × {columns} at {i}, {j}");
                }
            }
        }
    }
}
