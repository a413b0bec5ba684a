//! State of a sequential solution: a Gaussian for the parameters, and sums for the noise model. Its size depends on the number of parameters alone.

use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::normal::Reduced;

/// Classes of stated variance; they are half an octave wide.
pub(in crate::calibrate) const CLASSES: usize = 36;
/// Binary logarithm of the smallest variance (px²) of the first class.
const FIRST: f64 = -14.0;

/// What earlier solutions know of the free parameters: a value and an information matrix, in the parameters' own units.
#[derive(Clone, Debug)]
pub(in crate::calibrate) struct Carried {
    /// Values, in the order of the free parameters.
    pub(in crate::calibrate) values: Vec<f64>,
    /// Inverse of their covariance.
    pub(in crate::calibrate) information: DMatrix<f64>,
}

impl Carried {
    fn off(&self, free: &[usize], values: &[f64]) -> DVector<f64> {
        DVector::from_fn(free.len(), |k, _| values[free[k]] - self.values[k])
    }

    /// (θ − θ₀)ᵀ·Λ·(θ − θ₀).
    pub(in crate::calibrate) fn cost(&self, free: &[usize], values: &[f64]) -> f64 {
        let off = self.off(free, values);
        off.dot(&(&self.information * &off))
    }

    /// Adds to the equations of the parameters, which are scaled.
    pub(super) fn add_to(&self, reduced: &mut Reduced, free: &[usize], values: &[f64], scale: &[f64]) {
        let pull = &self.information * self.off(free, values);
        for i in 0..free.len() {
            reduced.right[i] -= pull[i] / scale[i];
            for j in 0..free.len() {
                reduced.matrix[(i, j)] += self.information[(i, j)] / (scale[i] * scale[j]);
            }
        }
    }
}

/// Star images whose stated variances are about the same, as one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(in crate::calibrate) struct NoiseClass {
    /// Sum of the weights (probabilities that the identification is right).
    pub(in crate::calibrate) weight: f64,
    /// Weighted sum of the stated variances per axis, px².
    pub(in crate::calibrate) stated_px2: f64,
    /// Weighted sum of x² + y² of the residuals, px².
    pub(in crate::calibrate) square_px2: f64,
}

/// Sums over star images from which the noise is found without the images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(in crate::calibrate) struct NoiseMemory {
    /// Star images, the wrong ones included.
    pub(in crate::calibrate) images: f64,
    /// Degrees of freedom that the attitudes of the frames have taken.
    pub(in crate::calibrate) lost: f64,
    /// By stated variance; either none or [`CLASSES`].
    pub(in crate::calibrate) classes: Vec<NoiseClass>,
}

impl NoiseMemory {
    /// Adds a star image: its stated variance per axis, x² + y² of its residual, its weight.
    pub(in crate::calibrate) fn add(&mut self, stated_px2: f64, square_px2: f64, weight: f64) {
        self.classes.resize(CLASSES, NoiseClass::default());
        let place = (2.0 * (stated_px2.max(f64::MIN_POSITIVE).log2() - FIRST)).clamp(0.0, CLASSES as f64 - 1.0) as usize;
        let class = &mut self.classes[place];
        class.weight += weight;
        class.stated_px2 += weight * stated_px2;
        class.square_px2 += weight * square_px2;
        self.images += 1.0;
    }

    /// Σ w.
    pub(in crate::calibrate) fn weight(&self) -> f64 {
        self.classes.iter().map(|class| class.weight).sum()
    }

    /// (weight, mean stated variance, mean square) of the classes that hold something.
    fn filled(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        let mean = |class: &NoiseClass| (class.weight, class.stated_px2 / class.weight, class.square_px2 / class.weight);
        self.classes.iter().filter(|class| class.weight > 0.0).map(mean)
    }

    /// Largest mean square of a class, px².
    pub(super) fn largest_square_px2(&self) -> f64 {
        self.filled().map(|(_, _, square)| square).fold(0.0, f64::max)
    }

    /// Derivative of the logarithm of the likelihood by the floor; `freedom` is the share of the residuals' squares that the fit has left.
    pub(super) fn score(&self, floor_px2: f64, freedom: f64) -> f64 {
        let of = |(weight, stated, square): (f64, f64, f64)| {
            let variance = stated + floor_px2;
            weight * (square / (freedom * variance) - 2.0) / variance
        };
        self.filled().map(of).sum()
    }

    /// Σ w·r²/v with this floor.
    pub(in crate::calibrate) fn chi_squared(&self, floor_px2: f64) -> f64 {
        self.filled().map(|(weight, stated, square)| weight * square / (stated + floor_px2).max(f64::MIN_POSITIVE)).sum()
    }

    /// Σ w/v with this floor: how much the star images know in all.
    fn precision(&self, floor_px2: f64) -> f64 {
        self.filled().map(|(weight, stated, _)| weight / (stated + floor_px2).max(f64::MIN_POSITIVE)).sum()
    }

    /// What the star images know of the parameters with another floor than the one that they were weighted with, as a factor.
    pub(in crate::calibrate) fn information_factor(&self, from_px2: f64, to_px2: f64) -> f64 {
        let (before, after) = (self.precision(from_px2), self.precision(to_px2));
        if before > 0.0 && after > 0.0 { after / before } else { 1.0 }
    }

    /// Counts everything by this factor.
    pub(in crate::calibrate) fn scale(&mut self, factor: f64) {
        self.images *= factor;
        self.lost *= factor;
        for class in &mut self.classes {
            class.weight *= factor;
            class.stated_px2 *= factor;
            class.square_px2 *= factor;
        }
    }

    /// Adds what another knows; its squares are counted `squares` times, for what the solution has taken out of them elsewhere.
    pub(in crate::calibrate) fn merge(&mut self, other: &Self, squares: f64) {
        self.classes.resize(CLASSES, NoiseClass::default());
        self.images += other.images;
        self.lost += other.lost;
        for (class, one) in self.classes.iter_mut().zip(&other.classes) {
            class.weight += one.weight;
            class.stated_px2 += one.stated_px2;
            class.square_px2 += squares * one.square_px2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The equations lead back to the values carried, from anywhere and in any scale, by a step that costs what the cost says.
    #[test]
    fn what_is_carried_pulls_back() {
        let information = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 0.5]);
        let carried = Carried { values: vec![3.0, -2.0], information: information.clone() };
        let (free, values, scale) = ([0, 2], [3.5, 99.0, -4.0], [10.0, 0.1]);
        let mut reduced = Reduced::zero(2);
        carried.add_to(&mut reduced, &free, &values, &scale);
        let step = reduced.matrix.clone().cholesky().unwrap().solve(&reduced.right);
        assert!((values[0] + step[0] / scale[0] - 3.0).abs() < 1e-12 && (values[2] + step[1] / scale[1] + 2.0).abs() < 1e-12);
        let cost = 4.0 * 0.25 + 2.0 * 0.5 * -2.0 + 0.5 * 4.0;
        assert!((carried.cost(&free, &values) - cost).abs() < 1e-12);
        assert!((step.dot(&reduced.right) - cost).abs() < 1e-12);
    }

    /// Classes stand for their images: χ² and the score are those of the images summed one by one.
    #[test]
    fn classes_stand_for_their_images() {
        let images: Vec<(f64, f64, f64)> =
            (0..200).map(|k| (0.01 * 1.002_f64.powi(k), 0.02 + 0.001 * f64::from(k % 17), if k % 9 == 0 { 0.3 } else { 1.0 })).collect();
        let mut memory = NoiseMemory::default();
        for (stated, square, weight) in &images {
            memory.add(*stated, *square, *weight);
        }
        for floor in [0.0, 0.003, 0.02] {
            let chi: f64 = images.iter().map(|(stated, square, weight)| weight * square / (stated + floor)).sum();
            let score: f64 = images.iter().map(|(v, square, weight)| weight * (square / (0.9 * (v + floor)) - 2.0) / (v + floor)).sum();
            let size: f64 = images.iter().map(|(v, _, weight)| weight * 2.0 / (v + floor)).sum();
            assert!((memory.chi_squared(floor) / chi - 1.0).abs() < 0.01, "floor {floor}");
            assert!((memory.score(floor, 0.9) - score).abs() < 0.02 * size, "floor {floor}: {} {score}", memory.score(floor, 0.9));
        }
        assert!((memory.information_factor(0.0, 0.01) - 0.55).abs() < 0.05);
        let mut twice = memory.clone();
        twice.merge(&memory, 1.0);
        memory.scale(2.0);
        assert!((twice.chi_squared(0.01) / memory.chi_squared(0.01) - 1.0).abs() < 1e-12);
    }
}
