//! Scores: how surprising what each question's columns explain of the rows is, and how alike two questions are.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use statrs::function::beta::beta_reg;

use super::row_fit::{Projected, RowFit};
use super::rows::{Question, Rows};
use crate::effects::detector::brighter_fatter::BrighterFatter;
use crate::effects::pixel::pass::PassHead;
use crate::parallel;
use crate::statistics::order::descending;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Of two names one is about as good: odds of 100 : 1.
pub(super) const AS_GOOD: f64 = 4.6;
/// A column of which what is fitted leaves a smaller share is no question.
const MIN_SHARE: f64 = 0.02;
/// Of so many degrees of freedom the scatter of means is told well.
const MANY_MEANS: usize = 60;
/// Of the scatter of few means so much is left at least: what an effect takes of it is known no better.
const MIN_LEFT: f64 = 0.02;
/// So many standard errors on the wrong side of zero are no size of an effect that has a sign.
const WRONG_SIDE: f64 = 1.0;
/// Charge that is pushed aside widens bright stars: what the noise alone shows is not it.
const WIDER_BY_CHARGE: f64 = 3.0;

/// The answer to a question.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Answer {
    pub(in crate::diagnose) question: usize,
    /// What the columns explain of ψ.
    pub(in crate::diagnose) statistic: f64,
    /// Independent columns.
    pub(in crate::diagnose) rank: usize,
    /// −ln of its probability by chance.
    pub(in crate::diagnose) surprise: f64,
}

/// What a question's columns add to ψ, orthonormal; none where too little is left of them.
pub(in crate::diagnose) fn directions(rows: &Rows, fit: &RowFit, columns: &[Vec<f64>]) -> Vec<DVector<f64>> {
    let projected: Vec<Projected> = columns.iter().map(|column| fit.project(rows, column)).collect();
    directions_of(rows, fit, &projected)
}

fn directions_of(rows: &Rows, fit: &RowFit, projected: &[Projected]) -> Vec<DVector<f64>> {
    let mut found: Vec<DVector<f64>> = Vec::new();
    for column in projected {
        let mut own = fit.added(rows, column.rest.clone());
        for _ in 0..2 {
            for known in &found {
                let along = known.dot(&own);
                own.axpy(-along, known, 1.0);
            }
        }
        let length = own.norm();
        if length > MIN_SHARE * column.whole && length > 0.0 {
            found.push(own / length);
        }
    }
    found
}

/// The score of a question beside what is fitted; nothing where too little is left of its columns.
pub(in crate::diagnose) fn answer(rows: &Rows, fit: &RowFit, index: usize) -> Option<Answer> {
    let question = &rows.questions[index];
    let projected: Vec<Projected> = question.columns.iter().map(|column| fit.project(rows, column)).collect();
    let directions = directions_of(rows, fit, &projected);
    if directions.len() < question.columns.len().min(1) || directions.is_empty() {
        return None;
    }
    let psi = DVector::from_column_slice(&fit.psi);
    let score = directions.iter().map(|direction| direction.dot(&psi).powi(2)).sum::<f64>();
    // Where few rows tell nearly all, and are far off without the effect, they have no weight in the score.
    let statistic = score.max(fit.best_fall(rows, &projected));
    let rank = directions.len();
    let is_wrong = question.sign.is_some_and(|sign| {
        let own = fit.amplitude_of(&fit.added(rows, projected[0].rest.clone()), |_| true);
        let least = if question.id == <BrighterFatter as PassHead>::ID { WIDER_BY_CHARGE } else { WRONG_SIDE };
        own.is_some_and(|[size, sigma]| sign * size < least * sigma)
    });
    let surprise = if is_wrong { 0.0 } else { surprise(rank, statistic, fit.share_of_means(rows, &directions)) };
    Some(Answer { question: index, statistic, rank, surprise })
}

/// −ln of the probability of a score. Where it is of the means of few groups (frames), the scatter of these is known from themselves alone, the effect's
/// trace included, and bounds the score: the share of it that the effect takes has a Beta distribution.
fn surprise(rank: usize, statistic: f64, means: Option<(f64, usize)>) -> f64 {
    let by_chi2 = neg_ln_chi2_sf(rank as f64, statistic);
    let Some((share, dof)) = means.filter(|(_, dof)| *dof > rank + 1 && *dof < MANY_MEANS) else { return by_chi2 };
    let total = dof as f64;
    let left = (1.0 - share).max(MIN_LEFT);
    let tail = beta_reg(0.5 * (total - rank as f64), 0.5 * rank as f64, left);
    if tail > 0.0 { -tail.ln() } else { by_chi2 }
}

/// The answers to all questions that are not yet accepted.
pub(in crate::diagnose) fn answers(rows: &Rows, fit: &RowFit, accepted: &[usize]) -> Vec<Answer> {
    let free: Vec<usize> = (0..rows.questions.len()).filter(|index| !accepted.contains(index)).collect();
    parallel::map(&free, |index| answer(rows, fit, *index)).into_iter().flatten().collect()
}

/// Columns of accepted questions.
pub(in crate::diagnose) fn columns<'a>(rows: &'a Rows, accepted: &[usize]) -> Vec<&'a Vec<f64>> {
    accepted.iter().flat_map(|index| &rows.questions[*index].columns).collect()
}

/// A fit with questions accepted.
pub(in crate::diagnose) fn fitted(rows: &Rows, allowed: &[bool], accepted: &[usize], begin: Option<&RowFit>) -> RowFit {
    RowFit::new(rows, allowed, &columns(rows, accepted), begin)
}

/// How alike what two questions add to ψ is: the cosine of the smallest angle between them.
pub(in crate::diagnose) fn cosine(rows: &Rows, fit: &RowFit, one: usize, other: usize) -> f64 {
    let of = |index: usize| directions(rows, fit, &rows.questions[index].columns);
    let (a, b) = (of(one), of(other));
    if a.is_empty() || b.is_empty() {
        return 0.0;
    }
    DMatrix::from_fn(a.len(), b.len(), |i, j| a[i].dot(&b[j])).singular_values().max().min(1.0)
}

/// The largest surprise over some questions of each of so many recordings in which nothing is missing. A score is a sum over many rows of ψ, which
/// is bounded and has the variance one: the scores of all questions are drawn together as normal numbers with the products of their directions as
/// covariance. Where few rows decide, tails are shorter than normal ones, and the probability is an upper bound.
pub(in crate::diagnose) fn chance(rows: &Rows, fit: &RowFit, questions: &[&Question], nulls: usize, seed: u64) -> Vec<f64> {
    let bases: Vec<Vec<DVector<f64>>> = parallel::map(questions, |question| directions(rows, fit, &question.columns));
    let width: usize = bases.iter().map(Vec::len).sum();
    if width == 0 {
        return vec![0.0; nulls];
    }
    let matrix = DMatrix::from_iterator(rows.len(), width, bases.iter().flatten().flat_map(|direction| direction.iter().copied()));
    let root = root(super::products(&matrix, &matrix));
    let simulate = |null: usize| {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ (null as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let along = &root * DVector::from_fn(width, |_, _| -> f64 { StandardNormal.sample(&mut rng) });
        let mut first = 0;
        let mut most = 0.0_f64;
        for basis in &bases {
            let square: f64 = along.rows(first, basis.len()).norm_squared();
            first += basis.len();
            if !basis.is_empty() {
                most = most.max(neg_ln_chi2_sf(basis.len() as f64, square));
            }
        }
        most
    };
    let mut all: Vec<f64> = parallel::map_numbers(nulls, simulate);
    descending(&mut all, |a| *a);
    all
}

/// A root of a covariance; what is dependent has none of its own.
fn root(covariance: DMatrix<f64>) -> DMatrix<f64> {
    let eigen = covariance.symmetric_eigen();
    &eigen.eigenvectors * DMatrix::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::super::rows::{Kind, Row, Shared};
    use super::*;
    use crate::diagnose::channels::Channel;

    /// Means of eight groups whose scatter only they tell: the probability is even over draws, and that of χ² with the scatter found is not.
    #[test]
    fn of_few_means_the_probability_is_that_of_their_own_scatter() {
        const GROUPS: usize = 8;
        const DRAWS: usize = 4000;
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let (mut by_scatter, mut by_chi2) = (0, 0);
        for _ in 0..DRAWS {
            // One direction among the seven that the mean leaves.
            let own: Vec<f64> = (1..GROUPS).map(|_| StandardNormal.sample(&mut rng)).collect();
            let whole: f64 = own.iter().map(|value| value * value).sum();
            let share = own[0] * own[0] / whole;
            let statistic = own[0] * own[0] / (whole / (GROUPS - 1) as f64);
            by_scatter += usize::from(surprise(1, statistic, Some((share, GROUPS - 1))) > -0.01_f64.ln());
            by_chi2 += usize::from(surprise(1, statistic, None) > -0.01_f64.ln());
        }
        // Forty are due, ± 6.3.
        assert!((20..=62).contains(&by_scatter), "{by_scatter}");
        assert!(!(20..=62).contains(&by_chi2), "{by_chi2}: the test could not fail");
    }

    /// Rows of three kinds whose frames scatter, and a question that is seen in the frames' means of all three; `size`: how much of it there is.
    fn scattered(seed: u64, size: f64) -> Rows {
        const FRAMES: usize = 12;
        const STARS: usize = 15;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let pattern: Vec<f64> = (0..FRAMES).map(|frame| (1.7 * frame as f64).sin()).collect();
        let mut column = Vec::new();
        let mut kind = |name: &'static str, part: f64| {
            let mut rows = Vec::new();
            for (frame, own) in pattern.iter().enumerate() {
                let shared = 2.0 * normal();
                for star in 0..STARS {
                    column.push(part * own);
                    rows.push(Row { value: size * part * own + shared + normal(), sigma: 1.0, frame, star, point: None });
                }
            }
            let common = vec![vec![1.0; rows.len()]];
            Kind { channel: Channel::Shape, name, rows, per_frame: Vec::new(), common, shared: Shared::Frame, is_scaled: true }
        };
        let kinds = vec![kind("size", 1.0), kind("along x", 0.8), kind("along the diagonal", -0.6)];
        let question = Question {
            id: "trail",
            parameters: Vec::new(),
            follows: "rate",
            columns: vec![column],
            rank: 1,
            sign: None,
            is_part: false,
            products_of: &[],
        };
        Rows { kinds, questions: vec![question], frames: FRAMES }
    }

    /// An effect in the means of several kinds: no more often a surprise than is said where it is not, and more of one than by χ², which the scatter that it
    /// makes bounds, where it is.
    #[test]
    fn means_of_several_kinds_count_together() {
        const DRAWS: u64 = 1500;
        let of = |seed: u64, size: f64| {
            let rows = scattered(seed, size);
            let fit = fitted(&rows, &vec![true; rows.len()], &[], None);
            answer(&rows, &fit, 0).unwrap()
        };
        let alarms = (0..DRAWS).filter(|seed| of(*seed, 0.0).surprise > -0.01_f64.ln()).count();
        let strong = of(1, 20.0);
        let by_chi2 = surprise(strong.rank, strong.statistic, None);
        println!("{alarms} of {DRAWS} at 1 %; {:.1} by the scatter of the means, {by_chi2:.1} by χ²", strong.surprise);
        // Fifteen are due, ± 3.9.
        assert!((4..=28).contains(&alarms), "{alarms}");
        assert!(strong.surprise > by_chi2 + 3.0, "{} {by_chi2}", strong.surprise);
    }

    /// The fewer the means, the less of a surprise the same share of them is.
    #[test]
    fn more_means_are_a_larger_surprise() {
        let of = |dof: usize| surprise(1, 100.0, Some((0.9, dof)));
        assert!(of(5) < of(9) && of(9) < of(19) && of(19) < of(MANY_MEANS));
    }
}
