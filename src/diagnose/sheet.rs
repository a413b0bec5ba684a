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
        let taken = self.take.iter().filter(|take| **take).count();
        let own: usize = self.local.len() * self.frames_taken(sheet);
        self.degrees = (2.0 * taken as f64 - own as f64 - self.basis.len() as f64).max(1.0);
        let nu = sheet.tail_degrees;
        let project = |column: &mut Whitened| -> Vec<f64> {
            let along: Vec<f64> = self.basis.iter().map(|basis| dot(basis, column)).collect();
            self.take_out_own(sheet, column);
            for (along, basis) in along.iter().zip(&self.basis) {
                subtract(column, *along, basis);
            }
            along
        };
        let (residual, moved) = descend(self.masked(&sheet.residual), &self.take, nu, self.basis.len(), project);
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
    let masked = residual.iter().enumerate().map(|(k, value)| if take[k / 2] { *value } else { 0.0 }).collect();
    let project = |column: &mut Whitened| -> Vec<f64> {
        take_out_own(sheet, &local, column);
        Vec::new()
    };
    descend(masked, take, sheet.tail_degrees, 0, project).0
}

/// Residuals of least Σρ that differ from those given by what `project` takes out of a column (it returns the coefficients along some of
/// what it takes), and the sums of these coefficients.
///
/// From the residuals as given, or from those of least squares if their cost is lower: with parameters of other frames a whole frame may
/// stand tens of σ off, where ψ is all tail. The step Πψ/d is Newton's with a mean slope; where it does not lower the cost the step with
/// the largest slope there is does (Huber's bound), so the descent cannot run away.
fn descend(
    start: Whitened,
    take: &[bool],
    tail_degrees: f64,
    along: usize,
    project: impl Fn(&mut Whitened) -> Vec<f64>,
) -> (Whitened, Vec<f64>) {
    const TURNS: usize = 60;
    let steepest = if tail_degrees.is_finite() { (tail_degrees + 2.0) / tail_degrees } else { 1.0 };
    let value = |residual: &Whitened| cost(residual, take, tail_degrees);
    // The residuals after a step along ψ with a slope, and the coefficients.
    let stepped = |residual: &Whitened, psi: &Whitened, slope: f64| {
        let mut left = psi.clone();
        let part = project(&mut left);
        let next: Whitened = residual.iter().zip(psi.iter().zip(&left)).map(|(r, (psi, left))| r - (psi - left) / slope).collect();
        (next, part.into_iter().map(|part| -part / slope).collect::<Vec<f64>>())
    };
    let (mut residual, mut moved) = (start, vec![0.0; along]);
    let mut least = value(&residual);
    let mut psi = residual.clone();
    let mut slope = 1.0;
    for turn in 0..TURNS {
        let (mut next, mut part) = stepped(&residual, &psi, slope);
        let mut reached = value(&next);
        if turn > 0 && reached > least {
            (next, part) = stepped(&residual, &psi, steepest);
            reached = value(&next);
        }
        if reached < least {
            for (moved, part) in moved.iter_mut().zip(part) {
                *moved += part;
            }
            let settled = least - reached < 1e-10 * least.abs().max(1.0);
            (residual, least) = (next, reached);
            if settled && turn > 0 {
                break;
            }
        } else if turn > 0 {
            break;
        }
        (psi, slope) = psi_of(&residual, take, tail_degrees);
    }
    (residual, moved)
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

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const FRAMES: usize = 6;
    const IMAGES: usize = 240;

    /// Random columns; residuals are noise plus a known change of the shared parameters and of one more column.
    fn sheet(rng: &mut Pcg64Mcg, changes: [f64; 3], tail_degrees: f64) -> (Sheet, Whitened) {
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
        (Sheet { frame, frames: FRAMES, residual, own, camera, tail_degrees }, more)
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
        let rest = fit.project(&sheet, &more);
        for camera in &sheet.camera {
            assert!(dot(&rest, camera).abs() < 1e-9);
            assert!(fit.project(&sheet, camera).iter().all(|value| value.abs() < 1e-9));
        }
        for own in &sheet.own {
            assert!(by_frame(&sheet, own, &rest).iter().all(|sum| sum.abs() < 1e-9));
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
            let sheet = Sheet { tail_degrees, ..sheet.clone() };
            Fit::new(&sheet, &[true; IMAGES], &[&more]).change[2].abs()
        };
        assert!(4.0 * change(4.0) < change(f64::INFINITY), "{} {}", change(4.0), change(f64::INFINITY));
    }
}
