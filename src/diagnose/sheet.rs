//! The star images as one linear problem: whitened residuals and columns, attitudes and camera projected out, robustly.
//!
//! With r the whitened residuals (two for each star image), D_h a frame's own columns (its attitude) and B the shared ones (camera, and
//! effects already accepted), a fit minimises Σ ρ(|r_i|) over all of them, ρ that of a two-dimensional t distribution:
//!
//! ```text
//! ψ_i = w_i·r_i,  w = (ν + 2)/(ν + |r_i|²);   r ← r − Π·ψ/d,  d = mean of ∂ψ/∂r;   Π = projector on (D, B)
//! ```
//! At its end Πψ = 0, and the score of any further column a is aᵀψ = (Ma)ᵀψ with M = 1 − Π and variance c·|Ma|², c = mean of ψ²: one
//! projection of each column serves all tests. No star is clipped: a star far off pulls by a bounded amount, and pulls fully again once an
//! effect explains where it is. Source: Huber, Robust Statistics (1981), 7.8 (pseudo-values); Lange, Little and Taylor, J. Am. Stat. Assoc.
//! 84, 881 (1989), for t.

use nalgebra::{DMatrix, DVector};

/// Numbers of both axes of all star images: x, y, x, y, …
pub(super) type Whitened = Vec<f64>;

/// Columns whose rest is smaller than this share of them are taken for linear combinations of those before.
const DEPENDENT: f64 = 1e-7;

/// The linear problem.
#[derive(Clone, Debug, Default)]
pub(super) struct Sheet {
    /// Place of each image's frame among the frames.
    pub(super) frame: Vec<usize>,
    /// Frames.
    pub(super) frames: usize,
    /// Whitened residuals at the point of linearisation.
    pub(super) residual: Whitened,
    /// Whitened own columns.
    pub(super) own: Vec<Whitened>,
    /// Whitened columns of the camera's free parameters.
    pub(super) camera: Vec<Whitened>,
    /// ν; infinite for normal errors.
    pub(super) tail_degrees: f64,
}

impl Sheet {
    /// Star images.
    pub(super) fn images(&self) -> usize {
        self.frame.len()
    }
}

/// A fit of some of the images.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    take: Vec<bool>,
    local: Vec<Whitened>,
    /// Orthonormal basis of the shared columns, own columns projected out.
    basis: Vec<Whitened>,
    /// Coefficients of the shared columns for each basis vector.
    mixing: DMatrix<f64>,
    /// Change of the shared parameters from the point of linearisation: camera first, then the others.
    pub(super) change: DVector<f64>,
    /// Residuals after the fit.
    pub(super) residual: Whitened,
    /// Residuals times weights.
    pub(super) psi: Whitened,
    /// Mean of ψ² per number, degrees of freedom counted.
    pub(super) c: f64,
    /// Mean of ∂ψ/∂r.
    pub(super) d: f64,
    /// Numbers minus parameters.
    pub(super) degrees: f64,
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

fn subtract(from: &mut [f64], factor: f64, what: &[f64]) {
    for (a, b) in from.iter_mut().zip(what) {
        *a -= factor * b;
    }
}

/// The weight of a residual with square `q`.
pub(super) fn weight(tail_degrees: f64, q: f64) -> f64 {
    if tail_degrees.is_finite() { (tail_degrees + 2.0) / (tail_degrees + q) } else { 1.0 }
}

impl Fit {
    /// Fits attitudes, camera and `more` columns to the images taken.
    pub(super) fn new(sheet: &Sheet, take: &[bool], more: &[&Whitened]) -> Self {
        let mut fit = Self {
            take: take.to_vec(),
            local: local_basis(sheet, take),
            basis: Vec::new(),
            mixing: DMatrix::zeros(0, 0),
            change: DVector::zeros(0),
            residual: Vec::new(),
            psi: Vec::new(),
            c: 1.0,
            d: 1.0,
            degrees: 1.0,
        };
        let shared: Vec<&Whitened> = sheet.camera.iter().chain(more.iter().copied()).collect();
        fit.set_shared(sheet, &shared);
        fit.solve(sheet);
        fit
    }

    fn masked(&self, column: &[f64]) -> Whitened {
        column.iter().enumerate().map(|(k, value)| if self.take[k / 2] { *value } else { 0.0 }).collect()
    }

    fn set_shared(&mut self, sheet: &Sheet, shared: &[&Whitened]) {
        let count = shared.len();
        let projected: Vec<Whitened> = shared.iter().map(|column| self.without_own(sheet, column)).collect();
        let length: Vec<f64> = projected.iter().map(|column| dot(column, column).sqrt()).collect();
        let raw: Vec<f64> = shared.iter().map(|column| dot(column, column).sqrt()).collect();
        let scale: Vec<f64> =
            (0..count).map(|k| if length[k] > DEPENDENT * raw[k] && length[k] > 0.0 { 1.0 / length[k] } else { 0.0 }).collect();
        let gram = DMatrix::from_fn(count, count, |i, j| scale[i] * scale[j] * dot(&projected[i], &projected[j]));
        let eigen = gram.symmetric_eigen();
        let kept: Vec<usize> = (0..count).filter(|k| eigen.eigenvalues[*k] > 1e-10).collect();
        self.mixing =
            DMatrix::from_fn(count, kept.len(), |i, j| scale[i] * eigen.eigenvectors[(i, kept[j])] / eigen.eigenvalues[kept[j]].sqrt());
        self.basis = (0..kept.len())
            .map(|j| {
                let mut vector = vec![0.0; 2 * sheet.images()];
                for (i, column) in projected.iter().enumerate() {
                    subtract(&mut vector, -self.mixing[(i, j)], column);
                }
                vector
            })
            .collect();
    }

    fn solve(&mut self, sheet: &Sheet) {
        const TURNS: usize = 30;
        let taken = self.take.iter().filter(|take| **take).count();
        let own: usize = self.local.len() * self.frames_taken(sheet);
        self.degrees = (2.0 * taken as f64 - own as f64 - self.basis.len() as f64).max(1.0);
        let mut residual = self.masked(&sheet.residual);
        let mut moved = DVector::zeros(self.basis.len());
        let nu = sheet.tail_degrees;
        for turn in 0..TURNS {
            let (psi, d) = psi_of(&residual, &self.take, nu);
            self.d = if turn == 0 { 1.0 } else { d };
            let mut step = psi;
            let kept = step.clone();
            let along: Vec<f64> = self.basis.iter().map(|basis| dot(basis, &step)).collect();
            self.take_out_own(sheet, &mut step);
            for (along, basis) in along.iter().zip(&self.basis) {
                subtract(&mut step, *along, basis);
            }
            // What was taken out of ψ is Πψ.
            let mut largest = 0.0_f64;
            for k in 0..residual.len() {
                let part = (kept[k] - step[k]) / self.d;
                residual[k] -= part;
                largest = largest.max(part.abs());
            }
            for (k, along) in along.iter().enumerate() {
                moved[k] -= along / self.d;
            }
            if largest < 1e-6 && turn > 0 {
                break;
            }
        }
        let (psi, d) = psi_of(&residual, &self.take, nu);
        self.c = dot(&psi, &psi) / self.degrees;
        self.d = d;
        self.change = &self.mixing * moved;
        self.residual = residual;
        self.psi = psi;
    }

    fn frames_taken(&self, sheet: &Sheet) -> usize {
        let mut seen = vec![false; sheet.frames];
        for (frame, _) in sheet.frame.iter().zip(&self.take).filter(|(_, take)| **take) {
            seen[*frame] = true;
        }
        seen.into_iter().filter(|seen| *seen).count()
    }

    /// Takes the own columns out of a masked column.
    fn take_out_own(&self, sheet: &Sheet, column: &mut [f64]) {
        take_out_own(sheet, &self.local, column);
    }

    fn without_own(&self, sheet: &Sheet, column: &[f64]) -> Whitened {
        let mut masked = self.masked(column);
        self.take_out_own(sheet, &mut masked);
        masked
    }

    /// M·a: what attitudes, camera and accepted effects leave of a column, on the images taken.
    pub(super) fn project(&self, sheet: &Sheet, column: &[f64]) -> Whitened {
        let mut rest = self.without_own(sheet, column);
        // Twice: a column that is nearly all taken up leaves its rounding errors after the first time.
        for _ in 0..2 {
            for basis in &self.basis {
                let along = dot(basis, &rest);
                subtract(&mut rest, along, basis);
            }
        }
        rest
    }

    /// Σ|a|² of a column over the images taken.
    pub(super) fn length_squared(&self, column: &[f64]) -> f64 {
        column.iter().enumerate().filter(|(k, _)| self.take[k / 2]).map(|(_, value)| value * value).sum()
    }

    /// Covariance of the shared parameters.
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        &self.mixing * self.mixing.transpose() * (self.c / (self.d * self.d))
    }

    /// The same fit with another's noise.
    pub(super) fn with_noise_of(self, other: &Self) -> Self {
        Self { c: other.c, ..self }
    }
}

/// −2·ln of the density over its value at zero, summed over the images taken.
pub(super) fn cost(residual: &[f64], take: &[bool], tail_degrees: f64) -> f64 {
    let of = |k: usize| {
        let q = residual[2 * k].powi(2) + residual[2 * k + 1].powi(2);
        if tail_degrees.is_finite() { (tail_degrees + 2.0) * (q / tail_degrees).ln_1p() } else { q }
    };
    (0..take.len()).filter(|k| take[*k]).map(of).sum()
}

/// ψ and the mean of its derivative.
pub(super) fn psi_of(residual: &[f64], take: &[bool], tail_degrees: f64) -> (Whitened, f64) {
    let mut psi = vec![0.0; residual.len()];
    let (mut slope, mut count) = (0.0, 0.0);
    for k in (0..take.len()).filter(|k| take[*k]) {
        let q = residual[2 * k].powi(2) + residual[2 * k + 1].powi(2);
        let w = weight(tail_degrees, q);
        psi[2 * k] = w * residual[2 * k];
        psi[2 * k + 1] = w * residual[2 * k + 1];
        slope += if tail_degrees.is_finite() { w * tail_degrees / (tail_degrees + q) } else { 1.0 };
        count += 1.0;
    }
    (psi, if count > 0.0 { slope / count } else { 1.0 })
}

/// Residuals of the images taken with every parameter but the own ones held: the attitudes are refitted, robustly.
pub(super) fn refit_own(sheet: &Sheet, take: &[bool], residual: &[f64]) -> Whitened {
    let local = local_basis(sheet, take);
    let mut rest: Whitened = residual.iter().enumerate().map(|(k, value)| if take[k / 2] { *value } else { 0.0 }).collect();
    for turn in 0..20 {
        // Least squares first: with the shared parameters of other frames a whole frame may stand tens of σ off, where ψ is all tail.
        let (psi, d) = if turn == 0 { (rest.clone(), 1.0) } else { psi_of(&rest, take, sheet.tail_degrees) };
        let mut step = psi.clone();
        take_out_own(sheet, &local, &mut step);
        let mut largest = 0.0_f64;
        for k in 0..rest.len() {
            let part = (psi[k] - step[k]) / d;
            rest[k] -= part;
            largest = largest.max(part.abs());
        }
        if largest < 1e-6 {
            break;
        }
    }
    rest
}

/// M_own·a on the images taken.
pub(super) fn project_own(sheet: &Sheet, take: &[bool], column: &[f64]) -> Whitened {
    let local = local_basis(sheet, take);
    let mut rest: Whitened = column.iter().enumerate().map(|(k, value)| if take[k / 2] { *value } else { 0.0 }).collect();
    take_out_own(sheet, &local, &mut rest);
    rest
}

/// The own columns, orthonormal within each frame.
fn local_basis(sheet: &Sheet, take: &[bool]) -> Vec<Whitened> {
    let mut basis: Vec<Whitened> = Vec::new();
    for column in &sheet.own {
        let mut vector: Whitened = column.iter().enumerate().map(|(k, value)| if take[k / 2] { *value } else { 0.0 }).collect();
        let before = by_frame(sheet, &vector, &vector);
        take_out_own(sheet, &basis, &mut vector);
        take_out_own(sheet, &basis, &mut vector);
        let length = by_frame(sheet, &vector, &vector);
        for (k, value) in vector.iter_mut().enumerate() {
            let frame = sheet.frame[k / 2];
            *value = if length[frame] > DEPENDENT * DEPENDENT * before[frame] && length[frame] > 0.0 {
                *value / length[frame].sqrt()
            } else {
                0.0
            };
        }
        basis.push(vector);
    }
    basis
}

fn by_frame(sheet: &Sheet, a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; sheet.frames];
    for (image, frame) in sheet.frame.iter().enumerate() {
        sums[*frame] += a[2 * image] * b[2 * image] + a[2 * image + 1] * b[2 * image + 1];
    }
    sums
}

fn take_out_own(sheet: &Sheet, local: &[Whitened], column: &mut [f64]) {
    for basis in local {
        let along = by_frame(sheet, basis, column);
        for (image, frame) in sheet.frame.iter().enumerate() {
            column[2 * image] -= along[*frame] * basis[2 * image];
            column[2 * image + 1] -= along[*frame] * basis[2 * image + 1];
        }
    }
}

/// The change of each own parameter, by parameter and frame, that leads from residuals with the shared parameters moved to those of the
/// fit: by least squares on the images taken, where it is exact.
pub(super) fn own_changes(sheet: &Sheet, take: &[bool], shared_moved: &[f64], fitted: &[f64]) -> Vec<Vec<f64>> {
    let own = sheet.own.len();
    let mut changes = vec![vec![0.0; sheet.frames]; own];
    if own == 0 {
        return changes;
    }
    let mut matrices = vec![DMatrix::<f64>::zeros(own, own); sheet.frames];
    let mut rights = vec![DVector::<f64>::zeros(own); sheet.frames];
    for k in (0..2 * sheet.images()).filter(|k| take[k / 2]) {
        let frame = sheet.frame[k / 2];
        let wanted = fitted[k] - shared_moved[k];
        for i in 0..own {
            rights[frame][i] += sheet.own[i][k] * wanted;
            for j in 0..own {
                matrices[frame][(i, j)] += sheet.own[i][k] * sheet.own[j][k];
            }
        }
    }
    for (frame, (matrix, right)) in matrices.into_iter().zip(rights).enumerate() {
        if let Some(solution) = matrix.pseudo_inverse(0.0).ok().map(|inverse| inverse * right) {
            for i in 0..own {
                changes[i][frame] = if solution[i].is_finite() { solution[i] } else { 0.0 };
            }
        }
    }
    changes
}
