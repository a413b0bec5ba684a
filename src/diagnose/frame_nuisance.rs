//! Nuisance parameters of a frame (its attitude): columns that act on one frame only, projected out frame by frame.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::linear_system::{DEPENDENT, Whitened, WhitenedSystem, dot, masked, subtract};

/// The frames' nuisance columns over the images taken, orthonormal within each frame.
#[derive(Clone, Debug)]
pub(super) struct FrameNuisance {
    basis: Vec<Whitened>,
    /// Frames, and the numbers of each stretch of images that lie in one frame.
    runs: Vec<(usize, Range<usize>)>,
    frames: usize,
}

impl FrameNuisance {
    /// Of the images taken.
    pub(super) fn new(system: &WhitenedSystem, take: &[bool]) -> Self {
        let mut own = Self { basis: Vec::new(), runs: runs(&system.frame), frames: system.frames };
        for column in &system.own {
            let mut vector = masked(column, take);
            let before = own.by_frame(&vector, &vector);
            own.take_out(&mut vector);
            own.take_out(&mut vector);
            let length = own.by_frame(&vector, &vector);
            for (frame, run) in &own.runs {
                let (before, length) = (before[*frame], length[*frame]);
                let factor = if length > DEPENDENT * DEPENDENT * before && length > 0.0 { 1.0 / length.sqrt() } else { 0.0 };
                for value in &mut vector[run.clone()] {
                    *value *= factor;
                }
            }
            own.basis.push(vector);
        }
        own
    }

    /// Own columns of a frame.
    pub(super) fn count(&self) -> usize {
        self.basis.len()
    }

    /// Frames.
    pub(super) fn frames(&self) -> usize {
        self.frames
    }

    /// Sums over each frame of the products of two columns.
    pub(super) fn by_frame(&self, a: &[f64], b: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.frames];
        for (frame, run) in &self.runs {
            sums[*frame] += dot(&a[run.clone()], &b[run.clone()]);
        }
        sums
    }

    /// Takes them out of a column that is zero where images are not taken.
    pub(super) fn take_out(&self, column: &mut [f64]) {
        let count = self.basis.len();
        let mut along = vec![0.0; count * self.frames];
        for (frame, run) in &self.runs {
            for (along, basis) in along[count * frame..].iter_mut().zip(&self.basis) {
                *along += dot(&basis[run.clone()], &column[run.clone()]);
            }
        }
        for (frame, run) in &self.runs {
            for (along, basis) in along[count * frame..].iter().zip(&self.basis) {
                subtract(&mut column[run.clone()], *along, &basis[run.clone()]);
            }
        }
    }
}

fn runs(frame: &[usize]) -> Vec<(usize, Range<usize>)> {
    let mut start = 0;
    frame
        .chunk_by(|a, b| a == b)
        .map(|stretch| {
            let first = start;
            start += 2 * stretch.len();
            (stretch[0], first..start)
        })
        .collect()
}

/// M_own·a on the images taken.
pub(super) fn project_own(system: &WhitenedSystem, take: &[bool], column: &[f64]) -> Whitened {
    let mut rest = masked(column, take);
    FrameNuisance::new(system, take).take_out(&mut rest);
    rest
}

/// The change of each nuisance parameter, by parameter and frame, that leads from residuals with the shared parameters moved to those of the
/// fit: by least squares on the images taken, where it is exact.
pub(super) fn own_changes(system: &WhitenedSystem, take: &[bool], shared_moved: &[f64], fitted: &[f64]) -> Vec<Vec<f64>> {
    let own = system.own.len();
    let mut changes = vec![vec![0.0; system.frames]; own];
    if own == 0 {
        return changes;
    }
    let mut matrices = vec![DMatrix::<f64>::zeros(own, own); system.frames];
    let mut rights = vec![DVector::<f64>::zeros(own); system.frames];
    for k in (0..2 * system.images()).filter(|k| take[k / 2]) {
        let frame = system.frame[k / 2];
        let wanted = fitted[k] - shared_moved[k];
        for i in 0..own {
            rights[frame][i] += system.own[i][k] * wanted;
            for j in 0..own {
                matrices[frame][(i, j)] += system.own[i][k] * system.own[j][k];
            }
        }
    }
    for (frame, (matrix, right)) in matrices.into_iter().zip(rights).enumerate() {
        if let Some(solution) = matrix.pseudo_inverse(0.0).ok().map(|inverse| inverse * right) {
            for i in 0..own {
                changes[i][frame] = if solution[i].is_finite() { solution[i] } else { 0.0 };
            }
        }
    }
    changes
}
