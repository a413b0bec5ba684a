//! What earlier solutions know of the camera, and their information on its parameters.

use nalgebra::DMatrix;

use super::{Attitudes, NoiseMemory, Problem};
use crate::camera::Model;

/// Factor of the information known while the new frames are looked at nearly alone.
pub(super) const WIDE: f64 = 1e-4;
/// What earlier solutions know.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Known<'a> {
    /// The camera at the estimate.
    pub(in crate::calibrate) model: &'a Model,
    /// Names of the free parameters, in the model's order.
    pub(in crate::calibrate) names: &'a [String],
    /// Information on them for unit weight, in their own units.
    pub(in crate::calibrate) information: DMatrix<f64>,
    /// The star images so far.
    pub(in crate::calibrate) memory: &'a NoiseMemory,
    /// The floor τ² that they were weighted with.
    pub(in crate::calibrate) floor_px2: f64,
    /// Radius in which wrong identifications fall.
    pub(in crate::calibrate) wrong_radius_px: f64,
}

/// Degrees of freedom that the attitudes of the new frames take.
pub(super) fn lost(problem: &Problem, active: usize) -> f64 {
    if problem.attitudes == Attitudes::FixedToEarth { 3.0 } else { 3.0 * active as f64 }
}

/// The information on the parameters of the model, in their own units, a mount's attitude eliminated.
pub(super) fn of_parameters(information: &DMatrix<f64>, free: usize, scale: &[f64]) -> Option<DMatrix<f64>> {
    let mut own = information.view((0, 0), (free, free)).into_owned();
    let others = information.nrows() - free;
    if others > 0 {
        let coupling = information.view((0, free), (free, others)).into_owned();
        let mount = information.view((free, free), (others, others)).into_owned().cholesky()?;
        own -= &coupling * mount.solve(&coupling.transpose());
    }
    // Symmetric to the last bit, as files have it.
    Some(DMatrix::from_fn(free, free, |i, j| f64::midpoint(own[(i, j)], own[(j, i)]) * scale[i] * scale[j]))
}

/// The inverse of an information matrix whose parameters may have any units; `None` where it leaves a combination open.
pub(in crate::calibrate) fn inverse(information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = information.nrows();
    let root: Vec<f64> = (0..n).map(|k| information[(k, k)].sqrt()).collect();
    if !root.iter().all(|root| root.is_finite() && *root > 0.0) {
        return None;
    }
    let equilibrated = DMatrix::from_fn(n, n, |i, j| information[(i, j)] / (root[i] * root[j]));
    let inverse = equilibrated.cholesky()?.inverse();
    Some(DMatrix::from_fn(n, n, |i, j| f64::midpoint(inverse[(i, j)], inverse[(j, i)]) / (root[i] * root[j])))
}
