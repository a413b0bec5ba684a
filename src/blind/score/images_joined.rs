//! Scores of parts of a study, made on other machines or days, joined to the score of all.
//!
//! Counts and sums are those of all answers together; strengths of half detection are worked out anew. Medians of parts (times, and how much of a size
//! could be hidden) are averaged over the answers.

use std::collections::BTreeMap;

use super::images::{ImageLadder, ImageNullScore, ImageRung, ImageScore, Names, PLAIN_NULLS};
use super::images_held_out::HeldOutChi2;
use super::{Ladder, Pulls, Rate};
use crate::blind::BlindError;
use crate::statistics::order::{ascending, sort_by_key};

/// The score of all parts. Fails where they are of different seeds or programs, or hold the same recording.
pub fn joined(parts: &[ImageScore]) -> Result<ImageScore, BlindError> {
    let Some(first) = parts.first() else { return Ok(ImageScore::default()) };
    let mut all = ImageScore { version: first.version.clone(), seed: first.seed, ..ImageScore::default() };
    for part in parts {
        if part.seed != first.seed || part.version != first.version {
            let of = |score: &ImageScore| format!("seed {}, boresight {}", score.seed, score.version);
            return Err(BlindError::OtherStudy { one: of(first), other: of(part) });
        }
        for (family, indices) in &part.recordings {
            let known = all.recordings.entry(*family).or_default();
            if let Some(&index) = indices.iter().find(|index| !known.insert(**index)) {
                return Err(BlindError::Twice { family: family.name(), index });
            }
        }
        add(&mut all, part);
    }
    sort_by_key(&mut all.nulls, |own| (!own.is_of_plain(), own.is_total(), own.counts.label.clone()));
    for ladder in &mut all.ladders {
        ascending(&mut ladder.rungs, |rung| rung.multiple);
        let mut curve = Ladder::default();
        for rung in &ladder.rungs {
            (0..rung.of).for_each(|k| curve.add(rung.multiple, k < rung.detected, false));
        }
        curve.finish();
        ladder.half = curve.half;
    }
    sort_by_key(&mut all.ladders, |own| own.label.clone());
    sort_by_key(&mut all.pairs, |own| own.label.clone());
    sort_by_key(&mut all.groups, |own| own.label.clone());
    for pulls in [&mut all.pulls, &mut all.absent] {
        sort_by_key(pulls, |own| (own.label == "all", own.label.clone()));
    }
    sort_by_key(&mut all.held_out, HeldOutChi2::place);
    Ok(all)
}

impl ImageNullScore {
    fn is_total(&self) -> bool {
        self.counts.label.starts_with("all ")
    }

    fn is_of_plain(&self) -> bool {
        self.counts.label == PLAIN_NULLS || self.counts.label.starts_with("plain")
    }
}

fn add(all: &mut ImageScore, part: &ImageScore) {
    let share = part.answers as f64 / (all.answers + part.answers).max(1) as f64;
    all.seconds = [all.seconds[0] + share * (part.seconds[0] - all.seconds[0]), all.seconds[1].max(part.seconds[1])];
    all.answers += part.answers;
    add_names(&mut all.unanswered, &part.unanswered);
    for own in &part.nulls {
        let known = known_or_new(&mut all.nulls, own, |other| other.counts.label == own.counts.label);
        let Some(known) = known else { continue };
        add_rate(&mut known.counts.named, own.counts.named);
        add_rate(&mut known.counts.alarmed, own.counts.alarmed);
        add_names(&mut known.names, &own.names);
        add_names(&mut known.unexplained, &own.unexplained);
    }
    for own in &part.ladders {
        if let Some(known) = known_or_new(&mut all.ladders, own, |other| other.label == own.label) {
            add_ladder(known, own);
        }
    }
    let (sum, own) = (&mut all.pool, &part.pool);
    add_rate(&mut sum.first, own.first);
    add_rate(&mut sum.in_set, own.in_set);
    add_rate(&mut sum.first_of_cut, own.first_of_cut);
    add_rate(&mut sum.first_of_unjudged, own.first_of_unjudged);
    for (all, part) in [(&mut all.pairs, &part.pairs), (&mut all.groups, &part.groups)] {
        for own in part {
            let Some(known) = known_or_new(all, own, |other| other.label == own.label) else { continue };
            add_rate(&mut known.exact, own.exact);
            known.cosines += own.cosines;
            add_rate(&mut known.one, own.one);
            add_names(&mut known.wrong, &own.wrong);
        }
    }
    for (all, part) in [(&mut all.pulls, &part.pulls), (&mut all.absent, &part.absent)] {
        for own in part {
            if let Some(known) = known_or_new(all, own, |other| other.label == own.label) {
                add_pulls(known, own);
            }
        }
    }
    for own in &part.held_out {
        if let Some(known) = known_or_new(&mut all.held_out, own, |other| other.label == own.label) {
            known.add(own);
        }
    }
}

/// The one among all that is the same. Where there is none it is pushed as it is, and nothing is left to add.
fn known_or_new<'a, T: Clone>(all: &'a mut Vec<T>, own: &T, is_same: impl Fn(&T) -> bool) -> Option<&'a mut T> {
    let Some(place) = all.iter().position(is_same) else {
        all.push(own.clone());
        return None;
    };
    all.get_mut(place)
}

fn add_names(all: &mut Names, own: &BTreeMap<String, usize>) {
    for (name, count) in own {
        *all.entry(name.clone()).or_default() += count;
    }
}

fn add_rate(all: &mut Rate, own: Rate) {
    *all = Rate { hits: all.hits + own.hits, of: all.of + own.of };
}

fn add_ladder(all: &mut ImageLadder, own: &ImageLadder) {
    all.known |= own.known;
    all.snr_shares += own.snr_shares;
    all.sized += own.sized;
    for rung in &own.rungs {
        let is_same = |other: &ImageRung| (other.multiple / rung.multiple - 1.0).abs() < 0.05;
        let Some(known) = known_or_new(&mut all.rungs, rung, is_same) else { continue };
        let share = rung.of as f64 / (known.of + rung.of).max(1) as f64;
        known.reached += share * (rung.reached - known.reached);
        for (sum, count) in [
            (&mut known.of, rung.of),
            (&mut known.first, rung.first),
            (&mut known.in_set, rung.in_set),
            (&mut known.withheld, rung.withheld),
            (&mut known.silent, rung.silent),
            (&mut known.detected, rung.detected),
        ] {
            *sum += count;
        }
        add_names(&mut known.wrong, &rung.wrong);
    }
}

/// Mean and standard deviation of both (T. F. Chan, G. H. Golub & R. J. LeVeque, The American Statistician 37, 242 (1983)).
fn add_pulls(all: &mut Pulls, own: &Pulls) {
    let [a, b] = [all.count as f64, own.count as f64];
    let apart = own.mean - all.mean;
    let squares = all.sd.powi(2) * (a - 1.0).max(0.0) + own.sd.powi(2) * (b - 1.0).max(0.0) + apart * apart * a * b / (a + b);
    all.mean += apart * b / (a + b);
    all.sd = (squares / (a + b - 1.0).max(1.0)).sqrt();
    all.count += own.count;
    add_rate(&mut all.within_1, own.within_1);
    add_rate(&mut all.within_2, own.within_2);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::answer::{Answer, AnswerFinding, AnswerParameter, AnswerSize};
    use crate::blind::generate::images::IMAGE_KINDS;
    use crate::blind::generate::{Family, Truth, concealed};
    use crate::blind::score::image_score;
    use crate::catalog::Catalog;

    /// An answer that names the first effect in two of three cases, with a size that is off.
    fn answered(family: Family, index: u32) -> (Truth, Answer) {
        let truth = concealed(family, index, 5, Catalog::embedded()).truth;
        let mut answer = Answer::none(family, index, 5, String::new());
        (answer.error, answer.seconds, answer.verdict) = (None, 1.0, "consistent".to_owned());
        answer.held_out_by_channel.insert("flux".to_owned(), [1.0 + 0.01 * f64::from(index), 50.0 + f64::from(index)]);
        let finding = |id: &str| AnswerFinding {
            id: id.to_owned(),
            parameters: truth
                .effects
                .iter()
                .flat_map(|effect| &effect.parameters)
                .map(|own| parameter(&own.name, own.value, index))
                .collect(),
            located_by: Vec::new(),
            snr: 9.0,
            delta_chi2: 81.0,
            set: Vec::new(),
            held_out_chi2: [("flux".to_owned(), [2.0, 1.0 + 0.02 * f64::from(index % 7), 100.0 + f64::from(index)])].into(),
        };
        answer.not_found = vec![AnswerSize { id: "vignetting".to_owned(), parameter: parameter("loss", 0.1, index) }];
        if !index.is_multiple_of(3) {
            answer.findings = truth.effects.first().map_or_else(Vec::new, |effect| vec![finding(&effect.id)]);
            answer.verdict = "explained".to_owned();
        }
        if index.is_multiple_of(5) {
            answer.findings.push(finding("stray-light"));
        }
        (truth, answer)
    }

    fn parameter(name: &str, value: f64, index: u32) -> AnswerParameter {
        AnswerParameter { name: name.to_owned(), value: value + 0.1 * (f64::from(index % 11) - 4.0), sigma: 0.2 }
    }

    /// Numbers to nine digits, wherever they stand.
    fn round(value: &mut serde_json::Value) {
        match value {
            serde_json::Value::Number(number) if number.is_f64() => *value = format!("{:.9}", number.as_f64().unwrap()).into(),
            serde_json::Value::Array(all) => all.iter_mut().for_each(round),
            serde_json::Value::Object(all) => all.values_mut().for_each(round),
            _ => (),
        }
    }

    fn rounded(score: &ImageScore) -> String {
        let mut value = serde_json::to_value(score).unwrap();
        round(&mut value);
        serde_json::to_string_pretty(&value).unwrap()
    }

    #[test]
    fn scores_of_parts_are_the_score_of_all() {
        let kinds = IMAGE_KINDS.len() as u32;
        // Two effects, each twice at two strengths. Few, since what is just seen of each is worked out anew.
        let ladder =
            (0..6 * kinds).filter(|index| index % kinds < 2 && index / kinds % 4 < 2).map(|index| answered(Family::ImageLadder, index));
        let nulls = (0..4).map(|index| answered(Family::ImageNull, index));
        let hard = (0..9).step_by(4).map(|index| answered(Family::ImageHardNull, index));
        let two = (0..3).map(|index| answered(Family::ImageTwo, index));
        let several = (0..3).map(|index| answered(Family::ImageSeveral, 7 * index));
        let all: Vec<(Truth, Answer)> = ladder.chain(nulls).chain(hard).chain(two).chain(several).collect();
        let parts: Vec<ImageScore> = (0..3)
            .map(|part| image_score(&all.iter().enumerate().filter(|(k, _)| k % 3 == part).map(|(_, own)| own.clone()).collect::<Vec<_>>()))
            .collect();
        let mut whole = image_score(&all);
        let mut of_parts = joined(&parts).unwrap();
        // Medians of parts are no median of all.
        for ladder in whole.ladders.iter_mut().chain(&mut of_parts.ladders) {
            ladder.rungs.iter_mut().for_each(|rung| rung.reached = 1.0);
        }
        assert_eq!(rounded(&of_parts), rounded(&whole));
        assert_ne!(rounded(&parts[0]), rounded(&whole));
        // Of the plain nulls alone, though every answer has a size.
        assert_eq!(whole.absent.iter().map(|own| (own.label.as_str(), own.count)).collect::<Vec<_>>(), [("vignetting.loss", 4)]);
        let refused = |parts: &[ImageScore]| joined(parts).unwrap_err().to_string();
        let other = ImageScore { seed: 6, ..parts[1].clone() };
        assert!(refused(&[parts[0].clone(), other]).contains("seed 6"));
        // A part of all, and all: the first null of the part is in both.
        assert!(refused(&[whole, parts[1].clone()]).contains("recording 2 of image-null "));
    }
}
