//! The pixels of the last cameras whose first word that stays is extreme: those that may have a defect.
//!
//! Few pixels have a defect, and which have one is the same in every frame of a camera. Up to shares of [`EXTREME_SHARE`] they are among the pixels
//! kept here, whatever the share is in a frame, and the words of the others need not be drawn again.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::effects::pixel::lanes::{BLOCK_PX, vectorised};
use crate::effects::pixel::pattern::fixed_words;
use crate::rng::StageKey;

/// Pixels behind these blocks (16 Mpx) are looked at in every frame.
const BLOCKS: usize = 1 << 16;
/// Cameras of which the blocks are kept: 2 MB each, and 3 MB of a frame of 16 Mpx.
const CAMERAS: usize = 4;
/// The share of the pixels that are kept for small words, and once more for large ones.
#[cfg(test)]
const EXTREME_SHARE: f64 = 1.0 / 256.0;
/// Words below the one or above the other are extreme.
const SMALL: u32 = 1 << 24;
const LARGE: u32 = u32::MAX - SMALL;

static KEPT: Mutex<Vec<(u64, u32, FirstWords)>> = Mutex::new(Vec::new());

/// The extreme pixels of a block, in order, by their numbers in it: they fit, as a block has no more than 256.
type Extreme = Box<[u8]>;

/// The extreme pixels of a camera and a stage.
#[derive(Clone, Debug)]
struct FirstWords(Arc<[OnceLock<Extreme>]>);

vectorised! {
    /// The first of the words that stay, of each of a run of pixels: it alone says whether a pixel has a defect. Says whether any of them is below the
    /// one limit or above the other.
    fn first_words(key: StageKey, first_pixel: u32, [below, above]: [u32; 2], words: &mut [u32]) -> bool {
        for (i, word) in (0..).zip(&mut *words) {
            *word = fixed_words(key, first_pixel.wrapping_add(i), 0)[0];
        }
        words.iter().fold(0, |any, word| any | u32::from(*word < below) | u32::from(*word > above)) != 0
    }
}

impl FirstWords {
    /// Those of the seed and the stage of a key: its frame does not count.
    fn of(key: StageKey) -> Self {
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, _, found)) = kept.iter().find(|(seed, stage, _)| (*seed, *stage) == (key.seed, key.stage)) {
            return found.clone();
        }
        let new = Self((0..BLOCKS).map(|_| OnceLock::new()).collect());
        if kept.len() == CAMERAS {
            kept.remove(0);
        }
        kept.push((key.seed, key.stage, new.clone()));
        new
    }

    /// The extreme pixels of a block, by its number.
    fn extreme(&self, key: StageKey, block: usize) -> Option<&[u8]> {
        Some(self.0.get(block)?.get_or_init(|| {
            let mut words = [0; BLOCK_PX];
            let _ = first_words(key, (block * BLOCK_PX) as u32, [SMALL, LARGE], &mut words);
            (0..=u8::MAX).zip(words).filter(|(_, word)| *word < SMALL || *word > LARGE).map(|(i, _)| i).collect()
        }))
    }
}

/// Hands every pixel whose first word that stays is below the one limit or above the other to `change`, with its index in the frame and its words.
pub(crate) fn where_first_word_is(
    [below, above]: [u32; 2],
    key: StageKey,
    first_pixel: u32,
    pixels: &mut [f32],
    mut change: impl FnMut(u32, [u32; 4], &mut f32),
) {
    let kept = (below <= SMALL && above >= LARGE).then(|| FirstWords::of(key));
    let mut drawn = [0; BLOCK_PX];
    let mut ask = |index: u32, pixel: &mut f32| {
        let words = fixed_words(key, index, 0);
        if words[0] < below || words[0] > above {
            change(index, words, pixel);
        }
    };
    let (mut rest, mut first) = (pixels, first_pixel);
    while !rest.is_empty() {
        // What the run has of a block.
        let (block, before) = (first as usize / BLOCK_PX, first as usize % BLOCK_PX);
        let (part, later) = rest.split_at_mut(rest.len().min(BLOCK_PX - before));
        if let Some(extreme) = kept.as_ref().and_then(|kept| kept.extreme(key, block)) {
            let end = before + part.len();
            for i in extreme.iter().map(|i| usize::from(*i)).filter(|i| (before..end).contains(i)) {
                ask(first + (i - before) as u32, &mut part[i - before]);
            }
        } else {
            let drawn = &mut drawn[..part.len()];
            if first_words(key, first, [below, above], drawn) {
                for ((i, pixel), _) in (0..).zip(&mut *part).zip(drawn).filter(|(_, word)| **word < below || **word > above) {
                    ask(first + i, pixel);
                }
            }
        }
        first = first.wrapping_add(part.len() as u32);
        rest = later;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Which pixels are handed over, of a run.
    fn handed(limits: [u32; 2], key: StageKey, first_pixel: u32, count: usize) -> Vec<u32> {
        let mut found = Vec::new();
        let mut pixels = vec![0.0; count];
        where_first_word_is(limits, key, first_pixel, &mut pixels, |index, words, pixel| {
            assert_eq!(words, fixed_words(key, index, 0));
            *pixel = 1.0;
            found.push(index);
        });
        let marked = (0..).zip(&pixels).filter(|(_, pixel)| **pixel == 1.0).map(|(i, _)| first_pixel.wrapping_add(i)).collect::<Vec<_>>();
        assert_eq!(marked, found);
        found
    }

    /// Pixel by pixel, from whole blocks and from parts of them, below the shares that are kept and above, in the first frame and behind others.
    #[test]
    fn the_pixels_are_those_of_their_words() {
        let share = |share: f64| (share * f64::from(u32::MAX)) as u32;
        for seed in [0x0f12_57a0_0d5e_ed01, 2, 3, 4, 5, 6] {
            for (frame, (small, large)) in (0..).zip([(1e-3, 1e-4), (EXTREME_SHARE, EXTREME_SHARE), (0.02, 0.0), (0.0, 1e-3), (1e-3, 1e-4)])
            {
                let (key, limits) = (StageKey { seed, frame, stage: 7 }, [share(small), u32::MAX - share(large)]);
                for (first, count) in [(0, 40_000), (BLOCK_PX as u32 * 3, BLOCK_PX), (777, 5000), (u32::MAX - 700, 2000)] {
                    let is_one = |index: &u32| {
                        let word = fixed_words(key, *index, 0)[0];
                        word < limits[0] || word > limits[1]
                    };
                    let expected: Vec<u32> = (0..count as u32).map(|i| first.wrapping_add(i)).filter(is_one).collect();
                    assert_eq!(handed(limits, key, first, count), expected, "{small} {large} from {first}");
                }
            }
        }
    }

    #[test]
    fn cameras_and_stages_are_kept_apart_and_old_ones_given_up() {
        let key = StageKey { seed: 77, frame: 1, stage: 9 };
        let of = |key: StageKey| FirstWords::of(key).extreme(key, 0).map(<[u8]>::to_vec);
        let first = of(key);
        assert_eq!(of(StageKey { frame: 2, ..key }), first);
        let all: Vec<_> = (0..64).map(|block| FirstWords::of(key).extreme(key, block).unwrap().len()).collect();
        let (mean, expected) = (all.iter().sum::<usize>() as f64 / 64.0, 2.0 * EXTREME_SHARE * BLOCK_PX as f64);
        assert!((mean - expected).abs() < 4.5 * (expected / 64.0).sqrt(), "{mean} of {expected}");
        assert_eq!(FirstWords::of(key).extreme(key, BLOCKS), None);
        for seed in 100..100 + 2 * CAMERAS as u64 {
            let _ = of(StageKey { seed, ..key });
        }
        assert!(KEPT.lock().unwrap().len() <= CAMERAS);
        assert_eq!(of(key), first);
    }
}
