//! Normal equations of a bundle adjustment, with the attitudes eliminated frame by frame (Schur complement).
//!
//! With the whitened columns C of the parameters that all frames share and D of a frame's own,
//!
//! ```text
//! (Σ_h CᵀC − CᵀD(DᵀD)⁻¹DᵀC)·δ = −Σ_h (Cᵀr − CᵀD(DᵀD)⁻¹Dᵀr),   φ_h = −(DᵀD)⁻¹·(Dᵀr + DᵀC·δ)
//! ```
//! so memory and time grow with the number of star images, never with the square of the number of frames.

use nalgebra::{DMatrix, DVector};

/// The most parameters that one adjustment solves, attitudes not counted.
pub(in crate::calibrate) const MAX_PARAMETERS: usize = 40;
/// Parameters of a frame: its attitude, and its rates where the rows are exposed one after the other.
pub(in crate::calibrate) const MAX_LOCAL: usize = 6;
/// Shared parameters at most: those of the model and a mount's attitude.
const MAX_SHARED: usize = MAX_PARAMETERS + 3;
/// One row of a frame's sums: shared columns, own columns, residual.
pub(super) const WIDTH: usize = MAX_SHARED + MAX_LOCAL + 1;
/// The same of the reference model's six parameters and an attitude.
const USUAL_WIDTH: usize = 6 + 3 + 1;

/// Sums over the star images of one frame.
#[derive(Clone, Debug)]
pub(super) struct FrameSums {
    shared: usize,
    local: usize,
    /// Upper triangle of the products of (C, D, r), row by row, `shared + local + 1` wide.
    sums: Vec<f64>,
    /// What is known beforehand: its part of the sum of squares.
    prior_cost: f64,
}

/// What is kept of a frame to find its own step once the shared one is known.
#[derive(Clone, Debug)]
pub(super) struct Eliminated {
    shared: usize,
    local: usize,
    /// L of V = DᵀD = L·Lᵀ.
    factor: [[f64; MAX_LOCAL]; MAX_LOCAL],
    /// L⁻¹·DᵀC, row by row.
    coupling: Vec<f64>,
    /// L⁻¹·Dᵀr.
    right: [f64; MAX_LOCAL],
}

/// The equations of the shared parameters.
#[derive(Clone, Debug)]
pub(super) struct Reduced {
    /// The matrix.
    pub(super) matrix: DMatrix<f64>,
    /// The right-hand side, −gradient.
    pub(super) right: DVector<f64>,
}

impl FrameSums {
    pub(super) fn new(shared: usize, local: usize) -> Self {
        let width = shared + local + 1;
        Self { shared, local, sums: vec![0.0; width * width], prior_cost: 0.0 }
    }

    /// Adds both whitened rows of a star image as they stand: shared columns, own columns, residual; what is behind does not count.
    pub(super) fn add_both(&mut self, rows: &[[f64; WIDTH]; 2]) {
        match self.shared + self.local + 1 {
            // The reference model with free attitudes: a width known beforehand is worth its own code.
            USUAL_WIDTH => Self::add_of_width(&mut self.sums, rows, USUAL_WIDTH),
            width => Self::add_of_width(&mut self.sums, rows, width),
        }
    }

    #[inline]
    fn add_of_width(sums: &mut [f64], [first, second]: &[[f64; WIDTH]; 2], width: usize) {
        for (i, line) in sums.chunks_exact_mut(width).enumerate() {
            let (a, b) = (first[i], second[i]);
            for ((sum, x), y) in line[i..].iter_mut().zip(&first[i..width]).zip(&second[i..width]) {
                *sum += a * x + b * y;
            }
        }
    }

    /// Adds what is known of a parameter beforehand: `at` counts the shared ones first, then the frame's own.
    pub(super) fn add_known(&mut self, at: usize, weight: f64, residual: f64) {
        let width = self.shared + self.local + 1;
        self.sums[at * width + at] += weight;
        self.sums[at * width + width - 1] += weight * residual;
        self.prior_cost += weight * residual * residual;
    }

    /// The part that [`Self::add_known`] has in the sum of squares.
    pub(super) fn prior_cost(&self) -> f64 {
        self.prior_cost
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        let (i, j) = if i <= j { (i, j) } else { (j, i) };
        self.sums[i * (self.shared + self.local + 1) + j]
    }

    /// Takes the frame's own parameters out and adds what is left to the equations of the shared ones. `damping` is added to the
    /// diagonal, relative to it. `None` if the frame's stars leave its own parameters open.
    pub(super) fn eliminate(&self, damping: f64, into: &mut Reduced) -> Option<Eliminated> {
        let (shared, local) = (self.shared, self.local);
        let last = shared + local;
        let mut factor = [[0.0; MAX_LOCAL]; MAX_LOCAL];
        for i in 0..local {
            for j in 0..=i {
                let damped = if i == j { 1.0 + damping } else { 1.0 };
                let mut sum = damped * self.at(shared + i, shared + j);
                sum -= (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
                if i == j {
                    if sum.is_nan() || sum <= 1e-13 * self.at(shared + i, shared + i) {
                        return None;
                    }
                    factor[i][i] = sum.sqrt();
                } else {
                    factor[i][j] = sum / factor[j][j];
                }
            }
        }
        let mut coupling = vec![0.0; local * shared];
        let mut right = [0.0; MAX_LOCAL];
        for i in 0..local {
            for column in 0..shared {
                let mut sum = self.at(column, shared + i);
                for k in 0..i {
                    sum -= factor[i][k] * coupling[k * shared + column];
                }
                coupling[i * shared + column] = sum / factor[i][i];
            }
            let mut sum = self.at(shared + i, last);
            for k in 0..i {
                sum -= factor[i][k] * right[k];
            }
            right[i] = sum / factor[i][i];
        }
        for i in 0..shared {
            for j in i..shared {
                let damped = if i == j { 1.0 + damping } else { 1.0 };
                let eliminated: f64 = (0..local).map(|k| coupling[k * shared + i] * coupling[k * shared + j]).sum();
                let value = damped * self.at(i, j) - eliminated;
                into.matrix[(i, j)] += value;
                if i != j {
                    into.matrix[(j, i)] += value;
                }
            }
            let eliminated: f64 = (0..local).map(|k| coupling[k * shared + i] * right[k]).sum();
            into.right[i] -= self.at(i, last) - eliminated;
        }
        Some(Eliminated { shared, local, factor, coupling, right })
    }

    /// The own matrix DᵀD: information on the attitude with everything else held.
    pub(super) fn own(&self) -> nalgebra::Matrix3<f64> {
        nalgebra::Matrix3::from_fn(|i, j| if self.local >= 3 { self.at(self.shared + i, self.shared + j) } else { 0.0 })
    }
}

impl Eliminated {
    /// The frame's own step after the shared one.
    pub(super) fn own_step(&self, shared_step: &DVector<f64>) -> [f64; MAX_LOCAL] {
        let mut step = [0.0; MAX_LOCAL];
        for i in (0..self.local).rev() {
            let coupled: f64 = (0..self.shared).map(|k| self.coupling[i * self.shared + k] * shared_step[k]).sum();
            let mut sum = -self.right[i] - coupled;
            sum -= (i + 1..self.local).map(|k| self.factor[k][i] * step[k]).sum::<f64>();
            step[i] = sum / self.factor[i][i];
        }
        step
    }
}

impl Reduced {
    pub(super) fn zero(shared: usize) -> Self {
        Self { matrix: DMatrix::zeros(shared, shared), right: DVector::zeros(shared) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The step equals that of the whole system solved at once.
    #[test]
    fn elimination_solves_the_whole_system() {
        let (shared, local, frames, rows) = (4, 3, 5, 9);
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let size = shared + local * frames;
        let (mut whole, mut whole_right) = (DMatrix::<f64>::zeros(size, size), DVector::<f64>::zeros(size));
        let mut reduced = Reduced::zero(shared);
        let mut eliminated = Vec::new();
        for frame in 0..frames {
            let mut sums = FrameSums::new(shared, local);
            for _ in 0..rows {
                let mut both = [[0.0; WIDTH]; 2];
                for row in &mut both {
                    row[..=shared + local].fill_with(&mut random);
                    let mut full = DVector::zeros(size);
                    for k in 0..shared {
                        full[k] = row[k];
                    }
                    for k in 0..local {
                        full[shared + frame * local + k] = row[shared + k];
                    }
                    whole += &full * full.transpose();
                    whole_right -= &full * row[shared + local];
                }
                sums.add_both(&both);
            }
            eliminated.push(sums.eliminate(0.0, &mut reduced).unwrap());
        }
        let expected = whole.cholesky().unwrap().solve(&whole_right);
        let step = reduced.matrix.cholesky().unwrap().solve(&reduced.right);
        for k in 0..shared {
            assert!((step[k] - expected[k]).abs() < 1e-10);
        }
        for (frame, eliminated) in eliminated.iter().enumerate() {
            let own = eliminated.own_step(&step);
            for k in 0..local {
                assert!((own[k] - expected[shared + frame * local + k]).abs() < 1e-10, "frame {frame}");
            }
        }
    }
}
