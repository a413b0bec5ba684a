//! Which effects the rows ask for: each by the score of its columns, the largest first, until none is beyond chance.

use super::narrowing::{exchanged, narrowed};
use super::row_fit::RowFit;
use super::rows::Rows;
use super::selection::{AS_GOOD, Answer, answer, answers, cosine, fitted};

/// Effects at most: a real camera has ten, and a sky and a detector add theirs.
const MAX_EFFECTS: usize = 20;
/// Columns more alike than this are one class; the more usual name is taken if it is about as good.
const SAME: f64 = 0.98;

/// Effects enter beside those given while one is beyond `threshold`; whoever is not beyond it beside the others leaves. Of an effect of which a part says as
/// much as the whole the part stays.
pub(in crate::diagnose) fn select(rows: &Rows, allowed: &[bool], given: &[usize], threshold: f64) -> (Vec<usize>, RowFit) {
    let mut accepted: Vec<usize> = given.to_vec();
    let mut fit = fitted(rows, allowed, &accepted, None);
    for _ in 0..MAX_EFFECTS {
        let mut found = answers(rows, &fit, &accepted);
        found.retain(|answer| answer.surprise > threshold);
        let Some(chosen) = choose(rows, &fit, &found) else { break };
        accepted.push(chosen);
        fit = fitted(rows, allowed, &accepted, None);
        let mut k = given.len();
        while accepted.len() > 1 && k + 1 < accepted.len() {
            let mut rest = accepted.clone();
            let tried = rest.remove(k);
            let without = fitted(rows, allowed, &rest, None);
            if answer(rows, &without, tried).is_none_or(|answer| answer.surprise < threshold) {
                (accepted, fit) = (rest, without);
            } else {
                k += 1;
            }
        }
    }
    let (accepted, fit) = narrowed(rows, allowed, (accepted, given.len()), fit);
    exchanged(rows, allowed, (accepted, given.len()), fit, threshold)
}

/// The most surprising; of its class that are about as good the more usual one, if it asks for no more parameters: a curved focal surface with
/// astigmatism can be sized to look like any coma, which has one size.
fn choose(rows: &Rows, fit: &RowFit, found: &[Answer]) -> Option<usize> {
    let best = found.iter().max_by(|a, b| a.surprise.total_cmp(&b.surprise).then(a.statistic.total_cmp(&b.statistic)))?;
    // Where both are beyond all numbers (a difference that is none) the statistics decide alone.
    let near = |other: &&Answer| {
        other.question == best.question
            || (best.surprise - other.surprise < AS_GOOD
                && other.rank <= best.rank
                && cosine(rows, fit, best.question, other.question) > SAME)
    };
    found.iter().filter(near).min_by_key(|answer| rows.questions[answer.question].rank).map(|answer| answer.question)
}
