//! A robust fit of the rows: nuisance parameters and accepted effects under errors with a t distribution, the noise of every kind found with it.
//!
//! At its end ψ = w·r (w the t weights) is orthogonal to everything fitted, and the score of a further column a is aᵀψ with the variance c·|Ma|², M the
//! projection that takes out what is fitted. ψ is given in units of its own scatter, kind by kind, so that c is one. The same pseudo-values as in
//! [`crate::diagnose::linear_fit`] (Huber, Robust Statistics, 1981, 7.8), for rows of one number.

use nalgebra::{DMatrix, DVector};

use super::rows::{Kind, KindNoise, Row, Rows, Shared};
use crate::statistics::median_in_place;

/// Degrees of freedom of the t distribution of the errors.
const TAIL_DEGREES: f64 = 6.0;
/// Median of χ² of one degree of freedom.
const MEDIAN_CHI2: f64 = 0.454_936;
/// Fewer groups do not tell what their rows share.
const MIN_GROUPS: usize = 4;
/// A row farther than this many standard deviations takes no part: another star, a variable one.
const GROSS_SIGMAS: f64 = 12.0;
const TURNS: usize = 4;
const STEPS: usize = 12;

/// A fit of the rows.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct RowFit {
    /// Noise of every kind.
    pub(in crate::diagnose) noise: Vec<KindNoise>,
    /// Rows that take part.
    pub(in crate::diagnose) take: Vec<bool>,
    /// Whitened residuals times weights, in units of their scatter.
    pub(in crate::diagnose) psi: Vec<f64>,
    /// Residuals in the rows' units.
    pub(in crate::diagnose) rest: Vec<f64>,
    /// Sizes of the accepted columns, their covariance.
    pub(in crate::diagnose) size: DVector<f64>,
    pub(in crate::diagnose) covariance: DMatrix<f64>,
    /// Root of the variance of ψ before it was put in its units, by kind.
    scatter: Vec<f64>,
    /// Mean slope of ψ over the root of its variance, by kind: what a unit of a whitened column adds to ψ.
    gain: Vec<f64>,
    basis: DMatrix<f64>,
    whiteners: std::sync::Arc<Vec<super::rows::Whitener>>,
}

impl RowFit {
    /// With some columns accepted, on the rows allowed; the noise is found anew from `begin`.
    pub(in crate::diagnose) fn new(rows: &Rows, allowed: &[bool], accepted: &[&Vec<f64>], begin: Option<&Self>) -> Self {
        let columns = design(rows, accepted);
        let mut noise = begin.map_or_else(|| vec![KindNoise::STATED; rows.kinds.len()], |fit| fit.noise.clone());
        let mut take = begin.map_or_else(|| allowed.to_vec(), |fit| fit.take.iter().zip(allowed).map(|(a, b)| *a && *b).collect());
        let mut turn = 0;
        loop {
            let fit = Self::with_noise(rows, &take, accepted.len(), &columns, (&noise, None));
            turn += 1;
            if turn > TURNS {
                return fit;
            }
            let parameters = columns.len();
            noise = rows
                .kinds
                .iter()
                .zip(rows.ranges())
                .map(|(kind, range)| found(kind, &fit.rest[range.clone()], &take[range], parameters))
                .collect();
            let sigma: Vec<f64> = rows
                .kinds
                .iter()
                .zip(&noise)
                .flat_map(|(kind, noise)| kind.rows.iter().map(|row| (noise.variance(row) + noise.shared).sqrt()))
                .collect();
            let is_normal = normal(rows);
            take = (0..take.len()).map(|k| allowed[k] && (is_normal[k] || fit.rest[k].abs() < GROSS_SIGMAS * sigma[k])).collect();
        }
    }

    /// Under the noise of another fit, on the rows allowed that are not far off there: a model that lacks an effect has no noise of its own to be
    /// judged by.
    pub(in crate::diagnose) fn under(rows: &Rows, allowed: &[bool], accepted: &[&Vec<f64>], other: &Self) -> Self {
        Self::with_noise(rows, allowed, accepted.len(), &design(rows, accepted), (&other.noise, Some(&other.scatter)))
    }

    /// With the noise as it is.
    fn with_noise(
        rows: &Rows,
        take: &[bool],
        accepted: usize,
        columns: &[Vec<f64>],
        (noise, scatter): (&[KindNoise], Option<&[f64]>),
    ) -> Self {
        let ranges = rows.ranges();
        let whitener = |((kind, noise), range): ((&Kind, &KindNoise), &std::ops::Range<usize>)| kind.whitener(noise, &take[range.clone()]);
        let whiteners: Vec<_> = rows.kinds.iter().zip(noise).zip(&ranges).map(whitener).collect();
        let white = |column: &[f64]| -> Vec<f64> {
            let mut all: Vec<f64> =
                whiteners.iter().zip(&ranges).flat_map(|(whitener, range)| whitener.apply(&column[range.clone()])).collect();
            for (value, take) in all.iter_mut().zip(take) {
                *value = if *take { *value } else { 0.0 };
            }
            all
        };
        let value: Vec<f64> = rows.rows().map(|row| row.value).collect();
        let (n, k) = (value.len(), columns.len());
        let y = DVector::from_vec(white(&value));
        let x = DMatrix::from_iterator(n, k, columns.iter().flat_map(|column| white(column)));
        let is_normal = normal(rows);
        let (all, weight, inverse) = robust(&y, &x, take, &is_normal);
        let residual = &y - &x * &all;
        let mut psi: Vec<f64> = residual.iter().zip(&weight).map(|(r, w)| r * w).collect();
        let (mut gain, mut scatters) = (Vec::with_capacity(ranges.len()), Vec::with_capacity(ranges.len()));
        let mut scale = vec![1.0; n];
        for range in &ranges {
            let taken: Vec<usize> = range.clone().filter(|k| take[*k]).collect();
            let count = taken.len().max(1) as f64;
            let slope = taken.iter().map(|k| if is_normal[*k] { 1.0 } else { slope(residual[*k]) }).sum::<f64>() / count;
            let lost = 1.0 - (k as f64 / n.max(1) as f64).min(0.5);
            let variance = (taken.iter().map(|k| psi[*k] * psi[*k]).sum::<f64>() / (count * lost)).max(1e-12);
            // Errors that are taken at their word are normal, and ψ is the residual.
            let found = if rows.kinds[gain.len()].is_scaled { variance.sqrt() } else { 1.0 };
            let own = scatter.map_or(found, |scatter| scatter[gain.len()]);
            range.clone().for_each(|k| scale[k] = own);
            gain.push(slope / own);
            scatters.push(own);
        }
        for (psi, scale) in psi.iter_mut().zip(&scale) {
            *psi /= scale;
        }
        let factor = error_factor(&gain, &ranges, take);
        let covariance = &inverse * factor;
        let from = k - accepted;
        let unwhitened: Vec<f64> =
            (0..n).map(|row| value[row] - (0..k).map(|column| columns[column][row] * all[column]).sum::<f64>()).collect();
        Self {
            noise: noise.to_vec(),
            take: take.to_vec(),
            psi,
            rest: unwhitened,
            size: all.rows(from, accepted).into_owned(),
            covariance: covariance.view((from, from), (accepted, accepted)).into_owned(),
            scatter: scatters,
            gain,
            basis: orthonormal(&x),
            whiteners: std::sync::Arc::new(whiteners),
        }
    }

    /// A column whitened, and what is fitted taken out.
    pub(in crate::diagnose) fn project(&self, rows: &Rows, column: &[f64]) -> DVector<f64> {
        let mut white: Vec<f64> =
            self.whiteners.iter().zip(rows.ranges()).flat_map(|(whitener, range)| whitener.apply(&column[range])).collect();
        for (value, take) in white.iter_mut().zip(&self.take) {
            *value = if *take { *value } else { 0.0 };
        }
        let mut rest = DVector::from_vec(white);
        for _ in 0..2 {
            let along = self.basis.tr_mul(&rest);
            rest -= &self.basis * along;
        }
        rest
    }

    /// Length of what a unit of a column would add to ψ if nothing were fitted.
    pub(in crate::diagnose) fn whole(&self, rows: &Rows, column: &[f64]) -> f64 {
        let of_kind = |((whitener, range), gain): ((&super::rows::Whitener, std::ops::Range<usize>), &f64)| -> f64 {
            let white = whitener.apply(&column[range.clone()]);
            white.iter().zip(&self.take[range]).filter(|(_, take)| **take).map(|(value, _)| (value * gain).powi(2)).sum()
        };
        self.whiteners.iter().zip(rows.ranges()).zip(&self.gain).map(of_kind).sum::<f64>().sqrt()
    }

    /// What a unit of a column adds to ψ, row by row, beyond what is fitted.
    pub(in crate::diagnose) fn response(&self, rows: &Rows, column: &[f64]) -> DVector<f64> {
        let mut rest = self.project(rows, column);
        for (gain, range) in self.gain.iter().zip(rows.ranges()) {
            rest.rows_mut(range.start, range.len()).scale_mut(*gain);
        }
        rest
    }

    /// Size and standard error of a column of its own, beside what is fitted, over the rows that `of` names.
    pub(in crate::diagnose) fn amplitude(&self, rows: &Rows, column: &[f64], of: impl Fn(usize) -> bool) -> Option<[f64; 2]> {
        let own = self.response(rows, column);
        let (mut along, mut square) = (0.0, 0.0);
        for k in (0..own.len()).filter(|k| of(*k)) {
            along += own[k] * self.psi[k];
            square += own[k] * own[k];
        }
        (square > 0.0).then(|| [along / square, square.sqrt().recip()])
    }
}

/// Nuisance columns of all kinds over all rows, and the accepted ones.
fn design(rows: &Rows, accepted: &[&Vec<f64>]) -> Vec<Vec<f64>> {
    let n = rows.len();
    let mut columns = Vec::new();
    for (kind, range) in rows.kinds.iter().zip(rows.ranges()) {
        for common in &kind.common {
            let mut column = vec![0.0; n];
            column[range.clone()].copy_from_slice(common);
            columns.push(column);
        }
        for own in &kind.per_frame {
            let frames: std::collections::BTreeSet<usize> = kind.rows.iter().map(|row| row.frame).collect();
            for frame in frames {
                let mut column = vec![0.0; n];
                for ((value, row), own) in column[range.clone()].iter_mut().zip(&kind.rows).zip(own) {
                    *value = if row.frame == frame { *own } else { 0.0 };
                }
                columns.push(column);
            }
        }
    }
    columns.extend(accepted.iter().map(|column| (*column).clone()));
    columns
}

fn weight(residual: f64) -> f64 {
    (TAIL_DEGREES + 1.0) / (TAIL_DEGREES + residual * residual)
}

fn slope(residual: f64) -> f64 {
    let w = weight(residual);
    w * (TAIL_DEGREES - residual * residual) / (TAIL_DEGREES + residual * residual)
}

/// Of every row whether its error is taken at its word, and normal.
fn normal(rows: &Rows) -> Vec<bool> {
    rows.kinds.iter().flat_map(|kind| vec![!kind.is_scaled; kind.rows.len()]).collect()
}

/// Factor of the variances of the sizes: of pseudo-values, whose mean slope over the root of their variance is the gain; weighted by the rows.
fn error_factor(gain: &[f64], ranges: &[std::ops::Range<usize>], take: &[bool]) -> f64 {
    let (mut square, mut count) = (0.0, 0.0);
    for (gain, range) in gain.iter().zip(ranges) {
        let taken = range.clone().filter(|k| take[*k]).count() as f64;
        square += taken * gain.powi(-2);
        count += taken;
    }
    if count > 0.0 { square / count } else { 1.0 }
}

/// Parameters of least t cost by weights found in turn, the weights, and the inverse of the unweighted normal matrix.
fn robust(y: &DVector<f64>, x: &DMatrix<f64>, take: &[bool], is_normal: &[bool]) -> (DVector<f64>, Vec<f64>, DMatrix<f64>) {
    let (n, k) = x.shape();
    let scale: Vec<f64> = x.column_iter().map(|column| column.norm().max(1e-300)).collect();
    let unit = DMatrix::from_fn(n, k, |i, j| x[(i, j)] / scale[j]);
    let mut weights = vec![1.0; n];
    let mut beta = DVector::zeros(k);
    for _ in 0..STEPS {
        let weighted = DMatrix::from_fn(n, k, |i, j| unit[(i, j)] * weights[i]);
        let right = weighted.tr_mul(y);
        let normal = super::products(&weighted, &unit);
        let solved = pseudo_inverse(normal) * right;
        let moved = (&solved - &beta).amax();
        let size = solved.amax();
        beta = solved;
        let residual = y - &unit * &beta;
        let of = |((r, take), is_normal): ((&f64, &bool), &bool)| match (*take, *is_normal) {
            (false, _) => 0.0,
            (true, true) => 1.0,
            (true, false) => weight(*r),
        };
        weights = residual.iter().zip(take).zip(is_normal).map(of).collect();
        if moved < 1e-9 * size.max(1e-9) {
            break;
        }
    }
    let inverse = pseudo_inverse(super::products(&unit, &unit));
    let back = DMatrix::from_fn(k, k, |i, j| inverse[(i, j)] / (scale[i] * scale[j]));
    (DVector::from_fn(k, |i, _| beta[i] / scale[i]), weights, back)
}

/// Inverse of a symmetric matrix of columns of unit length, what is dependent left out.
fn pseudo_inverse(matrix: DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    if let Some(cholesky) = matrix.clone().cholesky()
        && cholesky.l_dirty().diagonal().iter().all(|pivot| *pivot > 1e-5)
    {
        return cholesky.inverse();
    }
    let eigen = matrix.symmetric_eigen();
    let largest = eigen.eigenvalues.amax();
    let inverse = eigen.eigenvalues.map(|value| if value > 1e-10 * largest { value.recip() } else { 0.0 });
    &eigen.eigenvectors * DMatrix::from_diagonal(&inverse) * eigen.eigenvectors.transpose().columns(0, n)
}

/// Orthonormal basis of columns, dependent ones left out.
fn orthonormal(x: &DMatrix<f64>) -> DMatrix<f64> {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    for column in x.column_iter() {
        let length = column.norm();
        let mut vector = column.into_owned();
        for _ in 0..2 {
            for known in &basis {
                let along = known.dot(&vector);
                vector.axpy(-along, known, 1.0);
            }
        }
        let left = vector.norm();
        if left > 1e-7 * length && left > 0.0 {
            basis.push(vector / left);
        }
    }
    if basis.is_empty() { DMatrix::zeros(x.nrows(), 0) } else { DMatrix::from_columns(&basis) }
}

/// The noise of a kind from its residuals.
fn found(kind: &Kind, rest: &[f64], take: &[bool], parameters: usize) -> KindNoise {
    if !kind.is_scaled {
        return KindNoise::STATED;
    }
    let taken: Vec<usize> = (0..rest.len()).filter(|k| take[*k]).collect();
    let dof = 1.0 - (parameters as f64 / taken.len().max(1) as f64).min(0.5);
    let row = |k: &usize| &kind.rows[*k];
    let groups: Vec<Vec<usize>> = if kind.shared == Shared::No {
        Vec::new()
    } else {
        let is_taken = |group: Vec<usize>| group.into_iter().filter(|k| take[*k]).collect::<Vec<_>>();
        kind.groups().into_iter().map(is_taken).filter(|group| !group.is_empty()).collect()
    };
    let repeated = groups.iter().filter(|group| group.len() > 1).count();
    if repeated < MIN_GROUPS {
        let pairs: Vec<(f64, &Row)> = taken.iter().map(|k| (rest[*k], row(k))).collect();
        return within(&pairs, dof);
    }
    // Within groups first: what they share does not count there.
    let mut noise = KindNoise::STATED;
    for _ in 0..3 {
        let mut pairs = Vec::with_capacity(taken.len());
        let mut means = Vec::with_capacity(groups.len());
        for group in &groups {
            let weight = |k: &usize| noise.variance(row(k)).recip();
            let total: f64 = group.iter().map(weight).sum();
            let mean = group.iter().map(|k| rest[*k] * weight(k)).sum::<f64>() / total;
            means.push((mean, total.recip()));
            if group.len() > 1 {
                // A residual about its group's mean is smaller by what it gave to the mean.
                pairs.extend(group.iter().map(|k| ((rest[*k] - mean) / (1.0 - weight(k) / total).sqrt(), row(k))));
            }
        }
        noise = within(&pairs, 1.0);
        noise.shared = between(&means);
    }
    noise
}

/// Factor and floor of the variance of rows.
fn within(pairs: &[(f64, &Row)], dof: f64) -> KindNoise {
    let typical = |noise: &KindNoise| {
        let mut squares: Vec<f64> = pairs.iter().map(|(rest, row)| rest * rest / noise.variance(row)).collect();
        median_in_place(&mut squares).unwrap_or(MEDIAN_CHI2) / (MEDIAN_CHI2 * dof)
    };
    let stated = typical(&KindNoise::STATED);
    if stated <= 1.0 {
        return KindNoise { factor: stated.max(0.25), ..KindNoise::STATED };
    }
    let mut variances: Vec<f64> = pairs.iter().map(|(_, row)| row.sigma * row.sigma).collect();
    let scale = median_in_place(&mut variances).unwrap_or(1.0);
    let at = |floor: f64| KindNoise { floor, ..KindNoise::STATED };
    let (mut low, mut high) = (0.0, scale * stated * 4.0);
    while typical(&at(high)) > 1.0 && high < scale * 1e12 {
        high *= 4.0;
    }
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if typical(&at(middle)) > 1.0 { low = middle } else { high = middle }
    }
    at(0.5 * (low + high))
}

/// Variance of what groups share, from their means and the variances of these.
fn between(means: &[(f64, f64)]) -> f64 {
    // What all groups have in common the zero points take up, or leave: it is no scatter.
    let middle = crate::statistics::median(&means.iter().map(|(mean, _)| *mean).collect::<Vec<_>>()).unwrap_or(0.0);
    let means: Vec<(f64, f64)> = means.iter().map(|(mean, variance)| (mean - middle, *variance)).collect();
    let typical = |shared: f64| {
        let mut squares: Vec<f64> = means.iter().map(|(mean, variance)| mean * mean / (variance + shared)).collect();
        // Few means: their mean square, the largest cut, scatters less than their median.
        squares.sort_by(f64::total_cmp);
        let kept = &squares[..squares.len() - squares.len() / 20];
        let cut = if squares.len() >= 20 { 0.81 } else { 1.0 };
        kept.iter().sum::<f64>() / (kept.len() as f64 * cut) * (means.len() as f64 / (means.len() as f64 - 1.0))
    };
    if means.len() < MIN_GROUPS || typical(0.0) <= 1.0 {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, means.iter().map(|(mean, _)| mean * mean).fold(0.0, f64::max));
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if typical(middle) > 1.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}
