//! Proof on what took no part: effects are chosen and sized without a third of the frames and a third of the stars, and scored on those stars in
//! those frames.

use super::row_fit::RowFit;
use super::rows::{KNOWN_BEFOREHAND, Row, Rows};
use super::selection::{columns as columns_of, cosine, select};
use crate::parallel;

/// Blocks of frames, at most.
const BLOCKS: usize = 3;
/// Parts of the stars.
const PARTS: usize = 3;
/// Fewer frames are not left out: parts of the stars are.
const MIN_FRAMES: usize = 4;
/// What leaves the same trace is credited alike.
const SAME_TRACE: f64 = 0.95;
/// The fall must stand so many standard deviations above that without the effect.
const MIN_SCORE: f64 = 2.0;
/// An effect is chosen again in this share of the turns at least.
const MIN_TURNS: f64 = 0.5;

/// What held-out rows say of an effect.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::diagnose) struct HeldOut {
    /// Fall of χ² with the sizes of the turns.
    pub(in crate::diagnose) delta_chi2: f64,
    /// Sum of the squares of what the effect adds.
    pub(in crate::diagnose) square: f64,
    /// By kind: fall of χ².
    pub(in crate::diagnose) by_kind: Vec<f64>,
    /// Turns that chose it, of how many.
    pub(in crate::diagnose) chosen: [usize; 2],
}

impl HeldOut {
    /// Standard deviations above the mean without the effect: mean −|x|², variance 4·|x|².
    pub(in crate::diagnose) fn score(&self) -> f64 {
        if self.square > 0.0 { (self.delta_chi2 + self.square) / (2.0 * self.square.sqrt()) } else { 0.0 }
    }

    /// Why the effect is not confirmed; nothing where it is.
    pub(in crate::diagnose) fn fails(&self) -> Option<String> {
        let [times, turns] = self.chosen;
        if times == 0 || (times as f64) < MIN_TURNS * turns as f64 {
            return Some(format!("it is chosen again in {times} of {turns} turns that leave frames and stars out"));
        }
        (self.delta_chi2 <= 0.0 || self.score() < MIN_SCORE)
            .then(|| format!("it does not improve frames and stars that took no part: Δχ² {:.1}", self.delta_chi2))
    }
}

/// The turns: rows to choose and size by, and rows to score on.
pub(in crate::diagnose) fn turns(rows: &Rows) -> Vec<[Vec<bool>; 2]> {
    let blocks = if rows.frames >= MIN_FRAMES { BLOCKS.min(rows.frames) } else { 1 };
    let mut all = Vec::new();
    for block in 0..blocks {
        for part in 0..PARTS {
            let is_block = |frame: usize| blocks == 1 || frame.saturating_mul(blocks) / rows.frames.max(1) == block;
            // A star's number says nothing of the star; rows of no star follow their frame alone.
            let is_part = |point: Option<usize>, star: usize| match point {
                Some(_) => (star.wrapping_mul(0x9e37_79b9) >> 7) % PARTS == part,
                // Each frame's own rows are scored once.
                None => part == 0,
            };
            let is_held = |row: &Row| is_block(row.frame) && is_part(row.point, row.star);
            let is_trained = |row: &Row| (blocks == 1 || !is_block(row.frame)) && (row.point.is_none() || !is_part(row.point, row.star));
            // What is known beforehand is known on both sides.
            let is_known = |row: &Row| row.frame == KNOWN_BEFOREHAND;
            let train = rows.rows().map(|row| is_known(row) || is_trained(row) && !is_held(row)).collect();
            let held = rows.rows().map(|row| is_known(row) || is_held(row)).collect();
            all.push([train, held]);
        }
    }
    all
}

/// What the turns say of each of the effects found by all rows; those given are in every turn.
pub(in crate::diagnose) fn held_out(rows: &Rows, all: &RowFit, (found, given): (&[usize], &[usize]), threshold: f64) -> Vec<HeldOut> {
    let turns = turns(rows);
    // What leaves the same trace is seen beside what is given alone: of an effect that is fitted nothing is left.
    let beside = RowFit::under(rows, &all.take, &columns_of(rows, given), all);
    let of_turn = |[train, held]: &[Vec<bool>; 2]| -> Vec<Option<HeldOut>> {
        let (chosen, fit) = select(rows, train, given, threshold);
        let on_held = RowFit::under(rows, held, &[], &fit);
        let mut credited = vec![None; found.len()];
        let mut first = 0;
        for &question in &chosen {
            let columns = &rows.questions[question].columns;
            let sizes: Vec<f64> = (0..columns.len()).map(|k| fit.size[first + k]).collect();
            first += columns.len();
            let is_alike = |own: &usize| !chosen.contains(own) && cosine(rows, &beside, *own, question) > SAME_TRACE;
            let owner = found.iter().position(|own| *own == question).or_else(|| found.iter().position(is_alike));
            if let Some(owner) = owner.filter(|owner| credited[*owner].is_none()) {
                credited[owner] = Some(gain(rows, (held, &fit), &on_held, (columns, &sizes)));
            }
        }
        credited
    };
    let by_turn: Vec<Vec<Option<HeldOut>>> = parallel::map(&turns, of_turn);
    (0..found.len())
        .map(|k| {
            let mut sum = HeldOut { by_kind: vec![0.0; rows.kinds.len()], chosen: [0, turns.len()], ..HeldOut::default() };
            for own in by_turn.iter().filter_map(|turn| turn[k].as_ref()) {
                sum.delta_chi2 += own.delta_chi2;
                sum.square += own.square;
                sum.chosen[0] += 1;
                for (sum, own) in sum.by_kind.iter_mut().zip(&own.by_kind) {
                    *sum += own;
                }
            }
            sum
        })
        .collect()
}

/// Fall of χ² on held-out rows with columns of given sizes: their nuisance parameters are fitted with the effect taken off, and without.
fn gain(rows: &Rows, (held, fit): (&[bool], &RowFit), before: &RowFit, (columns, sizes): (&[Vec<f64>], &[f64])) -> HeldOut {
    let mut without = Rows { kinds: rows.kinds.clone(), questions: Vec::new(), frames: rows.frames };
    for (kind, range) in without.kinds.iter_mut().zip(rows.ranges()) {
        for (row, k) in kind.rows.iter_mut().zip(range) {
            row.value -= columns.iter().zip(sizes).map(|(column, size)| column[k] * size).sum::<f64>();
        }
    }
    let after = RowFit::under(&without, held, &[], fit);
    let (by_kind, square) = before.fall_to(rows, &after);
    HeldOut { delta_chi2: by_kind.iter().sum(), square, by_kind, chosen: [1, 1] }
}

#[cfg(test)]
mod tests {
    use super::super::selection::fitted;
    use super::super::stars::rows_of_stars;
    use super::super::tests::{FRAMES, stars};
    use super::*;

    /// Of two names of one trace the turns choose the more usual one, and the other is confirmed by that.
    #[test]
    fn what_leaves_the_same_trace_confirms() {
        let dark_corners = |image: &crate::effects::ImageContext| (0.3 * (image.at[0].powi(2) + image.at[1].powi(2)), [0.0; 3]);
        let (mut rows, ..) = rows_of_stars(&stars(3, dark_corners), FRAMES, None);
        let own = rows.questions.iter().position(|question| question.id == "vignetting").unwrap();
        let other = super::super::rows::Question { id: "another-name", rank: 0, ..rows.questions[own].clone() };
        rows.questions[own].rank = 9;
        let unlike = rows.questions.iter().position(|question| question.id == "passband").unwrap();
        rows.questions.push(other);
        let all = vec![true; rows.len()];
        let credited = |found: &[usize]| held_out(&rows, &fitted(&rows, &all, found, None), (found, &[]), 4.6)[0].clone();
        let alike = credited(&[own]);
        assert_eq!(alike.chosen, [9, 9]);
        assert!(alike.fails().is_none() && alike.delta_chi2 > 20.0, "{alike:?}");
        assert_eq!(credited(&[unlike]).chosen, [0, 9]);
    }
}
