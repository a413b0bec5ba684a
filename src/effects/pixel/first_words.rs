//! The smallest and the largest of the first words that stay, for each block of pixels of the last cameras.
//!
//! Few pixels have a defect, and which have one is the same in every frame of a camera. Where neither of the two is beyond a limit, no pixel of the
//! block has a defect, whatever the share of pixels with defects is in a frame; then the words need not be drawn again.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::effects::pixel::lanes::BLOCK_PX;
use crate::rng::StageKey;

/// Pixels behind these blocks (16 Mpx) are looked at in every frame.
const BLOCKS: usize = 1 << 16;
/// Cameras of which the blocks are kept: 2 MB.
const CAMERAS: usize = 4;
/// No block has it: a smallest word above the largest.
const UNKNOWN: u64 = u32::MAX as u64;

static KEPT: Mutex<Vec<(u64, u32, FirstWords)>> = Mutex::new(Vec::new());

/// Those of a camera and a stage.
#[derive(Clone, Debug)]
pub(crate) struct FirstWords(Arc<[AtomicU64]>);

impl FirstWords {
    /// Those of the seed and the stage of a key: its frame does not count.
    #[must_use]
    pub(crate) fn of(key: StageKey) -> Self {
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, _, found)) = kept.iter().find(|(seed, stage, _)| (*seed, *stage) == (key.seed, key.stage)) {
            return found.clone();
        }
        let new = Self((0..BLOCKS).map(|_| AtomicU64::new(UNKNOWN)).collect());
        if kept.len() == CAMERAS {
            kept.remove(0);
        }
        kept.push((key.seed, key.stage, new.clone()));
        new
    }

    /// The smallest and the largest word of the pixels from `first_pixel` on, if they are a whole block of which both are known.
    #[must_use]
    pub(crate) fn extremes(&self, first_pixel: u32, count: usize) -> Option<[u32; 2]> {
        let known = self.block(first_pixel, count)?.load(Ordering::Relaxed);
        (known != UNKNOWN).then_some([known as u32, (known >> 32) as u32])
    }

    /// Keeps both for the next frame, if the words are those of a whole block.
    pub(crate) fn keep(&self, first_pixel: u32, words: &[u32]) {
        if let (Some(block), Some(smallest), Some(largest)) = (self.block(first_pixel, words.len()), words.iter().min(), words.iter().max())
        {
            block.store(u64::from(*largest) << 32 | u64::from(*smallest), Ordering::Relaxed);
        }
    }

    fn block(&self, first_pixel: u32, count: usize) -> Option<&AtomicU64> {
        let place = first_pixel as usize;
        if count == BLOCK_PX && place.is_multiple_of(BLOCK_PX) { self.0.get(place / BLOCK_PX) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: StageKey = StageKey { seed: 0x0f12_57a0_0d5e_ed01, frame: 3, stage: 7 };

    #[test]
    fn a_whole_block_is_known_in_the_next_frame_of_its_camera_alone() {
        let words: Vec<u32> = (10..10 + BLOCK_PX as u32).collect();
        let first = BLOCK_PX as u32 * 5;
        FirstWords::of(KEY).keep(first, &words);
        assert_eq!(FirstWords::of(StageKey { frame: 4, ..KEY }).extremes(first, BLOCK_PX), Some([10, 9 + BLOCK_PX as u32]));
        assert_eq!(FirstWords::of(StageKey { stage: 8, ..KEY }).extremes(first, BLOCK_PX), None);
        assert_eq!(FirstWords::of(StageKey { seed: 1, ..KEY }).extremes(first, BLOCK_PX), None);
        assert_eq!(FirstWords::of(KEY).extremes(first + BLOCK_PX as u32, BLOCK_PX), None);
    }

    #[test]
    fn parts_of_a_block_are_never_kept() {
        let own = FirstWords::of(StageKey { stage: 9, ..KEY });
        own.keep(0, &[1, 2, 3]);
        own.keep(1, &vec![4; BLOCK_PX]);
        own.keep(u32::MAX - BLOCK_PX as u32 + 1, &vec![4; BLOCK_PX]);
        assert_eq!([own.extremes(0, 3), own.extremes(0, BLOCK_PX), own.extremes(1, BLOCK_PX)], [None; 3]);
    }
}
