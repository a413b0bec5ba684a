//! Twins over many pixels at once: registers as wide as the processor has, and normal numbers for four pixels from one random call.

use super::math::normal_pair;
use crate::rng::StageKey;

/// Compiles functions for AVX-512, for AVX2 and for every processor, and lets the first call choose.
///
/// What they call must be inlined into them. The bytes are the same on each: vectors of IEEE operations round like single ones, and the compiler
/// fuses no product with a sum.
macro_rules! vectorised {
    ($($item:item)*) => { $(
        #[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2", "x86_64+avx2"))]
        $item
    )* };
}
pub(crate) use vectorised;

/// Pixels that one random call serves: its four words make two pairs of normal numbers.
pub(crate) const QUAD_PX: usize = 4;

/// Pixels treated together: enough that no part of the work is too short for vectors, and few enough for the first cache.
pub(crate) const BLOCK_PX: usize = 256;

const QUADS: usize = BLOCK_PX / QUAD_PX;

/// Normal numbers of a block of pixels that begins with a quad.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
fn normals(key: StageKey, first_quad: u32, normals: &mut [f32; BLOCK_PX]) {
    // Each step is a loop of its own over plain arrays: that is what vectorises.
    let mut words = [[0_u32; QUADS]; 4];
    for i in 0..QUADS {
        let of_quad = key.words(first_quad.wrapping_add(i as u32), 0);
        for (list, word) in words.iter_mut().zip(of_quad) {
            list[i] = word;
        }
    }
    let mut columns = [[0.0_f32; QUADS]; 4];
    for pair in 0..2 {
        for i in 0..QUADS {
            let [first, second] = normal_pair(words[2 * pair][i], words[2 * pair + 1][i]);
            columns[2 * pair][i] = first;
            columns[2 * pair + 1][i] = second;
        }
    }
    for (i, quad) in normals.as_chunks_mut::<QUAD_PX>().0.iter_mut().enumerate() {
        *quad = [columns[0][i], columns[1][i], columns[2][i], columns[3][i]];
    }
}

/// Hands runs of pixels, with a standard normal number for each, to `change`. The first pixel has the index `first_pixel` in the frame; the
/// numbers depend on the key and the pixels' indices alone.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into what is compiled for several processors")]
pub(crate) fn with_normals(key: StageKey, first_pixel: u32, pixels: &mut [f32], mut change: impl FnMut(&mut [f32], &[f32])) {
    let mut of_block = [0.0_f32; BLOCK_PX];
    let (mut rest, mut pixel) = (pixels, first_pixel);
    while !rest.is_empty() {
        let before = pixel as usize % QUAD_PX;
        let count = rest.len().min(BLOCK_PX - before);
        normals(key, pixel / QUAD_PX as u32, &mut of_block);
        let (now, later) = rest.split_at_mut(count);
        change(now, &of_block[before..before + count]);
        (rest, pixel) = (later, pixel.wrapping_add(count as u32));
    }
}

vectorised! {
    /// Whole numbers from 0 to 65 535 as counts.
    pub(crate) fn to_counts(values: &[f32], counts: &mut [u16]) {
        for (count, value) in counts.iter_mut().zip(values) {
            // Rust's own conversion is checked and does not vectorise; 2²³ added leaves a whole number in the last bits.
            *count = (*value + 8_388_608.0).to_bits() as u16;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: StageKey = StageKey { seed: 3, frame: 4, stage: 5 };

    /// A pixel's number does not depend on where its run begins or ends.
    #[test]
    fn runs_do_not_matter() {
        let drawn = |first: u32, count: usize| {
            let mut pixels = vec![0.0; count];
            with_normals(KEY, first, &mut pixels, |run, normals| run.copy_from_slice(normals));
            pixels
        };
        let whole = drawn(0, 2000);
        for (first, count) in [(0, 1), (1, 1), (3, 7), (255, 600), (1022, 300), (1997, 3)] {
            assert_eq!(drawn(first as u32, count), whole[first..first + count], "{count} pixels from {first}");
        }
        let words = KEY.words(7, 0);
        let pairs = [normal_pair(words[0], words[1]), normal_pair(words[2], words[3])];
        assert_eq!(whole[28..32], *pairs.as_flattened());
    }

    #[test]
    fn counts_are_kept() {
        let values: Vec<f32> = (0..=u16::MAX).map(f32::from).collect();
        let mut counts = vec![0; values.len()];
        to_counts(&values, &mut counts);
        assert!((0..=u16::MAX).eq(counts));
    }
}
