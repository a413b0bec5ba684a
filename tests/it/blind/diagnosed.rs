//! A small fixed part of the benchmark: what is hidden plainly is named, and nothing else is.

use boresight::blind::generate::{Family, LADDER, LIBRARY, Truth, concealed};
use boresight::blind::{Answer, answer, score};
use boresight::catalog::Catalog;
use boresight::diagnose::DiagnoseOptions;
use rayon::prelude::*;

const SEED: u64 = 3;

fn on_the_ladder(label: &str, rung: usize) -> (Family, u32) {
    let effect = LIBRARY.iter().position(|kind| kind.label() == label).expect("an effect of the library");
    (Family::Ladder, (effect + rung * LIBRARY.len()) as u32)
}

#[test]
fn plain_cases_are_answered_rightly() {
    let strongest = LADDER.len() - 1;
    let mut cases = vec![(Family::Null, 0), (Family::Null, 2), (Family::HardNull, 1), (Family::HardNull, 3), (Family::Absorbed, 1)];
    let labels = ["quadratic-rest", "thermal-focal-length", "lateral-colour", "rolling-shutter", "stellar-aberration"];
    cases.extend(labels.map(|label| on_the_ladder(label, strongest)));
    let options = DiagnoseOptions { nulls: 200, ..DiagnoseOptions::default() };
    let pairs: Vec<(Truth, Answer)> = cases
        .into_par_iter()
        .map(|(family, index)| (concealed(family, index, SEED, Catalog::embedded()).truth, answer(family, index, SEED, &options)))
        .collect();
    for (truth, answer) in &pairs {
        let named: Vec<&str> = answer.findings.iter().map(|finding| finding.id.as_str()).collect();
        println!("{} {} {}: {:?} {named:?} {:?}", truth.family.name(), truth.index, truth.setup, answer.verdict, answer.error);
        let hidden: Vec<&str> = truth.effects.iter().filter(|effect| effect.multiple > 1.0).map(|effect| effect.id.as_str()).collect();
        assert_eq!(named, hidden, "{} {}: {answer:?}", truth.family.name(), truth.index);
    }
    let score = score(&pairs);
    // The thermal focal length has a near relative (its distortion) and does not count among those that are easily told apart.
    assert_eq!((score.unanswered, score.named.hits), (0, score.named.of));
    assert!(score.named.of >= 4);
    assert!(score.all_pulls.count >= labels.len() && score.all_pulls.within_2.share() > Some(0.6), "{:?}", score.pulls);
}
