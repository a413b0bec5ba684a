//! Cross-fitting: effects are selected, searched for and sized without a part of the frames (and stars), and scored on that part. Each fold runs
//! the whole procedure, the noise model included.
//!
//! Every choice of every fold is one proposal, credited once: to the effect itself, or to one already proposed whose displacements are the same
//! (cosine from [`SAME_TRACE`] on). A fold that does not choose an effect contributes zero to it. Without any effect the sum over all proposals has
//! a mean below zero, whatever the threshold, since each fold's choice is made without the errors that score it. That holds for the list of all
//! proposals alone; those that all images propose together have been chosen with every error in hand, and those named have passed the test besides.

use super::evidence::Evidence;
use super::fit_state::{FitState, SelectedEffect, basis, columns, cosine};
use super::folds::{Fold, Folds, goes_by_stars, threshold};
use super::holdout::{Gain, Turned, gain, held_out_quality, plausible};
use super::linear_fit::Fit;
use super::linear_system::{Whitened, dot};
use super::noise::NoiseModel;
use super::refine::refine;
use super::stepwise::select;
use crate::calibrate::{BundleSolution, Column};
use crate::identify::ControlPoints;
use crate::parallel;
use crate::statistics::significance::{chi_squared_quantile, normal_cdf};

/// Effects with a larger cosine leave the same trace: what one gains the other would.
const SAME_TRACE: f64 = 0.95;
/// Fewer numbers beyond the parameters choose nothing.
const MIN_DEGREES: f64 = 20.0;
/// The fall on what was held out must stand so many standard deviations above that without the effect.
const MIN_SCORE: f64 = 2.0;
/// The root of a statistic scatters by one: the fall stays within so many, nearly always.
const SCATTER: f64 = 2.0;
/// An effect is chosen again in this share of the turns at least: one that is just significant is in nine of ten.
const MIN_TURNS: f64 = 0.5;

/// An effect that a turn has chosen, and what it gained.
#[derive(Clone, Debug)]
struct Pick {
    hypothesis: usize,
    /// The hypothesis that it is credited to.
    owner: usize,
    columns: Vec<Column>,
    gain: Gain,
}

/// What came of a turn.
#[derive(Clone, Debug)]
struct Turn {
    picks: Vec<Pick>,
    /// Noise and images of the rest; nothing where nothing was chosen.
    rest: Option<(NoiseModel, Vec<bool>)>,
    /// The root of the statistic that a choice of one degree of freedom needed.
    asked: f64,
}

/// All turns, and what they chose.
pub(super) struct CrossFit {
    /// What was left out.
    pub(super) folds: Folds,
    turns: Vec<Turn>,
    /// Of each hypothesis, whether it goes by the star's own numbers.
    by_stars: Vec<bool>,
    owners: Vec<usize>,
}

/// What is proposed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Proposal {
    /// By all images.
    Entry(SelectedEffect),
    /// By turns alone: a hypothesis.
    Turns(usize),
}

impl Proposal {
    fn hypothesis(self) -> usize {
        match self {
            Self::Entry(entry) => entry.hypothesis,
            Self::Turns(hypothesis) => hypothesis,
        }
    }
}

/// What held-out images say of a proposal.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Proof {
    /// What the held-out images gained, over the turns that chose it.
    pub(super) gain: Gain,
    /// What was to be expected of one of the size found, turns that would miss it counted.
    pub(super) expected: f64,
    /// Scatter of that.
    pub(super) scatter: f64,
    /// In how many of how many turns it was chosen.
    pub(super) chosen: [usize; 2],
    /// What was left out in its turns.
    pub(super) left_out: &'static str,
    /// Its statistic on all images.
    pub(super) statistic: f64,
}

impl Proof {
    /// Why it is not confirmed; nothing where it is.
    pub(super) fn fails(&self) -> Option<String> {
        let ([times, turns], held) = (self.chosen, self.gain.delta_chi2);
        if (times as f64) < MIN_TURNS * turns as f64 || times == 0 {
            return Some(format!("it is chosen again in {times} of {turns} turns that leave {} out", self.left_out));
        }
        let least = 0.5 * self.expected - SCATTER * self.scatter;
        let confirms = held > 0.0 && self.gain.score() >= MIN_SCORE && held >= least;
        (!confirms).then(|| {
            format!("{} left out in turn do not confirm it (χ² falls by {held:.1} where {:.1} is expected)", self.left_out, self.expected)
        })
    }

    /// What a fall that is larger than the size lets expect says.
    pub(super) fn remark(&self) -> Option<String> {
        (self.gain.delta_chi2 > self.expected + SCATTER * self.scatter).then(|| {
            "more than the score on all images lets expect: how large it is, or how large the errors are, is not quite as modelled"
                .to_owned()
        })
    }
}

impl CrossFit {
    /// Chooses and sizes anew in every turn; `whole` is the surprise that a choice needs on all images, of `hypotheses` independent ones.
    pub(super) fn new(
        evidence: &Evidence,
        joint: &BundleSolution,
        points: &ControlPoints,
        begin: &NoiseModel,
        (whole, hypotheses): (f64, f64),
    ) -> Self {
        let folds = Folds::new(evidence);
        let by_stars: Vec<bool> = parallel::map(&evidence.hypotheses, |own| goes_by_stars(own, joint, evidence, points));
        let of = |fold: &Fold| {
            let least = threshold(whole, hypotheses, fold.share());
            turn(evidence, joint, fold, begin, least, &by_stars)
        };
        let turns = parallel::map(&folds.all, of);
        Self { folds, turns, by_stars, owners: Vec::new() }
    }

    /// The turns that judge a hypothesis.
    fn judging(&self, hypothesis: usize) -> impl Iterator<Item = (&Fold, &Turn)> {
        let own = self.by_stars[hypothesis];
        self.folds.all.iter().zip(&self.turns).filter(move |(fold, _)| fold.judges.takes(own))
    }

    /// Credits every pick of every turn: to the effect itself, or to one of its kind that leaves the same trace. Effects that all images
    /// propose (`proposals`) stand first, then those that turns alone propose. `base` is the fit of all images without any.
    pub(super) fn credit(&mut self, evidence: &Evidence, base: &FitState, proposals: &[SelectedEffect]) {
        let white = |column: &Column| evidence.white(&base.noise, column);
        self.owners = proposals.iter().map(|entry| entry.hypothesis).collect();
        let mut traces: Vec<Vec<Whitened>> =
            proposals.iter().map(|entry| columns(evidence, std::slice::from_ref(entry)).map(white).collect()).collect();
        for (fold, turn) in self.folds.all.iter().zip(&mut self.turns) {
            for pick in turn.picks.iter_mut().filter(|pick| fold.judges.takes(self.by_stars[pick.hypothesis])) {
                pick.owner = pick.hypothesis;
                if self.owners.contains(&pick.hypothesis) {
                    continue;
                }
                let trace: Vec<Whitened> = pick.columns.iter().map(white).collect();
                let of_its_kind = self.owners.iter().zip(&traces).filter(|(own, _)| self.by_stars[**own] == self.by_stars[pick.hypothesis]);
                let alike = of_its_kind.map(|(own, known)| (*own, cosine(&base.fit, known, &trace))).filter(|(_, cos)| *cos >= SAME_TRACE);
                if let Some((own, _)) = alike.max_by(|a, b| a.1.total_cmp(&b.1)) {
                    pick.owner = own;
                } else {
                    self.owners.push(pick.hypothesis);
                    traces.push(trace);
                }
            }
        }
    }

    /// The hypotheses proposed, by all images or by turns alone, once credited.
    pub(super) fn proposed(&self) -> &[usize] {
        &self.owners
    }

    /// The proof of a proposal. `stand` holds `kept`, on all images; where the proposal is one of them it is judged beside the others.
    pub(super) fn proof(&self, evidence: &Evidence, stand: &FitState, kept: &[SelectedEffect], proposal: Proposal) -> Proof {
        let hypothesis = proposal.hypothesis();
        let shown = shown(evidence, stand, kept, proposal);
        let (mut sum, mut times, mut turns, mut expected) = (Gain::default(), 0, 0, 0.0);
        for (fold, turn) in self.judging(hypothesis) {
            let own: Vec<&Pick> = turn.picks.iter().filter(|pick| pick.owner == hypothesis).collect();
            turns += 1;
            times += usize::from(!own.is_empty());
            expected += shown.expected(fold, turn.asked);
            sum = own.into_iter().fold(sum, |sum, pick| sum.and(pick.gain));
        }
        Proof {
            gain: sum,
            expected,
            scatter: 2.0 * shown.strength().sqrt(),
            chosen: [times, turns],
            left_out: self.folds.words(self.by_stars[hypothesis]),
            statistic: shown.statistic,
        }
    }

    /// What the held-out images gain with another effect in the place of a hypothesis, in the turns that chose this one.
    pub(super) fn in_place(&self, evidence: &Evidence, hypothesis: usize, instead: SelectedEffect) -> f64 {
        let of = |(fold, turn): (&Fold, &Turn)| {
            let (noise, take) = turn.rest.as_ref().filter(|_| turn.picks.iter().any(|pick| pick.owner == hypothesis))?;
            let white = |column: &Column| evidence.white(noise, column);
            let others = turn.picks.iter().filter(|pick| pick.owner != hypothesis);
            let kept: Vec<Whitened> = others.flat_map(|pick| &pick.columns).map(white).collect();
            let tried: Vec<Whitened> = columns(evidence, &[instead]).map(white).collect();
            let system = evidence.system(noise);
            let fit = Fit::new(&system, take, &kept.iter().collect::<Vec<_>>());
            let stand = FitState { noise: noise.clone(), system, take: take.clone(), more: kept, fit };
            let held = believed(evidence, &stand, fold);
            Some(gain(&stand, &held, &stand.more.iter().collect::<Vec<_>>(), &tried.iter().collect::<Vec<_>>()).delta_chi2)
        };
        self.judging(hypothesis).filter_map(of).sum()
    }

    /// χ² per number and rms (px) of held-out frames with the noise of `stand`; each turn's model is what it chose itself of `named`.
    pub(super) fn quality(&self, evidence: &Evidence, stand: &FitState, named: &[SelectedEffect]) -> Option<(f64, f64)> {
        let first = self.folds.all.first()?.judges;
        let is_named = |pick: &&Pick| named.iter().any(|entry| entry.hypothesis == pick.owner);
        let of = |(fold, turn): (&'_ Fold, &Turn)| {
            let columns = turn.picks.iter().filter(is_named).flat_map(|pick| &pick.columns);
            (fold.train.clone(), fold.held.clone(), columns.map(|column| evidence.white(&stand.noise, column)).collect())
        };
        let turned: Vec<Turned> = self.folds.all.iter().zip(&self.turns).filter(|(fold, _)| fold.judges == first).map(of).collect();
        held_out_quality(evidence, stand, &turned)
    }

    /// How many turns judge effects, those of the stars and the others.
    pub(super) fn counts(&self) -> [usize; 2] {
        let count = |by_stars: bool| self.folds.all.iter().filter(|fold| fold.judges.takes(by_stars)).count();
        [count(false), count(true)]
    }
}

/// Held-out images of a turn that are images of their stars.
fn believed(evidence: &Evidence, stand: &FitState, fold: &Fold) -> Vec<bool> {
    fold.held.iter().zip(plausible(evidence, stand)).map(|(held, plausible)| *held && plausible).collect()
}

/// One turn: choice, search and size on the rest, and what comes of it on what is left out.
fn turn(evidence: &Evidence, joint: &BundleSolution, fold: &Fold, begin: &NoiseModel, least: f64, by_stars: &[bool]) -> Turn {
    let asked = chi_squared_quantile(1.0, least).sqrt();
    let nothing = Turn { picks: Vec::new(), rest: None, asked };
    if degrees(evidence, fold) < MIN_DEGREES {
        return nothing;
    }
    let (mut entries, mut stand) = select(evidence, &fold.train, begin, least);
    if entries.is_empty() {
        return nothing;
    }
    let mut searched = std::borrow::Cow::Borrowed(evidence);
    if entries.iter().any(|entry| evidence.hypotheses[entry.hypothesis].searched.is_some()) {
        refine(searched.to_mut(), joint, &mut entries, &fold.train, begin);
        stand = FitState::new(&searched, &fold.train, &entries, &stand.noise);
    }
    let held = believed(&searched, &stand, fold);
    let white = |entry: &SelectedEffect| {
        columns(&searched, std::slice::from_ref(entry)).map(|c| searched.white(&stand.noise, c)).collect::<Vec<_>>()
    };
    let of = |k: usize| {
        let judged = fold.judges.takes(by_stars[entries[k].hypothesis]);
        let kept: Vec<Whitened> = entries.iter().enumerate().filter(|(index, _)| *index != k).flat_map(|(_, entry)| white(entry)).collect();
        let tried = white(&entries[k]);
        let gain = judged.then(|| gain(&stand, &held, &kept.iter().collect::<Vec<_>>(), &tried.iter().collect::<Vec<_>>()));
        Pick {
            hypothesis: entries[k].hypothesis,
            owner: entries[k].hypothesis,
            columns: columns(&searched, &entries[k..=k]).cloned().collect(),
            gain: gain.unwrap_or_default(),
        }
    };
    let picks = (0..entries.len()).map(of).collect();
    Turn { picks, rest: Some((stand.noise, stand.take)), asked }
}

/// Numbers beyond attitudes and camera on the images fitted to.
fn degrees(evidence: &Evidence, fold: &Fold) -> f64 {
    let mut seen = vec![false; evidence.frames.len()];
    for (place, _) in evidence.place.iter().zip(&fold.train).filter(|(_, train)| **train) {
        seen[*place] = true;
    }
    let own = evidence.own.len() * seen.iter().filter(|seen| **seen).count();
    2.0 * fold.train.iter().filter(|train| **train).count() as f64 - own as f64 - evidence.camera.len() as f64
}

/// What all images show of an effect, and where.
struct Shown {
    statistic: f64,
    rank: usize,
    /// |d|² of each image, d what it moves beyond attitudes, camera and the other effects.
    moved: Vec<f64>,
}

impl Shown {
    /// The statistic beyond what chance brings.
    fn strength(&self) -> f64 {
        (self.statistic - self.rank as f64).max(0.0)
    }

    /// Fall of χ² to be expected in a turn, whose choice needs `asked` standard deviations: the chance that it is chosen times what it then
    /// brings, less what its size costs that is known from the rest alone.
    fn expected(&self, fold: &Fold, asked: f64) -> f64 {
        let on = |mask: &[bool]| mask.iter().zip(&self.moved).filter(|(own, _)| **own).map(|(_, moved)| moved).sum::<f64>();
        let all: f64 = self.moved.iter().sum();
        let (trained, held) = (on(&fold.train) / all, on(&fold.held) / all);
        if !(trained > 0.0 && held.is_finite()) {
            return 0.0;
        }
        let chosen = normal_cdf((trained * self.strength()).sqrt() - asked);
        chosen * held * (self.strength() - self.rank as f64 / trained)
    }
}

/// Of a proposal beside the others of `kept`; of one by turns alone at its best variant.
fn shown(evidence: &Evidence, stand: &FitState, kept: &[SelectedEffect], proposal: Proposal) -> Shown {
    let white = |entry: SelectedEffect| stand.white(evidence, &[entry]);
    let hypothesis = proposal.hypothesis();
    let others: Vec<Whitened> = kept.iter().filter(|entry| entry.hypothesis != hypothesis).flat_map(|entry| white(*entry)).collect();
    let without = stand.beside(others);
    let own = match proposal {
        Proposal::Entry(entry) => white(entry),
        Proposal::Turns(_) => (0..evidence.hypotheses[hypothesis].variants.len())
            .map(|variant| white(SelectedEffect { hypothesis, variant }))
            .max_by(|a, b| without.score(a).0.total_cmp(&without.score(b).0))
            .unwrap_or_default(),
    };
    let rest: Vec<Whitened> = own.iter().map(|column| without.fit.project(column)).collect();
    let (directions, _) = basis(&rest, &own, &without.fit);
    let mut moved = vec![0.0; 2 * evidence.images.len()];
    let mut statistic = 0.0;
    for direction in &directions {
        let along = dot(direction, &without.fit.psi);
        statistic += along * along / without.fit.c;
        for (moved, value) in moved.iter_mut().zip(direction) {
            *moved += along * value;
        }
    }
    let moved = moved.chunks_exact(2).map(|pair| pair[0] * pair[0] + pair[1] * pair[1]).collect();
    Shown { statistic, rank: directions.len(), moved }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proof(delta_chi2: f64, expected: f64, chosen: [usize; 2]) -> Proof {
        let gain = Gain { delta_chi2, square: expected.max(1.0) };
        Proof { gain, expected, scatter: 2.0 * expected.max(1.0).sqrt(), chosen, left_out: "frames", statistic: expected }
    }

    /// A fall that is larger than expected is no lack of confirmation: it is said, and confirms. One that is far smaller does not; nor does
    /// what few turns choose, whatever it brought there.
    #[test]
    fn a_larger_fall_is_said_and_a_smaller_one_or_few_turns_withhold() {
        let larger = proof(813.0, 167.0, [8, 8]);
        assert!(larger.fails().is_none() && larger.remark().is_some(), "{larger:?}");
        let as_expected = proof(150.0, 167.0, [7, 8]);
        assert!(as_expected.fails().is_none() && as_expected.remark().is_none());
        assert!(proof(20.0, 167.0, [8, 8]).fails().is_some_and(|against| against.contains("167")));
        for few in [[0, 8], [2, 8], [3, 8]] {
            assert!(proof(167.0, 167.0, few).fails().is_some_and(|against| against.contains(&format!("{} of 8", few[0]))), "{few:?}");
        }
        assert!(proof(-5.0, 3.0, [8, 8]).fails().is_some());
    }

    /// Without the effect the fall has mean −|d|² and variance 4·|d|², and the score is standard normal.
    #[test]
    fn the_score_of_nothing_is_standard_normal() {
        let gain = Gain { delta_chi2: -9.0, square: 9.0 };
        assert!(gain.score().abs() < 1e-12);
        let two_sigma = Gain { delta_chi2: -9.0 + 2.0 * 6.0, square: 9.0 };
        assert!((two_sigma.score() - 2.0).abs() < 1e-12);
        assert!(gain.and(two_sigma).score() > 1.3);
    }
}
