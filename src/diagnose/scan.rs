//! Many questions to the same residuals, and what chance would answer: every hypothesis and every pattern of every covariate is a group of
//! columns; its statistic is the square of what it explains of ψ over c, χ² of its rank without any effect. The largest of all is held
//! against recordings simulated without any effect: the same star images, errors drawn from the residuals' own distribution of sizes in
//! random directions, the same projections. Where the p-value lies below what the simulations resolve it is read off the tail that
//! they show: p = 1 − (1 − p₁)^m with m the number of independent questions that they amount to.
//!
//! Source: Westfall and Young, Resampling-Based Multiple Testing (1993), maxT.

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::evidence::Evidence;
use super::noise::NoiseModel;
use super::sheet::{Fit, Sheet, Whitened, dot};
use crate::calibrate::Column;
use crate::statistics::significance::chi_squared_surprise;

/// Simulated recordings drawn together.
const BATCH: usize = 64;
/// Directions of simulated errors.
const DIRECTIONS: usize = 4096;
/// A combination of columns of which attitudes and camera leave a smaller share is no question.
const LEAST_SHARE: f64 = 1e-3;
/// m is read off this part of the simulations, those with the smallest p.
const TAIL_SHARE: f64 = 0.2;

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
    /// Its columns among all, orthonormal.
    columns: std::ops::Range<usize>,
}

impl Group {
    /// How many independent columns it has.
    pub(super) fn rank(&self) -> usize {
        self.columns.len()
    }
}

/// All questions, ready to be asked.
#[derive(Clone, Debug)]
pub(super) struct Scan {
    /// The groups.
    pub(super) groups: Vec<Group>,
    /// Line by line: a product of two matrices in this order is what the library does fast.
    columns: DMatrix<f64>,
}

/// What chance answers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Chance {
    /// The largest surprise of each simulation, over all groups; sorted, the largest first.
    pub(super) all: Vec<f64>,
    /// Over the hypotheses alone.
    pub(super) hypotheses: Vec<f64>,
    /// Over the covariates alone.
    pub(super) covariates: Vec<f64>,
}

impl Scan {
    /// The questions of the hypotheses for which `asked` is true, and of all covariates.
    pub(super) fn new(evidence: &Evidence, noise: &NoiseModel, sheet: &Sheet, fit: &Fit, asked: impl Fn(usize) -> bool) -> Self {
        Self::prepared(evidence, noise, sheet, fit, asked, true)
    }

    /// The questions of hypotheses alone.
    pub(super) fn hypotheses(evidence: &Evidence, noise: &NoiseModel, sheet: &Sheet, fit: &Fit, asked: impl Fn(usize) -> bool) -> Self {
        Self::prepared(evidence, noise, sheet, fit, asked, false)
    }

    fn prepared(
        evidence: &Evidence,
        noise: &NoiseModel,
        sheet: &Sheet,
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
        let bases: Vec<(Asks, usize, Vec<Whitened>)> = wanted
            .into_par_iter()
            .map(|(asks, pattern, columns)| {
                let raw: Vec<Whitened> = columns.into_iter().map(|column| evidence.white(noise, column)).collect();
                (asks, pattern, orthonormal(sheet, fit, &raw))
            })
            .collect();
        let mut groups = Vec::new();
        let mut flat: Vec<f64> = Vec::new();
        let rows = 2 * sheet.images();
        let mut count = 0;
        for (asks, pattern, basis) in bases {
            groups.push(Group { asks, pattern, columns: count..count + basis.len() });
            count += basis.len();
            flat.extend(basis.into_iter().flatten());
        }
        groups.retain(|group| !group.columns.is_empty());
        Self { groups, columns: DMatrix::from_vec(rows, count, flat).transpose() }
    }

    /// The statistic of every group.
    pub(super) fn ask(&self, psi: &[f64], c: f64) -> Vec<f64> {
        let z = &self.columns * DVector::from_column_slice(psi);
        self.groups.iter().map(|group| group.columns.clone().map(|k| z[k] * z[k]).sum::<f64>() / c).collect()
    }

    /// Surprises of the groups.
    pub(super) fn surprises(&self, psi: &[f64], c: f64) -> Vec<f64> {
        let statistics = self.ask(psi, c);
        self.groups.iter().zip(statistics).map(|(group, t)| chi_squared_surprise(group.rank() as f64, t)).collect()
    }

    /// Simulated recordings `from..to` without any effect.
    pub(super) fn chance(&self, fit: &Fit, take: &[bool], seed: u64, from: usize, to: usize) -> Chance {
        let sizes: Vec<f64> = (0..take.len()).filter(|k| take[*k]).map(|k| fit.psi[2 * k].hypot(fit.psi[2 * k + 1])).collect();
        let directions: Vec<[f64; 2]> = (0..DIRECTIONS)
            .map(|k| {
                let (sine, cosine) = (k as f64 * std::f64::consts::TAU / DIRECTIONS as f64).sin_cos();
                [cosine, sine]
            })
            .collect();
        let tables = Tables::new(self.groups.iter().map(Group::rank));
        let batches: Vec<(usize, usize)> = (from..to).step_by(BATCH).map(|first| (first, (first + BATCH).min(to))).collect();
        let largest: Vec<[f64; 3]> = batches
            .into_par_iter()
            .flat_map_iter(|(first, last)| {
                let rows = self.columns.ncols();
                let mut noise = DMatrix::zeros(rows, last - first);
                let mut c = Vec::with_capacity(last - first);
                for null in first..last {
                    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ (null as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
                    let mut square = 0.0;
                    let mut column = noise.column_mut(null - first);
                    for k in (0..take.len()).filter(|k| take[*k]) {
                        let size = sizes[rng.random_range(0..sizes.len())];
                        let [x, y] = directions[rng.random_range(0..DIRECTIONS)];
                        column[2 * k] = size * x;
                        column[2 * k + 1] = size * y;
                        square += size * size;
                    }
                    c.push(square / (2.0 * sizes.len() as f64));
                }
                let z = &self.columns * &noise;
                let of = |null: usize| {
                    let mut most = [0.0_f64; 3];
                    for group in &self.groups {
                        let t = group.columns.clone().map(|k| z[(k, null)].powi(2)).sum::<f64>() / c[null];
                        let surprise = tables.surprise(group.rank(), t);
                        most[0] = most[0].max(surprise);
                        let own = if matches!(group.asks, Asks::Hypothesis(..)) { 1 } else { 2 };
                        most[own] = most[own].max(surprise);
                    }
                    most
                };
                (0..last - first).map(of).collect::<Vec<_>>()
            })
            .collect();
        let sorted = |which: usize| {
            let mut values: Vec<f64> = largest.iter().map(|most| most[which]).collect();
            values.sort_by(|a, b| b.total_cmp(a));
            values
        };
        Chance { all: sorted(0), hypotheses: sorted(1), covariates: sorted(2) }
    }
}

impl Chance {
    /// With more simulations.
    pub(super) fn and(mut self, more: Self) -> Self {
        for (own, others) in [(&mut self.all, more.all), (&mut self.hypotheses, more.hypotheses), (&mut self.covariates, more.covariates)] {
            own.extend(others);
            own.sort_by(|a, b| b.total_cmp(a));
        }
        self
    }
}

/// How many independent questions the simulations amount to: the m for which the smallest p of m follows their tail.
pub(super) fn independent(largest: &[f64]) -> f64 {
    let n = largest.len();
    let tail = ((n as f64 * TAIL_SHARE) as usize).max(1).min(n);
    // Of maximum likelihood for a tail cut at its own k-th value: k − ½ of n lie below the k-th smallest p.
    let Some(edge) = largest.get(tail - 1) else { return 1.0 };
    let share = (tail as f64 - 0.5) / n as f64;
    (-(1.0 - share).ln() / -(-(-edge).exp()).ln_1p()).max(1.0)
}

/// Probability that the largest surprise of a recording without any effect is as large.
pub(super) fn family_p(largest: &[f64], surprise: f64) -> f64 {
    let above = largest.partition_point(|value| *value >= surprise);
    let n = largest.len();
    if n > 0 && above >= 10 {
        return above as f64 / n as f64;
    }
    let m = independent(largest);
    let p = (-surprise).exp();
    -(m * (-p).ln_1p()).exp_m1()
}

/// Orthonormal columns that span what a fit leaves of others.
pub(super) fn orthonormal(sheet: &Sheet, fit: &Fit, raw: &[Whitened]) -> Vec<Whitened> {
    let rest: Vec<Whitened> = raw.iter().map(|column| fit.project(sheet, column)).collect();
    let length: Vec<f64> = raw.iter().map(|column| fit.length_squared(column).sqrt()).collect();
    let scale: Vec<f64> = length.iter().map(|length| if *length > 0.0 { 1.0 / length } else { 0.0 }).collect();
    let n = raw.len();
    let gram = DMatrix::from_fn(n, n, |i, j| if j <= i { scale[i] * scale[j] * dot(&rest[i], &rest[j]) } else { 0.0 });
    let gram = DMatrix::from_fn(n, n, |i, j| if j <= i { gram[(i, j)] } else { gram[(j, i)] });
    let eigen = gram.symmetric_eigen();
    let kept = (0..n).filter(|k| eigen.eigenvalues[*k] > LEAST_SHARE * LEAST_SHARE);
    kept.map(|k| {
        let root = 1.0 / eigen.eigenvalues[k].sqrt();
        let mut vector = vec![0.0; 2 * sheet.images()];
        for (i, column) in rest.iter().enumerate() {
            let factor = root * scale[i] * eigen.eigenvectors[(i, k)];
            if factor != 0.0 {
                for (a, b) in vector.iter_mut().zip(column) {
                    *a += factor * b;
                }
            }
        }
        vector
    })
    .collect()
}

/// Surprise as a function of the statistic, for the ranks that occur: the special function is too slow for millions of calls.
struct Tables(std::collections::BTreeMap<usize, (f64, Vec<f64>)>);

impl Tables {
    const POINTS: usize = 600;

    fn new(ranks: impl Iterator<Item = usize>) -> Self {
        let mut tables = std::collections::BTreeMap::new();
        for rank in ranks {
            tables.entry(rank).or_insert_with(|| {
                let q = rank as f64;
                let top = q + 14.0 * (2.0 * q).sqrt() + 40.0;
                let step = top / Self::POINTS as f64;
                let values = (0..=Self::POINTS).map(|k| chi_squared_surprise(q, step * k as f64)).collect();
                (step, values)
            });
        }
        Self(tables)
    }

    fn surprise(&self, rank: usize, t: f64) -> f64 {
        let Some((step, values)) = self.0.get(&rank) else { return 0.0 };
        let at = t / step;
        let k = at as usize;
        if k + 1 >= values.len() {
            return chi_squared_surprise(rank as f64, t);
        }
        let share = at - k as f64;
        values[k] * (1.0 - share) + values[k + 1] * share
    }
}
