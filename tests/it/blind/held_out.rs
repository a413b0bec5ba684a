//! Where nothing is hidden, what is called held out brings nothing.

use boresight::blind::generate::{Family, concealed};
use boresight::blind::{Answer, AnswerProposal, HeldOutStudy, control_points, held_out_study, recording, telemetry};
use boresight::catalog::Catalog;
use boresight::diagnose::{DiagnoseOptions, diagnose};
use rayon::prelude::*;

const SEED: u64 = 20_261_122;
const NULLS: u32 = 24;

/// Diagnosed so loosely that chance is proposed.
fn answered(index: u32) -> Answer {
    let lists = concealed(Family::Null, index, SEED, Catalog::embedded()).lists;
    let recording = recording(&lists);
    let points = control_points(&recording, &lists.model, Catalog::embedded()).unwrap();
    let physics = lists.model.iter().map(|id| (*id).to_owned()).collect();
    let options = DiagnoseOptions { nulls: 200, alpha: 0.5, seed: u64::from(index), physics, ..DiagnoseOptions::default() };
    let diagnosis = diagnose(&points, &telemetry(&recording), &options).unwrap();
    for finding in &diagnosis.findings {
        let own = diagnosis.proposed.iter().find(|own| own.id == finding.id).expect("a finding was proposed");
        assert!(own.named && own.by_all_images && own.against.is_empty());
        assert_eq!((own.held_out_delta_chi2, own.chosen_again), (finding.held_out_delta_chi2, finding.chosen_again));
        assert!(2 * own.chosen_again[0] >= own.chosen_again[1] && own.held_out_delta_chi2 > 0.0, "{own:?}");
    }
    for own in diagnosis.proposed.iter().filter(|own| !own.named) {
        assert!(!own.against.is_empty(), "{own:?}");
    }
    let proposal = |own: &boresight::diagnose::Proposed| AnswerProposal {
        id: own.id.clone(),
        named: own.named,
        by_all_images: own.by_all_images,
        delta_chi2: own.delta_chi2,
        held_out_delta_chi2: own.held_out_delta_chi2,
        held_out_expected: own.held_out_expected,
        chosen_again: own.chosen_again,
    };
    let proposed = diagnosis.proposed.iter().map(proposal).collect();
    Answer { error: None, alpha: 0.5, proposed, ..Answer::none(Family::Null, index, SEED, String::new()) }
}

/// The mean over all that was proposed is not above zero. What all star images proposed together looks like something in sample (a fall of
/// χ² of ten), and leaving frames out of its size alone would leave nearly all of that: held out choice and all, nothing is left.
#[test]
fn what_is_held_out_has_no_mean_above_zero_where_nothing_is_hidden() {
    let answers: Vec<Answer> = (0..NULLS).into_par_iter().map(answered).collect();
    let study: HeldOutStudy = held_out_study(&answers);
    println!("{}", study.markdown("under test"));
    let [all, by_parts, by_all] = [0, 1, 2].map(|k| &study.rows[k]);
    assert!(study.is_honest(), "{all:?}");
    assert!(all.mean < 0.0 && by_parts.mean < -2.0 * by_parts.error, "{all:?} {by_parts:?}");
    assert!(by_all.count >= 3 && by_all.in_sample > 7.0, "{by_all:?}");
    assert!(by_all.mean < 0.3 * by_all.in_sample, "a choice made with all errors in hand: {by_all:?}");
}
