//! Counting.

use std::collections::BTreeMap;

use statrs::distribution::{ContinuousCDF, Normal};

use super::{ConfuserScore, HeldOutScore, Ladder, NullScore, OffLibraryScore, Pulls, Rate, SCORE_FORMAT, Score};
use crate::blind::answer::Answer;
use crate::blind::generate::{Family, TrueEffect, Truth};

/// Above this cosine two effects count as alike, below it as separable.
const SEPARABLE: f64 = 0.9;
/// Above this one they cannot be told apart at moderate signal.
const TWINS: f64 = 0.95;
const TWINS_SNR: f64 = 15.0;
/// What is truly equal to an effect of the library is no mistake.
const EQUAL_TO_LIBRARY: f64 = 0.97;
/// Strengths from which names, places and mended data are judged, in multiples of what is just seen.
const JUDGE_NAME_FROM: f64 = 3.9;
const JUDGE_PLACE_FROM: f64 = 1.9;
/// Off-library totals are of signals from here on.
const OFF_LIBRARY_SNR: f64 = 14.0;

type Pair<'a> = (&'a Truth, &'a Answer);

pub(super) fn alarmed(answer: &Answer) -> bool {
    // Where nothing could have shown nothing is said to be missing.
    !matches!(answer.verdict.as_str(), "consistent" | "undecided")
}

pub(super) fn first_name(answer: &Answer) -> Option<&str> {
    answer.findings.first().map(|finding| finding.id.as_str())
}

fn in_set(answer: &Answer, id: &str) -> bool {
    answer.findings.iter().any(|finding| finding.id == id || finding.set.iter().any(|other| other == id))
}

/// Whether the first covariate named is one of the right ones.
fn located(answer: &Answer, effect: &TrueEffect) -> bool {
    let named = answer.findings.first().and_then(|finding| finding.located_by.first());
    let unknown = answer.unknown_located_by.as_ref().and_then(|list| list.first());
    let first = named.or(unknown).or(answer.located.first());
    first.is_some_and(|covariate| effect.covariates.contains(covariate))
}

/// The largest cosine with an effect that the program has tried.
fn most_alike<'a>(answer: &Answer, effect: &'a TrueEffect) -> Option<(&'a str, f64)> {
    let tried = |id: &str| answer.status_of(id).is_some_and(|status| status != "not-applicable");
    effect.alike.iter().find(|alike| tried(&alike.id)).map(|alike| (alike.id.as_str(), alike.cos))
}

pub(super) fn score(pairs: &[(Truth, Answer)]) -> Score {
    let given: Vec<Pair> = pairs.iter().filter(|(_, answer)| answer.error.is_none()).map(|(truth, answer)| (truth, answer)).collect();
    let of = |family: Family| given.iter().copied().filter(move |(truth, _)| truth.family == family);
    let single = |families: &'static [Family]| {
        let chosen = given.iter().copied().filter(|(truth, _)| families.contains(&truth.family));
        chosen.filter_map(|(truth, answer)| Some((truth, truth.effects.first()?, answer)))
    };
    let mut score = Score {
        format: SCORE_FORMAT.to_owned(),
        version: versions(pairs.iter().map(|(_, answer)| answer.version.as_str())),
        seed: pairs.first().map_or(0, |(truth, _)| truth.seed),
        answers: given.len(),
        unanswered: pairs.len() - given.len(),
        unanswered_reason: pairs.iter().find_map(|(_, answer)| answer.error.clone()),
        ..Score::default()
    };
    nulls(&mut score, &given);
    ladders(&mut score, of(Family::Ladder));

    let mut sizes = Vec::new();
    for (_, effect, answer) in single(&[Family::Ladder, Family::Confuser, Family::Natural]) {
        let Some(status) = answer.status_of(&effect.id) else { continue };
        if status == "not-applicable" {
            continue;
        }
        let alike = most_alike(answer, effect).map_or(0.0, |(_, cos)| cos);
        if effect.multiple >= JUDGE_NAME_FROM && alike < SEPARABLE {
            score.named.count(first_name(answer) == Some(&effect.id));
            if let Some(finding) = answer.findings.iter().find(|finding| finding.id == effect.id) {
                score.needless.count(!finding.set.is_empty());
            }
        }
        if let (Some((twin, cos)), false) = (most_alike(answer, effect), answer.findings.is_empty())
            && cos > TWINS
            && effect.snr < TWINS_SNR
        {
            score.cannot_tell.count(in_set(answer, &effect.id) && in_set(answer, twin));
        }
        if !answer.findings.is_empty() {
            score.in_set.count(in_set(answer, &effect.id));
            sizes.extend(answer.findings.iter().map(|finding| 1.0 + finding.set.len() as f64));
        }
        if effect.multiple >= JUDGE_PLACE_FROM && alarmed(answer) {
            score.located.count(located(answer, effect));
        }
    }
    score.set_size = mean(&sizes);

    for (truth, answer) in of(Family::Absorbed) {
        score.absorbed_quiet.count(answer.findings.is_empty());
        if let Some(status) = truth.effects.first().and_then(|effect| answer.status_of(&effect.id)) {
            score.absorbed_told.count(status == "not-observable");
        }
    }
    two(&mut score, of(Family::Two));
    let mut natural: BTreeMap<&str, Rate> = BTreeMap::new();
    for (_, effect, answer) in single(&[Family::Natural]) {
        natural.entry(&effect.label).or_default().count(first_name(answer) == Some(&effect.id));
    }
    score.natural = natural.into_iter().map(|(label, rate)| (label.to_owned(), rate)).collect();
    confusers(&mut score, of(Family::Confuser));
    lasso(&mut score, &given);
    off_library(&mut score, of(Family::OffLibrary));
    pulls(&mut score, &given);
    held_out(&mut score, &given);
    let mut seconds: Vec<f64> = given.iter().map(|(_, answer)| answer.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    score.seconds = [seconds.get(seconds.len() / 2).copied().unwrap_or_default(), seconds.last().copied().unwrap_or_default()];
    score
}

/// Two effects at a time: whether both are named, and nothing else.
fn two<'a>(score: &mut Score, of_two: impl Iterator<Item = Pair<'a>>) {
    let mut wrong_names = Vec::new();
    for (truth, answer) in of_two {
        let known = truth.effects.iter().all(|effect| answer.status_of(&effect.id).is_some());
        if !known {
            continue;
        }
        let is_true = |id: &String| truth.effects.iter().any(|effect| effect.id == *id);
        let wrong = answer.findings.iter().filter(|finding| !is_true(&finding.id)).count();
        let right = truth.effects.iter().filter(|effect| answer.findings.iter().any(|finding| finding.id == effect.id)).count();
        score.two_exact.count(wrong == 0 && right == truth.effects.len());
        wrong_names.push(wrong as f64);
    }
    score.two_false = mean(&wrong_names);
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn nulls(score: &mut Score, given: &[Pair]) {
    let mut kinds: BTreeMap<(Family, String), NullScore> = BTreeMap::new();
    let fresh = |label: &str| NullScore { label: label.to_owned(), named: Rate::default(), alarmed: Rate::default() };
    for (truth, answer) in given {
        let total = match truth.family {
            Family::Null => 0,
            Family::HardNull => 1,
            _ => continue,
        };
        let trap = truth.trap.and_then(|trap| serde_json::to_value(trap).ok()?.as_str().map(str::to_owned));
        let label = trap.unwrap_or_else(|| format!("plain, {}", truth.setup));
        let kind = kinds.entry((truth.family, label.clone())).or_insert_with(|| fresh(&label));
        let total = score.null_totals[total].get_or_insert_with(|| fresh(if total == 0 { "all plain nulls" } else { "all hard nulls" }));
        for counted in [kind, total] {
            counted.named.count(!answer.findings.is_empty());
            counted.alarmed.count(alarmed(answer));
        }
    }
    score.nulls = kinds.into_values().collect();
}

fn ladders<'a>(score: &mut Score, given: impl Iterator<Item = Pair<'a>>) {
    let mut ladders: BTreeMap<String, Ladder> = BTreeMap::new();
    score.all_ladders = Ladder { label: "all that the program knows".to_owned(), known: true, ..Ladder::default() };
    for (truth, answer) in given {
        let Some(effect) = truth.effects.first() else { continue };
        let ladder = ladders.entry(effect.label.clone()).or_default();
        ladder.label.clone_from(&effect.label);
        let known = answer.status_of(&effect.id).is_some();
        ladder.known |= known;
        let named = first_name(answer) == Some(&effect.id);
        ladder.add(effect.multiple, alarmed(answer), named);
        if known {
            score.all_ladders.add(effect.multiple, alarmed(answer), named);
        }
    }
    score.ladders = ladders.into_values().collect();
    for ladder in score.ladders.iter_mut().chain([&mut score.all_ladders]) {
        ladder.finish();
    }
}

fn confusers<'a>(score: &mut Score, given: impl Iterator<Item = Pair<'a>>) {
    let mut cases: BTreeMap<(String, u32), (ConfuserScore, f64)> = BTreeMap::new();
    for (truth, answer) in given {
        let Some(effect) = truth.effects.first() else { continue };
        if answer.status_of(&effect.id).is_none() {
            continue;
        }
        let (rival, cos) = most_alike(answer, effect).unwrap_or(("", 0.0));
        let fresh = || {
            let score = ConfuserScore {
                label: effect.label.clone(),
                rival: rival.to_owned(),
                cos: 0.0,
                snr: effect.snr.round(),
                named: Rate::default(),
                in_set: Rate::default(),
                expected: 0.0,
            };
            (score, 0.0)
        };
        let (case, count) = cases.entry((effect.label.clone(), effect.snr.round() as u32)).or_insert_with(fresh);
        case.named.count(first_name(answer) == Some(&effect.id));
        case.in_set.count(in_set(answer, &effect.id));
        case.cos += cos;
        case.expected += Normal::standard().cdf(effect.snr * ((1.0 - cos) / 2.0).sqrt());
        *count += 1.0;
    }
    score.confusers =
        cases.into_values().map(|(case, count)| ConfuserScore { cos: case.cos / count, expected: case.expected / count, ..case }).collect();
}

fn off_library<'a>(score: &mut Score, given: impl Iterator<Item = Pair<'a>>) {
    let mut cases: BTreeMap<(String, u32), OffLibraryScore> = BTreeMap::new();
    for (truth, answer) in given {
        let Some(effect) = truth.effects.first() else { continue };
        let fresh = || OffLibraryScore {
            label: effect.label.clone(),
            snr: effect.snr.round(),
            found: Rate::default(),
            misnamed: Rate::default(),
            located: Rate::default(),
        };
        let case = cases.entry((effect.label.clone(), effect.snr.round() as u32)).or_insert_with(fresh);
        let misnamed = answer.verdict == "explained" && !answer.findings.is_empty();
        case.found.count(alarmed(answer));
        case.misnamed.count(misnamed);
        if alarmed(answer) {
            case.located.count(located(answer, effect));
        }
        let equal = most_alike(answer, effect).is_some_and(|(_, cos)| cos > EQUAL_TO_LIBRARY);
        if effect.snr >= OFF_LIBRARY_SNR && !equal {
            score.off_library_totals[0].count(!misnamed);
            score.off_library_totals[1].count(alarmed(answer));
        }
    }
    score.off_library = cases.into_values().collect();
}

/// What LASSO names, counted as the diagnosis is.
fn lasso(score: &mut Score, given: &[Pair]) {
    for (truth, answer) in given {
        let Some(names) = answer.rivals.as_ref().and_then(|rivals| rivals.lasso_names.as_ref()) else { continue };
        let known = truth.effects.iter().all(|effect| answer.status_of(&effect.id).is_some());
        let exact = names.len() == truth.effects.len() && truth.effects.iter().all(|effect| names.contains(&effect.id));
        match (truth.family, truth.effects.as_slice()) {
            (Family::Null, _) => score.lasso_null.count(!names.is_empty()),
            (Family::Ladder, [effect]) if known && effect.multiple >= JUDGE_NAME_FROM => {
                score.lasso_exact.count(exact);
                score.exact.count(answer.findings.len() == 1 && first_name(answer) == Some(&effect.id));
            }
            (Family::Two, [_, _]) if known => score.lasso_two.count(exact),
            _ => {}
        }
    }
}

fn pulls(score: &mut Score, given: &[Pair]) {
    let mut by_parameter: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (truth, answer) in given {
        // With something else hidden beside it, or with another's trap, errors are another matter.
        for effect in truth.effects.iter().filter(|effect| effect.multiple >= JUDGE_PLACE_FROM) {
            let Some(finding) = answer.findings.iter().find(|finding| finding.id == effect.id) else { continue };
            for parameter in &effect.parameters {
                let found = finding.parameters.iter().find(|found| found.name == parameter.name && found.sigma > 0.0);
                if let Some(found) = found {
                    let pull = (found.value - parameter.value) / found.sigma;
                    by_parameter.entry(format!("{}.{}", effect.id, parameter.name)).or_default().push(pull);
                }
            }
        }
    }
    let all: Vec<f64> = by_parameter.values().flatten().copied().collect();
    score.pulls = by_parameter.iter().map(|(label, pulls)| summary(label, pulls)).collect();
    score.all_pulls = summary("all", &all);
}

pub(super) fn summary(label: &str, pulls: &[f64]) -> Pulls {
    let mean = mean(pulls).unwrap_or_default();
    let variance = pulls.iter().map(|pull| (pull - mean).powi(2)).sum::<f64>() / (pulls.len() as f64 - 1.0).max(1.0);
    Pulls {
        label: label.to_owned(),
        count: pulls.len(),
        mean,
        sd: variance.sqrt(),
        within_1: Rate::of(pulls.iter().map(|pull| pull.abs() < 1.0)),
        within_2: Rate::of(pulls.iter().map(|pull| pull.abs() < 1.959_964)),
    }
}

/// The builds that answered; a page should have one.
fn versions<'a>(all: impl Iterator<Item = &'a str>) -> String {
    all.collect::<std::collections::BTreeSet<_>>().into_iter().collect::<Vec<_>>().join(" and ")
}

fn held_out(score: &mut Score, given: &[Pair]) {
    let mut by_label: BTreeMap<&str, Vec<[Option<f64>; 5]>> = BTreeMap::new();
    for (truth, answer) in given {
        let ([effect], Some(rivals)) = (truth.effects.as_slice(), answer.rivals.as_ref()) else { continue };
        if effect.multiple < JUDGE_NAME_FROM || truth.family == Family::OffLibrary {
            continue;
        }
        by_label.entry(&effect.label).or_default().push([
            Some(rivals.baseline),
            rivals.diagnosis,
            Some(rivals.radial_clipped),
            Some(rivals.polynomial),
            rivals.lasso,
        ]);
    }
    score.held_out = by_label
        .into_iter()
        .map(|(label, rows)| {
            let column = |k: usize| mean(&rows.iter().filter_map(|row| row[k]).collect::<Vec<_>>());
            HeldOutScore {
                label: label.to_owned(),
                count: rows.len(),
                before: column(0).unwrap_or(f64::NAN),
                after: column(1),
                radial_clipped: column(2),
                polynomial: column(3),
                lasso: column(4),
            }
        })
        .collect();
}
