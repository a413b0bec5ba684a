//! A solved problem, with the larger model that it may have left out.

use nalgebra::DMatrix;

use super::{Adjusted, Problem};

/// A solved problem.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Solved {
    /// What was adjusted, the model at the solution.
    pub(in crate::calibrate) problem: Problem,
    /// Where it ended.
    pub(in crate::calibrate) adjusted: Adjusted,
    /// What to mind.
    pub(in crate::calibrate) notes: Vec<String>,
    /// A larger model that the star images do not support and need not exclude.
    pub(in crate::calibrate) alternative: Option<Alternative>,
}

/// A larger model than the chosen one, which the star images do not support and need not exclude.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Alternative {
    /// Its parameters.
    pub(super) names: Vec<String>,
    /// Its solution minus the chosen model's, in the parameters' units.
    pub(super) difference: Vec<f64>,
    /// Covariance of its parameters.
    pub(super) covariance: DMatrix<f64>,
}

/// The covariance of the solved parameters, and of those that are left out after them, about the values stated; `None` where there was no
/// choice.
pub(super) fn left_open(solved: &[String], alternative: Option<&Alternative>) -> Option<(Vec<String>, DMatrix<f64>)> {
    let Alternative { names: its, difference, covariance } = alternative?;
    let more = its.iter().filter(|name| !solved.contains(name));
    let names: Vec<String> = solved.iter().chain(more).cloned().collect();
    let places: Vec<usize> = names.iter().map(|name| its.iter().position(|other| other == name)).collect::<Option<_>>()?;
    let n = names.len();
    let sum = DMatrix::from_fn(n, n, |i, j| {
        let (i, j) = (places[i], places[j]);
        covariance[(i, j)] + difference[i] * difference[j]
    });
    Some((names, sum))
}
