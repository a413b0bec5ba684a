//! Chance that is addressed and never consumed: a value is a function of the seed, the level (camera, frame, …), the index of that level and the hash
//! of what is drawn. A further draw changes no other value, and any frame can be drawn alone.
//!
//! Words are Threefry's ([`crate::rng`]): seed and hash are the key, index, level and number of the word the counter.
//!
//! **Even spread.** Value i of n takes the stratum π(i) of n equal parts of [0, 1) and a place by chance within it. π is a permutation without memory: a
//! Feistel network of eight rounds on the smallest 2²ᵏ ≥ n numbers, applied again while the result is not below n (cycle walking; at most four times in the
//! mean). In several dimensions each has a permutation of its own, which is a Latin hypercube.
//! Sources: McKay, Beckman & Conover, Technometrics 21, 239 (1979); Luby & Rackoff, SIAM J. Comput. 17, 373 (1988); Black & Rogaway, CT-RSA 2002, LNCS
//! 2271, 114.

use sha2::{Digest, Sha256};

use crate::rng::threefry4x32;

/// Words beyond the first of a value, by what they are for.
const PERMUTATION: u32 = 0x8000_0000;

/// The random numbers of one thing that is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AddressedChance {
    key: [u32; 4],
    level: u32,
}

/// Among which values a value is spread evenly: its number and theirs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stratum {
    /// Which of them.
    pub(super) index: u64,
    /// How many there are.
    pub(super) count: u64,
    /// Different for groups that are spread each by itself.
    pub(super) group: u32,
}

impl AddressedChance {
    /// Of what goes by `name` under a seed, on a level.
    #[must_use]
    pub fn new(seed: u64, level: u32, name: &str) -> Self {
        let hash = Sha256::digest(name.as_bytes());
        let word = |at: usize| u32::from_le_bytes([hash[at], hash[at + 1], hash[at + 2], hash[at + 3]]);
        Self { key: [seed as u32, (seed >> 32) as u32, word(0), word(4)], level }
    }

    /// Four words for an index.
    #[must_use]
    pub fn words(&self, index: u64, number: u32) -> [u32; 4] {
        threefry4x32([index as u32, (index >> 32) as u32, self.level, number], self.key)
    }

    /// A number from 0 to below 1 for an index; each `number` is another.
    #[must_use]
    pub fn uniform(&self, index: u64, number: u32) -> f64 {
        let [low, high, ..] = self.words(index, number);
        unit(low, high)
    }

    /// The same, spread evenly: of all values of the stratum's group there is one in each of `count` equal parts.
    pub(super) fn even(&self, index: u64, number: u32, stratum: Stratum) -> f64 {
        if stratum.count < 2 {
            return self.uniform(index, number);
        }
        let part = self.permuted(stratum, number);
        ((part as f64 + self.uniform(index, number)) / stratum.count as f64).min(1.0 - f64::EPSILON / 2.0)
    }

    /// The place of an element in a permutation of its group.
    pub(super) fn permuted(&self, Stratum { index, count, group }: Stratum, number: u32) -> u64 {
        const ROUNDS: u32 = 8;
        if count < 2 {
            return 0;
        }
        let half = (u64::BITS - (count - 1).leading_zeros()).div_ceil(2);
        let mask = (1_u64 << half) - 1;
        let mut at = index % count;
        loop {
            let (mut left, mut right) = (at >> half, at & mask);
            for round in 0..ROUNDS {
                let counter = [right as u32, group, self.level ^ round << 8, number | PERMUTATION];
                let [low, high, ..] = threefry4x32(counter, self.key);
                (left, right) = (right, left ^ ((u64::from(high) << 32 | u64::from(low)) & mask));
            }
            at = left << half | right;
            if at < count {
                return at;
            }
        }
    }
}

/// A number from 0 to below 1 of 53 bits.
fn unit(low: u32, high: u32) -> f64 {
    const SCALE: f64 = 1.0 / (1_u64 << 53) as f64;
    ((u64::from(high) << 32 | u64::from(low)) >> 11) as f64 * SCALE
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHANCE: fn(&str) -> AddressedChance = |name| AddressedChance::new(20_261_122, 3, name);

    #[test]
    fn numbers_are_even_and_go_by_their_address() {
        let chance = CHANCE("camera.focal_length_px");
        let count = 40_000;
        let values: Vec<f64> = (0..count).map(|index| chance.uniform(index, 0)).collect();
        let mean = values.iter().sum::<f64>() / count as f64;
        // Standard error of the mean: 1/√(12 n) = 0.00144.
        assert!((mean - 0.5).abs() < 5.0 * 0.00144, "mean {mean}");
        let mut tenths = [0; 10];
        for value in &values {
            tenths[(10.0 * value) as usize] += 1;
        }
        assert!(tenths.iter().all(|number: &i32| (number - 4000).abs() < 5 * 60), "{tenths:?}");
        let lagged: f64 = values.windows(2).map(|pair| (pair[0] - 0.5) * (pair[1] - 0.5)).sum::<f64>() * 12.0 / count as f64;
        assert!(lagged.abs() < 5.0 / f64::from(40_000_u32).sqrt(), "neighbours hang together: {lagged}");
        // In any order, and nothing else changes them.
        let backwards: Vec<f64> = (0..count).rev().map(|index| chance.uniform(index, 0)).collect();
        assert!(values.iter().rev().eq(&backwards));
        let others = [
            CHANCE("camera.focal_length_py").uniform(5, 0),
            AddressedChance::new(20_261_122, 2, "camera.focal_length_px").uniform(5, 0),
            AddressedChance::new(20_261_123, 3, "camera.focal_length_px").uniform(5, 0),
            chance.uniform(5, 1),
        ];
        assert!(others.iter().all(|other| *other != chance.uniform(5, 0)), "{others:?}");
    }

    #[test]
    fn even_numbers_have_one_in_each_part() {
        let chance = CHANCE("frames.roll_deg");
        for count in [2, 3, 7, 64, 100, 1000, 4097] {
            let part = |index| (chance.even(index + 77, 0, Stratum { index, count, group: 1 }) * count as f64) as u64;
            let mut parts: Vec<u64> = (0..count).map(part).collect();
            let is_sorted = parts.is_sorted();
            parts.sort_unstable();
            assert!(parts.iter().copied().eq(0..count), "{count}: {parts:?}");
            assert!(count < 8 || !is_sorted, "{count}: in order");
        }
        // The test can fail: independent numbers leave parts empty.
        let mut parts: Vec<u64> = (0..100).map(|index| (chance.uniform(index, 0) * 100.0) as u64).collect();
        parts.sort_unstable();
        parts.dedup();
        assert!(parts.len() < 80);
    }

    #[test]
    fn groups_and_dimensions_have_permutations_of_their_own() {
        let chance = CHANCE("frames.rate_deg_s");
        let order = |group, number| (0..50).map(|index| chance.permuted(Stratum { index, count: 50, group }, number)).collect::<Vec<_>>();
        assert_ne!(order(0, 0), order(1, 0));
        assert_ne!(order(0, 0), order(0, 1));
        // Correlation of the places with the indices and of two dimensions: below 5 standard errors of 1/√n.
        let count = 2000;
        let place = |index, number| chance.permuted(Stratum { index, count, group: 0 }, number) as f64 / count as f64 - 0.5;
        let with_index: f64 =
            (0..count).map(|index| place(index, 0) * (index as f64 / count as f64 - 0.5)).sum::<f64>() * 12.0 / count as f64;
        let with_other: f64 = (0..count).map(|index| place(index, 0) * place(index, 1)).sum::<f64>() * 12.0 / count as f64;
        assert!(with_index.abs() < 0.11 && with_other.abs() < 0.11, "{with_index} {with_other}");
    }
}
