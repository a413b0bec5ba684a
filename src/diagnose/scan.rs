//! Score tests of many groups of columns on the same residuals: every hypothesis and every pattern of every covariate is a group. Its statistic is
//! the square of what it explains of ψ over c, which is χ² of its rank if there is no effect.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::evidence::Evidence;
use super::linear_fit::Fit;
use super::linear_system::{Whitened, WhitenedSystem, products};
use super::noise::NoiseModel;
use crate::calibrate::Column;
use crate::statistics::significance::neg_ln_chi2_sf;

/// A combination of columns of which attitudes and camera leave a smaller share is no question.
pub(super) const MIN_SHARE: f64 = 1e-3;
/// Whose question it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Asks {
    /// Of a hypothesis (its index) and a variant of it.
    Hypothesis(usize, usize),
    /// Of a covariate (its index).
    Covariate(usize),
}

/// A group of columns.
#[derive(Clone, Debug)]
pub(super) struct Group {
    /// Whose.
    pub(super) asks: Asks,
    /// Which of the covariate's patterns.
    pub(super) pattern: usize,
    /// How many independent columns it has.
    pub(super) rank: usize,
    /// The square of what it explains of ψ, over c.
    pub(super) statistic: f64,
}

impl Group {
    /// −ln of the probability of such a statistic without any effect.
    pub(super) fn surprise(&self) -> f64 {
        neg_ln_chi2_sf(self.rank as f64, self.statistic)
    }
}

/// All questions and their answers.
#[derive(Clone, Debug)]
pub(super) struct Scan {
    /// The groups.
    pub(super) groups: Vec<Group>,
    /// Orthonormal columns of all groups, one group after the other, to ask chance with; none where it is not to be asked. Rounded to single
    /// precision: a statistic changes by a millionth.
    pub(super) columns: DMatrix<f32>,
}

impl Scan {
    /// The questions of the hypotheses for which `asked` is true, and of all covariates.
    pub(super) fn new(evidence: &Evidence, noise: &NoiseModel, system: &WhitenedSystem, fit: &Fit, asked: impl Fn(usize) -> bool) -> Self {
        Self::prepared(evidence, noise, system, fit, asked, true)
    }

    /// The questions of hypotheses alone.
    pub(super) fn hypotheses(
        evidence: &Evidence,
        noise: &NoiseModel,
        system: &WhitenedSystem,
        fit: &Fit,
        asked: impl Fn(usize) -> bool,
    ) -> Self {
        Self::prepared(evidence, noise, system, fit, asked, false)
    }

    fn prepared(
        evidence: &Evidence,
        noise: &NoiseModel,
        system: &WhitenedSystem,
        fit: &Fit,
        asked: impl Fn(usize) -> bool,
        with_covariates: bool,
    ) -> Self {
        let mut wanted: Vec<(Asks, usize, Vec<&Column>)> = Vec::new();
        for (index, hypothesis) in evidence.hypotheses.iter().enumerate().filter(|(index, _)| asked(*index)) {
            for (variant, of) in hypothesis.variants.iter().enumerate() {
                wanted.push((Asks::Hypothesis(index, variant), 0, of.columns.iter().collect()));
            }
        }
        if with_covariates {
            for (index, covariate) in evidence.covariates.iter().enumerate() {
                for (place, pattern) in covariate.patterns.iter().enumerate() {
                    wanted.push((Asks::Covariate(index), place, pattern.iter().collect()));
                }
            }
        }
        let answered: Vec<(Group, Vec<f32>)> = wanted
            .into_par_iter()
            .filter_map(|(asks, pattern, columns)| {
                let raw: Vec<Whitened> = columns.into_iter().map(|column| evidence.white(noise, column)).collect();
                let (rest, mixing) = spanned(system, fit, &raw);
                let along = mixing.tr_mul(&rest.tr_mul(&DVector::from_column_slice(&fit.psi)));
                let group = Group { asks, pattern, rank: mixing.ncols(), statistic: along.norm_squared() / fit.c };
                let columns = if with_covariates { (rest * mixing).iter().map(|value| *value as f32).collect() } else { Vec::new() };
                (group.rank > 0).then_some((group, columns))
            })
            .collect();
        let rows = 2 * system.images();
        let count = answered.iter().map(|(_, columns)| columns.len()).sum::<usize>().checked_div(rows).unwrap_or(0);
        let mut flat: Vec<f32> = Vec::with_capacity(rows * count);
        let mut groups = Vec::with_capacity(answered.len());
        for (group, columns) in answered {
            groups.push(group);
            flat.extend(columns);
        }
        Self { groups, columns: DMatrix::from_vec(rows, count, flat) }
    }
}

/// Orthonormal columns that span what a fit leaves of others.
pub(super) fn orthonormal(system: &WhitenedSystem, fit: &Fit, raw: &[Whitened]) -> DMatrix<f64> {
    let (rest, mixing) = spanned(system, fit, raw);
    rest * mixing
}

/// What a fit leaves of columns, and the coefficients of orthonormal combinations of it.
fn spanned(system: &WhitenedSystem, fit: &Fit, raw: &[Whitened]) -> (DMatrix<f64>, DMatrix<f64>) {
    let rest = fit.project_all(system, raw);
    let length: Vec<f64> = raw.iter().map(|column| fit.length_squared(column).sqrt()).collect();
    let scale: Vec<f64> = length.iter().map(|length| if *length > 0.0 { 1.0 / length } else { 0.0 }).collect();
    let n = raw.len();
    let mut gram = products(&rest, &rest);
    for (k, value) in gram.iter_mut().enumerate() {
        *value *= scale[k % n] * scale[k / n];
    }
    let eigen = gram.symmetric_eigen();
    let kept: Vec<usize> = (0..n).filter(|k| eigen.eigenvalues[*k] > MIN_SHARE * MIN_SHARE).collect();
    let mixing = DMatrix::from_fn(n, kept.len(), |i, j| scale[i] * eigen.eigenvectors[(i, kept[j])] / eigen.eigenvalues[kept[j]].sqrt());
    (rest, mixing)
}
