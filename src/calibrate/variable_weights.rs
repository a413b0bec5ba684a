//! Variable weights: attitude-independent calibration on pairs of stars by iteratively reweighted least squares. The reference method.
//!
//! Source: patent CN 104931071 B (filed 2015-06-30); Wang, Cheng et al., "On-orbit calibration approach for star cameras based
//! on the iteration method with variable weights", Applied Optics 54(21), 2015. The weights are Li Deren's posterior variance
//! estimation.
//!
//! # Equations
//! The angle between two stars is the same on the sky and in the camera whatever the attitude, so each pair (i < j) of a frame
//! gives R = v_iᵀv_j − g(X̂) = A·ΔX, where g = w_iᵀw_j is the cosine of the measured directions at the camera X = (x0, y0, f, k1, p1, p2).
//!
//! ```text
//! 0. X̂ = ground values, k = 0, P = I
//! 1. ΔX = (AᵀPA)⁻¹AᵀPR
//! 2. if ‖ΔX‖ ≤ ε: X̂ ← X̂ + ΔX, stop
//! 3. if k > 0: X̂ ← X̂ + ΔX          (the first solution only finds weights)
//! 4. U = AΔX − R, σ̂0² = UᵀPU/L, L = rows − parameters,
//!    l_t = p_t·q_tt with Q_UU = P⁻¹ − A(AᵀPA)⁻¹Aᵀ   (redundancy; Σ l_t = L)
//!    T_t = u_t²/(σ̂0²·l_t);  p_t ← 1 if T_t < F, else σ̂0²·l_t/u_t²
//!    k ← k + 1, back to 1
//! ```
//!
//! # Two traps
//! - **Sign.** The patent writes A = −∂g/∂X̂ together with X̂ ← X̂ + ΔX. Taken to the letter that walks away from the solution
//!   (it doubles the error at each step). With R = v_iᵀv_j − g the consistent pair is A = +∂g/∂X̂ and X̂ ← X̂ + ΔX; that is used here.
//! - **Inversion.** The method's own measured directions are (−x, −y, f), those of the camera's axes turned by 180° about z.
//!   Angles do not see the turn, so [`crate::camera::direction_from_pixel`] is used as it is.
//!
//! ‖ΔX‖ is taken in scaled parameters: pixels of mapping over the frame. Pairs share stars, so T, σ̂0 and (AᵀPA)⁻¹ are not
//! calibrated as statistics; the uncertainty comes from the stars (see `uncertainty`).

use super::geometry::{Matrix6, Scaling, Vector6};
use super::pairs::{FrameStars, Pairs};
use super::{CalibrateError, Iteration, Status};
use crate::camera::{Camera, PARAMETER_COUNT, PARAMETER_NAMES};
use crate::statistics::order::descending;

/// Smallest ratio of the eigenvalues of AᵀPA (in pixels of mapping) at which its solution still has correct digits.
const SMALLEST_EIGENVALUE_RATIO: f64 = 1e-13;

/// What a solver on pairs comes to.
#[derive(Clone, Debug)]
pub(super) struct PairSolution {
    /// The camera.
    pub(super) camera: Camera,
    /// Whether the steps became small enough.
    pub(super) status: Status,
    /// One entry for each solution of the normal equations.
    pub(super) iterations: Vec<Iteration>,
    /// The weight of each pair in the last solution.
    pub(super) weights: Vec<f64>,
    /// Whether it took [`solve_in_stages`] to get there.
    pub(super) in_stages: bool,
}

/// What stops an iteration.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// F; `None` keeps all weights at one (plain least squares).
    pub(super) f_threshold: Option<f64>,
    /// ε, px of mapping.
    pub(super) epsilon_px: f64,
    /// The most solutions of the normal equations.
    pub(super) max_iterations: usize,
}

/// Solves with variable weights, as published.
pub(super) fn solve(frames: &[FrameStars], start: &Camera, scaling: &Scaling, limits: &Limits) -> Result<PairSolution, CalibrateError> {
    solve_from(frames, start, None, scaling, limits)
}

/// The way out where the published iteration runs away: in a narrow field the centre and the decentring distortion are all but
/// the same, and while wrong identifications still have weight they drive this combination out of the range in which the
/// linear equations hold. So the focal length and the radial distortion are solved first, which finds the weights; the
/// iteration with all parameters starts from there. `None` where that would be the same iteration again.
pub(super) fn solve_in_stages(
    frames: &[FrameStars],
    start: &Camera,
    scaling: &Scaling,
    limits: &Limits,
) -> Option<Result<PairSolution, CalibrateError>> {
    let first = Scaling { free: std::array::from_fn(|k| scaling.free[k] && matches!(PARAMETER_NAMES[k], "f" | "k1")), ..*scaling };
    if first.free == scaling.free || first.free_count() == 0 {
        return None;
    }
    let staged = || {
        let weights = solve_from(frames, start, None, &first, limits)?;
        let mut solution = solve_from(frames, &weights.camera, Some(weights.weights), scaling, limits)?;
        solution.iterations.splice(0..0, weights.iterations);
        Ok(PairSolution { in_stages: true, ..solution })
    };
    Some(staged())
}

/// The iteration, from the weights given, or from P = I: then the first solution only finds weights.
fn solve_from(
    frames: &[FrameStars],
    start: &Camera,
    weights: Option<Vec<f64>>,
    scaling: &Scaling,
    limits: &Limits,
) -> Result<PairSolution, CalibrateError> {
    let mut camera = *start;
    let mut pairs = Pairs::at(frames, &camera, scaling);
    let redundancy = redundancy(pairs.count(), scaling)?;
    let moves_at_once = weights.is_some() || limits.f_threshold.is_none();
    let mut weights = weights.unwrap_or_else(|| vec![1.0; pairs.count()]);
    let mut iterations = Vec::new();
    for k in 0..limits.max_iterations {
        let (step, whitening) = normal_solution(&pairs, &weights, scaling)?;
        let variance = pairs.weighted_square_sum(&weights, &step) / redundancy;
        let down_weighted = weights.iter().filter(|p| **p != 1.0).count();
        iterations.push(Iteration {
            step_px: step.norm(),
            pair_sigma_rad: variance.sqrt(),
            pairs_down_weighted: down_weighted,
            star_sigma_px: 0.0,
            stars_down_weighted: 0,
        });
        let converged = step.norm() <= limits.epsilon_px;
        if converged || k > 0 || moves_at_once {
            camera = checked(scaling.moved(&camera, &step), k + 1)?;
        }
        if converged {
            return Ok(PairSolution { camera, status: Status::Converged, iterations, weights, in_stages: false });
        }
        if let Some(f) = limits.f_threshold {
            pairs.reweigh(&mut weights, &step, &whitening, |p, u_squared, leverage| new_weight(f, variance, p, u_squared, leverage));
        }
        pairs = Pairs::at(frames, &camera, scaling);
    }
    Ok(PairSolution { camera, status: Status::NotConverged, iterations, weights, in_stages: false })
}

/// p ← 1 if T < F, else σ̂0²·l/u². `leverage` = aᵀ(AᵀPA)⁻¹a, so that l = p·(1/p − leverage).
fn new_weight(f_threshold: f64, variance: f64, p: f64, u_squared: f64, leverage: f64) -> f64 {
    let local_redundancy = (1.0 - p * leverage).max(0.0);
    let expected = variance * local_redundancy;
    // T < F without the division: exact data have u = σ̂0 = 0, and such a pair is as good as any.
    if u_squared == 0.0 || u_squared < f_threshold * expected { 1.0 } else { expected / u_squared }
}

/// Rows minus parameters.
fn redundancy(pairs: usize, scaling: &Scaling) -> Result<f64, CalibrateError> {
    let parameters = scaling.free_count();
    if pairs <= parameters {
        return Err(CalibrateError::TooFewPairs { pairs, parameters });
    }
    Ok((pairs - parameters) as f64)
}

/// ΔX, and L⁻¹ with AᵀPA = L·Lᵀ.
fn normal_solution(pairs: &Pairs, weights: &[f64], scaling: &Scaling) -> Result<(Vector6, Matrix6), CalibrateError> {
    let mut normal = pairs.normal_equations(weights);
    // Equilibrated to a unit diagonal: what is left of the condition is true correlation, not units.
    let free = |k: usize| scaling.free[k];
    let root: [f64; PARAMETER_COUNT] = std::array::from_fn(|k| if free(k) { normal.matrix[(k, k)].sqrt() } else { 1.0 });
    if let Some(k) = (0..PARAMETER_COUNT).find(|&k| root[k].is_nan() || root[k] <= 0.0 || root[k].is_infinite()) {
        return Err(CalibrateError::Singular { combination: PARAMETER_NAMES[k].to_owned() });
    }
    scaling.pin_held(&mut normal.matrix);
    let equilibrated = Matrix6::from_fn(|k, l| normal.matrix[(k, l)] / (root[k] * root[l]));
    let eigen = equilibrated.symmetric_eigen();
    let (weakest, smallest) = eigen.eigenvalues.argmin();
    if smallest.is_nan() || smallest <= SMALLEST_EIGENVALUE_RATIO * eigen.eigenvalues.max() {
        return Err(CalibrateError::Singular { combination: combination(&eigen.eigenvectors.column(weakest).into_owned()) });
    }
    let singular = || CalibrateError::Singular { combination: "several parameters".to_owned() };
    let factor = equilibrated.cholesky().ok_or_else(singular)?;
    let scale = Vector6::from(root);
    let step = factor.solve(&normal.right.component_div(&scale)).component_div(&scale);
    let inverse = factor.l().try_inverse().ok_or_else(singular)?;
    let whitening = Matrix6::from_fn(|k, l| inverse[(k, l)] / root[l]);
    Ok((step, whitening))
}

/// A direction in parameter space in words: its large components.
pub(super) fn combination(vector: &Vector6) -> String {
    let largest = vector.amax();
    let mut parts: Vec<(f64, &str)> =
        vector.iter().zip(PARAMETER_NAMES).filter(|(v, _)| v.abs() > 0.2 * largest).map(|(v, name)| (*v, name)).collect();
    descending(&mut parts, |a| a.0.abs());
    parts.iter().map(|(_, name)| *name).collect::<Vec<_>>().join(", ")
}

/// Refuses a camera that the iteration has thrown out of the physical range.
fn checked(camera: Camera, iteration: usize) -> Result<Camera, CalibrateError> {
    if camera.parameters().iter().all(|p| p.is_finite()) && camera.focal_length_px > 0.0 {
        Ok(camera)
    } else {
        Err(CalibrateError::Diverged { iteration, focal_length_px: camera.focal_length_px })
    }
}
