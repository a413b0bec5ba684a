//! Solution of the rows: parameters of least t cost, kind by kind.
//!
//! A nuisance parameter belongs to one kind of rows and is zero in all others, so products are formed kind by kind: the time grows with the rows times
//! the square of the parameters of a kind, and not of all kinds together.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::products;
use super::row_noise::weight as weight_of;
use super::rows::{Kind, Rows, Whitener};

const STEPS: usize = 12;
/// A step of so small a share of the largest parameter is none: its error is larger by orders.
const SETTLED: f64 = 1e-8;
/// Of a column so small a share is rounding.
const LOST: f64 = 1e-7;

/// The columns over the rows of a kind: its own nuisance parameters, and what is accepted.
pub(super) struct Columns {
    pub(super) own: Vec<Vec<f64>>,
    /// The frame that a column is of alone, where it is of one.
    frames: Vec<Option<usize>>,
    accepted: Vec<Vec<f64>>,
}

/// Of every kind.
pub(super) fn design(rows: &Rows, accepted: &[&Vec<f64>]) -> Vec<Columns> {
    let of_kind = |(kind, range): (&Kind, Range<usize>)| {
        let mut own = kind.common.clone();
        let mut of = vec![None; own.len()];
        for column in &kind.per_frame {
            let frames: std::collections::BTreeSet<usize> = kind.rows.iter().map(|row| row.frame).collect();
            let of_frame =
                |frame: usize| kind.rows.iter().zip(column).map(|(row, value)| if row.frame == frame { *value } else { 0.0 }).collect();
            of.extend(frames.iter().copied().map(Some));
            own.extend(frames.into_iter().map(of_frame));
        }
        Columns { own, frames: of, accepted: accepted.iter().map(|column| column[range.clone()].to_vec()).collect() }
    };
    rows.kinds.iter().zip(rows.ranges()).map(of_kind).collect()
}

/// The rows of a kind, whitened; rows that take no part are zero.
pub(super) struct Block {
    value: DVector<f64>,
    /// Nuisance parameters that have rows, and their numbers among all of the kind.
    pub(super) own: DMatrix<f64>,
    numbers: Vec<usize>,
    accepted: DMatrix<f64>,
    pub(super) take: Vec<bool>,
    /// Whether its errors are taken at their word, and normal.
    pub(super) is_normal: bool,
}

impl Block {
    pub(super) fn new(kind: &Kind, whitener: &Whitener, columns: &Columns, take: &[bool]) -> Self {
        let white = |column: &[f64]| -> DVector<f64> {
            let mut all = whitener.apply(column);
            all.iter_mut().zip(take).filter(|(_, take)| !**take).for_each(|(value, _)| *value = 0.0);
            DVector::from_vec(all)
        };
        let value: Vec<f64> = kind.rows.iter().map(|row| row.value).collect();
        let own = columns.own.iter().map(|column| white(column)).enumerate().filter(|(_, column)| column.norm() > 0.0);
        let (numbers, own): (Vec<usize>, Vec<DVector<f64>>) = own.unzip();
        let accepted: Vec<DVector<f64>> = columns.accepted.iter().map(|column| white(column)).collect();
        let joined = |columns: &[DVector<f64>]| {
            if columns.is_empty() { DMatrix::zeros(value.len(), 0) } else { DMatrix::from_columns(columns) }
        };
        Self {
            value: white(&value),
            own: joined(&own),
            numbers,
            accepted: joined(&accepted),
            take: take.to_vec(),
            is_normal: !kind.is_scaled,
        }
    }

    /// Which of the kind's own parameters are of one frame, and of which.
    pub(super) fn frames<'a>(&'a self, columns: &'a Columns) -> impl Iterator<Item = (usize, usize)> + 'a {
        self.numbers.iter().enumerate().filter_map(|(k, number)| columns.frames[*number].map(|frame| (k, frame)))
    }

    /// Residuals in the rows' units, with the sizes of the kind's own parameters and of the accepted columns.
    pub(super) fn rest(&self, kind: &Kind, columns: &Columns, (own, accepted): &(Vec<f64>, Vec<f64>)) -> Vec<f64> {
        let mut rest: Vec<f64> = kind.rows.iter().map(|row| row.value).collect();
        let of_own = self.numbers.iter().map(|number| &columns.own[*number]).zip(own);
        for (column, size) in of_own.chain(columns.accepted.iter().zip(accepted)) {
            rest.iter_mut().zip(column).for_each(|(rest, value)| *rest -= size * value);
        }
        rest
    }
}

/// A solution.
pub(super) struct Solved {
    /// Sizes: of every kind its own nuisance parameters, then of the accepted columns.
    pub(super) all: DVector<f64>,
    /// Of every kind whitened residuals, and their t weights.
    pub(super) residual: Vec<DVector<f64>>,
    pub(super) weight: Vec<Vec<f64>>,
}

impl Solved {
    /// Sizes of a kind's own parameters and of the accepted columns.
    pub(super) fn sizes(&self, blocks: &[Block], number: usize) -> (Vec<f64>, Vec<f64>) {
        let before: usize = blocks[..number].iter().map(|block| block.own.ncols()).sum();
        let all: usize = blocks.iter().map(|block| block.own.ncols()).sum();
        let own = self.all.rows(before, blocks[number].own.ncols());
        (own.iter().copied().collect(), self.all.rows(all, self.all.len() - all).iter().copied().collect())
    }
}

/// Columns of length one of every kind, their numbers among all, and the lengths of all.
type Units = (Vec<(DMatrix<f64>, Vec<usize>)>, Vec<f64>);

fn units(blocks: &[Block], accepted: usize) -> Units {
    let own: usize = blocks.iter().map(|block| block.own.ncols()).sum();
    let scale = scales(blocks, own + accepted);
    let mut first = 0;
    let of_block = |block: &Block| {
        let k = block.own.ncols();
        let numbers: Vec<usize> = (first..first + k).chain(own..own + accepted).collect();
        first += k;
        let column = |j: usize| if j < k { block.own.column(j) } else { block.accepted.column(j - k) };
        let columns: Vec<DVector<f64>> = numbers.iter().enumerate().map(|(j, number)| column(j) / scale[*number]).collect();
        (if columns.is_empty() { DMatrix::zeros(block.value.len(), 0) } else { DMatrix::from_columns(&columns) }, numbers)
    };
    (blocks.iter().map(of_block).collect(), scale)
}

/// Inverse of the normal matrix of all columns, unweighted.
pub(super) fn inverse(blocks: &[Block], accepted: usize) -> DMatrix<f64> {
    let (units, scale) = units(blocks, accepted);
    let ones: Vec<Vec<f64>> = blocks.iter().map(|block| vec![1.0; block.value.len()]).collect();
    let unweighted = normal(blocks, &units, &ones, scale.len()).0;
    let inverse = if unweighted.is_empty() { unweighted } else { pseudo_inverse(unweighted) };
    DMatrix::from_fn(scale.len(), scale.len(), |i, j| inverse[(i, j)] / (scale[i] * scale[j]))
}

/// Parameters of least t cost by weights found in turn, and the weights. `begin`: the weights to begin with, those of a solution that is near.
pub(super) fn robust(blocks: &[Block], accepted: usize, begin: Option<Vec<Vec<f64>>>) -> Solved {
    let (units, scale) = units(blocks, accepted);
    let mut weight = begin.unwrap_or_else(|| blocks.iter().map(|block| vec![1.0; block.value.len()]).collect());
    let mut beta = DVector::zeros(scale.len());
    let mut residual: Vec<DVector<f64>> = Vec::new();
    for _ in 0..STEPS {
        let (normal, right) = normal(blocks, &units, &weight, scale.len());
        // Nothing may be free: products of empty matrices are not defined in the library.
        let solved = if right.is_empty() { right } else { solution(normal, &right) };
        let (moved, size) = (largest(&(&solved - &beta)), largest(&solved));
        beta = solved;
        let rest = |(block, (unit, numbers)): (&Block, &(DMatrix<f64>, Vec<usize>))| {
            if numbers.is_empty() { block.value.clone() } else { &block.value - unit * sizes(&beta, numbers) }
        };
        residual = blocks.iter().zip(&units).map(rest).collect();
        let of = |(block, residual): (&Block, &DVector<f64>)| -> Vec<f64> {
            let of_row = |(r, take): (&f64, &bool)| {
                if !*take {
                    0.0
                } else if block.is_normal {
                    1.0
                } else {
                    weight_of(*r)
                }
            };
            residual.iter().zip(&block.take).map(of_row).collect()
        };
        weight = blocks.iter().zip(&residual).map(of).collect();
        if moved < SETTLED * size.max(SETTLED) {
            break;
        }
    }
    Solved { all: DVector::from_fn(scale.len(), |i, _| beta[i] / scale[i]), residual, weight }
}

fn sizes(beta: &DVector<f64>, numbers: &[usize]) -> DVector<f64> {
    DVector::from_iterator(numbers.len(), numbers.iter().map(|number| beta[*number]))
}

fn largest(values: &DVector<f64>) -> f64 {
    values.iter().fold(0.0, |most: f64, value| most.max(value.abs()))
}

/// Length of every column over all kinds.
fn scales(blocks: &[Block], count: usize) -> Vec<f64> {
    let own: Vec<f64> = blocks.iter().flat_map(|block| block.own.column_iter().map(|column| column.norm()).collect::<Vec<_>>()).collect();
    let accepted = (0..count - own.len()).map(|j| blocks.iter().map(|block| block.accepted.column(j).norm_squared()).sum::<f64>().sqrt());
    own.iter().copied().chain(accepted).map(|length| length.max(1e-300)).collect()
}

/// Weighted normal matrix and right side.
fn normal(blocks: &[Block], units: &[(DMatrix<f64>, Vec<usize>)], weight: &[Vec<f64>], count: usize) -> (DMatrix<f64>, DVector<f64>) {
    let mut all = DMatrix::zeros(count, count);
    let mut right = DVector::zeros(count);
    for ((block, (unit, numbers)), weight) in blocks.iter().zip(units).zip(weight) {
        if numbers.is_empty() {
            continue;
        }
        let mut weighted = unit.clone();
        for mut column in weighted.column_iter_mut() {
            column.iter_mut().zip(weight).for_each(|(value, weight)| *value *= weight);
        }
        let own = products(&weighted, unit);
        for (i, row) in numbers.iter().enumerate() {
            for (j, column) in numbers.iter().enumerate() {
                all[(*row, *column)] += own[(i, j)];
            }
            right[*row] += weighted.column(i).dot(&block.value);
        }
    }
    (all, right)
}

/// Orthonormal columns of what is fitted: of every kind its own nuisance parameters, and what the accepted columns add to them all.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    own: Vec<DMatrix<f64>>,
    accepted: DMatrix<f64>,
}

impl Basis {
    pub(super) fn of(blocks: &[Block], ranges: &[Range<usize>]) -> Self {
        let n = ranges.last().map_or(0, |range| range.end);
        let own: Vec<DMatrix<f64>> = blocks.iter().map(|block| orthonormal(&block.own)).collect();
        let mut basis = Self { own, accepted: DMatrix::zeros(n, 0) };
        let count = blocks.first().map_or(0, |block| block.accepted.ncols());
        let columns: Vec<DVector<f64>> = (0..count)
            .map(|j| {
                DVector::from_iterator(n, blocks.iter().flat_map(|block| block.accepted.column(j).iter().copied().collect::<Vec<_>>()))
            })
            .collect();
        let lengths: Vec<f64> = columns.iter().map(DVector::norm).collect();
        let rest: Vec<DVector<f64>> = columns.into_iter().map(|column| basis.take_out(ranges, column)).collect();
        // What nuisance parameters take up wholly is rounding.
        let kept: Vec<DVector<f64>> =
            rest.into_iter().zip(lengths).filter(|(rest, length)| rest.norm() > LOST * length).map(|(rest, _)| rest).collect();
        if !kept.is_empty() {
            basis.accepted = orthonormal(&DMatrix::from_columns(&kept));
        }
        basis
    }

    /// Of every kind the number of its own parameters.
    pub(super) fn parameters(&self) -> impl Iterator<Item = usize> {
        self.own.iter().map(DMatrix::ncols)
    }

    /// A whitened column over the rows of all kinds, less what is fitted.
    pub(super) fn take_out(&self, ranges: &[Range<usize>], mut column: DVector<f64>) -> DVector<f64> {
        for _ in 0..2 {
            for (own, range) in self.own.iter().zip(ranges) {
                let mut part = column.rows_mut(range.start, range.len());
                if own.ncols() > 0 && part.iter().any(|value| *value != 0.0) {
                    let along = own.tr_mul(&part);
                    part.gemv(-1.0, own, &along, 1.0);
                }
            }
            if self.accepted.ncols() > 0 {
                let along = self.accepted.tr_mul(&column);
                column.gemv(-1.0, &self.accepted, &along, 1.0);
            }
        }
        column
    }
}

/// Root of a symmetric matrix of columns of unit length, if none of them depends on others.
fn independent(matrix: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    matrix.clone().cholesky().filter(|cholesky| cholesky.l_dirty().diagonal().iter().all(|pivot| *pivot > 1e-5))
}

/// Solution of the normal equations of columns of unit length, what is dependent left out.
fn solution(matrix: DMatrix<f64>, right: &DVector<f64>) -> DVector<f64> {
    match independent(&matrix) {
        Some(cholesky) => cholesky.solve(right),
        None => pseudo_inverse(matrix) * right,
    }
}

/// Inverse of a symmetric matrix of columns of unit length, what is dependent left out.
fn pseudo_inverse(matrix: DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    if let Some(cholesky) = independent(&matrix) {
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
        if left > LOST * length && left > 0.0 {
            basis.push(vector / left);
        }
    }
    if basis.is_empty() { DMatrix::zeros(x.nrows(), 0) } else { DMatrix::from_columns(&basis) }
}
