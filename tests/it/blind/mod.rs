//! The benchmark of concealed recordings.

mod diagnosed;
mod generator;
mod held_out;
mod images;
mod pixels;
mod scorer;

use std::collections::BTreeMap;

use boresight::blind::generate::Family;
use boresight::blind::{Answer, AnswerFinding};

/// A finding that says its name alone.
fn finding_of(id: &str) -> AnswerFinding {
    AnswerFinding {
        id: id.to_owned(),
        parameters: Vec::new(),
        located_by: Vec::new(),
        snr: 9.0,
        delta_chi2: 81.0,
        set: Vec::new(),
        held_out_chi2: BTreeMap::new(),
    }
}

/// An answer with a verdict and names.
fn answer_of(family: Family, seed: u64, verdict: &str, names: &[&str]) -> Answer {
    let mut answer = Answer::none(family, 0, seed, String::new());
    answer.error = None;
    verdict.clone_into(&mut answer.verdict);
    answer.findings = names.iter().map(|id| finding_of(id)).collect();
    answer
}
