//! Pixels with a defect, found once for a camera.
//!
//! A pixel has a defect where the first of its random words that stay (see `pattern.rs`) is small or large enough. Which pixels these are is the same in
//! every frame of a camera, and they are few. All that have one at shares of up to 1/256 small and 1/256 large are kept: the words of the others are not
//! drawn again, neither for a frame nor for the few pixels of one star.

use std::cell::RefCell;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use crate::effects::pixel::lanes::{BLOCK_PX, vectorised};
use crate::effects::pixel::pattern::fixed_words;
use crate::rng::StageKey;

/// Words below the one or above the other: 1/256 of all each.
const SMALL: u32 = 1 << 24;
const LARGE: u32 = u32::MAX - SMALL;
/// Pixels that are looked at together. It divides 2³², so that no index wraps within.
const CHUNK_PX: usize = 1 << 14;
/// Pixels behind these chunks (16 Mpx) are looked at in every frame.
const CHUNKS: usize = 1 << 10;
/// Cameras, of one effect each, of which the pixels are kept: 0.3 MB each for a frame of 16 Mpx.
const MAX_CAMERAS: usize = 64;
/// The same for what a thread asks next: more than there are such effects.
const MAX_OF_A_THREAD: usize = 4;

/// The candidates of a chunk, in order, by their numbers in it.
type Chunk = Box<[u16]>;

/// The pixels of a camera that may have a defect of one effect.
#[derive(Clone, Debug)]
struct Candidates {
    seed: u64,
    stage: u32,
    chunks: Arc<[OnceLock<Chunk>]>,
}

static KEPT: Mutex<Vec<Candidates>> = Mutex::new(Vec::new());

thread_local! {
    /// Every row of every star asks: it shall wait for no other thread, nor lose what many other cameras push out.
    static OF_THREAD: RefCell<Vec<Candidates>> = const { RefCell::new(Vec::new()) };
}

vectorised! {
    /// The first of the words that stay, of each of a run of pixels. Says whether any of them is below the one limit or above the other.
    fn first_words(key: StageKey, first_pixel: u32, [below, above]: [u32; 2], words: &mut [u32]) -> bool {
        for (i, word) in (0..).zip(&mut *words) {
            *word = fixed_words(key, first_pixel.wrapping_add(i), 0)[0];
        }
        words.iter().fold(0, |any, word| any | u32::from(*word < below) | u32::from(*word > above)) != 0
    }
}

/// Finds the camera in a list, or puts it there; the oldest makes room.
fn found_in(kept: &mut Vec<Candidates>, most: usize, key: StageKey, make: impl FnOnce() -> Candidates) -> Candidates {
    if let Some(found) = kept.iter().find(|own| (own.seed, own.stage) == (key.seed, key.stage)) {
        return found.clone();
    }
    let new = make();
    if kept.len() >= most {
        kept.remove(0);
    }
    kept.push(new.clone());
    new
}

impl Candidates {
    /// Those of the seed and the stage of a key: its frame does not count.
    fn of(key: StageKey) -> Self {
        let new = || Self { seed: key.seed, stage: key.stage, chunks: (0..CHUNKS).map(|_| OnceLock::new()).collect() };
        let shared = || found_in(&mut KEPT.lock().unwrap_or_else(PoisonError::into_inner), MAX_CAMERAS, key, new);
        OF_THREAD.with_borrow_mut(|own| found_in(own, MAX_OF_A_THREAD, key, shared))
    }

    /// Those of a chunk, by its number.
    fn chunk(&self, key: StageKey, number: usize) -> Option<&[u16]> {
        Some(self.chunks.get(number)?.get_or_init(|| {
            let (mut words, mut all) = ([0; BLOCK_PX], Vec::new());
            for start in (0..CHUNK_PX).step_by(BLOCK_PX) {
                if first_words(key, (number * CHUNK_PX + start) as u32, [SMALL, LARGE], &mut words) {
                    let is_one = |(_, word): &(usize, &u32)| !(SMALL..=LARGE).contains(*word);
                    all.extend((start..).zip(&words).filter(is_one).map(|(place, _)| place as u16));
                }
            }
            all.into_boxed_slice()
        }))
    }
}

/// Hands every pixel whose first word that stays is below the one limit or above the other to `change`, with its index in the frame and its words.
pub(crate) fn for_each_defect(
    [below, above]: [u32; 2],
    key: StageKey,
    first_pixel: u32,
    pixels: &mut [f32],
    mut change: impl FnMut(u32, [u32; 4], &mut f32),
) {
    let kept = (below <= SMALL && above >= LARGE).then(|| Candidates::of(key));
    let mut ask = |index: u32, pixel: &mut f32| {
        let words = fixed_words(key, index, 0);
        if words[0] < below || words[0] > above {
            change(index, words, pixel);
        }
    };
    let (mut rest, mut first) = (pixels, first_pixel);
    while !rest.is_empty() {
        // What the run has of a chunk.
        let (number, before) = (first as usize / CHUNK_PX, first as usize % CHUNK_PX);
        let count = rest.len().min(CHUNK_PX - before);
        let (part, later) = rest.split_at_mut(count);
        if let Some(candidates) = kept.as_ref().and_then(|kept| kept.chunk(key, number)) {
            let start = candidates.partition_point(|place| usize::from(*place) < before);
            for i in candidates[start..].iter().map(|place| usize::from(*place) - before).take_while(|i| *i < count) {
                ask(first + i as u32, &mut part[i]);
            }
        } else {
            let mut words = [0; BLOCK_PX];
            for (offset, part) in (0_u32..).step_by(BLOCK_PX).zip(part.chunks_mut(BLOCK_PX)) {
                let (first, words) = (first + offset, &mut words[..part.len()]);
                if first_words(key, first, [below, above], words) {
                    for ((i, pixel), _) in (0..).zip(part).zip(words).filter(|(_, word)| **word < below || **word > above) {
                        ask(first + i, pixel);
                    }
                }
            }
        }
        first = first.wrapping_add(count as u32);
        rest = later;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEPT_SHARE: f64 = 1.0 / 256.0;

    /// Which pixels are handed over, of a run.
    fn handed(limits: [u32; 2], key: StageKey, first_pixel: u32, count: usize) -> Vec<u32> {
        let mut found = Vec::new();
        let mut pixels = vec![0.0; count];
        for_each_defect(limits, key, first_pixel, &mut pixels, |index, words, pixel| {
            assert_eq!(words, fixed_words(key, index, 0));
            *pixel = 1.0;
            found.push(index);
        });
        let marked = (0..).zip(&pixels).filter(|(_, pixel)| **pixel == 1.0).map(|(i, _)| first_pixel.wrapping_add(i)).collect::<Vec<_>>();
        assert_eq!(marked, found);
        found
    }

    /// Pixel by pixel, from whole chunks and from parts of them, below the shares that are kept and above, in the first frame and behind others.
    #[test]
    fn the_pixels_are_those_of_their_words() {
        let share = |share: f64| (share * f64::from(u32::MAX)) as u32;
        for seed in [0x0f12_57a0_0d5e_ed01, 2, 3] {
            for (frame, (small, large)) in (0..).zip([(1e-3, 1e-4), (KEPT_SHARE, KEPT_SHARE), (0.02, 0.0), (0.0, 1e-3), (1e-3, 1e-4)]) {
                let (key, limits) = (StageKey { seed, frame, stage: 7 }, [share(small), u32::MAX - share(large)]);
                let beyond = (CHUNKS * CHUNK_PX) as u32;
                for (first, count) in
                    [(0, 40_000), (CHUNK_PX as u32, CHUNK_PX), (777, 20), (16_000, 5000), (beyond - 900, 1500), (u32::MAX - 700, 2000)]
                {
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
    fn cameras_and_effects_are_kept_apart_and_old_ones_given_up() {
        let key = StageKey { seed: 77, frame: 1, stage: 9 };
        let of = |key: StageKey| Candidates::of(key).chunk(key, 3).map(<[u16]>::to_vec).unwrap();
        let first = of(key);
        let expected = 2.0 * KEPT_SHARE * CHUNK_PX as f64;
        assert!((first.len() as f64 - expected).abs() < 4.5 * expected.sqrt(), "{} of {expected}", first.len());
        assert_eq!(of(StageKey { frame: 2, ..key }), first);
        assert_ne!(of(StageKey { stage: 8, ..key }), first);
        assert_ne!(of(StageKey { seed: 78, ..key }), first);
        assert_eq!(Candidates::of(key).chunk(key, CHUNKS), None);
        assert_eq!(std::thread::spawn(move || of(key)).join().unwrap(), first);
        // What the thread has asked is not made anew, however many others there have been since.
        let own = Candidates::of(key);
        let others = (1000..1000 + 2 * MAX_CAMERAS as u64).map(move |seed| StageKey { seed, ..key });
        let many = others.clone();
        std::thread::spawn(move || many.for_each(|key| drop(Candidates::of(key)))).join().unwrap();
        assert!(Arc::ptr_eq(&own.chunks, &Candidates::of(key).chunks));
        others.for_each(|key| drop(Candidates::of(key)));
        assert!(KEPT.lock().unwrap().len() <= MAX_CAMERAS && OF_THREAD.with_borrow(Vec::len) <= MAX_OF_A_THREAD);
        assert_eq!(of(key), first);
    }
}
