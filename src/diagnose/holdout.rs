//! Hold-out test: images that were not used to find an effect are predicted with it and without it, with only their attitudes fitted.
//!
//! The camera is that of the images fitted to, with the effect and without it; a held-out frame estimates its own attitude from its held-out
//! images, since attitudes belong to frames. Without the effect the fall of χ² then has a mean of −|d|², d what the effect as fitted moves
//! the held-out images beyond their attitudes: d comes from other images than their errors do, and the camera's own error is uncorrelated
//! with the size of what was fitted beside it. With heavy tails it is no more (a density that falls off on all sides loses by any shift).

use super::descent::refit_own;
use super::evidence::Evidence;
use super::fit_state::FitState;
use super::frame_nuisance::project_own;
use super::linear_fit::Fit;
use super::linear_system::{Whitened, WhitenedSystem, dot};
use crate::statistics::student_t::{cost, psi_of};

/// A larger residual, standard errors, is that of no image of the star.
const GROSS: f64 = 20.0;

/// What held-out images say of columns: sums that add over turns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Gain {
    /// Fall of χ² with them.
    pub(super) delta_chi2: f64,
    /// |d|² in its units: without the effect the fall has mean −|d|² and variance 4·|d|².
    pub(super) square: f64,
}

impl Gain {
    /// With another turn's.
    pub(super) fn and(self, other: Self) -> Self {
        Self { delta_chi2: self.delta_chi2 + other.delta_chi2, square: self.square + other.square }
    }

    /// How far the fall lies above what it is without the effect, standard deviations. By the likelihood, not by the score where the effect
    /// is absent: stars that it moves far are outliers there, and pull little.
    pub(super) fn score(&self) -> f64 {
        if self.square > 0.0 { (self.delta_chi2 + self.square) / (2.0 * self.square.sqrt()) } else { 0.0 }
    }
}

/// Residuals with the shared parameters of a fit.
fn predicted(system: &WhitenedSystem, fit: &Fit, more: &[&Whitened]) -> Whitened {
    let mut residual = system.residual.clone();
    for (column, change) in system.camera.iter().chain(more.iter().copied()).zip(fit.change.iter()) {
        for (a, b) in residual.iter_mut().zip(column) {
            *a += change * b;
        }
    }
    residual
}

/// What held-out images gain by the columns `tried` beside those `kept`, all fitted to the images that `stand` takes.
pub(super) fn gain(stand: &FitState, held: &[bool], kept: &[&Whitened], tried: &[&Whitened]) -> Gain {
    let system = &stand.system;
    let all: Vec<&Whitened> = kept.iter().chain(tried).copied().collect();
    let (without, with) = (Fit::new(system, &stand.take, kept), Fit::new(system, &stand.take, &all));
    let (before, after) = (predicted(system, &without, kept), predicted(system, &with, &all));
    let moved: Whitened = before.iter().zip(&after).map(|(a, b)| a - b).collect();
    let moved = project_own(system, held, &moved);
    let nu = system.tail_degrees;
    let value = |residual: &Whitened| cost(&refit_own(system, held, residual), held, nu);
    let unit = stand.fit.d / stand.fit.c;
    Gain { delta_chi2: (value(&before) - value(&after)) * unit, square: dot(&moved, &moved) * stand.fit.d * unit }
}

/// Images that are images of their stars under the model of a stand, those that take no part in it too.
pub(super) fn plausible(evidence: &Evidence, stand: &FitState) -> Vec<bool> {
    let all = vec![true; evidence.images.len()];
    let more: Vec<&Whitened> = stand.more.iter().collect();
    let refitted = refit_own(&stand.system, &all, &predicted(&stand.system, &stand.fit, &more));
    refitted.chunks_exact(2).map(|pair| pair[0].powi(2) + pair[1].powi(2) < GROSS * GROSS).collect()
}

/// Images that are fitted to, those that are predicted, and the columns that are fitted beside the camera.
pub(super) type Turned = (Vec<bool>, Vec<bool>, Vec<Whitened>);

/// χ² per number and 2-D rms (px) of held-out images, with the noise of `stand`.
pub(super) fn held_out_quality(evidence: &Evidence, stand: &FitState, turns: &[Turned]) -> Option<(f64, f64)> {
    let system = &stand.system;
    let plausible = plausible(evidence, stand);
    let (mut sum, mut square_px, mut count, mut lost) = (0.0, 0.0, 0.0, 0.0);
    for (train, held, columns) in turns {
        let believed = |mask: &[bool]| mask.iter().zip(&plausible).map(|(own, plausible)| *own && *plausible).collect::<Vec<bool>>();
        let (train, held) = (believed(train), believed(held));
        let more: Vec<&Whitened> = columns.iter().collect();
        let left = refit_own(system, &held, &predicted(system, &Fit::new(system, &train, &more), &more));
        let (psi, _) = psi_of(&left, &held, system.tail_degrees);
        sum += dot(&psi, &left);
        let px = stand.noise.unwhiten(&evidence.images, &evidence.place, &left);
        square_px += dot(&px, &px);
        count += held.iter().filter(|held| **held).count() as f64;
        let mut seen = vec![false; system.frames];
        for (frame, _) in system.frame.iter().zip(&held).filter(|(_, held)| **held) {
            seen[*frame] = true;
        }
        lost += (system.own.len() * seen.iter().filter(|seen| **seen).count()) as f64;
    }
    // Under the noise found, ψ·r has expectation one for each number and degree of freedom.
    (count > 0.0 && 2.0 * count > lost).then(|| (sum / (2.0 * count - lost), (square_px / count).sqrt()))
}
