//! Null distribution of the largest statistic of a [`Scan`] (maxT), by simulation. The simulated recordings have the same star images, no effect,
//! errors with the residuals' own distribution of sizes in random directions, and the same projections. A p-value below what the simulations
//! resolve is read off their tail: p = 1 − (1 − p₁)^m with m the effective number of independent tests.
//!
//! Source: Westfall and Young, Resampling-Based Multiple Testing (1993), maxT.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{DMatrix, DMatrixView};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::linear_fit::Fit;
use super::scan::{Asks, Scan};
use crate::parallel;
use crate::statistics::order::descending;
use crate::statistics::significance::{family_wise_p_value, neg_ln_chi2_sf};

/// Simulated recordings drawn together.
pub(super) const BATCH: usize = 200;
/// Directions of simulated errors.
const DIRECTIONS: usize = 4096;
/// m is read off this part of the simulations, those with the smallest p.
const TAIL_SHARE: f64 = 0.2;
/// So many simulations beyond a surprise tell its probability by themselves.
pub(super) const COUNTED_FROM: usize = 10;

/// What chance answers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NullDistribution {
    /// Simulations.
    pub(super) nulls: usize,
    /// The largest surprise of each simulation over the hypotheses; sorted, the largest first.
    pub(super) hypotheses: Vec<f64>,
    /// Over the covariates.
    pub(super) covariates: Vec<f64>,
}

impl Scan {
    /// Simulated recordings `from..to` without any effect.
    pub(super) fn chance(&self, fit: &Fit, take: &[bool], seed: u64, from: usize, to: usize) -> NullDistribution {
        let [hypotheses, covariates] = self.simulated(fit, take, seed, from, to).map(|mut values| {
            descending(&mut values, |a| *a);
            values
        });
        NullDistribution { nulls: to - from, hypotheses, covariates }
    }

    /// The largest surprise over the hypotheses, and over the covariates, of each of the simulated recordings `from..to`. The errors hang on
    /// the seed and the number of the recording alone, not on the questions.
    pub(super) fn simulated(&self, fit: &Fit, take: &[bool], seed: u64, from: usize, to: usize) -> [Vec<f64>; 2] {
        let sizes: Vec<f64> = (0..take.len()).filter(|k| take[*k]).map(|k| fit.psi[2 * k].hypot(fit.psi[2 * k + 1])).collect();
        let directions: Vec<[f64; 2]> = (0..DIRECTIONS)
            .map(|k| {
                let (sine, cosine) = (k as f64 * std::f64::consts::TAU / DIRECTIONS as f64).sin_cos();
                [cosine, sine]
            })
            .collect();
        let tables: Vec<Arc<Table>> = self.groups.iter().map(|group| Table::of(group.rank)).collect();
        let batches: Vec<(usize, usize)> = (from..to).step_by(BATCH).map(|first| (first, (first + BATCH).min(to))).collect();
        let largest: Vec<[Vec<f64>; 2]> = parallel::map(&batches, |&(first, last)| {
            let rows = self.columns.nrows();
            let nulls = last - first;
            let mut noise = vec![0.0_f32; rows * nulls];
            let mut c = Vec::with_capacity(nulls);
            for (null, column) in (first..last).zip(noise.chunks_exact_mut(rows)) {
                let mut rng = Pcg64Mcg::seed_from_u64(seed ^ (null as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
                let mut square = 0.0;
                for k in (0..take.len()).filter(|k| take[*k]) {
                    let size = sizes[rng.random_range(0..sizes.len())];
                    let [x, y] = directions[rng.random_range(0..DIRECTIONS)];
                    column[2 * k] = (size * x) as f32;
                    column[2 * k + 1] = (size * y) as f32;
                    square += size * size;
                }
                c.push(square / (2.0 * sizes.len() as f64));
            }
            // One line for each recording: the library's product is fast in this order.
            let z = DMatrixView::from_slice_with_strides(&noise, nulls, rows, rows, 1) * &self.columns;
            self.largest(&z, &c, &tables)
        });
        [0, 1].map(|which| largest.iter().flat_map(|most| &most[which]).copied().collect())
    }

    /// The largest surprises of simulated recordings, over the hypotheses and over the covariates, from their sums with all columns.
    fn largest(&self, z: &DMatrix<f32>, c: &[f64], tables: &[Arc<Table>]) -> [Vec<f64>; 2] {
        let mut most = [vec![0.0_f64; c.len()], vec![0.0_f64; c.len()]];
        let mut columns = z.column_iter();
        for (group, table) in self.groups.iter().zip(tables) {
            let mut squares = vec![0.0_f64; c.len()];
            for column in columns.by_ref().take(group.rank) {
                for (square, z) in squares.iter_mut().zip(column.iter()) {
                    *square += f64::from(*z) * f64::from(*z);
                }
            }
            let own = &mut most[usize::from(matches!(group.asks, Asks::Covariate(_)))];
            for ((most, square), c) in own.iter_mut().zip(squares).zip(c) {
                *most = most.max(table.surprise(square / c));
            }
        }
        most
    }
}

impl NullDistribution {
    /// With more simulations.
    pub(super) fn and(mut self, more: Self) -> Self {
        self.nulls += more.nulls;
        for (own, others) in [(&mut self.hypotheses, more.hypotheses), (&mut self.covariates, more.covariates)] {
            own.extend(others);
            descending(own, |a| *a);
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
    if n > 0 && above >= COUNTED_FROM {
        return above as f64 / n as f64;
    }
    let m = independent(largest);
    family_wise_p_value((-surprise).exp(), m)
}

/// Standard error of ln p, p that of a surprise.
pub(super) fn family_p_error(largest: &[f64], surprise: f64) -> f64 {
    let above = largest.partition_point(|value| *value >= surprise);
    let counted = if above >= COUNTED_FROM { above as f64 } else { (largest.len() as f64 * TAIL_SHARE).max(1.0) };
    1.0 / counted.sqrt()
}

/// Surprise as a function of the statistic for one rank: the special function is too slow for millions of calls.
struct Table {
    rank: f64,
    step: f64,
    values: Vec<f64>,
}

impl Table {
    const POINTS: usize = 600;

    /// Made once for all recordings.
    fn of(rank: usize) -> Arc<Self> {
        static MADE: Mutex<BTreeMap<usize, Arc<Table>>> = Mutex::new(BTreeMap::new());
        let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        made.entry(rank)
            .or_insert_with(|| {
                let rank = rank as f64;
                let step = (rank + 14.0 * (2.0 * rank).sqrt() + 40.0) / Self::POINTS as f64;
                let values = (0..=Self::POINTS).map(|k| neg_ln_chi2_sf(rank, step * k as f64)).collect();
                Arc::new(Self { rank, step, values })
            })
            .clone()
    }

    fn surprise(&self, statistic: f64) -> f64 {
        let at = statistic / self.step;
        let k = at as usize;
        match self.values.get(k..k + 2) {
            Some([low, high]) => {
                let share = at - k as f64;
                low * (1.0 - share) + high * share
            }
            _ => neg_ln_chi2_sf(self.rank, statistic),
        }
    }
}
