//! Uncertainty of a solution: covariance of the parameters and of the map, coverage of the frame, degeneracies.
//!
//! # Covariance
//! The noise belongs to stars, not to pairs. With n_i the error of star image i (unit-weight variance σ² per axis, from the
//! star-level residuals with free attitudes), the residual of a pair changes by e_ij = −(∂g/∂pixel_i·n_i + ∂g/∂pixel_j·n_j), and the
//! estimate solves Σ a_ij·ψ(u_ij) = 0 with ψ(u) = p(u)·u. To first order in n, ψ answers with its mean slope κ, the same for all
//! pairs of stars that are what they are held to be; κ cancels, and over the pairs of the stars kept
//!
//! ```text
//! cov₁ = σ²·N⁻¹·(Σ_i G_i·G_iᵀ)·N⁻¹,   N = Σ a_ij·a_ijᵀ,   G_i = Σ_j a_ij·(∂g_ij/∂pixel_i)ᵀ
//! ```
//! (the "sandwich"; Huber 1967). What ψ does beyond its mean slope is noise of each pair: by Stein's lemma κ = E[ψ·u]/E\[u²\], so
//!
//! ```text
//! cov₂ = (E[ψ²]/κ² − E[u²])·N⁻¹
//! ```
//! is added, with the means taken over the same pairs. It vanishes for least squares, is negligible for F = 10.83 and is about a
//! tenth of the variance for F = 4. The bound that a joint adjustment of camera and attitudes would reach,
//! σ²·(Σ_h C_hᵀC_h − C_hᵀD_h(D_hᵀD_h)⁻¹D_hᵀC_h)⁻¹, is computed beside it.

use super::coverage::Coverage;
use super::error::CalibrateError;
use super::geometry::{FrameNormal, Matrix6, Scaling, Vector6, rotation_free_map};
use super::pairs::{FrameStars, Pairs, cosine_columns, cosine_residual};
use super::variable_weights::combination;
use crate::camera::{Camera, PARAMETER_COUNT};

/// Combinations of parameters that move the map less than this (relative to the strongest, squared) count as having no effect on it.
const NO_EFFECT: f64 = 1e-10;

/// Covariances of the scaled parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Covariances {
    /// Of the estimate from pairs.
    pub(super) pairs: Matrix6,
    /// Of a joint adjustment with the same stars: the lower bound.
    pub(super) joint: Matrix6,
}

/// Both covariances at the solution. `used`: the stars kept; `variance_px2`: σ².
pub(super) fn covariances(pairs: &Pairs, weights: &[f64], used: &[Vec<bool>], variance_px2: f64, scaling: &Scaling) -> Option<Covariances> {
    let mut normal = Matrix6::zeros();
    let mut influence: Vec<Vec<[[f64; 2]; PARAMETER_COUNT]>> =
        used.iter().map(|stars| vec![[[0.0; 2]; PARAMETER_COUNT]; stars.len()]).collect();
    // Σu², Σψ·u and Σψ².
    let (mut square, mut slope, mut psi_square, mut count) = (0.0, 0.0, 0.0, 0_usize);
    pairs.for_each(weights, |frame, i, j, p| {
        if !(used[frame][i] && used[frame][j]) {
            return;
        }
        let (first, second) = (&pairs.stars(frame)[i], &pairs.stars(frame)[j]);
        let row = Vector6::from(cosine_columns(&first.local, &second.local));
        normal += row * row.transpose();
        for (star, local, other) in [(i, &first.local, &second.local), (j, &second.local, &first.local)] {
            let by_pixel: [f64; 2] = std::array::from_fn(|axis| (0..3).map(|c| local.by_pixel[c][axis] * other.direction[c]).sum());
            for (own, a) in influence[frame][star].iter_mut().zip(row.iter()) {
                own[0] += a * by_pixel[0];
                own[1] += a * by_pixel[1];
            }
        }
        let u = cosine_residual(first, second);
        square += u * u;
        slope += p * u * u;
        psi_square += p * p * u * u;
        count += 1;
    });
    let mut middle = Matrix6::zeros();
    for g in influence.iter().flatten() {
        middle += Matrix6::from_fn(|k, l| g[k][0] * g[l][0] + g[k][1] * g[l][1]);
    }
    let cofactor = inverse(&normal, scaling).filter(is_covariance)?;
    let joint = inverse(&information(pairs, used), scaling).filter(is_covariance)?;
    let bent = if slope > 0.0 { ((psi_square * square / (slope * slope) - 1.0) * square / count as f64).max(0.0) } else { 0.0 };
    Some(Covariances { pairs: cofactor * middle * cofactor * variance_px2 + cofactor * bent, joint: joint * variance_px2 })
}

/// Normal matrix of the camera at star level, all attitudes eliminated, for σ = 1 px.
fn information(pairs: &Pairs, used: &[Vec<bool>]) -> Matrix6 {
    let mut sum = Matrix6::zeros();
    for (frame, used) in used.iter().enumerate() {
        let stars = pairs.stars(frame).iter().zip(used).filter(|(_, used)| **used).map(|(star, _)| &star.local);
        if let Some((normal, _)) = FrameNormal::of(stars).without_attitude() {
            sum += normal;
        }
    }
    sum
}

/// The inverse, by way of a unit diagonal; zero in the rows and columns of parameters that are held.
fn inverse(matrix: &Matrix6, scaling: &Scaling) -> Option<Matrix6> {
    let mut matrix = *matrix;
    scaling.pin_held(&mut matrix);
    let root = matrix.diagonal().map(|d| d.abs().sqrt());
    if root.iter().any(|r| r.is_nan() || *r <= 0.0) {
        return None;
    }
    let equilibrated = Matrix6::from_fn(|k, l| matrix[(k, l)] / (root[k] * root[l]));
    let inverse = equilibrated.try_inverse()?;
    Some(Matrix6::from_fn(|k, l| if scaling.free[k] && scaling.free[l] { inverse[(k, l)] / (root[k] * root[l]) } else { 0.0 }))
}

fn is_covariance(matrix: &Matrix6) -> bool {
    matrix.iter().all(|c| c.is_finite()) && matrix.diagonal().iter().all(|d| *d >= 0.0)
}

/// Standard error of the map (2-D, px) at each point of the grid, after the best rotation.
pub(super) fn map_sigma_px(camera: &Camera, scaling: &Scaling, covariance: &Matrix6) -> Option<Vec<f64>> {
    let map = rotation_free_map(camera, scaling)?;
    Some(map.iter().map(|columns| (columns * covariance * columns.transpose()).trace().max(0.0).sqrt()).collect())
}

/// How star images at their measured places cover the frame; it depends on no identification.
pub(super) fn coverage(frames: &[FrameStars], camera: &Camera, scaling: &Scaling) -> Result<Coverage, CalibrateError> {
    let pairs = Pairs::at(frames, camera, scaling);
    let used: Vec<Vec<bool>> = frames.iter().map(|frame| vec![true; frame.stars.len()]).collect();
    let stars: usize = frames.iter().map(|frame| frame.stars.len()).sum();
    let seen = information(&pairs, &used) / stars as f64;
    let map = rotation_free_map(camera, scaling).ok_or(CalibrateError::NominalFolds)?;
    let mut gram = Matrix6::zeros();
    for columns in &map {
        gram += columns.transpose() * columns / map.len() as f64;
    }
    // Generalised eigenvalues of (seen, gram) on the combinations that do something to the map.
    let eigen = gram.symmetric_eigen();
    let smallest = NO_EFFECT * eigen.eigenvalues.max();
    let kept: Vec<usize> = (0..PARAMETER_COUNT).filter(|k| eigen.eigenvalues[*k] > smallest).collect();
    let basis = nalgebra::DMatrix::from_fn(PARAMETER_COUNT, kept.len(), |row, column| {
        eigen.eigenvectors[(row, kept[column])] / eigen.eigenvalues[kept[column]].sqrt()
    });
    let dynamic = nalgebra::DMatrix::from_fn(PARAMETER_COUNT, PARAMETER_COUNT, |k, l| seen[(k, l)]);
    let reduced = (basis.transpose() * dynamic * &basis).symmetric_eigen();
    let (weakest, value) = reduced.eigenvalues.argmin();
    let direction = &basis * reduced.eigenvectors.column(weakest);
    Ok(Coverage { share: value.max(0.0).sqrt(), combination: combination(&Vector6::from_fn(|k, _| direction[k])) })
}
