//! `frames = "auto"`: frames are added until every requirement is decided, and what the verdicts may err by is spent over the looks.
//!
//! The bounds at each look are taken at a part of the whole error rate; the parts of all looks sum to it. This holds whatever the looks have to do with each
//! other, for every kind of bound. The last look, which most close calls reach, has half of it; the earlier ones share the rest evenly.

use super::verdict::ErrorRates;

/// From one look to the next the frames grow by this factor.
const GROWTH: f64 = 2.0;
/// The part of the error rate that the last look has.
const OF_LAST: f64 = 0.5;

/// The numbers of frames at which a case is looked at.
#[must_use]
pub fn looks(first: usize, most: usize) -> Vec<usize> {
    let mut all = Vec::new();
    let mut next = first.max(1) as f64;
    while (next as usize) < most {
        all.push(next.round() as usize);
        next *= GROWTH;
    }
    // A last step that adds next to nothing is no look of its own.
    if all.last().is_some_and(|last| (*last as f64) * 1.25 > most as f64) {
        all.pop();
    }
    all.push(most);
    all
}

/// The error rates of look `index` of `count`.
#[must_use]
pub fn spent(whole: ErrorRates, index: usize, count: usize) -> ErrorRates {
    let part = if count == 1 {
        1.0
    } else if index + 1 == count {
        OF_LAST
    } else {
        (1.0 - OF_LAST) / (count - 1) as f64
    };
    ErrorRates { false_pass: whole.false_pass * part, false_fail: whole.false_fail * part }
}
