//! Is the improvement real: frames that were not used to find an effect are predicted with it and without it, only their attitudes fitted.

use super::attribute::{Entry, Stand, columns};
use super::descent::{cost, psi_of, refit_own};
use super::evidence::Evidence;
use super::own::project_own;
use super::sheet::{Fit, Whitened, dot};
use crate::statistics::significance::chi_squared_surprise;

/// From so many frames on a part of them is locked away; below, every frame is left out once.
pub(super) const LOCK_BOX_FROM: usize = 16;
/// Every so many-th block is locked away.
const EVERY: usize = 4;
/// Blocks in all.
const BLOCKS: usize = 16;
/// The score on the held-out frames must be as large, standard deviations.
const LEAST_SCORE: f64 = 2.0;

/// The square root of a statistic scatters by one: by so many at most, nearly always.
const SCATTER: f64 = 2.0;
/// Held-out frames on which less is expected decide nothing, standard deviations.
const DECISIVE: f64 = 3.0;

/// The frames set aside, by place; empty where there are too few frames.
pub(super) fn locked_away(frames: usize, hash: u64) -> Vec<usize> {
    if frames < LOCK_BOX_FROM {
        return Vec::new();
    }
    let block = |place: usize| place * BLOCKS / frames;
    let first = (hash % EVERY as u64) as usize;
    (0..frames).filter(|place| block(*place) % EVERY == first).collect()
}

/// Held-out evidence for one of the accepted effects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Proof {
    /// Fall of χ² on the held-out frames.
    pub(super) delta_chi2: f64,
    /// Its expectation.
    pub(super) expected: f64,
    /// Score along the frozen direction, standard deviations.
    pub(super) score: f64,
    /// Whether the held-out frames hold too little of the effect to decide.
    pub(super) powerless: bool,
    /// Whether that confirms the effect.
    pub(super) confirms: bool,
}

/// Predictions of held-out images.
struct Held {
    before: Whitened,
    after: Whitened,
    direction: Whitened,
    /// |direction|² on the frames fitted to.
    trained: f64,
}

/// One fold: fitted to `train`, judged on `held`.
fn judge(stand: &Stand, train: &[bool], held: &[bool], kept: &[&Whitened], tried: &[&Whitened]) -> Held {
    let sheet = &stand.sheet;
    let all: Vec<&Whitened> = kept.iter().chain(tried).copied().collect();
    let (without, with) = (Fit::new(sheet, train, kept), Fit::new(sheet, train, &all));
    let predict = |fit: &Fit, more: &[&Whitened]| {
        let mut residual = sheet.residual.clone();
        for (column, change) in sheet.camera.iter().chain(more.iter().copied()).zip(fit.change.iter()) {
            for (a, b) in residual.iter_mut().zip(column) {
                *a += change * b;
            }
        }
        residual
    };
    let (before, after) = (predict(&without, kept), predict(&with, &all));
    let difference: Whitened = before.iter().zip(&after).map(|(a, b)| a - b).collect();
    Held {
        before: refit_own(sheet, held, &before),
        after: refit_own(sheet, held, &after),
        direction: project_own(sheet, held, &difference),
        trained: {
            let seen = project_own(sheet, train, &difference);
            dot(&seen, &seen)
        },
    }
}

/// What comes of the choice of effects repeated without the images of each fold.
#[derive(Clone, Debug)]
pub(super) struct Again {
    /// The surprise that a choice needs.
    pub(super) threshold: f64,
    /// Whether the effect is chosen, fold by fold.
    pub(super) chosen: Vec<bool>,
}

impl Again {
    /// An effect of which so much shows (χ²) in what is left would be chosen nearly always.
    fn would_choose(&self, rank: usize, shows: f64) -> bool {
        let at_least = (shows.sqrt() - SCATTER).max(0.0);
        chi_squared_surprise(rank as f64, at_least * at_least) > self.threshold
    }
}

/// The proof of entry `k`, over folds given by the masks of their held-out images. Where the choice repeated without a fold's images misses it
/// though enough is left to choose it by, it improves nothing there. `statistic` is its T on the images it was found in, `rank` its degrees of freedom.
pub(super) fn prove(
    evidence: &Evidence,
    stand: &Stand,
    entries: &[Entry],
    k: usize,
    (folds, again): (&[Vec<bool>], Option<&Again>),
    (statistic, rank): (f64, usize),
) -> Proof {
    let own = |entry: &Entry| {
        columns(evidence, std::slice::from_ref(entry)).map(|column| evidence.white(&stand.noise, column)).collect::<Vec<_>>()
    };
    let tried: Vec<Whitened> = own(&entries[k]);
    let kept: Vec<Whitened> = entries.iter().enumerate().filter(|(index, _)| *index != k).flat_map(|(_, entry)| own(entry)).collect();
    let (kept, tried): (Vec<&Whitened>, Vec<&Whitened>) = (kept.iter().collect(), tried.iter().collect());
    let plausible = evidence_mask(evidence, stand);
    let (mut delta, mut along, mut length, mut trained) = (0.0, 0.0, 0.0, 0.0);
    for (index, fold) in folds.iter().enumerate() {
        let held: Vec<bool> = fold.iter().zip(&plausible).map(|(fold, plausible)| *fold && *plausible).collect();
        let train: Vec<bool> = fold.iter().zip(&plausible).map(|(fold, plausible)| !*fold && *plausible).collect();
        let result = judge(stand, &train, &held, &kept, &tried);
        length += dot(&result.direction, &result.direction);
        trained += result.trained / folds.len() as f64;
        let all_of_it = result.trained + dot(&result.direction, &result.direction);
        let left = (statistic - rank as f64).max(0.0) * if all_of_it > 0.0 { result.trained / all_of_it } else { 0.0 };
        if again.is_some_and(|again| again.chosen.get(index) == Some(&false) && again.would_choose(rank, left)) {
            continue;
        }
        let nu = stand.sheet.tail_degrees;
        delta += (cost(&result.before, &held, nu) - cost(&result.after, &held, nu)) * stand.fit.d / stand.fit.c;
        let (psi, _) = psi_of(&result.before, &held, nu);
        along += dot(&psi, &result.direction);
    }
    let score = if length > 0.0 { along / (length * stand.fit.c).sqrt() } else { 0.0 };
    // What the effect moves there against what it moves where it was found, not numbers of stars: some effects live on few.
    let found_in = if folds.len() > 1 { length.max(trained) } else { trained };
    let lambda = (statistic - rank as f64).max(0.0) * if found_in > 0.0 { length / found_in } else { 0.0 };
    let (expected, sd) = (lambda - rank as f64, 2.0 * lambda.sqrt());
    Proof {
        delta_chi2: delta,
        expected,
        score,
        powerless: lambda.sqrt() < DECISIVE,
        confirms: delta > 0.0 && score >= LEAST_SCORE && delta >= 0.5 * expected - 2.0 * sd,
    }
}

/// Images that are images of their stars under the model that has been found.
fn evidence_mask(evidence: &Evidence, stand: &Stand) -> Vec<bool> {
    let mut take = vec![true; evidence.images.len()];
    // Held-out images take no part in the fit: their own residuals with the shared parameters moved say whether they are plausible.
    let mut residual = stand.sheet.residual.clone();
    for (column, change) in stand.sheet.camera.iter().chain(&stand.more).zip(stand.fit.change.iter()) {
        for (a, b) in residual.iter_mut().zip(column) {
            *a += change * b;
        }
    }
    let refitted = refit_own(&stand.sheet, &take, &residual);
    for (k, take) in take.iter_mut().enumerate() {
        let q = refitted[2 * k].powi(2) + refitted[2 * k + 1].powi(2);
        *take = q < 400.0;
    }
    take
}

/// χ² per number and 2-D rms (px) of held-out images with a set of effects; folds as in [`prove`].
pub(super) fn held_out_quality(evidence: &Evidence, stand: &Stand, entries: &[Entry], folds: &[Vec<bool>]) -> Option<(f64, f64)> {
    let own: Vec<Whitened> = columns(evidence, entries).map(|column| evidence.white(&stand.noise, column)).collect();
    let kept: Vec<&Whitened> = own.iter().collect();
    let plausible = evidence_mask(evidence, stand);
    let (mut sum, mut square_px, mut count, mut lost) = (0.0, 0.0, 0.0, 0.0);
    for fold in folds {
        let held: Vec<bool> = fold.iter().zip(&plausible).map(|(fold, plausible)| *fold && *plausible).collect();
        let train: Vec<bool> = fold.iter().zip(&plausible).map(|(fold, plausible)| !*fold && *plausible).collect();
        let result = judge(stand, &train, &held, &kept, &[]);
        let (psi, _) = psi_of(&result.before, &held, stand.sheet.tail_degrees);
        sum += dot(&psi, &result.before);
        let px = stand.noise.unwhiten(&evidence.images, &evidence.place, &result.before);
        square_px += dot(&px, &px);
        count += held.iter().filter(|held| **held).count() as f64;
        let mut seen = vec![false; stand.sheet.frames];
        for (frame, _) in stand.sheet.frame.iter().zip(&held).filter(|(_, held)| **held) {
            seen[*frame] = true;
        }
        lost += (stand.sheet.own.len() * seen.iter().filter(|seen| **seen).count()) as f64;
    }
    // Under the noise found, ψ·r has expectation one for each number and degree of freedom.
    (count > 0.0 && 2.0 * count > lost).then(|| (sum / (2.0 * count - lost), (square_px / count).sqrt()))
}

/// Masks of held-out images: the frames locked away, or every frame in turn.
pub(super) fn folds(evidence: &Evidence, locked: &[usize]) -> Vec<Vec<bool>> {
    let mask = |wanted: &dyn Fn(usize) -> bool| evidence.place.iter().map(|place| wanted(*place)).collect::<Vec<bool>>();
    if locked.is_empty() {
        (0..evidence.frames.len()).map(|frame| mask(&|place| place == frame)).collect()
    } else {
        vec![mask(&|place| locked.contains(&place))]
    }
}
