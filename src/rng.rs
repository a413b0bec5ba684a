//! Counter-based random numbers, the same integers on CPU and GPU.
//!
//! Every draw is a pure function of (seed, frame, stage, pixel, draw): any pixel of any frame can be made alone, in any order, on any
//! number of threads, and the bytes are the same. The function is Threefry4x32 with 20 rounds (Salmon, Moraes, Dror, Shaw: "Parallel
//! random numbers: as easy as 1, 2, 3", SC'11), a keyed bijection of 128-bit counters that passes TestU01's BigCrush from 12 rounds on.
//! Seed, frame and stage are the key, pixel and draw the counter: pixels and draws of one key are different points of one permutation, and
//! no two share state. It needs additions, rotations and exclusive or, and no product of 64 bits, which WGSL does not have. Its
//! published known answers are tested here; `shaders/lib/rng.wgsl` is the same in WGSL.
//!
//! Philox4x32 with 10 rounds, of the same paper, serves where whole recordings are drawn up and not pixels.

const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];
const ROUNDS: u32 = 10;

/// Four random words for a counter and a key: Philox4x32, 10 rounds.
#[must_use]
pub fn philox4x32(counter: [u32; 4], key: [u32; 2]) -> [u32; 4] {
    let [mut a, mut b, mut c, mut d] = counter;
    let [mut k0, mut k1] = key;
    for _ in 0..ROUNDS {
        let p0 = u64::from(a) * u64::from(MULTIPLIERS[0]);
        let p1 = u64::from(c) * u64::from(MULTIPLIERS[1]);
        (a, b, c, d) = ((p1 >> 32) as u32 ^ b ^ k0, p1 as u32, (p0 >> 32) as u32 ^ d ^ k1, p0 as u32);
        k0 = k0.wrapping_add(WEYL[0]);
        k1 = k1.wrapping_add(WEYL[1]);
    }
    [a, b, c, d]
}

/// The constant of the fifth word of Threefry's key, that no key is all zeros (Skein, version 1.3).
const PARITY: u32 = 0x1BD1_1BDA;
/// Rotations of the rounds 0–3, 8–11, …, and of those between.
const ROTATIONS: [[[u32; 2]; 4]; 2] = [[[10, 26], [11, 21], [13, 27], [23, 5]], [[6, 20], [17, 11], [25, 10], [18, 20]]];

/// Four rounds and the addition of a part of the key. Written out: loops over pixels are vectorised only if there is none inside.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
fn four_rounds(words: [u32; 4], rotations: &[[u32; 2]; 4], key: [u32; 4]) -> [u32; 4] {
    let mix = |a: u32, b: u32, rotation: u32| {
        let sum = a.wrapping_add(b);
        (sum, b.rotate_left(rotation) ^ sum)
    };
    let [a, b, c, d] = words;
    let ((a, b), (c, d)) = (mix(a, b, rotations[0][0]), mix(c, d, rotations[0][1]));
    let ((a, d), (c, b)) = (mix(a, d, rotations[1][0]), mix(c, b, rotations[1][1]));
    let ((a, b), (c, d)) = (mix(a, b, rotations[2][0]), mix(c, d, rotations[2][1]));
    let ((a, d), (c, b)) = (mix(a, d, rotations[3][0]), mix(c, b, rotations[3][1]));
    [a.wrapping_add(key[0]), b.wrapping_add(key[1]), c.wrapping_add(key[2]), d.wrapping_add(key[3])]
}

/// Four random words for a counter and a key: Threefry4x32, 20 rounds.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
#[must_use]
pub fn threefry4x32(counter: [u32; 4], key: [u32; 4]) -> [u32; 4] {
    let [k0, k1, k2, k3] = key;
    let k4 = PARITY ^ k0 ^ k1 ^ k2 ^ k3;
    let [even, odd] = &ROTATIONS;
    let x = [counter[0].wrapping_add(k0), counter[1].wrapping_add(k1), counter[2].wrapping_add(k2), counter[3].wrapping_add(k3)];
    let x = four_rounds(x, even, [k1, k2, k3, k4.wrapping_add(1)]);
    let x = four_rounds(x, odd, [k2, k3, k4, k0.wrapping_add(2)]);
    let x = four_rounds(x, even, [k3, k4, k0, k1.wrapping_add(3)]);
    let x = four_rounds(x, odd, [k4, k0, k1, k2.wrapping_add(4)]);
    four_rounds(x, even, [k0, k1, k2, k3.wrapping_add(5)])
}

/// What the random numbers of one stage in one frame hang on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageKey {
    /// The scene's seed.
    pub seed: u64,
    /// The frame's index in its series.
    pub frame: u32,
    /// The stage (each effect that draws has its own number).
    pub stage: u32,
}

impl StageKey {
    /// Four words for a pixel (its index in the frame, row by row) and the `draw`-th call there.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "inlined into the loops over pixels, which are vectorised only then")]
    #[must_use]
    pub fn words(&self, pixel: u32, draw: u32) -> [u32; 4] {
        threefry4x32([pixel, draw, 0, 0], [self.seed as u32, (self.seed >> 32) as u32, self.frame, self.stage])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers of the Random123 distribution (file `kat_vectors`, lines `philox4x32 10`).
    #[test]
    fn known_answers_of_philox() {
        assert_eq!(philox4x32([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox4x32([u32::MAX; 4], [u32::MAX; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
        assert_eq!(
            philox4x32([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    /// Known answers of the same file, lines `threefry4x32 20`.
    #[test]
    fn known_answers_of_threefry() {
        assert_eq!(threefry4x32([0; 4], [0; 4]), [0x9c6c_a96a, 0xe17e_ae66, 0xfc10_ecd4, 0x5256_a7d8]);
        assert_eq!(threefry4x32([u32::MAX; 4], [u32::MAX; 4]), [0x2a88_1696, 0x5701_2287, 0xf6c7_446e, 0xa16a_6732]);
        let pi = [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344, 0xa409_3822, 0x299f_31d0, 0x082e_fa98, 0xec4e_6c89];
        let (counter, key) = ([pi[0], pi[1], pi[2], pi[3]], [pi[4], pi[5], pi[6], pi[7]]);
        assert_eq!(threefry4x32(counter, key), [0x59cd_1dbb, 0xb887_9579, 0x86b5_d00c, 0xac8b_6d84]);
    }

    /// Words of neighbours in each of the five keys differ in half of their bits: no key is ignored, and none acts weakly.
    #[test]
    fn each_key_changes_half_of_the_bits() {
        type Neighbour = fn(StageKey, u32, u32) -> [u32; 4];
        let neighbours: [Neighbour; 6] = [
            |k, p, d| StageKey { seed: k.seed ^ 1, ..k }.words(p, d),
            |k, p, d| StageKey { seed: k.seed ^ (1 << 40), ..k }.words(p, d),
            |k, p, d| StageKey { frame: k.frame + 1, ..k }.words(p, d),
            |k, p, d| StageKey { stage: k.stage + 1, ..k }.words(p, d),
            |k, p, d| k.words(p + 1, d),
            |k, p, d| k.words(p, d + 1),
        ];
        for (which, neighbour) in neighbours.iter().enumerate() {
            let mut differing = 0_u32;
            for pixel in 0..4000_u32 {
                let key = StageKey { seed: 7, frame: pixel % 13, stage: 2 };
                let (a, b) = (key.words(pixel, 0), neighbour(key, pixel, 0));
                differing += a.iter().zip(b).map(|(x, y)| (x ^ y).count_ones()).sum::<u32>();
            }
            // 4000 · 128 fair bits: 256 000 ± 358.
            assert!((f64::from(differing) - 256_000.0).abs() < 5.0 * 358.0, "key {which}: {differing} of 512 000 bits differ");
        }
    }
}
