//! A robust fit of the rows: nuisance parameters and accepted effects under errors with a t distribution, the noise of every kind found with it.
//!
//! At its end ψ = w·r (w the t weights) is orthogonal to everything fitted, and the score of a further column a is aᵀψ with the variance c·|Ma|², M the
//! projection that takes out what is fitted. ψ is given in units of its own scatter, kind by kind, so that c is one. The same pseudo-values as in
//! [`crate::diagnose::linear_fit`] (Huber, Robust Statistics, 1981, 7.8), for rows of one number.

use nalgebra::{DMatrix, DVector};

use super::row_noise::{TAIL_DEGREES, found, slope, weight};
use super::row_solve::{Basis, Block, Columns, Solved, design, inverse, robust};
use super::rows::{Kind, KindNoise, Rows, Whitener};

/// A row farther than this many standard deviations takes no part: its weight is nothing, and it spoils the means of its group.
const GROSS_SIGMAS: f64 = 40.0;
const TURNS: usize = 4;
/// A share of the scatter that is fitted is reckoned with up to here: beyond it few rows tell their own noise.
const MAX_FITTED: f64 = 0.5;
/// Of a direction so much lies in the means of groups.
const MOSTLY: f64 = 0.7;

/// A fit of the rows.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct RowFit {
    /// Noise of every kind.
    pub(in crate::diagnose) noise: Vec<KindNoise>,
    /// Rows that take part.
    pub(in crate::diagnose) take: Vec<bool>,
    /// Whitened residuals times weights, in units of their scatter.
    pub(in crate::diagnose) psi: Vec<f64>,
    /// Whitened residuals.
    white: Vec<f64>,
    /// Residuals in the rows' units.
    pub(in crate::diagnose) rest: Vec<f64>,
    /// Of every kind the parameters that frames have of their own: by the frame's place, with the standard error of what each differs by from the mean
    /// of all. What all have in common (errors of the catalogue, where they see the same stars) is no part of it.
    pub(in crate::diagnose) frame_levels: Vec<std::collections::BTreeMap<usize, [f64; 2]>>,
    /// Sizes of the accepted columns, their covariance.
    pub(in crate::diagnose) size: DVector<f64>,
    pub(in crate::diagnose) covariance: DMatrix<f64>,
    /// Root of the variance of ψ before it was put in its units, by kind.
    scatter: Vec<f64>,
    /// Mean slope of ψ over the root of its variance, by kind: what a unit of a whitened column adds to ψ.
    gain: Vec<f64>,
    basis: std::sync::Arc<Basis>,
    whiteners: std::sync::Arc<Vec<Whitener>>,
}

impl RowFit {
    /// With some columns accepted, on the rows allowed; the noise is found anew from `begin`.
    pub(in crate::diagnose) fn new(rows: &Rows, allowed: &[bool], accepted: &[&Vec<f64>], begin: Option<&Self>) -> Self {
        let columns: Vec<Columns> = design(rows, accepted);
        let mut noise = begin.map_or_else(|| vec![KindNoise::STATED; rows.kinds.len()], |fit| fit.noise.clone());
        let mut take = begin.map_or_else(|| allowed.to_vec(), |fit| fit.take.iter().zip(allowed).map(|(a, b)| *a && *b).collect());
        let mut turn = 0;
        let mut weights = None;
        let ranges = rows.ranges();
        loop {
            let solution = Solution::new(rows, &take, (accepted.len(), weights), &columns, &noise);
            turn += 1;
            if turn > TURNS {
                return Self::of(rows, &take, accepted.len(), &columns, (&noise, None), solution);
            }
            let rest = solution.rest(rows, &columns);
            noise = rows
                .kinds
                .iter()
                .zip(&ranges)
                .zip(&columns)
                .map(|((kind, range), columns)| found(kind, &rest[range.clone()], &take[range.clone()], columns.own.len() + accepted.len()))
                .collect();
            let sigma: Vec<f64> = rows
                .kinds
                .iter()
                .zip(&noise)
                .flat_map(|(kind, noise)| kind.rows.iter().map(|row| (noise.variance(row) + noise.shared).sqrt()))
                .collect();
            let is_normal = normal(rows);
            let before = std::mem::take(&mut take);
            take = (0..before.len()).map(|k| allowed[k] && (is_normal[k] || rest[k].abs() < GROSS_SIGMAS * sigma[k])).collect();
            // The same rows under a noise that is hardly another: their weights are near.
            weights = (take == before).then_some(solution.solved.weight);
        }
    }

    /// Under the noise of another fit, on the rows allowed that are not far off there: a model that lacks an effect has no noise of its own to be
    /// judged by.
    pub(in crate::diagnose) fn under(rows: &Rows, allowed: &[bool], accepted: &[&Vec<f64>], other: &Self) -> Self {
        let columns = design(rows, accepted);
        let solution = Solution::new(rows, allowed, (accepted.len(), None), &columns, &other.noise);
        Self::of(rows, allowed, accepted.len(), &columns, (&other.noise, Some(&other.scatter)), solution)
    }

    /// Of a solution.
    fn of(
        rows: &Rows,
        take: &[bool],
        accepted: usize,
        columns: &[Columns],
        (noise, scatter): (&[KindNoise], Option<&[f64]>),
        Solution { whiteners, blocks, solved }: Solution,
    ) -> Self {
        let ranges = rows.ranges();
        let own: usize = blocks.iter().map(|block| block.own.ncols()).sum();
        let basis = Basis::of(&blocks, &ranges);
        let parameters: Vec<usize> = basis.parameters().collect();
        let all_taken = take.iter().filter(|take| **take).count().max(1) as f64;
        let mut psi: Vec<f64> = Vec::with_capacity(rows.len());
        let (mut gain, mut scatters) = (Vec::with_capacity(ranges.len()), Vec::with_capacity(ranges.len()));
        for (number, (block, (residual, weight))) in blocks.iter().zip(solved.residual.iter().zip(&solved.weight)).enumerate() {
            let taken: Vec<usize> = (0..residual.len()).filter(|k| block.take[*k]).collect();
            let count = taken.len().max(1) as f64;
            let slope = taken.iter().map(|k| if block.is_normal { 1.0 } else { slope(residual[*k]) }).sum::<f64>() / count;
            // What is fitted takes its part of the scatter: of a kind its own parameters, and what is accepted of each as its rows are of all.
            let fitted = parameters[number] as f64 / count + accepted as f64 / all_taken;
            let lost = 1.0 - fitted.min(MAX_FITTED);
            let variance = (taken.iter().map(|k| (residual[*k] * weight[*k]).powi(2)).sum::<f64>() / (count * lost)).max(1e-12);
            // Errors that are taken at their word are normal, and ψ is the residual.
            let found = if block.is_normal { 1.0 } else { variance.sqrt() };
            let scale = scatter.map_or(found, |scatter| scatter[number]);
            psi.extend(residual.iter().zip(weight).map(|(r, w)| r * w / scale));
            gain.push(slope / scale);
            scatters.push(scale);
        }
        let covariance = inverse(&blocks, accepted) * error_factor(&gain, &ranges, take);
        let rest = rest_of(rows, columns, &blocks, &solved);
        let mut first = 0;
        let mut frame_levels = Vec::with_capacity(blocks.len());
        for (block, columns) in blocks.iter().zip(columns) {
            let own: Vec<(usize, usize)> = block.frames(columns).map(|(k, frame)| (first + k, frame)).collect();
            let with_all = |k: usize| own.iter().map(|(other, _)| covariance[(k, *other)]).sum::<f64>() / own.len() as f64;
            let of_mean = own.iter().map(|(k, _)| with_all(*k)).sum::<f64>() / own.len() as f64;
            let told = |k: usize| [solved.all[k], (covariance[(k, k)] - 2.0 * with_all(k) + of_mean).max(0.0).sqrt()];
            frame_levels.push(own.iter().map(|(k, frame)| (*frame, told(*k))).collect());
            first += block.own.ncols();
        }
        Self {
            noise: noise.to_vec(),
            take: take.to_vec(),
            psi,
            white: solved.residual.iter().flat_map(|own| own.iter().copied()).collect(),
            rest,
            frame_levels,
            size: solved.all.rows(own, accepted).into_owned(),
            covariance: covariance.view((own, own), (accepted, accepted)).into_owned(),
            scatter: scatters,
            gain,
            basis: std::sync::Arc::new(basis),
            whiteners: std::sync::Arc::new(whiteners),
        }
    }

    /// Weight of a row beside that of its error: far off it has little.
    pub(in crate::diagnose) fn weight(&self, row: usize) -> f64 {
        weight(self.white[row])
    }

    /// A column whitened, and what is fitted taken out.
    pub(in crate::diagnose) fn project(&self, rows: &Rows, column: &[f64]) -> Projected {
        let ranges = rows.ranges();
        let mut white: Vec<f64> =
            self.whiteners.iter().zip(&ranges).flat_map(|(whitener, range)| whitener.apply(&column[range.clone()])).collect();
        for (value, take) in white.iter_mut().zip(&self.take) {
            *value = if *take { *value } else { 0.0 };
        }
        let of_kind =
            |(gain, range): (&f64, &std::ops::Range<usize>)| gain * gain * white[range.clone()].iter().map(|v| v * v).sum::<f64>();
        let whole = self.gain.iter().zip(&ranges).map(of_kind).sum::<f64>().sqrt();
        Projected { rest: self.basis.take_out(&ranges, DVector::from_vec(white)), whole }
    }

    /// What share of the scatter of the means of groups that share an error some directions take, and the degrees of freedom of that scatter; nothing where
    /// the directions do not lie in such means for the most part. A trail is seen in the size of a frame's images and in their elongation: the means of
    /// all kinds in which a direction lies count, each in its own errors.
    pub(in crate::diagnose) fn share_of_means(&self, rows: &Rows, directions: &[DVector<f64>]) -> Option<(f64, usize)> {
        /// Of all kinds that have a part of the directions in their means so large a part at least.
        const MIN_PART: f64 = 0.05;
        struct OfKind {
            part: f64,
            means: Vec<DVector<f64>>,
            scatter: DVector<f64>,
        }
        let of_kind = |(whitener, range): (&Whitener, std::ops::Range<usize>)| {
            let means: Vec<DVector<f64>> =
                directions.iter().map(|direction| whitener.means(&direction.as_slice()[range.clone()])).collect();
            let part = means.iter().map(DVector::norm_squared).sum::<f64>() / directions.len().max(1) as f64;
            OfKind { part, means, scatter: whitener.means(&self.psi[range]) }
        };
        let mut kinds: Vec<OfKind> = self.whiteners.iter().zip(rows.ranges()).map(of_kind).collect();
        kinds.retain(|own| own.part > MIN_PART);
        if kinds.iter().map(|own| own.part).sum::<f64>() < MOSTLY {
            return None;
        }
        let joined =
            |of: &dyn Fn(&OfKind) -> &DVector<f64>| DVector::from_vec(kinds.iter().flat_map(|own| of(own).iter().copied()).collect());
        let scatter = joined(&|own| &own.scatter);
        let mut taken = 0.0;
        let mut known: Vec<DVector<f64>> = Vec::new();
        for direction in 0..directions.len() {
            let mut own = joined(&|kind| &kind.means[direction]);
            for other in &known {
                let along = other.dot(&own);
                own.axpy(-along, other, 1.0);
            }
            let length = own.norm();
            if length > 1e-6 {
                own /= length;
                taken += own.dot(&scatter).powi(2);
                known.push(own);
            }
        }
        // One mean of each kind is that of all.
        let dof = scatter.len().saturating_sub(kinds.len());
        Some((taken / scatter.norm_squared().max(f64::MIN_POSITIVE), dof))
    }

    /// Fall of the cost of the residuals, kind by kind, to those of a fit under the same noise; and the sum of the squares of what changed. The cost is twice
    /// the difference of the logarithms of the t densities, in units in which a small change falls by χ². The score follows from it for changes that
    /// are small beside the errors; where they are larger the residuals have hardly any weight, and the score no meaning.
    pub(in crate::diagnose) fn fall_to(&self, rows: &Rows, other: &Self) -> (Vec<f64>, f64) {
        let ranges = rows.ranges();
        let of_kind = |(number, range): (usize, &std::ops::Range<usize>)| {
            let (before, after) = (&self.white[range.clone()], &other.white[range.clone()]);
            let square: f64 = before.iter().zip(after).map(|(before, after)| (before - after).powi(2)).sum();
            (self.cost_fall(number, &rows.kinds[number], before, after), self.gain[number].powi(2) * square)
        };
        let (fall, square): (Vec<f64>, Vec<f64>) = ranges.iter().enumerate().map(of_kind).unzip();
        (fall, square.iter().sum())
    }

    /// Of every kind χ² (the sum of the squares of ψ) and its degrees of freedom: rows that take part, less the nuisance parameters.
    pub(in crate::diagnose) fn chi2_and_dof(&self, rows: &Rows) -> Vec<[f64; 2]> {
        let of_kind = |(range, parameters): (std::ops::Range<usize>, usize)| {
            let taken = range.clone().filter(|k| self.take[*k]).count();
            [self.psi[range].iter().map(|own| own * own).sum(), taken.saturating_sub(parameters) as f64]
        };
        rows.ranges().into_iter().zip(self.basis.parameters()).map(of_kind).collect()
    }

    /// The same of the rows of a kind.
    fn cost_fall(&self, number: usize, kind: &Kind, before: &[f64], after: &[f64]) -> f64 {
        let pairs = before.iter().zip(after);
        if !kind.is_scaled {
            return pairs.map(|(before, after)| before * before - after * after).sum();
        }
        let fall: f64 = pairs.map(|(before, after)| ((TAIL_DEGREES + before * before) / (TAIL_DEGREES + after * after)).ln()).sum();
        // Slope over the variance of ψ: what makes of a cost a χ².
        (TAIL_DEGREES + 1.0) * fall * self.gain[number] / self.scatter[number]
    }

    /// Fall of the cost with the best sizes of some columns beside what is fitted, by weights found in turn from equal ones.
    pub(in crate::diagnose) fn best_fall(&self, rows: &Rows, projected: &[Projected]) -> f64 {
        const STEPS: usize = 8;
        const SAME_SIZE: f64 = 1e-9;
        // Rows that no column changes keep their cost.
        let changes =
            |range: &std::ops::Range<usize>| projected.iter().any(|own| own.rest.as_slice()[range.clone()].iter().any(|v| *v != 0.0));
        let kinds: Vec<(usize, std::ops::Range<usize>)> =
            rows.ranges().into_iter().enumerate().filter(|(_, range)| changes(range)).collect();
        let joined = |all: &[f64]| DVector::from_vec(kinds.iter().flat_map(|(_, range)| &all[range.clone()]).copied().collect());
        let columns: Vec<DVector<f64>> = projected.iter().map(|own| joined(own.rest.as_slice())).collect();
        let white = joined(&self.white);
        let mut weights: DVector<f64> = DVector::repeat(white.len(), 1.0);
        let (mut most, mut last) = (0.0_f64, DVector::zeros(columns.len()));
        for _ in 0..STEPS {
            let weighted: Vec<DVector<f64>> = columns.iter().map(|column| column.component_mul(&weights)).collect();
            let normal = DMatrix::from_fn(columns.len(), columns.len(), |i, j| weighted[i].dot(&columns[j]));
            let right = DVector::from_iterator(columns.len(), weighted.iter().map(|column| column.dot(&white)));
            let Some(sizes) = normal.lu().solve(&right) else { return most };
            let mut after = white.clone();
            columns.iter().zip(sizes.iter()).for_each(|(column, size)| after.axpy(-*size, column, 1.0));
            let mut first = 0;
            let mut fall = 0.0;
            for (number, range) in &kinds {
                let own = first..first + range.len();
                fall += self.cost_fall(*number, &rows.kinds[*number], &white.as_slice()[own.clone()], &after.as_slice()[own.clone()]);
                if rows.kinds[*number].is_scaled {
                    own.clone().for_each(|k| weights[k] = weight(after[k]));
                }
                first = own.end;
            }
            most = most.max(fall);
            if (&sizes - &last).amax() <= SAME_SIZE * sizes.amax() {
                break;
            }
            last = sizes;
        }
        most
    }

    /// What a unit of a column adds to ψ, row by row, beyond what is fitted.
    pub(in crate::diagnose) fn response(&self, rows: &Rows, column: &[f64]) -> DVector<f64> {
        self.response_beside(self, rows, column)
    }

    /// The same beside what another fit of the same noise has fitted.
    pub(in crate::diagnose) fn response_beside(&self, other: &Self, rows: &Rows, column: &[f64]) -> DVector<f64> {
        self.added(rows, other.project(rows, column).rest)
    }

    /// What a projected column adds to ψ.
    pub(in crate::diagnose) fn added(&self, rows: &Rows, mut rest: DVector<f64>) -> DVector<f64> {
        for (gain, range) in self.gain.iter().zip(rows.ranges()) {
            rest.rows_mut(range.start, range.len()).scale_mut(*gain);
        }
        rest
    }

    /// Size and standard error of a column of its own, beside what is fitted, over the rows that `of` names.
    pub(in crate::diagnose) fn amplitude(&self, rows: &Rows, column: &[f64], of: impl Fn(usize) -> bool) -> Option<[f64; 2]> {
        self.amplitude_of(&self.response(rows, column), of)
    }

    /// The same of what a unit of the column adds to ψ.
    pub(in crate::diagnose) fn amplitude_of(&self, own: &DVector<f64>, of: impl Fn(usize) -> bool) -> Option<[f64; 2]> {
        let (mut along, mut square) = (0.0, 0.0);
        for k in (0..own.len()).filter(|k| of(*k)) {
            along += own[k] * self.psi[k];
            square += own[k] * own[k];
        }
        (square > 0.0).then(|| [along / square, square.sqrt().recip()])
    }
}

/// A column whitened, and what is fitted taken out.
pub(in crate::diagnose) struct Projected {
    /// What is left.
    pub(in crate::diagnose) rest: DVector<f64>,
    /// Length of what a unit of the column would add to ψ if nothing were fitted.
    pub(in crate::diagnose) whole: f64,
}

/// Sizes under a noise, and what they were found with.
struct Solution {
    whiteners: Vec<Whitener>,
    blocks: Vec<Block>,
    solved: Solved,
}

impl Solution {
    /// `accepted`: how many columns are, and the weights to begin with.
    fn new(
        rows: &Rows,
        take: &[bool],
        (accepted, weights): (usize, Option<Vec<Vec<f64>>>),
        columns: &[Columns],
        noise: &[KindNoise],
    ) -> Self {
        let ranges = rows.ranges();
        let whitener = |((kind, noise), range): ((&Kind, &KindNoise), &std::ops::Range<usize>)| kind.whitener(noise, &take[range.clone()]);
        let whiteners: Vec<_> = rows.kinds.iter().zip(noise).zip(&ranges).map(whitener).collect();
        let blocks: Vec<Block> = rows
            .kinds
            .iter()
            .zip(&whiteners)
            .zip(ranges.iter().zip(columns))
            .map(|((kind, whitener), (range, columns))| Block::new(kind, whitener, columns, &take[range.clone()]))
            .collect();
        let solved = robust(&blocks, accepted, weights);
        Self { whiteners, blocks, solved }
    }

    fn rest(&self, rows: &Rows, columns: &[Columns]) -> Vec<f64> {
        rest_of(rows, columns, &self.blocks, &self.solved)
    }
}

/// Residuals in the rows' units.
fn rest_of(rows: &Rows, columns: &[Columns], blocks: &[Block], solved: &Solved) -> Vec<f64> {
    let of_kinds = blocks.iter().zip(rows.kinds.iter().zip(columns)).enumerate();
    of_kinds.flat_map(|(number, (block, (kind, columns)))| block.rest(kind, columns, &solved.sizes(blocks, number))).collect()
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
