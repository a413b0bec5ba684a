//! Work limit of a frame: pictures of leaves, letters and clouds have thousands of maxima whose fits never converge.
//!
//! Work is counted in pixels drawn, not by the clock: the same frame gives the same stars on every machine and at any number of threads. Frames of
//! stars stay far below the limit. An optional deadline ends the work too, and then the answer depends on the machine.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use crate::parallel;

/// What a pixel costs to be drawn and weighed, nanoseconds of a usual core: of a round image, of any ellipse.
pub(super) const ROUND_NS: u64 = 20;
pub(super) const ELLIPSE_NS: u64 = 130;
/// The same of a trail without its light, and what a pixel costs in the light of each of the trail's round parts.
pub(super) const BESIDE_TRAIL_NS: u64 = 30;
pub(super) const IN_TRAIL_NS: u64 = 3;
/// What is allowed: for any frame, and for each pixel of it.
const ALLOWED_NS: u64 = 1_000_000_000;
const ALLOWED_NS_PER_PIXEL: u64 = 350;
/// Things that are done together before what they cost is looked at: at first, and at most, since dear ones may follow on cheap ones.
const MIN_BATCH: usize = 4;
const MAX_BATCH: usize = 64;
/// What is done together costs at most this part of what is allowed, as far as those before tell.
const PART: f64 = 0.04;

/// The parts of the work by which its stages have to end, so that those behind them have their time too.
pub(super) const SEARCHED: f64 = 0.3;
pub(super) const WEIGHED: f64 = 0.4;
pub(super) const FITTED: f64 = 0.75;
pub(super) const RESTED: f64 = 0.85;
pub(super) const PARTED: f64 = 1.0;
pub(super) const DESCRIBED: f64 = 1.1;

/// The work on one frame.
#[derive(Debug)]
pub(super) struct Work {
    spent_ns: AtomicU64,
    allowed_ns: u64,
    deadline: Option<Instant>,
    is_unfinished: AtomicBool,
}

impl Work {
    /// On a frame of so many pixels.
    pub(super) fn on(pixels: usize, deadline: Option<Instant>) -> Self {
        let allowed_ns = ALLOWED_NS.saturating_add(ALLOWED_NS_PER_PIXEL.saturating_mul(pixels as u64));
        Self { spent_ns: AtomicU64::new(0), allowed_ns, deadline, is_unfinished: AtomicBool::new(false) }
    }

    /// Without a limit.
    pub(super) const fn unlimited() -> Self {
        Self { spent_ns: AtomicU64::new(0), allowed_ns: u64::MAX, deadline: None, is_unfinished: AtomicBool::new(false) }
    }

    /// So much was done.
    pub(super) fn spend(&self, ns: u64) {
        self.spent_ns.fetch_add(ns, Ordering::Relaxed);
    }

    fn spent(&self) -> u64 {
        self.spent_ns.load(Ordering::Relaxed)
    }

    fn until(&self, part: f64) -> u64 {
        (self.allowed_ns as f64 * part) as u64
    }

    /// Whether this part of what is allowed is spent, or the time is up.
    pub(super) fn is_spent(&self, part: f64) -> bool {
        self.spent() >= self.until(part) || self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// Whether anything was left undone.
    pub(super) fn is_unfinished(&self) -> bool {
        self.is_unfinished.load(Ordering::Relaxed)
    }

    /// Does something for each of some things, until a part of what is allowed is spent; nothing for those that are left then. To be called by
    /// one stage at a time.
    pub(super) fn each<T: Sync, R: Send>(&self, of: &[T], part: f64, each: impl Fn(&T) -> R + Sync) -> Vec<Option<R>> {
        let mut done: Vec<Option<R>> = Vec::with_capacity(of.len());
        let mut together = MIN_BATCH;
        while done.len() < of.len() && !self.is_spent(part) {
            let before = self.spent();
            let now = &of[done.len()..(done.len() + together).min(of.len())];
            let results: Vec<Option<R>> = parallel::map(now, |one| Some(each(one)));
            done.extend(results);
            let each_ns = ((self.spent() - before) as f64 / now.len() as f64).max(1.0);
            together = ((PART * self.allowed_ns as f64 / each_ns) as usize).clamp(MIN_BATCH, MAX_BATCH);
        }
        if done.len() < of.len() {
            self.is_unfinished.store(true, Ordering::Relaxed);
        }
        done.resize_with(of.len(), || None);
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_ends_where_its_part_is_spent_and_at_the_same_place_with_any_threads() {
        let things: Vec<u64> = (0..2000).map(|i| 1 + i % 7).collect();
        let done = |threads: usize| {
            let work = Work { allowed_ns: 4000, ..Work::unlimited() };
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let results = pool.install(|| work.each(&things, 0.5, |ns| work.spend(*ns)));
            results.iter().flatten().count()
        };
        assert_eq!(done(1), done(4));
        assert!((400..700).contains(&done(1)), "{}", done(1));
        let free = Work::unlimited();
        assert_eq!(free.each(&things, 1.0, |ns| free.spend(*ns)).iter().flatten().count(), 2000);
        let late = Work { deadline: Some(Instant::now()), ..Work::unlimited() };
        assert_eq!(late.each(&things, 1.0, |_| ()).iter().flatten().count(), 0);
    }
}
