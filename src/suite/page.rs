//! The page of a result: one HTML file without script and without any other file.

use super::junit::{measured_words, number, requirement_words};
use super::page_plot::sweep_plots;
use super::result::{CaseResult, CaseValueResult, RequirementResult, SuiteResult};
use super::suite_file::RequirementLevel;
use super::verdict::RequirementVerdict;
use crate::dataset::{base64, escaped};

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;max-width:64rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}\
    h1{font-size:1.6rem}h2{font-size:1.25rem;margin-top:2.4rem;border-top:1px solid #ddd;padding-top:1rem}h3{font-size:1rem;margin:1.2rem 0 .3rem}\
    table{border-collapse:collapse;width:100%}td,th{padding:.25rem .6rem;text-align:left;border-bottom:1px solid #ddd;vertical-align:top}\
    td.n,th.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}svg{max-width:100%;height:auto}code{background:#f3f3f3;padding:0 .2em}\
    .v{display:inline-block;min-width:6.6em;padding:0 .4em;border-radius:.25em;color:#fff;text-align:center;font-weight:600;font-size:.85em}\
    .PASS{background:#2a7f3f}.FAIL{background:#b3261e}.UNDECIDED{background:#8a6d00}.box{border-left:4px solid #b3261e;padding:.1rem .8rem;margin:.6rem 0;\
    background:#fbf3f2}.quiet{color:#666}figure{display:inline-block;margin:.4rem .8rem .4rem 0;max-width:30rem;vertical-align:top}\
    figure img{max-width:100%;display:block}figcaption{font-size:12px;color:#555}ul{margin:.3rem 0;padding-left:1.2rem}dt{font-weight:600}dd{margin:0 0 .4rem 1rem}";

/// A picture of a frame, by the folder of its files.
#[derive(Clone, Debug)]
pub struct FramePicture {
    /// The folder that [`super::result::WorstFrame`] names.
    pub folder: String,
    /// PNG.
    pub png: Vec<u8>,
}

/// The page. `commands` are those that lead to the result again.
#[must_use]
pub fn page(result: &SuiteResult, pictures: &[FramePicture], commands: &[String]) -> String {
    let [met, broken, undecided] = result.counts();
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>boresight test: {} {}</title><style>{STYLE}</style></head><body>\n<h1>{} {}</h1>\n\
         <p>The system under test is <b>{}</b>. {met} requirements are met, {broken} are broken, {undecided} are undecided. Suite <code>{}</code>, seed {}, boresight {}.</p>\n",
        result.verdict.word(),
        escaped(&result.suite),
        badge(result.verdict),
        escaped(&result.suite),
        escaped(&result.system),
        escaped(&result.suite),
        result.seed,
        escaped(&result.provenance.version),
    );
    page += &overview(result);
    if let Some(baseline) = &result.baseline {
        page += &format!("<h2>Against {}</h2>\n", escaped(&baseline.file));
        page += &if baseline.worse.is_empty() {
            "<p>Nothing became worse by more than its bounds.</p>\n".to_owned()
        } else {
            list(baseline.worse.iter().map(|own| own.sentence.as_str()))
        };
    }
    for case in &result.cases {
        page += &of_case(case, pictures);
    }
    page += &words();
    page += "<h2>To have it again</h2>\n";
    for command in commands {
        page += &format!("<p><code>{}</code></p>\n", escaped(command));
    }
    page += "</body></html>\n";
    page
}

fn badge(verdict: RequirementVerdict) -> String {
    format!("<span class=\"v {0}\">{0}</span>", verdict.word())
}

fn list<'a>(items: impl Iterator<Item = &'a str>) -> String {
    let lines: Vec<String> = items.map(|item| format!("<li>{}</li>", escaped(item))).collect();
    format!("<ul>{}</ul>\n", lines.concat())
}

/// A row for each case: its name, and its verdict at each value of the sweep.
fn overview(result: &SuiteResult) -> String {
    let mut text = "<table><tr><th>case<th>verdict<th class=\"n\">frames<th class=\"n\">right<th class=\"n\">wrong<th class=\"n\">none<th class=\"n\">boresight, p95</tr>\n".to_owned();
    for case in &result.cases {
        for value in &case.values {
            let measured = |name: &str| value.measured.iter().find(|own| own.metric == name).map(|own| own.value);
            let percent = |share: Option<f64>| share.map_or_else(|| "–".to_owned(), |share| format!("{:.1} %", 100.0 * share));
            let (right, wrong) = (measured("acquisition.correct_rate"), measured("acquisition.false_rate"));
            let none = right.zip(wrong).map(|(right, wrong)| 1.0 - right - wrong);
            let p95 = measured("attitude.cross_boresight_arcsec.p95").map_or_else(|| "–".to_owned(), |own| format!("{}″", number(own)));
            text += &format!(
                "<tr><td>{}{}<td>{}<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{}<td class=\"n\">{p95}</tr>\n",
                escaped(&case.name),
                if value.words.is_empty() { String::new() } else { format!(", {}", escaped(&value.words)) },
                badge(SuiteResult::verdict_of(&[CaseResult { values: vec![value.clone()], ..case.clone() }])),
                value.frames,
                percent(right),
                percent(wrong),
                percent(none.map(|none| none.max(0.0))),
            );
        }
    }
    text + "</table>\n"
}

fn of_case(case: &CaseResult, pictures: &[FramePicture]) -> String {
    let mut text = format!("<h2>{}</h2>\n", escaped(&case.name));
    if let Some(small) = &case.smallest_failure {
        text += &format!("<div class=\"box\"><p><b>{}.</b>", escaped(&small.sentence));
        if !small.superfluous.is_empty() {
            text += &format!(" Makes no difference: {}.", escaped(&small.superfluous.join(", ")));
        }
        if let Some(scene) = &small.scene {
            text += &format!(" <code>boresight simulate {} -o night</code> renders its worst frame.", escaped(scene));
        }
        text += "</p></div>\n";
    }
    text += &sweep_plots(case);
    for value in &case.values {
        text += &of_value(value, pictures);
    }
    text
}

fn of_value(value: &CaseValueResult, pictures: &[FramePicture]) -> String {
    let mut text = String::new();
    if !value.words.is_empty() {
        text += &format!("<h3>{}</h3>\n", escaped(&value.words));
    }
    if value.requirements.is_empty() {
        text += "<p class=\"quiet\">Nothing is required here.</p>\n";
    } else {
        text += "<table><tr><th>verdict<th>requirement<th>measured, with its bounds<th class=\"n\">of<th>why</tr>\n";
        text += &value.requirements.iter().map(row).collect::<String>();
        text += "</table>\n";
    }
    if !value.faults.is_empty() {
        text += &format!("<div class=\"box\">{}</div>\n", list(value.faults.iter().map(|fault| fault.sentence.as_str())));
    }
    for worst in &value.worst {
        let Some(picture) = pictures.iter().find(|picture| worst.folder.as_ref() == Some(&picture.folder)) else { continue };
        let [ra, dec, roll] = worst.radec_roll_deg;
        text += &format!(
            "<figure><img alt=\"frame {}\" src=\"data:image/png;base64,{}\"><figcaption>frame {}: {}. Truth: right ascension {ra:.4}°, declination {dec:.4}°, roll {roll:.3}°.\
             </figcaption></figure>\n",
            worst.frame,
            base64(&picture.png),
            worst.frame,
            escaped(&worst.answer)
        );
    }
    text
}

fn row(own: &RequirementResult) -> String {
    let level = if own.level == RequirementLevel::Minimum {
        String::new()
    } else {
        format!(" <span class=\"quiet\">({})</span>", own.level.word())
    };
    format!(
        "<tr><td>{}<td>{}{level}<td>{}<td class=\"n\">{}<td>{}</tr>\n",
        badge(own.verdict),
        escaped(&requirement_words(own)),
        escaped(&measured_words(own)),
        own.measured.as_ref().map_or(0, |own| own.units),
        escaped(&own.reasons.join(" "))
    )
}

/// The terms, for readers who did not write the suite.
fn words() -> String {
    const TERMS: [(&str, &str); 6] = [
        (
            "PASS, FAIL, UNDECIDED",
            "A requirement is met if the one-sided bound of its value, at the stated confidence, keeps the limit; broken if the opposite bound breaks it; else the frames do not tell.",
        ),
        ("right, wrong, none", "An attitude within the stated angles of the truth; another attitude; no attitude."),
        ("bias", "The size of the mean error: what all frames have in common (ECSS-E-ST-60-20C)."),
        (
            "FOV spatial error",
            "Standard deviation from field to field: distortion, and what else follows the stars that are seen (the same).",
        ),
        ("pixel spatial error", "Standard deviation over places within a pixel of one field: unevenness of pixels, S-curve (the same)."),
        ("temporal noise", "Standard deviation from exposure to exposure at one place (the same)."),
    ];
    let term = |(term, what): &(&str, &str)| format!("<dt>{term}</dt><dd>{what}</dd>");
    format!("<h2>Terms</h2>\n<dl>{}</dl>\n", TERMS.iter().map(term).collect::<String>())
}
