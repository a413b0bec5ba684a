//! What the star images determine: whether a solution is one, its covariance, and which parameters they do not tell apart.

use nalgebra::DMatrix;

use super::mapping::{self, MapColumns};
use super::{Problem, Solved, State, adjust, is_reference, names};
use crate::calibrate::CalibrateError;
use crate::calibrate::calibration::Combination;
use crate::calibrate::coverage::Coverage;
use crate::calibrate::geometry::GRID;
use crate::calibrate::lit::lit_grid;
use crate::statistics::order::{ascending, descending};

/// Of a combination with a singular value below this the standard error is taken from the cost itself.
const HARDLY: f64 = 0.1;
/// A combination with a singular value below this is put into words.
const BADLY: f64 = 0.2;

/// Whether the star images, all of them right, would determine the map.
pub(super) fn check_coverage(problem: &Problem, state: &State, scale: &[f64]) -> Result<(), CalibrateError> {
    let grid = lit_grid(problem.model.camera(), problem.lit.as_ref(), GRID);
    let Some(map) = mapping::rotation_free_map(&problem.model, &state.values, &problem.free, &grid) else { return Ok(()) };
    let weights: Vec<Vec<f64>> = problem.exposures.iter().map(|exposure| vec![1.0; exposure.images.len()]).collect();
    let coverage = coverage(problem, state, &weights, scale, &map);
    // What is no number the adjustment itself will tell.
    if coverage.share.is_nan() { Ok(()) } else { coverage.checked().map(|_| ()) }
}

/// How the star images with weight cover the map.
pub(super) fn coverage(problem: &Problem, state: &State, weights: &[Vec<f64>], scale: &[f64], map: &[MapColumns]) -> Coverage {
    let (share, direction) = mapping::coverage(problem, state, weights, scale, map);
    Coverage { share, combination: in_words(&direction, &names(problem)) }
}

/// Whether a solution is one: converged, determined, and its map too.
pub(super) fn check_solved(solved: &Solved) -> Result<(), CalibrateError> {
    let Solved { problem, adjusted, .. } = solved;
    let names = names(problem);
    covariance(&adjusted.information, &names)?;
    if !adjusted.converged {
        return Err(CalibrateError::Singular { combination: names.join(", ") });
    }
    let grid = lit_grid(problem.model.camera(), problem.lit.as_ref(), GRID);
    let values = &adjusted.state.values;
    let map = mapping::rotation_free_map(&problem.model, values, &problem.free, &grid).ok_or(CalibrateError::NominalFolds)?;
    coverage(problem, &adjusted.state, &adjusted.weights, &adjusted.scale, &map).checked().map(|_| ())
}

/// The covariance of the scaled free parameters for unit weight.
pub(super) fn covariance(information: &DMatrix<f64>, names: &[String]) -> Result<DMatrix<f64>, CalibrateError> {
    let n = information.nrows();
    let root: Vec<f64> = (0..n).map(|k| information[(k, k)].max(0.0).sqrt()).collect();
    if let Some(k) = (0..n).find(|k| !(root[*k] > 0.0 && root[*k].is_finite())) {
        return Err(CalibrateError::Singular { combination: names.get(k).map_or("the mount's attitude", String::as_str).to_owned() });
    }
    let equilibrated = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (root[i] * root[j]));
    let eigen = equilibrated.clone().symmetric_eigen();
    let (weakest, smallest) = eigen.eigenvalues.argmin();
    if smallest.is_nan() || smallest <= adjust::OPEN * eigen.eigenvalues.max() {
        let direction: Vec<f64> = eigen.eigenvectors.column(weakest).iter().copied().take(names.len()).collect();
        return Err(CalibrateError::Singular { combination: in_words(&direction, names) });
    }
    let inverse = equilibrated.try_inverse().ok_or_else(|| CalibrateError::Singular { combination: names.join(", ") })?;
    let free = names.len();
    Ok(DMatrix::from_fn(free, free, |i, j| inverse[(i, j)] / (root[i] * root[j])))
}

/// A direction in parameter space in words: its large components, the largest first.
fn in_words(direction: &[f64], names: &[String]) -> String {
    let largest = direction.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let mut parts: Vec<(f64, &String)> =
        direction.iter().zip(names).filter(|(v, _)| v.abs() > 0.2 * largest).map(|(v, name)| (v.abs(), name)).collect();
    descending(&mut parts, |a| a.0);
    parts.into_iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>().join(", ")
}

/// The table of singular values: combinations of parameters from the worst to the best determined. `covariance` in the parameters' own
/// units.
pub(super) fn combinations(map: &[MapColumns], covariance: &DMatrix<f64>, names: &[String]) -> Vec<Combination> {
    const SMALL_SHARE: f64 = 0.1;
    let n = names.len();
    let root: Vec<f64> = (0..n).map(|k| covariance[(k, k)].max(0.0).sqrt()).collect();
    let correlation = DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (root[i] * root[j]));
    let Some(information) = correlation.try_inverse() else { return Vec::new() };
    // Each column of length one: what is left are the angles between them.
    let length: Vec<f64> = (0..n).map(|k| information[(k, k)].max(0.0).sqrt()).collect();
    let eigen = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (length[i] * length[j])).symmetric_eigen();
    let mut order: Vec<usize> = (0..n).collect();
    ascending(&mut order, |a| eigen.eigenvalues[*a]);
    let of = |k: usize| {
        let singular_value = eigen.eigenvalues[k].max(0.0).sqrt();
        let shares = eigen.eigenvectors.column(k);
        let step: Vec<f64> = (0..n).map(|i| shares[i] / singular_value.max(f64::MIN_POSITIVE) * root[i] / length[i]).collect();
        let square: f64 = map
            .iter()
            .flat_map(|place| &place.columns)
            .map(|column| column.iter().zip(&step).map(|(column, step)| column * step).sum::<f64>().powi(2))
            .sum();
        let sigma_px = (square / map.len().max(1) as f64).sqrt();
        let mut parameters: Vec<(String, f64)> = names
            .iter()
            .zip(shares.iter())
            .filter(|(_, share)| share.abs() >= SMALL_SHARE)
            .map(|(name, share)| (name.clone(), *share))
            .collect();
        descending(&mut parameters, |a| a.1.abs());
        let sentence = (parameters.len() > 1 && singular_value < BADLY).then(|| {
            let list: Vec<&str> = parameters.iter().map(|(name, _)| name.as_str()).collect();
            let (last, rest) = list.split_last().map_or(("", &[][..]), |(last, rest)| (*last, rest));
            format!(
                "{} and {last} cannot be told apart well here (singular value {singular_value:.3}); what stays open between them moves the map by {sigma_px:.4} px",
                rest.join(", ")
            )
        });
        Combination { singular_value, sigma_px, parameters, sentence }
    };
    order.into_iter().map(of).collect()
}

/// Of each combination that is hardly determined the parameter that has most of it, none twice; one of an effect before those of the
/// reference model.
pub(super) fn weakest(combinations: &[Combination], names: &[String]) -> Vec<usize> {
    let mut chosen = Vec::new();
    for combination in combinations.iter().filter(|combination| combination.singular_value < HARDLY) {
        let place = |of_reference: bool| {
            let of_kind = combination.parameters.iter().filter(|(name, _)| is_reference(name) == of_reference);
            of_kind.filter_map(|(name, _)| names.iter().position(|other| other == name)).find(|place| !chosen.contains(place))
        };
        let found = place(false).or_else(|| place(true));
        chosen.extend(found);
    }
    chosen
}
