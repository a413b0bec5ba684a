//! The tier of pixels: the same figures as of star lists, and how far the two tiers agree about the same world.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::count::{self, alarmed, first_name, summary};
use super::{Ladder, Pulls, Rate, Score};
use crate::blind::answer::{Answer, AnswerFinding};
use crate::blind::generate::Truth;
use crate::blind::pixels::Centres;

/// How far answers about pixels and about star lists agree, recording by recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Agreement {
    /// The same verdict.
    pub verdict: Rate,
    /// Something is said to be missing in both or in neither.
    pub detected: Rate,
    /// Said to be missing in the pixels alone, of all.
    pub pixels_alone: Rate,
    /// Said to be missing in the star lists alone, of all.
    pub lists_alone: Rate,
    /// The same first name, of those in which either has one.
    pub first_name: Rate,
    /// Where both have it: difference of each parameter of the hidden effect, pixels less lists, over both standard errors together.
    pub parameters: Pulls,
}

/// How the pixels led to control points.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WayOfPixels {
    /// Frames identified.
    pub frames: Rate,
    /// Stars painted alone that the diagnosis used under their names.
    pub stars: Rate,
    /// Star images used under the name of a star that is not there, of all that were used.
    pub wrong: Rate,
    /// Mean of the errors of measured centres over the declared ones.
    pub centre_mean: f64,
    /// Their standard deviation.
    pub centre_sd: f64,
    /// Within one declared standard error.
    pub centre_within_1: Rate,
    /// Beyond four.
    pub centre_beyond_4: Rate,
    /// Median of painting, measuring, identifying, diagnosing, s.
    pub seconds_by_step: [f64; 4],
}

/// The figures of the tier.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PixelScore {
    /// Of the answers about pixels.
    pub seen: Score,
    /// Of the answers about the same worlds as star lists.
    pub lists: Score,
    /// Both together.
    pub agreement: Agreement,
    /// From pixels to control points.
    pub way: WayOfPixels,
}

pub(super) fn score(pairs: &[(Truth, Answer)]) -> PixelScore {
    let as_lists = |truth: &Truth, answer: &Answer| {
        let family = truth.family.of_lists().unwrap_or(truth.family);
        (Truth { family, ..truth.clone() }, Answer { family, ..answer.clone() })
    };
    let seen: Vec<(Truth, Answer)> = pairs.iter().map(|(truth, answer)| as_lists(truth, answer)).collect();
    let twins = pairs.iter().filter_map(|(truth, answer)| Some(as_lists(truth, &answer.pixels.as_ref()?.lists)));
    let lists: Vec<(Truth, Answer)> = twins.collect();
    PixelScore { seen: count::score(&seen), lists: count::score(&lists), agreement: agreement(pairs), way: way(pairs) }
}

fn agreement(pairs: &[(Truth, Answer)]) -> Agreement {
    let mut agreement = Agreement::default();
    let mut differences = Vec::new();
    for (truth, seen) in pairs {
        let Some(lists) = seen.pixels.as_ref().map(|pixels| &pixels.lists).filter(|lists| lists.error.is_none()) else { continue };
        let (by_pixels, by_lists) = (alarmed(seen), alarmed(lists));
        agreement.verdict.count(seen.verdict == lists.verdict);
        agreement.detected.count(by_pixels == by_lists);
        agreement.pixels_alone.count(by_pixels && !by_lists);
        agreement.lists_alone.count(by_lists && !by_pixels);
        if first_name(seen).or(first_name(lists)).is_some() {
            agreement.first_name.count(first_name(seen) == first_name(lists));
        }
        for effect in &truth.effects {
            let of = |answer: &Answer| answer.findings.iter().find(|finding| finding.id == effect.id).cloned();
            if let (Some(a), Some(b)) = (of(seen), of(lists)) {
                differences.extend(apart(&a, &b));
            }
        }
    }
    agreement.parameters = summary("pixels less lists", &differences);
    agreement
}

/// Differences of the parameters that both have, in standard errors of the difference.
fn apart(a: &AnswerFinding, b: &AnswerFinding) -> Vec<f64> {
    let with = |name: &str| b.parameters.iter().find(|other| other.name == name && other.sigma > 0.0);
    a.parameters
        .iter()
        .filter(|one| one.sigma > 0.0)
        .filter_map(|one| with(&one.name).map(|other| (one.value - other.value) / one.sigma.hypot(other.sigma)))
        .collect()
}

fn way(pairs: &[(Truth, Answer)]) -> WayOfPixels {
    let mut way = WayOfPixels::default();
    let mut centres = Centres::default();
    let mut steps: [Vec<f64>; 4] = Default::default();
    for pixels in pairs.iter().filter_map(|(_, answer)| answer.pixels.as_ref()) {
        let add = |rate: &mut Rate, hits: usize, of: usize| *rate = Rate { hits: rate.hits + hits, of: rate.of + of };
        add(&mut way.frames, pixels.frames_identified, pixels.frames);
        add(&mut way.stars, pixels.stars_right, pixels.stars_painted);
        add(&mut way.wrong, pixels.stars_wrong, pixels.stars_right + pixels.stars_wrong);
        add(&mut way.centre_within_1, pixels.centres.within_1, pixels.centres.count);
        add(&mut way.centre_beyond_4, pixels.centres.beyond_4, pixels.centres.count);
        centres.count += pixels.centres.count;
        centres.sum += pixels.centres.sum;
        centres.square += pixels.centres.square;
        for (all, one) in steps.iter_mut().zip(pixels.seconds_by_step) {
            all.push(one);
        }
    }
    let count = centres.count.max(1) as f64;
    way.centre_mean = centres.sum / count;
    way.centre_sd = (centres.square / count - way.centre_mean.powi(2)).max(0.0).sqrt();
    way.seconds_by_step = steps.map(|mut all| {
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or_default()
    });
    way
}

/// The section of the page.
pub(super) fn section(score: &PixelScore) -> String {
    let mut text = String::new();
    let mut line = |words: &str| {
        let _ = writeln!(text, "{words}"); // writing to a String cannot fail
    };
    let (seen, lists, agreement, way) = (&score.seen, &score.lists, &score.agreement, &score.way);
    line("\n## Pixels\n");
    line(&format!(
        "{} recordings of frames of 512² in which the stars are painted (Gaussian images, photons, background, read noise, counts), {} without \
         an answer{}. Stars are found, measured and identified lost in space, as `boresight diagnose` does. Beside them the same worlds with \
         the same things hidden as star lists with normal errors. Hidden is where a star's image falls, in both; effects that act on pixels \
         are painted by the displacement that they make. Stars that shine into one another are painted too, and stand in no list.\n",
        seen.answers + seen.unanswered,
        seen.unanswered,
        seen.unanswered_reason.as_ref().map_or_else(String::new, |reason| format!(" (first reason: {reason})")),
    ));
    line(&format!(
        "Median {:.2} s, longest {:.2} s from painting to verdict; medians of painting {:.2} s, measuring {:.2} s, identifying {:.2} s, \
         diagnosing {:.2} s.\n",
        seen.seconds[0], seen.seconds[1], way.seconds_by_step[0], way.seconds_by_step[1], way.seconds_by_step[2], way.seconds_by_step[3],
    ));
    line("| figure | pixels | the same as star lists |");
    line("|---|---|---|");
    let null = |score: &Score| {
        score.null_totals[0]
            .as_ref()
            .map_or_else(|| ["–".to_owned(), "–".to_owned()], |total| [total.named.to_string(), total.alarmed.to_string()])
    };
    let pulls = |pulls: &Pulls| format!("{:+.2}, {:.2} ({})", pulls.mean, pulls.sd, pulls.count);
    let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| format!("{value:.2}"));
    let both = |figure: &dyn Fn(&Score) -> String| [figure(seen), figure(lists)];
    let rows = [
        ("a name in a null", both(&|score| null(score)[0].clone())),
        ("a null not \"consistent\"", both(&|score| null(score)[1].clone())),
        ("half detection, × what is just seen", both(&|score| number(score.all_ladders.half))),
        ("first name right, from 4 ×, cos < 0.9", both(&|score| score.named.to_string())),
        ("truth among the names", both(&|score| score.in_set.to_string())),
        ("not observable: said", both(&|score| score.absorbed_told.to_string())),
        ("not observable: nothing named", both(&|score| score.absorbed_quiet.to_string())),
        ("off library, SNR ≥ 15: not misnamed", both(&|score| score.off_library_totals[0].to_string())),
        ("off library, SNR ≥ 15: found", both(&|score| score.off_library_totals[1].to_string())),
        ("first covariate right, from 2 ×", both(&|score| score.located.to_string())),
        ("pulls: mean, sd", both(&|score| pulls(&score.all_pulls))),
        ("within 1σ", both(&|score| score.all_pulls.within_1.to_string())),
        ("within 1.96σ", both(&|score| score.all_pulls.within_2.to_string())),
    ];
    for (figure, [here, there]) in rows {
        line(&format!("| {figure} | {here} | {there} |"));
    }
    line("\n| agreement of pixels and star lists | |");
    line("|---|---|");
    for (figure, value) in [
        ("same verdict", agreement.verdict.to_string()),
        ("something missing: in both or in neither", agreement.detected.to_string()),
        ("something missing: in the pixels alone", agreement.pixels_alone.to_string()),
        ("something missing: in the star lists alone", agreement.lists_alone.to_string()),
        ("same first name, where either has one", agreement.first_name.to_string()),
        ("parameters, pixels less lists over both errors: mean, sd", pulls(&agreement.parameters)),
        ("frames identified", way.frames.to_string()),
        ("stars painted alone, used under their names", way.stars.to_string()),
        ("stars used that are not there", way.wrong.to_string()),
        (
            "errors of centres over the declared: mean, sd",
            format!("{:+.3}, {:.3} ({})", way.centre_mean, way.centre_sd, way.centre_within_1.of),
        ),
        ("errors of centres within 1σ", way.centre_within_1.to_string()),
        ("errors of centres beyond 4σ", way.centre_beyond_4.to_string()),
    ] {
        line(&format!("| {figure} | {value} |"));
    }
    line("\nDetected (first name right) of all, by pixels; then by star lists:\n");
    for words in ladders(&seen.ladders, &seen.all_ladders, &lists.ladders, &lists.all_ladders) {
        line(&words);
    }
    text
}

/// Two columns a rung: pixels, star lists.
fn ladders(seen: &[Ladder], all_seen: &Ladder, lists: &[Ladder], all_lists: &Ladder) -> Vec<String> {
    let multiples: Vec<f64> = all_seen.rungs.iter().map(|rung| rung.multiple).collect();
    let heads: Vec<String> = multiples.iter().map(|multiple| format!(" {multiple:.0} × | lists |")).collect();
    let mut lines = vec![format!("| effect |{}", heads.concat()), format!("|---|{}", "---|---|".repeat(multiples.len()))];
    let twins: BTreeMap<&str, &Ladder> = lists.iter().map(|ladder| (ladder.label.as_str(), ladder)).collect();
    let rows = seen.iter().map(|ladder| (ladder, twins.get(ladder.label.as_str()).copied())).chain([(all_seen, Some(all_lists))]);
    for (ladder, twin) in rows {
        let cell = |ladder: Option<&Ladder>, multiple: f64| {
            let rung = ladder.and_then(|ladder| ladder.rungs.iter().find(|rung| (rung.multiple / multiple - 1.0).abs() < 0.05));
            rung.map_or_else(String::new, |rung| format!("{} ({}) / {}", rung.detected.hits, rung.named.hits, rung.detected.of))
        };
        let cells: Vec<String> =
            multiples.iter().map(|multiple| format!(" {} | {} |", cell(Some(ladder), *multiple), cell(twin, *multiple))).collect();
        lines.push(format!("| {} |{}", ladder.label, cells.concat()));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::answer::AnswerParameter;

    fn finding(value: f64, sigma: f64) -> AnswerFinding {
        let parameter = AnswerParameter { name: "size".to_owned(), value, sigma };
        AnswerFinding {
            id: "shear".to_owned(),
            parameters: vec![parameter],
            located_by: Vec::new(),
            snr: 9.0,
            delta_chi2: 81.0,
            set: Vec::new(),
            held_out_chi2: BTreeMap::new(),
        }
    }

    #[test]
    fn differences_count_in_both_errors() {
        let [difference] = apart(&finding(5.0, 3.0), &finding(10.0, 4.0))[..] else { panic!("one parameter") };
        assert!((difference + 1.0).abs() < 1e-12, "{difference}");
        assert!(apart(&finding(5.0, 0.0), &finding(10.0, 4.0)).is_empty());
    }
}
