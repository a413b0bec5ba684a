//! Diagnosis of a frame whose positions scatter more than those of the others.
//!
//! Such a frame is weighted down, and the user wants to know why. Three reasons are distinguished: the model lacks k2 and k3, and this frame is the
//! one with stars in the corners; the frame has another focal length than the others (another camera, zoom or focus); or its star images themselves
//! are worse. The first is tested first, since it causes the second.

use nalgebra::{SMatrix, SVector};

use super::groups::higher_radial;
use super::solve_for::full_name;
use super::{Problem, Run, Solved, names, scales};
use crate::identify::ControlPoints;

/// By how much χ² falls at least with k2 and k3 where the model lacks them.
const LACKS: f64 = 25.0;
/// A focal length is another one if it is so many of its standard errors off,
const ANOTHER_SIGMAS: f64 = 6.0;
/// and if with it so much of the squares of the frame's residuals is left at most.
const EXPLAINED: f64 = 0.5;
/// Turns of the robust fit of a frame's own focal length.
const TURNS: usize = 12;

/// One sentence for each frame that is worse than the others.
pub(super) fn sentences(solved: &Solved, points: &ControlPoints) -> Vec<String> {
    let Solved { problem, adjusted, .. } = solved;
    let worse: Vec<usize> = (0..problem.exposures.len()).filter(|exposure| adjusted.noise.frame_factors[*exposure] > 1.0).collect();
    if worse.is_empty() {
        return Vec::new();
    }
    let lacks = lacking(solved).filter(|fall| *fall > LACKS);
    let sentence = |exposure: usize| {
        let name = points.frame_name(problem.exposures[exposure].frame);
        let factor = adjusted.noise.frame_factors[exposure].sqrt();
        let reason = match (lacks, own_focal_length(solved, exposure)) {
            (Some(fall), _) => format!(
                "the model lacks k2 and k3 (with them χ² falls by {fall:.0}), which frames with stars far from the centre show first; solve for them"
            ),
            (None, Some(Own { focal_px, sigma_px })) => format!(
                "by itself it has the focal length {focal_px:.2} ± {sigma_px:.2} px where all together have {:.2} px: it is of another camera, or \
                 zoom or focus were changed",
                adjusted.state.values[2]
            ),
            (None, None) => "trailed, unsharp, or something moved".to_owned(),
        };
        format!("{name} is worse than the others (its positions scatter {factor:.1} times as much) and is weighted by it: {reason}")
    };
    worse.into_iter().map(sentence).collect()
}

/// By how much χ² falls with k2 and k3, weights and noise held; `None` where the model holds them, or cannot.
fn lacking(solved: &Solved) -> Option<f64> {
    let higher: Vec<String> = higher_radial().flatten().map(|name| full_name(name).into_owned()).collect();
    let Solved { problem, adjusted, .. } = solved;
    let solves: Vec<String> = names(problem);
    if solves.iter().any(|name| higher.contains(name)) {
        return None;
    }
    let mut model = problem.model.clone();
    let wanted: Vec<String> = solves.iter().cloned().chain(higher).collect();
    let free = super::indices(&mut model, &wanted)?;
    let mut state = adjusted.state.clone();
    state.values = model.values();
    let larger = Problem { model, free, priors: Vec::new(), carried: None, ..problem.clone() };
    let scale = scales(&larger, &state);
    if scale.iter().any(|scale| !(scale.is_finite() && *scale > 0.0)) {
        return None;
    }
    let run = Run { epsilon_px: 1e-3, max_turns: 10, from_afar: false, hold_noise: true };
    let with = larger.adjust(state, adjusted.noise.clone(), &scale, &run, Some(&adjusted.weights));
    Some((adjusted.chi_squared - with.chi_squared) / adjusted.noise.unit_variance).filter(|fall| fall.is_finite())
}

/// What a frame tells of the focal length by itself.
struct Own {
    focal_px: f64,
    sigma_px: f64,
}

/// The focal length of a frame by itself, everything else of the camera held and its attitude free, where it is not that of the others.
fn own_focal_length(solved: &Solved, exposure: usize) -> Option<Own> {
    let Solved { problem, adjusted, .. } = solved;
    let place = problem.free.iter().position(|index| *index == 2)?;
    let mut rows: Vec<([f64; 4], f64)> = Vec::new();
    problem.linearise(&adjusted.state, exposure, |_, row| {
        for axis in 0..2 {
            let [x, y, z] = row.by_rotation[axis];
            rows.push(([x, y, z, row.by_parameter[axis][place]], row.residual[axis]));
        }
    });
    let before = fit(&rows, 3)?;
    let after = fit(&rows, 4)?;
    let is_another = after.value.abs() > ANOTHER_SIGMAS * after.sigma && after.scatter_px2 < EXPLAINED * before.scatter_px2;
    is_another.then(|| Own { focal_px: adjusted.state.values[2] + after.value, sigma_px: after.sigma })
}

/// A robust fit of some columns to residuals.
struct Fit {
    /// Of the last column.
    value: f64,
    sigma: f64,
    /// Square of the residuals' scale.
    scatter_px2: f64,
}

/// The first `columns` of the rows fitted to their residuals, with weights that fall as 1/r² (Cauchy).
fn fit(rows: &[([f64; 4], f64)], columns: usize) -> Option<Fit> {
    if rows.len() < 2 * columns + 2 {
        return None;
    }
    let mut weights = vec![1.0; rows.len()];
    let mut found = None;
    for _ in 0..TURNS {
        let mut normal = SMatrix::<f64, 4, 4>::zeros();
        let mut right = SVector::<f64, 4>::zeros();
        for ((row, residual), weight) in rows.iter().zip(&weights) {
            let mut row = SVector::from(*row);
            row.rows_range_mut(columns..).fill(0.0);
            normal += *weight * row * row.transpose();
            right -= *weight * residual * row;
        }
        for held in columns..4 {
            normal[(held, held)] = 1.0;
        }
        let inverse = normal.try_inverse()?;
        let step = inverse * right;
        let left: Vec<f64> = rows.iter().map(|(row, residual)| residual + SVector::from(*row).dot(&step)).collect();
        let scale = crate::statistics::mad_sigma(&left).filter(|scale| *scale > 0.0)?;
        let freedom = (rows.len() - columns) as f64;
        let square: f64 = left.iter().zip(&weights).map(|(left, weight)| weight * left * left).sum();
        let sigma = (inverse[(columns - 1, columns - 1)] * square / freedom).max(0.0).sqrt();
        found = Some(Fit { value: step[columns - 1], sigma, scatter_px2: scale * scale });
        for (weight, left) in weights.iter_mut().zip(&left) {
            *weight = 1.0 / (1.0 + (left / (2.0 * scale)).powi(2));
        }
    }
    found
}
