//! The generator's random numbers: every recording a pure function of (seed, family, index).

use rand::{Rng, RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal, StudentT};
use rand_pcg::Pcg64Mcg;

use crate::rng::philox4x32;

/// The generator of one part of one recording. Parts do not share numbers, so that a new draw in one leaves the others as they are.
pub(super) fn stream(seed: u64, family: u32, index: u32, part: u32) -> Pcg64Mcg {
    let words = philox4x32([index, family, part, 0], [seed as u32, (seed >> 32) as u32]);
    let mut bytes = [0; 16];
    for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    Pcg64Mcg::from_seed(bytes)
}

/// Uniform between two bounds.
pub(super) fn between(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// True with this probability.
pub(super) fn chance(rng: &mut impl Rng, probability: f64) -> bool {
    rng.random::<f64>() < probability
}

/// One of `count` numbers from 0.
pub(super) fn pick(rng: &mut impl Rng, count: usize) -> usize {
    rng.random_range(0..count)
}

/// Standard normal.
pub(super) fn normal(rng: &mut impl Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Student's t with three degrees of freedom, in units of its own standard deviation √3.
pub(super) fn heavy(rng: &mut impl Rng) -> f64 {
    StudentT::new(3.0).map_or(0.0, |t| t.sample(rng)) / 3.0_f64.sqrt()
}

/// A unit vector, evenly over the sphere.
pub(super) fn direction(rng: &mut impl Rng) -> [f64; 3] {
    let z = between(rng, -1.0, 1.0);
    let (sin, cos) = between(rng, 0.0, std::f64::consts::TAU).sin_cos();
    let r = (1.0 - z * z).sqrt();
    [r * cos, r * sin, z]
}

/// Cosine and sine of an angle drawn evenly.
pub(super) fn on_circle(rng: &mut impl Rng) -> [f64; 2] {
    let (sin, cos) = between(rng, 0.0, std::f64::consts::TAU).sin_cos();
    [cos, sin]
}
