//! Seal, scorer and rivals of the benchmark.

use std::collections::BTreeMap;

use boresight::blind::generate::{Family, LADDER, LIBRARY, Truth, concealed};
use boresight::blind::{
    Answer, AnswerFinding, AnswerParameter, BlindError, Seal, answers, append, control_points, markdown, open, opened, recording,
    rival_fits, score, seal,
};
use boresight::catalog::Catalog;

/// The answer of somebody who knows the truth: found from just-seen strength on, parameters off by `pull` standard errors.
fn oracle(truth: &Truth, pull: f64) -> Answer {
    let mut answer = Answer::none(truth.family, truth.index, truth.seed, String::new());
    answer.error = None;
    answer.effects = LIBRARY.iter().map(|kind| (kind.id().to_owned(), "not-found".to_owned())).collect();
    answer
        .effects
        .extend(["thin-prism", "detector-tilt", "boresight-drift", "time-tag"].map(|id| (id.to_owned(), "not-observable".to_owned())));
    let finding = |effect: &boresight::blind::generate::TrueEffect| AnswerFinding {
        id: effect.id.clone(),
        parameters: effect
            .parameters
            .iter()
            .map(|parameter| AnswerParameter { name: parameter.name.clone(), value: parameter.value + 2.0 * pull, sigma: 2.0 })
            .collect(),
        located_by: effect.covariates.clone(),
        snr: effect.snr,
        delta_chi2: effect.snr.powi(2),
        set: Vec::new(),
        held_out_chi2: BTreeMap::new(),
    };
    let seen = truth.effects.iter().filter(|effect| effect.multiple > 0.99);
    let (library, other): (Vec<_>, Vec<_>) = seen.partition(|effect| effect.in_library);
    answer.findings = library.into_iter().map(finding).collect();
    answer.unknown_located_by = other.first().map(|effect| effect.covariates.clone());
    let verdict = match (answer.findings.is_empty(), other.is_empty()) {
        (true, true) => "consistent",
        (_, true) => "explained",
        (_, false) => "unexplained",
    };
    verdict.clone_into(&mut answer.verdict);
    answer
}

fn truths(family: Family, indices: impl IntoIterator<Item = u32>) -> Vec<Truth> {
    indices.into_iter().map(|index| concealed(family, index, 7, Catalog::embedded()).truth).collect()
}

#[test]
fn what_is_read_is_what_was_sealed() {
    let folder = tempfile::tempdir().unwrap();
    let made = truths(Family::Absorbed, 0..3);
    let sealed = seal(folder.path(), 7, &made).unwrap();
    assert_eq!(Seal::read(folder.path()).unwrap().unwrap(), sealed);
    for truth in &made {
        let read = open(folder.path(), &sealed, truth.family, truth.index).unwrap();
        // The JSON reader may be off in the last digit of a number.
        assert!((read.camera.parameters[2] / truth.camera.parameters[2] - 1.0).abs() < 1e-15);
        assert_eq!((read.index, read.stars, &read.effects[0].id), (truth.index, truth.stars, &truth.effects[0].id));
    }
    // Sealing the same again changes nothing; another truth of the same name, or of another seed, is refused.
    assert_eq!(seal(folder.path(), 7, &made[..1]).unwrap(), sealed);
    let mut other = made[1].clone();
    other.stars += 1;
    assert!(matches!(seal(folder.path(), 7, &[other]), Err(BlindError::Broken { .. })));
    assert!(matches!(seal(folder.path(), 8, &made), Err(BlindError::OtherSeed { .. })));
    // A truth changed after the fact is noticed.
    let path = folder.path().join("truth/absorbed-00001.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"index\": 1", "\"index\":  1")).unwrap();
    assert!(matches!(open(folder.path(), &sealed, Family::Absorbed, 1), Err(BlindError::Broken { .. })));
    assert!(!sealed.holds(Family::Absorbed, 3));
}

#[test]
fn answers_are_appended_whole_and_read_once() {
    let folder = tempfile::tempdir().unwrap();
    let made = truths(Family::Absorbed, 0..3);
    let sealed = seal(folder.path(), 7, &made).unwrap();
    assert_eq!(sealed.files.len(), 3);
    for index in [2, 0] {
        append(folder.path(), &oracle(&made[index], 0.0)).unwrap();
    }
    // A line cut short by a crash, a second try, and the next one.
    let path = folder.path().join("answers/absorbed.jsonl");
    let mut text = std::fs::read_to_string(&path).unwrap();
    text.push_str("{\"family\":\"absor");
    std::fs::write(&path, text).unwrap();
    append(folder.path(), &Answer { verdict: "unexplained".to_owned(), ..oracle(&made[0], 0.0) }).unwrap();
    append(folder.path(), &oracle(&made[1], 0.0)).unwrap();
    let read = answers(folder.path(), Family::Absorbed).unwrap();
    assert_eq!(read, made.iter().map(|truth| oracle(truth, 0.0)).collect::<Vec<_>>());
    assert_eq!(opened(folder.path()).unwrap().len(), 3);
}

#[test]
fn who_knows_the_truth_scores_full_marks() {
    let rungs = LADDER.len() as u32;
    // One effect in five up the whole ladder.
    let effects = LIBRARY.len() as u32;
    let ladder = (0..rungs).flat_map(|rung| (0..effects).step_by(5).map(move |effect| effect + rung * effects));
    let mut all = truths(Family::Ladder, ladder);
    all.extend(truths(Family::Null, 0..4));
    all.extend(truths(Family::HardNull, 0..9));
    all.extend(truths(Family::Absorbed, 0..4));
    all.extend(truths(Family::Two, 0..4));
    all.extend(truths(Family::OffLibrary, 14..20));
    all.extend(truths(Family::Confuser, 0..4));
    let pairs: Vec<(Truth, Answer)> = all
        .iter()
        .enumerate()
        // Pulls of −1.5, 0 and +1.5 in turn: two thirds lie beyond one standard error.
        .map(|(place, truth)| (truth.clone(), oracle(truth, 1.5 * ((place % 3) as f64 - 1.0))))
        .collect();
    let full = score(&pairs);
    let all_of = |rate: boresight::blind::Rate| rate.of > 0 && rate.hits == rate.of;
    let none_of = |rate: boresight::blind::Rate| rate.of > 0 && rate.hits == 0;
    assert!(full.null_totals.iter().flatten().count() == 2);
    assert!(full.nulls.len() == 4 + 9 && full.nulls.iter().all(|null| none_of(null.named) && none_of(null.alarmed)));
    let half = full.all_ladders.half.unwrap();
    assert!((half - (0.7_f64).sqrt()).abs() < 0.01, "seen from 1 on and not at 0.7: {half}");
    for (rate, name) in [
        (full.named, "named"),
        (full.in_set, "in set"),
        (full.absorbed_quiet, "quiet"),
        (full.absorbed_told, "told"),
        (full.two_exact, "two"),
        (full.off_library_totals[0], "not misnamed"),
        (full.off_library_totals[1], "found"),
        (full.located, "located"),
    ] {
        assert!(all_of(rate), "{name}: {rate}");
    }
    assert_eq!((full.set_size, full.two_false), (Some(1.0), Some(0.0)));
    assert!(none_of(full.needless));
    let beyond = full.all_pulls.within_1.share().unwrap();
    assert!((beyond - 1.0 / 3.0).abs() < 0.1 && all_of(full.all_pulls.within_2), "{beyond}");
    assert!(full.all_pulls.mean.abs() < 0.2 && (full.all_pulls.sd - 1.22).abs() < 0.15, "{:?}", full.all_pulls);
    let page = markdown(&full);
    assert!(page.contains("| two at once (SNR 7–15): exact pair | 80 % | 92 % | 100.0 % (4/4"), "{page}");

    // Who calls everything pixel aspect does not.
    let mistaken: Vec<(Truth, Answer)> = pairs
        .iter()
        .map(|(truth, answer)| {
            let finding = AnswerFinding { set: vec!["shear".to_owned()], ..super::finding_of("pixel-aspect") };
            (truth.clone(), Answer { findings: vec![finding], verdict: "explained".to_owned(), ..answer.clone() })
        })
        .collect();
    let wrong = score(&mistaken);
    assert!(wrong.nulls.iter().all(|null| all_of(null.named)));
    assert!(
        wrong.named.share().unwrap() < 0.5
            && none_of(wrong.two_exact)
            && none_of(wrong.off_library_totals[0])
            && none_of(wrong.absorbed_quiet)
    );
    assert_eq!(wrong.set_size, Some(2.0));
    assert!(wrong.all_ladders.half.is_none(), "found at every strength");
}

/// Rivals mend what they can: k2 by k2 and k3 and by the polynomial, temperature by neither; on a null all leave noise.
#[test]
fn rivals_mend_what_is_theirs() {
    let catalog = Catalog::embedded();
    let fits = |family, index| {
        let made = concealed(family, index, 7, catalog);
        let points = control_points(&recording(&made.lists), &made.lists.model, catalog).unwrap();
        let held_out: Vec<usize> = (points.attitudes.len() * 3 / 4..points.attitudes.len()).collect();
        // A diagnosis that names the truth, judged as all others are.
        let finding = |effect: &str| AnswerFinding { snr: 0.0, ..super::finding_of(effect) };
        let named: Vec<AnswerFinding> = made.truth.effects.iter().map(|effect| finding(&effect.id)).collect();
        (
            made.truth,
            rival_fits(&points, &made.lists.model.iter().map(|id| (*id).to_owned()).collect::<Vec<_>>(), &named, &held_out)
                .expect("a calibration"),
        )
    };
    let (_, null) = fits(Family::Null, 0);
    for chi2 in [null.baseline, null.radial_clipped, null.polynomial] {
        assert!((0.85..1.25).contains(&chi2), "{null:?}");
    }
    assert_eq!(null.diagnosis, Some(null.baseline), "what names nothing is the camera alone, by the same measure");
    let at = |label: &str| {
        let effect = LIBRARY.iter().position(|kind| kind.label() == label).unwrap();
        fits(Family::Ladder, (effect + 6 * LIBRARY.len()) as u32)
    };
    let (truth, radial) = at("radial-high-order, k2");
    println!("{} {radial:?}", truth.setup);
    assert!(radial.baseline > 1.3 && radial.radial_clipped < 1.15 && radial.polynomial < 1.25, "{radial:?}");
    // The truth named is as good as the columns that are made for it, with the true noise near 1.
    assert!(radial.diagnosis.is_some_and(|chi2| (0.85..1.15).contains(&chi2)), "{radial:?}");
    let (truth, warm) = at("thermal-focal-length");
    println!("{} {warm:?}", truth.setup);
    // LASSO holds the right column too, among others.
    assert!(warm.lasso_names.as_ref().is_some_and(|names| names.iter().any(|name| name == "thermal-focal-length")), "{warm:?}");
    assert!(warm.lasso < Some(warm.baseline - 0.2), "{warm:?}");
    assert!(warm.baseline > 1.3 && warm.radial_clipped > 1.3 && warm.polynomial > 1.3, "{warm:?}");
    assert!(warm.diagnosis.is_some_and(|chi2| (0.85..1.15).contains(&chi2)), "{warm:?}");
}
