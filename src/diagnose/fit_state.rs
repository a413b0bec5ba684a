//! A fit of the star images with some effects accepted: its noise, its score for further columns, and how alike effects are beside it.

use super::clusters::coherent;
use super::evidence::Evidence;
use super::linear_fit::Fit;
use super::linear_system::{Whitened, WhitenedSystem, dot};
use super::noise::{NoiseModel, freedom};
use crate::calibrate::Column;
use crate::statistics::student_t::cost;

/// Rivals whose evidence differs by less (odds of 100 : 1) are as good: 2·ln 100.
pub(super) const AS_GOOD: f64 = 9.21;
/// Below this survival nothing is claimed.
pub(super) const UNOBSERVABLE: f64 = 0.02;
/// A known size is believed if the size found agrees within so many standard errors; if it does not, it is not that effect alone.
pub(super) const AGREES: f64 = 3.0;
/// An effect that has entered: hypothesis and variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SelectedEffect {
    /// Index of the hypothesis.
    pub(super) hypothesis: usize,
    /// Index of its variant.
    pub(super) variant: usize,
}

/// Everything as it stands with some effects accepted.
#[derive(Clone, Debug)]
pub(super) struct FitState {
    /// The noise.
    pub(super) noise: NoiseModel,
    /// The linear problem, whitened by it.
    pub(super) system: WhitenedSystem,
    /// The images that take part.
    pub(super) take: Vec<bool>,
    /// The accepted effects' columns.
    pub(super) more: Vec<Whitened>,
    /// The fit.
    pub(super) fit: Fit,
}

impl FitState {
    /// With effects accepted, on the images allowed. The noise is found anew.
    pub(super) fn new(evidence: &Evidence, allowed: &[bool], accepted: &[SelectedEffect], begin: &NoiseModel) -> Self {
        const TURNS: usize = 3;
        let mut noise = begin.clone();
        let mut take = allowed.to_vec();
        let mut turn = 0;
        loop {
            let system = evidence.system(&noise);
            let more: Vec<Whitened> = columns(evidence, accepted).map(|column| evidence.white(&noise, column)).collect();
            let fit = Fit::new(&system, &take, &more.iter().collect::<Vec<_>>());
            turn += 1;
            if turn == TURNS {
                return Self { noise, system, take, more, fit };
            }
            let residual_px = noise.unwhiten(&evidence.images, &evidence.place, &full_residual(&system, &fit, &more, &take));
            let free = freedom(&system, &take, system.camera.len() + more.len());
            let together = coherent(evidence, &noise, &residual_px, allowed);
            let alone: Vec<bool> = take.iter().zip(&together).map(|(take, together)| *take && !together).collect();
            let found = NoiseModel::find(&evidence.images, &evidence.place, &residual_px, &alone, free, &evidence.frame_factors);
            let plausible = found.plausible(&evidence.images, &evidence.place, &residual_px);
            let believed = plausible.iter().zip(&together).map(|(plausible, together)| *plausible || *together);
            let next: Vec<bool> = allowed.iter().zip(believed).map(|(allowed, believed)| *allowed && believed).collect();
            let settled = next == take
                && (found.factor / noise.factor - 1.0).abs() < 0.01
                && found.tail_degrees.total_cmp(&noise.tail_degrees).is_eq();
            if settled {
                return Self { noise, system, take, more, fit };
            }
            (noise, take) = (found, next);
        }
    }

    /// The statistic of some columns: what they explain of ψ, over c; and the degrees of freedom.
    pub(super) fn score(&self, columns: &[Whitened]) -> (f64, usize) {
        let rest: Vec<Whitened> = columns.iter().map(|column| self.fit.project(column)).collect();
        let (basis, _) = basis(&rest, columns, &self.fit);
        let t = basis.iter().map(|b| dot(b, &self.fit.psi).powi(2)).sum::<f64>() / self.fit.c;
        (t, basis.len())
    }

    /// Effects' columns, whitened by this noise.
    pub(super) fn white(&self, evidence: &Evidence, effects: &[SelectedEffect]) -> Vec<Whitened> {
        columns(evidence, effects).map(|column| evidence.white(&self.noise, column)).collect()
    }

    /// The same images and noise with other columns in the place of the accepted effects'.
    pub(super) fn beside(&self, more: Vec<Whitened>) -> Self {
        // The noise is that of the whole model: a model without an effect that is there has no noise of its own to be judged by.
        let fit = Fit::new(&self.system, &self.take, &more.iter().collect::<Vec<_>>()).with_noise_of(&self.fit);
        Self { more, fit, ..self.clone() }
    }

    /// The same without entry `k` of the accepted effects, all others in it.
    pub(super) fn without(&self, evidence: &Evidence, entries: &[SelectedEffect], k: usize) -> Self {
        let others: Vec<SelectedEffect> = entries.iter().enumerate().filter(|(index, _)| *index != k).map(|(_, entry)| *entry).collect();
        self.beside(self.white(evidence, &others))
    }

    /// T of an accepted effect beside the others, and its degrees of freedom.
    pub(super) fn statistic(&self, evidence: &Evidence, entries: &[SelectedEffect], k: usize) -> (f64, usize) {
        self.without(evidence, entries, k).score(&self.white(evidence, &entries[k..=k]))
    }

    /// Whitened residuals of all images, those that take no part too.
    pub(super) fn everywhere(&self) -> Vec<f64> {
        full_residual(&self.system, &self.fit, &self.more, &self.take)
    }

    /// ln of the numbers that take part.
    pub(super) fn ln_n(&self) -> f64 {
        (2.0 * self.take.iter().filter(|take| **take).count() as f64).max(1.0).ln()
    }
}

/// Residuals of all images, those not taken too, each frame's attitude as fitted to those taken; x, y, … whitened.
fn full_residual(system: &WhitenedSystem, fit: &Fit, more: &[Whitened], take: &[bool]) -> Vec<f64> {
    // Shared parameters are known; a frame's own change follows from what they leave.
    let mut residual = system.residual.clone();
    for (column, change) in system.camera.iter().chain(more).zip(fit.change.iter()) {
        for (a, b) in residual.iter_mut().zip(column) {
            *a += change * b;
        }
    }
    let own = super::frame_nuisance::own_changes(system, take, &residual, &fit.residual);
    for (column, changes) in system.own.iter().zip(own) {
        for (k, value) in residual.iter_mut().enumerate() {
            *value += changes[system.frame[k / 2]] * column[k];
        }
    }
    for (k, value) in residual.iter_mut().enumerate() {
        if take[k / 2] {
            *value = fit.residual[k];
        }
    }
    residual
}

/// The accepted effects' columns.
pub(super) fn columns<'a>(evidence: &'a Evidence, accepted: &'a [SelectedEffect]) -> impl Iterator<Item = &'a Column> {
    accepted.iter().flat_map(|entry| evidence.hypotheses[entry.hypothesis].variants[entry.variant].columns.iter())
}

/// Orthonormal basis of projected columns, those dropped of which too little is left; and the lengths of what is left.
pub(super) fn basis(rest: &[Whitened], raw: &[Whitened], fit: &Fit) -> (Vec<Whitened>, Vec<f64>) {
    let mut found: Vec<Whitened> = Vec::new();
    let mut lengths = Vec::new();
    for (column, raw) in rest.iter().zip(raw) {
        let mut vector = column.clone();
        for _ in 0..2 {
            for b in &found {
                let along = dot(b, &vector);
                for (v, b) in vector.iter_mut().zip(b) {
                    *v -= along * b;
                }
            }
        }
        let length = dot(&vector, &vector).sqrt();
        lengths.push(dot(column, column).sqrt());
        if length > 1e-4 * fit.length_squared(raw).sqrt() && length > 0.0 {
            for v in &mut vector {
                *v /= length;
            }
            found.push(vector);
        }
    }
    (found, lengths)
}

/// Cosine of the largest principal angle's complement: how alike two sets of projected columns are (their best aligned directions).
pub(super) fn cosine(fit: &Fit, a: &[Whitened], b: &[Whitened]) -> f64 {
    let projected = |columns: &[Whitened]| columns.iter().map(|column| fit.project(column)).collect::<Vec<_>>();
    let (a, _) = basis(&projected(a), a, fit);
    let (b, _) = basis(&projected(b), b, fit);
    if a.is_empty() || b.is_empty() {
        return 0.0;
    }
    let matrix = nalgebra::DMatrix::from_fn(a.len(), b.len(), |i, j| dot(&a[i], &b[j]));
    matrix.singular_values().max().min(1.0)
}

/// Share of a hypothesis's displacement (rms) that attitudes and camera leave: of its best surviving parameter.
pub(super) fn survival(stand: &FitState, columns: &[Whitened]) -> f64 {
    let of = |column: &Whitened| {
        let raw = stand.fit.length_squared(column);
        let rest = stand.fit.project(column);
        if raw > 0.0 { (dot(&rest, &rest) / raw).sqrt() } else { 0.0 }
    };
    columns.iter().map(of).fold(0.0, f64::max)
}

/// Value and standard error of the only parameter of a set of columns, given a fit, as a change from the point of linearisation.
pub(super) fn amplitude(stand: &FitState, column: &Whitened) -> Option<[f64; 2]> {
    let rest = stand.fit.project(column);
    let square = dot(&rest, &rest);
    (square > 0.0).then(|| {
        let change = -dot(&rest, &stand.fit.psi) / (square * stand.fit.d);
        [change, (stand.fit.c / square).sqrt() / stand.fit.d]
    })
}

/// Fall of −2·ln of the likelihood from one fit to another of the same images, in units in which a superfluous parameter gains one.
pub(super) fn fall(stand: &FitState, from: &Fit, to: &Fit) -> f64 {
    let of = |fit: &Fit| cost(&fit.residual, &stand.take, stand.system.tail_degrees);
    (of(from) - of(to)) * stand.fit.d / stand.fit.c
}
