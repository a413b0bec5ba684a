//! Robust linear model of the star images: whitened residuals and design columns, with attitudes and camera projected out.
//!
//! With r the whitened residuals (two for each star image), D_h a frame's nuisance columns (its attitude) and B the shared ones (camera, and
//! effects already accepted), a fit minimises Σ ρ(|r_i|) over all of them, ρ that of a two-dimensional t distribution:
//!
//! ```text
//! ψ_i = w_i·r_i,  w = (ν + 2)/(ν + |r_i|²);   r ← r − Π·ψ/d,  d = mean of ∂ψ/∂r;   Π = projector on (D, B)
//! ```
//! At its end Πψ = 0, and the score of any further column a is aᵀψ = (Ma)ᵀψ with M = 1 − Π and variance c·|Ma|², c = mean of ψ²: one
//! projection of each column serves all tests. No star is clipped: a star far off pulls by a bounded amount, and pulls fully again once an
//! effect explains where it is. Source: Huber, Robust Statistics (1981), 7.8 (pseudo-values); Lange, Little and Taylor, J. Am. Stat. Assoc.
//! 84, 881 (1989), for t.

use nalgebra::{DMatrix, DMatrixView, DVector};

use super::descent::{descend, psi_of};
use super::frame_nuisance::FrameNuisance;

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

/// What columns are on each frame, frame by frame: of sums of them with a factor for each frame every score follows.
#[derive(Clone, Debug)]
pub(super) struct FrameSums {
    /// Product of each column with ψ.
    pub(super) score: Vec<Vec<f64>>,
    /// Σ|a|² of each column as it is.
    pub(super) length: Vec<Vec<f64>>,
    /// Products of the columns with one another, the frame's nuisance columns projected out.
    pub(super) gram: Vec<DMatrix<f64>>,
    /// Products of each column with the basis of the shared ones.
    pub(super) shared: Vec<Vec<Vec<f64>>>,
}

/// A fit of some of the images.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    take: Vec<bool>,
    own: FrameNuisance,
    /// Orthonormal basis of the shared columns, nuisance columns projected out.
    basis: DMatrix<f64>,
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

fn mask(column: &mut [f64], take: &[bool]) {
    for (pair, _) in column.chunks_exact_mut(2).zip(take).filter(|(_, take)| !**take) {
        pair.fill(0.0);
    }
}

/// aᵀ·b. The library's own product with a transposed matrix is a loop of single products, many times slower.
pub(super) fn products(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    const FEW: usize = 5;
    if a.ncols() <= FEW || b.ncols() <= FEW {
        let columns = |matrix: &DMatrix<f64>, k: usize| matrix.nrows() * k..matrix.nrows() * (k + 1);
        return DMatrix::from_fn(a.ncols(), b.ncols(), |i, j| dot(&a.as_slice()[columns(a, i)], &b.as_slice()[columns(b, j)]));
    }
    let turned = DMatrixView::from_slice_with_strides(a.as_slice(), a.ncols(), a.nrows(), a.nrows(), 1);
    turned * b
}

/// The weight of a residual with square `q`.
pub(super) fn weight(tail_degrees: f64, q: f64) -> f64 {
    if tail_degrees.is_finite() { (tail_degrees + 2.0) / (tail_degrees + q) } else { 1.0 }
}

impl Fit {
    /// Fits attitudes, camera and `more` columns to the images taken.
    pub(super) fn new(sheet: &WhitenedSystem, take: &[bool], more: &[&Whitened]) -> Self {
        let mut fit = Self {
            take: take.to_vec(),
            own: FrameNuisance::new(sheet, take),
            basis: DMatrix::zeros(2 * sheet.images(), 0),
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

    fn set_shared(&mut self, sheet: &WhitenedSystem, shared: &[&Whitened]) {
        let count = shared.len();
        let projected = self.without_own(sheet, shared.iter().map(|column| column.as_slice()));
        let length: Vec<f64> = projected.column_iter().map(|column| column.norm()).collect();
        let raw: Vec<f64> = shared.iter().map(|column| dot(column, column).sqrt()).collect();
        let scale: Vec<f64> =
            (0..count).map(|k| if length[k] > DEPENDENT * raw[k] && length[k] > 0.0 { 1.0 / length[k] } else { 0.0 }).collect();
        let mut gram = products(&projected, &projected);
        for (k, value) in gram.iter_mut().enumerate() {
            *value *= scale[k % count] * scale[k / count];
        }
        let eigen = gram.symmetric_eigen();
        let kept: Vec<usize> = (0..count).filter(|k| eigen.eigenvalues[*k] > 1e-10).collect();
        self.mixing =
            DMatrix::from_fn(count, kept.len(), |i, j| scale[i] * eigen.eigenvectors[(i, kept[j])] / eigen.eigenvalues[kept[j]].sqrt());
        let basis = projected * &self.mixing;
        if kept.is_empty() {
            self.basis = basis;
            return;
        }
        // Once more: where columns are nearly dependent the first time leaves them skew by what rounding makes of small eigenvalues.
        let eigen = basis.tr_mul(&basis).symmetric_eigen();
        let again = DMatrix::from_fn(kept.len(), kept.len(), |i, j| eigen.eigenvectors[(i, j)] / eigen.eigenvalues[j].max(1e-3).sqrt());
        self.basis = basis * &again;
        self.mixing = &self.mixing * again;
    }

    /// The basis of the shared columns, one vector after the other.
    fn directions(&self) -> impl Iterator<Item = &[f64]> {
        self.basis.as_slice().chunks_exact(self.basis.nrows().max(1))
    }

    fn solve(&mut self, sheet: &WhitenedSystem) {
        let taken = self.take.iter().filter(|take| **take).count();
        let own: usize = self.own.count() * self.frames_taken(sheet);
        self.degrees = (2.0 * taken as f64 - own as f64 - self.basis.ncols() as f64).max(1.0);
        let nu = sheet.tail_degrees;
        let project = |column: &mut Whitened| -> Vec<f64> {
            let along: Vec<f64> = self.directions().map(|basis| dot(basis, column)).collect();
            self.own.take_out(column);
            for (along, basis) in along.iter().zip(self.directions()) {
                subtract(column, *along, basis);
            }
            along
        };
        let (residual, moved) = descend(masked(&sheet.residual, &self.take), &self.take, nu, self.basis.ncols(), project);
        // c and d are those of errors, and residuals are smaller than errors by what the fit has taken.
        let larger = (2.0 * taken as f64 / self.degrees).sqrt();
        let errors: Whitened = residual.iter().map(|r| r * larger).collect();
        let (psi, d) = psi_of(&errors, &self.take, nu);
        self.c = dot(&psi, &psi) / (2.0 * taken as f64).max(1.0);
        self.d = d;
        let (psi, _) = psi_of(&residual, &self.take, nu);
        self.change = &self.mixing * DVector::from_vec(moved);
        self.residual = residual;
        self.psi = psi;
    }

    fn frames_taken(&self, sheet: &WhitenedSystem) -> usize {
        let mut seen = vec![false; sheet.frames];
        for (frame, _) in sheet.frame.iter().zip(&self.take).filter(|(_, take)| **take) {
            seen[*frame] = true;
        }
        seen.into_iter().filter(|seen| *seen).count()
    }

    fn without_own<'a>(&self, sheet: &WhitenedSystem, columns: impl Iterator<Item = &'a [f64]>) -> DMatrix<f64> {
        let mut all: Vec<f64> = columns.flatten().copied().collect();
        for rest in all.chunks_exact_mut(2 * sheet.images().max(1)) {
            mask(rest, &self.take);
            self.own.take_out(rest);
        }
        let rows = 2 * sheet.images();
        DMatrix::from_vec(rows, all.len().checked_div(rows).unwrap_or(0), all)
    }

    /// M·a: what attitudes, camera and accepted effects leave of a column, on the images taken.
    pub(super) fn project(&self, column: &[f64]) -> Whitened {
        let mut rest = masked(column, &self.take);
        self.own.take_out(&mut rest);
        // Twice: a column that is nearly all taken up leaves its rounding errors after the first time.
        for _ in 0..2 {
            for basis in self.directions() {
                let along = dot(basis, &rest);
                subtract(&mut rest, along, basis);
            }
        }
        rest
    }

    /// M·a of many columns.
    pub(super) fn project_all(&self, sheet: &WhitenedSystem, columns: &[Whitened]) -> DMatrix<f64> {
        let mut rest = self.without_own(sheet, columns.iter().map(Vec::as_slice));
        for _ in 0..2 {
            let along = products(&self.basis, &rest);
            rest.gemm(-1.0, &self.basis, &along, 1.0);
        }
        rest
    }

    /// Columns frame by frame.
    pub(super) fn frame_sums(&self, columns: &[Whitened]) -> FrameSums {
        let raw: Vec<Whitened> = columns.iter().map(|column| masked(column, &self.take)).collect();
        let mut rest = raw.clone();
        for column in &mut rest {
            self.own.take_out(column);
        }
        let frames = self.own.frames();
        let by_frame = |a: &[f64], b: &[f64]| self.own.by_frame(a, b);
        // Sums by column first, then turned: by frame.
        let turned =
            |sums: &[Vec<f64>]| -> Vec<Vec<f64>> { (0..frames).map(|frame| sums.iter().map(|own| own[frame]).collect()).collect() };
        let score: Vec<Vec<f64>> = rest.iter().map(|column| by_frame(column, &self.psi)).collect();
        let length: Vec<Vec<f64>> = raw.iter().map(|column| by_frame(column, column)).collect();
        let n = columns.len();
        let mut gram = vec![DMatrix::zeros(n, n); frames];
        for i in 0..n {
            for j in 0..=i {
                for (gram, value) in gram.iter_mut().zip(by_frame(&rest[i], &rest[j])) {
                    (gram[(i, j)], gram[(j, i)]) = (value, value);
                }
            }
        }
        let along: Vec<Vec<Vec<f64>>> =
            rest.iter().map(|column| turned(&self.directions().map(|basis| by_frame(column, basis)).collect::<Vec<_>>())).collect();
        let shared = (0..frames).map(|frame| along.iter().map(|own| own[frame].clone()).collect()).collect();
        FrameSums { score: turned(&score), length: turned(&length), gram, shared }
    }

    /// Σ|a|² of a column over the images taken.
    pub(super) fn length_squared(&self, column: &[f64]) -> f64 {
        column.iter().enumerate().filter(|(k, _)| self.take[k / 2]).map(|(_, value)| value * value).sum()
    }

    /// Covariance of the shared parameters. With heavy tails and fewer than some ten numbers for each parameter the errors are up to a tenth
    /// too small.
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        &self.mixing * self.mixing.transpose() * (self.c / (self.d * self.d))
    }

    /// The same fit with another's noise.
    pub(super) fn with_noise_of(self, other: &Self) -> Self {
        Self { c: other.c, ..self }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const FRAMES: usize = 6;
    const IMAGES: usize = 240;

    /// Random columns; residuals are noise plus a known change of the shared parameters and of one more column.
    fn sheet(rng: &mut Pcg64Mcg, changes: [f64; 3], tail_degrees: f64) -> (WhitenedSystem, Whitened) {
        let mut column = || (0..2 * IMAGES).map(|_| rng.random::<f64>() - 0.5).collect::<Whitened>();
        let (own, camera, more) = ((0..3).map(|_| column()).collect(), vec![column(), column()], column());
        let shared: Vec<&Whitened> = camera.iter().chain([&more]).collect();
        let residual = (0..2 * IMAGES)
            .map(|k| {
                let noise: f64 = StandardNormal.sample(rng);
                // The residual falls by what the change adds.
                noise - shared.iter().zip(changes).map(|(column, change)| change * column[k]).sum::<f64>()
            })
            .collect();
        let frame = (0..IMAGES).map(|k| k % FRAMES).collect();
        (WhitenedSystem { frame, frames: FRAMES, residual, own, camera, tail_degrees }, more)
    }

    /// The change found is that of the truth within its errors, and as often within them as it should be.
    #[test]
    fn changes_are_found_within_their_errors() {
        for tail_degrees in [f64::INFINITY, 5.0] {
            let mut rng = Pcg64Mcg::seed_from_u64(4);
            let truth = [3.0, -20.0, 5.0];
            let (mut square, mut count) = (0.0, 0.0_f64);
            for _ in 0..200 {
                let (sheet, more) = sheet(&mut rng, truth, tail_degrees);
                let fit = Fit::new(&sheet, &[true; IMAGES], &[&more]);
                let covariance = fit.covariance();
                for k in 0..3 {
                    square += (fit.change[k] - truth[k]).powi(2) / covariance[(k, k)];
                    count += 1.0;
                }
            }
            let sd = (square / count).sqrt();
            assert!((sd - 1.0).abs() < 0.1, "ν = {tail_degrees}: pulls of {sd}");
        }
    }

    /// A projected column is orthogonal to everything that was fitted, and of what was fitted nothing is left.
    #[test]
    fn what_is_fitted_leaves_nothing() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let (sheet, more) = sheet(&mut rng, [0.0; 3], f64::INFINITY);
        let fit = Fit::new(&sheet, &[true; IMAGES], &[]);
        let rest = fit.project(&more);
        for camera in &sheet.camera {
            assert!(dot(&rest, camera).abs() < 1e-9);
            assert!(fit.project(camera).iter().all(|value| value.abs() < 1e-9));
        }
        for own in &sheet.own {
            assert!(fit.own.by_frame(own, &rest).iter().all(|sum| sum.abs() < 1e-9));
        }
        assert!(dot(&fit.psi, &rest).abs() > 1e-6, "a column that was not fitted still has a score");
    }

    /// One image far off pulls by a bounded amount where tails are heavy, and by all of its residual where they are not.
    #[test]
    fn far_images_pull_little() {
        let mut rng = Pcg64Mcg::seed_from_u64(6);
        let (mut sheet, more) = sheet(&mut rng, [0.0; 3], 4.0);
        sheet.residual[10] += 200.0;
        let change = |tail_degrees: f64| {
            let sheet = WhitenedSystem { tail_degrees, ..sheet.clone() };
            Fit::new(&sheet, &[true; IMAGES], &[&more]).change[2].abs()
        };
        assert!(4.0 * change(4.0) < change(f64::INFINITY), "{} {}", change(4.0), change(f64::INFINITY));
    }
}
