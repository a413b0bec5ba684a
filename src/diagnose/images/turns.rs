//! Proof on what took no part: effects are chosen and sized without a third of the frames and a third of the stars, and scored on those stars in
//! those frames.

use std::ops::Range;

use super::forward_selection::select;
use super::narrowing::as_in_all_rows;
use super::row_fit::RowFit;
use super::rows::{KNOWN_BEFOREHAND, Row, Rows};
use super::selection::{columns as columns_of, cosine};
use crate::diagnose::channels::Channel;
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
    /// By kind: χ² that is left with all that was chosen, and its degrees of freedom.
    pub(in crate::diagnose) left: Vec<[f64; 2]>,
    /// Turns that chose it, of how many.
    pub(in crate::diagnose) chosen: [usize; 2],
    /// Whether it was chosen by all rows, and every turn sized it.
    pub(in crate::diagnose) is_sized_alone: bool,
    /// Size and standard error of an extinction by the zero points of the frames, which take no part in it, where they confirm it.
    pub(in crate::diagnose) by_zero_points: Option<[f64; 2]>,
}

impl HeldOut {
    /// Standard deviations above the mean without the effect: mean −|x|², variance 4·|x|².
    pub(in crate::diagnose) fn score(&self) -> f64 {
        if self.square > 0.0 { (self.delta_chi2 + self.square) / (2.0 * self.square.sqrt()) } else { 0.0 }
    }

    /// Fall of χ² of a channel, and χ² per degree of freedom of it without the effect and with all that was chosen, with the degrees of freedom.
    pub(in crate::diagnose) fn of_channel(&self, rows: &Rows, channel: Channel) -> (f64, Option<([f64; 2], f64)>) {
        let fall: f64 = rows.kinds.iter().zip(&self.by_kind).filter(|(kind, _)| kind.channel == channel).map(|(_, fall)| fall).sum();
        let [chi2, dof] = of_channel(rows, &self.left, channel);
        (fall, (dof > 0.0).then(|| ([(chi2 + fall) / dof, chi2 / dof], dof)))
    }

    /// Adds another turn.
    fn add(&mut self, own: &Self) {
        self.delta_chi2 += own.delta_chi2;
        self.square += own.square;
        self.chosen[0] += 1;
        for (sum, own) in self.by_kind.iter_mut().zip(&own.by_kind) {
            *sum += own;
        }
        add_all(&mut self.left, &own.left);
    }

    /// Why the effect is not confirmed; nothing where it is.
    pub(in crate::diagnose) fn fails(&self) -> Option<String> {
        if self.by_zero_points.is_some() {
            return None;
        }
        let [times, turns] = self.chosen;
        if !self.is_sized_alone && (times == 0 || (times as f64) < MIN_TURNS * turns as f64) {
            return Some(format!("it is chosen again in {times} of {turns} turns that leave frames and stars out"));
        }
        (self.delta_chi2 <= 0.0 || self.score() < MIN_SCORE)
            .then(|| format!("it does not improve frames and stars that took no part: Δχ² {:.1}", self.delta_chi2))
    }
}

/// Which frames a turn leaves out together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::diagnose) enum LeftOut {
    /// Frames that follow each other: what changes slowly is not known from its neighbours.
    Blocks,
    /// Every third frame. A level of their own takes a trend out of a block, and beyond the others a trend is hardly known.
    Interleaved,
}

/// The turns: rows to choose and size by, and rows to score on.
pub(in crate::diagnose) fn turns(rows: &Rows, left_out: LeftOut) -> Vec<[Vec<bool>; 2]> {
    let blocks = if rows.frames >= MIN_FRAMES { BLOCKS.min(rows.frames) } else { 1 };
    let mut all = Vec::new();
    for block in 0..blocks {
        for part in 0..PARTS {
            let block_of = |frame: usize| match left_out {
                LeftOut::Blocks => frame.saturating_mul(blocks) / rows.frames.max(1),
                LeftOut::Interleaved => frame % blocks,
            };
            let is_block = |frame: usize| blocks == 1 || block_of(frame) == block;
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

/// What the turns say.
#[derive(Clone, Debug)]
pub(in crate::diagnose) struct Turns {
    /// Of each of the effects found by all rows.
    pub(in crate::diagnose) effects: Vec<HeldOut>,
    /// By kind, over all turns: χ² of the held-out rows with all that a turn chose, and its degrees of freedom.
    pub(in crate::diagnose) left: Vec<[f64; 2]>,
}

/// What the turns say of each of the effects found by all rows; those given are in every turn.
pub(in crate::diagnose) fn held_out(rows: &Rows, all: &RowFit, (found, given): (&[usize], &[usize]), threshold: f64) -> Turns {
    held_out_of(rows, all, (found, given), (threshold, LeftOut::Blocks))
}

fn held_out_of(rows: &Rows, all: &RowFit, (found, given): (&[usize], &[usize]), (threshold, left_out): (f64, LeftOut)) -> Turns {
    let turns = turns(rows, left_out);
    // What leaves the same trace is seen beside what is given alone: of an effect that is fitted nothing is left.
    let beside = RowFit::under(rows, &all.take, &columns_of(rows, given), all);
    let of_turn = |[train, held]: &[Vec<bool>; 2]| -> (Vec<Option<HeldOut>>, Vec<[f64; 2]>) {
        let (chosen, fit) = select(rows, train, given, threshold);
        let (chosen, fit) = as_in_all_rows(rows, &beside, (chosen, given.len()), fit, found);
        let of_chosen: Vec<&Vec<f64>> = columns_of(rows, &chosen);
        let taken_off = |columns: &[usize]| {
            let (of, sizes): (Vec<&Vec<f64>>, Vec<f64>) = columns.iter().map(|k| (of_chosen[*k], fit.size[*k])).unzip();
            RowFit::under(&less(rows, &of, &sizes), held, &[], &fit)
        };
        let on_held = RowFit::under(rows, held, &[], &fit);
        let left = taken_off(&(0..of_chosen.len()).collect::<Vec<_>>()).chi2_and_dof(rows);
        let mut credited = vec![None; found.len()];
        let places = places_of(rows, &chosen);
        for (k, &question) in chosen.iter().enumerate() {
            let is_alike = |own: &usize| !chosen.contains(own) && cosine(rows, &beside, *own, question) > SAME_TRACE;
            let owner = found.iter().position(|own| *own == question).or_else(|| found.iter().position(is_alike));
            if let Some(owner) = owner.filter(|owner| credited[*owner].is_none()) {
                let others: Vec<usize> = of_same_product(rows, &chosen, k).into_iter().flat_map(|other| places[other].clone()).collect();
                let with: Vec<usize> = others.iter().copied().chain(places[k].clone()).collect();
                let beside_them = (!others.is_empty()).then(|| taken_off(&others));
                let gain = gain(rows, beside_them.as_ref().unwrap_or(&on_held), &taken_off(&with));
                credited[owner] = Some(HeldOut { left: left.clone(), ..gain });
            }
        }
        (credited, left)
    };
    let by_turn = parallel::map(&turns, of_turn);
    let mut left = vec![[0.0; 2]; rows.kinds.len()];
    for (_, own) in &by_turn {
        add_all(&mut left, own);
    }
    let effects = (0..found.len())
        .map(|k| {
            let kinds = rows.kinds.len();
            let mut sum =
                HeldOut { by_kind: vec![0.0; kinds], left: vec![[0.0; 2]; kinds], chosen: [0, turns.len()], ..HeldOut::default() };
            by_turn.iter().filter_map(|(turn, _)| turn[k].as_ref()).for_each(|own| sum.add(own));
            sum
        })
        .collect();
    Turns { effects, left }
}

/// A trend of the frames' widths was chosen at odds at which the few frames of a turn do not choose it, and the name that its scatter has otherwise is
/// held against nothing that was left out: it is sized by two thirds of the frames, and scored on those between. Widths that scatter by chance are not foretold
/// so. What was chosen again, and what the turns leave in each channel, is told as it was.
pub(in crate::diagnose) fn sized_alone(
    rows: &Rows,
    all: &RowFit,
    (found, given): (&[usize], &[usize]),
    (own, threshold): (usize, f64),
    turns: &mut Turns,
) {
    let Some(k) = found.iter().position(|question| *question == own).filter(|k| turns.effects[*k].fails().is_some()) else { return };
    let with: Vec<usize> = given.iter().copied().chain([own]).collect();
    let sized = held_out_of(rows, all, (found, &with), (threshold, LeftOut::Interleaved));
    let chosen = turns.effects[k].chosen;
    turns.effects[k] = HeldOut { chosen, is_sized_alone: true, ..sized.effects[k].clone() };
}

/// χ² and degrees of freedom of the kinds of a channel.
pub(super) fn of_channel(rows: &Rows, by_kind: &[[f64; 2]], channel: Channel) -> [f64; 2] {
    let own = rows.kinds.iter().zip(by_kind).filter(|(kind, _)| kind.channel == channel);
    own.fold([0.0; 2], |sum, (_, own)| [sum[0] + own[0], sum[1] + own[1]])
}

/// Adds χ² and degrees of freedom of another turn, kind by kind.
fn add_all(sums: &mut [[f64; 2]], own: &[[f64; 2]]) {
    for (sum, own) in sums.iter_mut().zip(own) {
        *sum = [sum[0] + own[0], sum[1] + own[1]];
    }
}

/// Places of the columns of each of the questions among those of all.
fn places_of(rows: &Rows, questions: &[usize]) -> Vec<Range<usize>> {
    let mut end = 0;
    let place = |question: &usize| {
        let first = end;
        end += rows.questions[*question].columns.len();
        first..end
    };
    questions.iter().map(place).collect()
}

/// The others of the questions that are chosen with a product, if this one is of it: over a curved focal surface a drift of the focus does in some frames the
/// opposite of what the surface does in the mean, so that either is asked beside the other and their product (J. A. Nelder, J. R. Stat. Soc. A 140, 48 (1977),
/// on marginality).
fn of_same_product(rows: &Rows, chosen: &[usize], own: usize) -> Vec<usize> {
    let id = |k: usize| rows.questions[chosen[k]].id;
    let products: Vec<&str> = chosen.iter().flat_map(|question| rows.questions[*question].products_of).copied().collect();
    if !products.contains(&id(own)) {
        return Vec::new();
    }
    (0..chosen.len()).filter(|other| *other != own && products.contains(&id(*other))).collect()
}

/// Fall of χ² on held-out rows from one fit of their nuisance parameters to another.
fn gain(rows: &Rows, without: &RowFit, with: &RowFit) -> HeldOut {
    let (by_kind, square) = without.fall_to(rows, with);
    HeldOut { delta_chi2: by_kind.iter().sum(), square, by_kind, chosen: [1, 1], ..HeldOut::default() }
}

/// The rows with columns of given sizes taken off.
fn less(rows: &Rows, columns: &[&Vec<f64>], sizes: &[f64]) -> Rows {
    let mut without = Rows { kinds: rows.kinds.clone(), questions: Vec::new(), frames: rows.frames };
    for (kind, range) in without.kinds.iter_mut().zip(rows.ranges()) {
        for (row, k) in kind.rows.iter_mut().zip(range) {
            row.value -= columns.iter().zip(sizes).map(|(column, size)| column[k] * size).sum::<f64>();
        }
    }
    without
}

#[cfg(test)]
mod tests {
    use super::super::selection::fitted;
    use super::super::stars::rows_of_stars;
    use super::super::tests::{FRAMES, nothing, stars};
    use super::*;

    /// Rows that took no part scatter as the noise of the others says, where nothing is missing. The mean of a variance over one that few stars or frames
    /// tell exceeds one (as that of F does), here by a fifth with 13 stars and 8 frames.
    #[test]
    fn held_out_chi2_per_dof_is_one_where_nothing_is_missing() {
        for (kept, least, most) in [(1, 0.95, 1.07), (3, 0.95, 1.25)] {
            let (mut chi2, mut dof) = ([0.0; 2], [0.0; 2]);
            for seed in 0..6 {
                let few: Vec<_> = stars(seed, nothing).into_iter().filter(|own| own.star % kept == 0).collect();
                let (rows, ..) = rows_of_stars(&few, FRAMES, None);
                let all = vec![true; rows.len()];
                let turns = held_out(&rows, &fitted(&rows, &all, &[], None), (&[], &[]), 12.0);
                for (k, channel) in [Channel::Flux, Channel::Shape].into_iter().enumerate() {
                    let own = of_channel(&rows, &turns.left, channel);
                    (chi2[k], dof[k]) = (chi2[k] + own[0], dof[k] + own[1]);
                }
            }
            let per_dof = [chi2[0] / dof[0], chi2[1] / dof[1]];
            println!("every {kept}: {per_dof:.3?} of {dof:?} degrees of freedom");
            assert!(per_dof.iter().all(|own| (least..most).contains(own)), "every {kept}: {per_dof:?} of {dof:?}");
        }
    }

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
        let credited = |found: &[usize]| held_out(&rows, &fitted(&rows, &all, found, None), (found, &[]), 4.6).effects[0].clone();
        let alike = credited(&[own]);
        assert_eq!(alike.chosen, [9, 9]);
        assert!(alike.fails().is_none() && alike.delta_chi2 > 20.0, "{alike:?}");
        assert_eq!(credited(&[unlike]).chosen, [0, 9]);
    }
}
