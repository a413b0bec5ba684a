//! Summary page of a diagnosis: sentences and one table. Fits a terminal of 100 columns.

use std::collections::BTreeMap;

use boresight::diagnose::{Bound, Diagnosis, EffectState, EffectStatus, Finding, FitQuality, FoundParameter, Rival, Unknown, Verdict};
use boresight::report::table;
use boresight::statistics::order::sort_by;

use super::calibrate_text::{with_sigma, wrapped};
use super::pictures::{probability, significant};

/// Columns of the words on the left.
const LABEL: usize = 12;
/// Rejected rivals of a finding shown.
const MAX_RIVALS: usize = 3;
/// Covariates shown.
const MAX_LOCATED: usize = 5;

/// The page.
pub(crate) fn text(diagnosis: &Diagnosis) -> String {
    let verdict = match diagnosis.verdict {
        Verdict::Consistent => "CONSISTENT",
        Verdict::Explained => "EXPLAINED",
        Verdict::Unexplained => "UNEXPLAINED",
        Verdict::Undecided => "UNDECIDED",
    };
    let mut text = String::new();
    for (index, sentence) in diagnosis.summary.iter().enumerate() {
        text += &wrapped(if index == 0 { verdict } else { "" }, sentence, LABEL);
    }
    // What the summary says is not said twice.
    let said = |sentence: &str| diagnosis.summary.iter().any(|known| known.contains(sentence));
    for finding in &diagnosis.findings {
        text += "\n";
        let looks_alike = diagnosis.resimulated_p_value.is_some_and(|p| p >= DIFFERS);
        text += &found(finding, said(&finding.sentence), looks_alike);
    }
    for unknown in &diagnosis.unknown {
        text += "\n";
        text += &remainder(unknown, said(&unknown.sentence));
    }
    text += "\n";
    text += &overview(diagnosis);
    text += "\n";
    text += &effects(&diagnosis.effects);
    for warning in &diagnosis.warnings {
        text += &wrapped("warning:", warning, "warning: ".len());
    }
    text
}

/// A probability by chance: `p = 0.03`, or `p < 1e-6` where the simulations resolve no smaller one.
pub(super) fn chance(p: f64, is: Option<Bound>) -> String {
    match is {
        Some(Bound::Upper) => format!("p < {}", probability(p)),
        None => format!("p = {}", probability(p)),
    }
}

/// Below this the recording simulated anew with everything found is not like the real one.
const DIFFERS: f64 = 0.01;

/// A finding: its sentence, numbers, evidence and rivals. `looks_alike`: whether the whole recording, resimulated with the findings, agrees with the
/// real one.
fn found(finding: &Finding, is_said: bool, looks_alike: bool) -> String {
    let mut text = String::new();
    let mut line = |label: &str, words: &str| text += &wrapped(label, words, LABEL);
    let parameters: Vec<String> = finding.parameters.iter().map(measured).collect();
    line("found", &format!("{}: {}", finding.id, parameters.join(", ")));
    if !is_said {
        line("", &finding.sentence);
    }
    if let Some([amplitude, sigma]) = finding.known_amplitude {
        let [value, sigma] = with_sigma(amplitude, sigma);
        line("", &format!("{value} ± {sigma} of the size that is known"));
    }
    if !finding.located_by.is_empty() {
        line("  follows", &format!("the residuals follow {}", finding.located_by.join(", ")));
    }
    let [p_value, family] = [chance(finding.p_value, finding.p_value_is), chance(finding.family_p_value, finding.family_p_value_is)];
    if finding.chosen_again[1] == 0 {
        // What is counted has no size that could be tried elsewhere.
        line("  evidence", &format!("counted in all frames ({p_value}); nothing was held out"));
    } else {
        let (snr, held_out) = (significant(finding.snr), significant(finding.held_out_score));
        line(
            "  evidence",
            &format!("{snr} standard deviations on all frames ({p_value}; {family} family-wise), {held_out} on held-out images"),
        );
        line("  agreed", &agreement(finding, looks_alike));
    }
    let odds = |rival: &Rival| {
        let held = rival.held_out_delta_chi2.map_or_else(String::new, |held| format!(", held-out χ² falls by {held:.0}"));
        format!("{} (cosine {:.2}, ΔBIC {}{held})", rival.id, rival.cos, significant(rival.delta_bic))
    };
    if finding.indistinguishable_from.is_empty() {
        let rivals: Vec<String> = finding.rivals.iter().take(MAX_RIVALS).map(odds).collect();
        if !rivals.is_empty() {
            line("  not", &format!("these look alike and explain less: {}", rivals.join(", ")));
        }
    } else {
        let alike = |id: &String| finding.rivals.iter().find(|rival| rival.id == *id).map_or_else(|| id.clone(), odds);
        line("  or", &finding.indistinguishable_from.iter().map(alike).collect::<Vec<_>>().join(", "));
        if !finding.decided_by.is_empty() {
            line("  decided", &format!("by {}", finding.decided_by));
        }
    }
    text
}

/// Robustness of a finding: sign-flip test, selection again in the folds, resimulation.
fn agreement(finding: &Finding, looks_alike: bool) -> String {
    let signs = &finding.signs;
    let mut parts = match signs.p_value {
        Some(p) => vec![format!("sign-flip test over {}: p = {}", signs.units, probability(p))],
        // Brightness, shape and noise are not put to it.
        None if signs.units.is_empty() => Vec::new(),
        None => vec![format!("too few {} for a sign-flip test (effective number {:.0})", signs.units, signs.effective)],
    };
    if let Some(p) = signs.between_frames_p_value {
        parts.push(format!("against the scatter between frames: p = {}", probability(p)));
    }
    let [times, turns] = finding.chosen_again;
    parts.push(format!("selected again in {times} of {turns} folds, {} left out", finding.left_out));
    if let Some(p) = finding.resimulated_p_value.filter(|_| looks_alike) {
        parts.push(format!("resimulation with it agrees with the recording (p = {})", probability(p)));
    }
    parts.join("; ")
}

/// What is left and has no name.
fn remainder(unknown: &Unknown, is_said: bool) -> String {
    let mut text = String::new();
    let mut line = |label: &str, words: &str| text += &wrapped(label, words, LABEL);
    let follows = if unknown.located_by.is_empty() { "nothing that is known".to_owned() } else { unknown.located_by.join(", ") };
    let p = chance(unknown.p_value, unknown.p_value_is);
    line("unknown", &format!("something is left in {} ({p}); it follows {follows}", unknown.channel.words()));
    if !is_said {
        line("", &unknown.sentence);
    }
    if unknown.field.is_told() {
        line(
            "  map",
            &format!(
                "{} px rms, changes over {} px, {:.0} % of it without curl; on frames that it was not made of χ² falls by {} with it{}",
                significant(unknown.field.rms_px),
                significant(unknown.field.length_px),
                100.0 * unknown.field.curl_free_share,
                significant(unknown.field.held_out_delta_chi2),
                unknown.map.as_ref().map_or_else(String::new, |file| format!("; {file}"))
            ),
        );
    }
    if !unknown.resembles.is_empty() {
        let alike: Vec<String> = unknown.resembles.iter().map(|other| format!("{} (cosine {:.2})", other.id, other.cos)).collect();
        line("  resembles", &alike.join(", "));
    }
    for veto in &unknown.vetoes {
        line("  yet", veto);
    }
    text
}

/// What it was held against, what it could have shown, how it fits, what the residuals follow, and the noise: one line each.
fn overview(diagnosis: &Diagnosis) -> String {
    let mut text = String::new();
    let mut line = |label: &str, words: &str| text += &wrapped(label, words, LABEL);
    line("model", &if diagnosis.physics.is_empty() { "no physics".to_owned() } else { diagnosis.physics.join(", ") });
    let stars = diagnosis.stars_used;
    let mut images = format!("{} used", stars.with_proper_motion + stars.without);
    if stars.without > 0 {
        images += &format!(" ({} of stars without known proper motion)", stars.without);
    }
    let left_out: Vec<String> = diagnosis.unused.iter().map(|own| format!("{}, since {}", own.images, own.reason)).collect();
    if !left_out.is_empty() {
        images += &format!("; left out: {}", left_out.join("; "));
    }
    line("star images", &images);
    line("could show", &could_show(diagnosis));
    let (before, after) = (diagnosis.fit.baseline, diagnosis.fit.after);
    line("rms before", &quality(&before));
    line("rms after", &quality(&after));
    if let Some(expected) = before.expected_rms_px {
        line("expected", &format!("{} px of the errors that the measurement states", significant(expected)));
    }
    if !diagnosis.located.is_empty() {
        let located = |located: &boresight::diagnose::Located| {
            let mut p = chance(located.p_value, located.p_value_is);
            if let (Some(dealt), Some(unit)) = (located.permutation_p_value, &located.permuted) {
                p += &format!("; {} if {unit} are permuted", probability(dealt));
            }
            if let Some(alone) = located.conditional_p_value {
                p += &format!("; {} beside those before it", probability(alone));
            }
            format!("{} ({:.1} % of the variance, {p})", located.covariate, 100.0 * located.explained)
        };
        let shown: Vec<String> = diagnosis.located.iter().take(MAX_LOCATED).map(located).collect();
        line("followed", &format!("residuals of the baseline model follow {}", shown.join(", ")));
    }
    if let Some(halves) = &diagnosis.half_nights {
        let below = |limit: f64| halves.p_values.iter().filter(|p| **p < limit).count();
        let count = halves.p_values.len();
        line(
            "halves",
            &format!(
                "split-half validation with {count} splits: p below 0.01, 0.1, 0.5 in {}, {}, {}; KS distance from uniform {:.3}, as large in {:.0} % of simulated nights",
                below(0.01),
                below(0.1),
                below(0.5),
                halves.ks_distance,
                100.0 * halves.ks_p_value
            ),
        );
    }
    if let Some(p) = diagnosis.resimulated_p_value {
        line(
            "simulated",
            &if p < DIFFERS {
                format!("with the findings, the simulated recording differs significantly from the real one (p = {})", probability(p))
            } else {
                format!("with the findings, the simulated recording agrees with the real one (p = {})", probability(p))
            },
        );
    }
    let noise = diagnosis.noise;
    line(
        "noise",
        &format!(
            "{} px per axis beyond the stated errors, stated variances × {}; {} % of the identifications wrong{}{}",
            significant(noise.floor_px),
            significant(noise.variance_factor),
            significant(100.0 * noise.wrong_share),
            noise.measured.stamp_chi2_per_dof.map_or_else(String::new, |chi2| format!("; stamps χ²/dof {chi2:.2}")),
            noise.measured.background_ratio.map_or_else(String::new, |ratio| format!("; background {ratio:.2} × as declared"))
        ),
    );
    text
}

/// Which effects of ordinary size would have shown in the positions.
fn could_show(diagnosis: &Diagnosis) -> String {
    let all = &diagnosis.channels.astrometry.detectable;
    let of = |would_show: bool| -> Vec<&str> { all.iter().filter(|own| own.would_show == would_show).map(|own| own.id.as_str()).collect() };
    let (shown, hidden) = (of(true), of(false));
    let mut text =
        if shown.is_empty() { "no effect of ordinary size".to_owned() } else { format!("of ordinary size {}", shown.join(", ")) };
    if !hidden.is_empty() {
        text += &format!("; not {}", hidden.join(", "));
    }
    text
}

fn quality(fit: &FitQuality) -> String {
    let held_out = fit.held_out_rms_px.map_or_else(|| "none were left out to ask".to_owned(), |rms| format!("{} px", significant(rms)));
    let chi2 = fit.held_out_chi2_per_dof.map_or_else(String::new, |chi2| format!(" (χ²/dof {chi2:.3})"));
    format!("{} px (χ²/dof {:.3}); on frames not used {held_out}{chi2}", significant(fit.rms_px), fit.chi2_per_dof)
}

/// The table of what was tested, then what could not be.
fn effects(all: &[EffectStatus]) -> String {
    let order = |state: EffectState| match state {
        EffectState::Found => 0,
        EffectState::Indistinguishable => 1,
        EffectState::Withheld => 2,
        EffectState::NotFound => 3,
        EffectState::NotObservable => 4,
        EffectState::NotApplicable => 5,
    };
    let mut tested: Vec<&EffectStatus> = all.iter().filter(|effect| order(effect.status) < 4).collect();
    sort_by(&mut tested, |a, b| {
        let p = |effect: &EffectStatus| effect.p_value.unwrap_or(1.0);
        order(a.status).cmp(&order(b.status)).then(p(a).total_cmp(&p(b))).then(a.id.cmp(&b.id))
    });
    let rows: Vec<[String; 5]> = tested.iter().map(|effect| row(effect)).collect();
    let lines = table(&["effect", "p", "left", "parameter", "size or limit"], &rows);
    let mut text = wrapped(
        "",
        "p: probability by chance of as much, for this effect alone. left: share of its displacement that attitudes and camera do not take up. \
         size or limit: of the first parameter, ± its standard error, or the limit below which it is with 95 %.",
        0,
    );
    let mut state = None;
    for (index, line) in lines.lines().enumerate() {
        let effect = index.checked_sub(2).map(|row| tested[row]);
        if let Some(effect) = effect.filter(|effect| state != Some(effect.status)) {
            state = Some(effect.status);
            text += match effect.status {
                EffectState::Found => "found:\n",
                EffectState::Indistinguishable => "not told apart from what was found:\n",
                EffectState::Withheld => "withheld (significant, but the name does not stand):\n",
                _ => "not found:\n",
            };
        }
        text += line.trim_end();
        text += "\n";
        if let Some(effect) = effect.filter(|effect| !effect.reason.is_empty()) {
            text += &wrapped("", &effect.reason, LABEL);
        }
    }
    for (label, state) in [("not observable in this recording", EffectState::NotObservable), ("not applicable", EffectState::NotApplicable)]
    {
        let mut by_reason: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for effect in all.iter().filter(|effect| effect.status == state) {
            let share = effect.survival.map_or_else(String::new, |share| format!(" {}", significant(share)));
            by_reason.entry(&effect.reason).or_default().push(format!("{}{share}", effect.id));
        }
        if !by_reason.is_empty() {
            text += &format!("{label}:\n");
        }
        for (reason, ids) in by_reason {
            let reason = if reason.is_empty() { String::new() } else { format!(" – {reason}") };
            text += &wrapped(" ", &format!("{}{reason}", ids.join(", ")), 2);
        }
    }
    text
}

/// A line of the table.
fn row(effect: &EffectStatus) -> [String; 5] {
    let p = |p: f64| if effect.p_value_is.is_some() { format!("< {}", probability(p)) } else { probability(p) };
    let shown = if effect.upper_limit_95.is_some() { effect.parameters.first() } else { surest(&effect.parameters) };
    let size = match (&effect.upper_limit_95, shown) {
        (Some(limit), _) => format!("< {}", compact(limit.value)),
        (None, Some(shown)) => with_error(shown),
        (None, None) => "–".to_owned(),
    };
    [
        format!("  {}", effect.id),
        effect.p_value.map_or_else(|| "–".to_owned(), p),
        effect.survival.map_or_else(|| "–".to_owned(), |share| format!("{share:.2}")),
        shown.map_or_else(String::new, |parameter| parameter.name.clone()),
        size,
    ]
}

/// The parameter that is farthest from zero in its own errors; the first where that has none. Of a tilted focal surface the first, its curvature, may be none.
fn surest(parameters: &[FoundParameter]) -> Option<&FoundParameter> {
    let first = parameters.first()?;
    let score = |own: &FoundParameter| if own.sigma > 0.0 { (own.value / own.sigma).abs() } else { 0.0 };
    let others = parameters.iter().skip(1).filter(|_| first.sigma > 0.0);
    Some(others.fold(first, |best, own| if score(own) > score(best) { own } else { best }))
}

/// Three significant digits at most, short for small and large numbers alike.
fn compact(number: f64) -> String {
    if number != 0.0 && !(1e-3..1e5).contains(&number.abs()) { format!("{number:.1e}") } else { significant(number) }
}

/// Its value with its error; what was counted has none.
fn with_error(parameter: &FoundParameter) -> String {
    if parameter.sigma > 0.0 && parameter.sigma.is_finite() { parameter.value_and_error() } else { compact(parameter.value) }
}

/// `name = value ± sigma unit`, the unit where the name does not end with it.
pub(super) fn measured(parameter: &FoundParameter) -> String {
    let number = with_error(parameter);
    let is_named = parameter.name.split('_').any(|part| part == parameter.unit);
    let unit = if parameter.unit.is_empty() || is_named { String::new() } else { format!(" {}", parameter.unit) };
    format!("{} {number}{unit}", parameter.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(id: &str, status: EffectState, p_value: Option<f64>, reason: &str) -> EffectStatus {
        EffectStatus {
            id: id.to_owned(),
            status,
            p_value,
            p_value_is: None,
            score_sigma: None,
            held_out_delta_chi2: None,
            survival: Some(0.25),
            parameters: vec![FoundParameter { name: "x_px".into(), value: 0.0123, sigma: 0.004, unit: "px".into() }],
            upper_limit_95: (status == EffectState::NotFound).then(|| boresight::diagnose::Limit {
                name: "x_px".into(),
                value: 0.02,
                unit: "px".into(),
            }),
            reason: reason.to_owned(),
        }
    }

    #[test]
    fn the_parameter_that_is_shown_is_the_surest() {
        let parameter = |name: &str, value: f64, sigma: f64| FoundParameter { name: name.into(), value, sigma, unit: "px".into() };
        let of = |parameters: &[FoundParameter]| surest(parameters).map(|own| own.name.clone());
        assert_eq!(of(&[parameter("curvature", -0.03, 0.05), parameter("tilt", 0.02, 0.002)]).as_deref(), Some("tilt"));
        assert_eq!(of(&[parameter("lost_bits", 4.0, 0.0), parameter("other", 1.0, 0.1)]).as_deref(), Some("lost_bits"));
        assert_eq!(of(&[]), None);
        // A limit is that of the first.
        let mut own = status("psf-shape", EffectState::NotFound, Some(0.5), "");
        own.parameters.push(parameter("tilt", 1.0, 0.01));
        assert_eq!(row(&own)[3..], ["x_px".to_owned(), "< 0.0200".to_owned()]);
        own.upper_limit_95 = None;
        assert_eq!(row(&own)[3], "tilt");
    }

    #[test]
    fn findings_come_first_and_what_could_not_be_tested_last() {
        let all = [
            status("shear", EffectState::NotFound, Some(0.5), ""),
            status("tilt", EffectState::NotObservable, None, "attitudes take it up"),
            status("spiral", EffectState::NotFound, Some(0.01), "at the limit"),
            status("pressure-scale", EffectState::NotApplicable, None, "no pressure"),
            status("refraction", EffectState::Found, Some(1e-40), ""),
        ];
        let text = effects(&all);
        let at = |part: &str| text.find(part).unwrap_or_else(|| panic!("{part:?} is not in {text}"));
        assert!(at("refraction") < at("spiral") && at("spiral") < at("at the limit") && at("at the limit") < at("shear"), "{text}");
        assert!(at("shear") < at("not observable in this recording:\n  tilt 0.250 – attitudes take it up"), "{text}");
        assert!(at("not applicable:\n  pressure-scale 0.250 – no pressure") > at("tilt"), "{text}");
        assert!(text.contains("0.0123 ± 0.0040") && text.contains("found:\n  refraction"), "{text}");
        // Every column has a heading, and what stands in them is explained before.
        let heading = text.lines().find(|line| line.starts_with("effect")).unwrap();
        assert_eq!(heading.split("  ").filter(|part| !part.trim().is_empty()).count(), 5, "{heading}");
        assert!(at("left: share of its displacement") < at("found:") && text.contains("< 0.0200"), "{text}");
    }

    #[test]
    fn names_are_never_cut() {
        let mut long = status("charge-transfer-inefficiency", EffectState::NotFound, Some(0.5), "");
        long.parameters[0].name = "arcsec_per_mag_at_45deg_and_some_more".into();
        long.p_value_is = Some(Bound::Upper);
        assert!(effects(&[long]).contains(" arcsec_per_mag_at_45deg_and_some_more "));
    }

    #[test]
    fn what_is_not_resolved_is_a_bound() {
        assert_eq!(chance(1e-6, Some(Bound::Upper)), "p < 1e-6");
        assert_eq!(chance(0.25, None), "p = 0.250");
    }

    #[test]
    fn units_are_said_once() {
        let parameter = |name: &str, unit: &str| FoundParameter { name: name.into(), value: 55.2, sigma: 0.31, unit: unit.into() };
        assert_eq!(measured(&parameter("refraction_at_45deg_arcsec", "arcsec")), "refraction_at_45deg_arcsec 55.20 ± 0.31");
        assert_eq!(measured(&parameter("tilt", "rad")), "tilt 55.20 ± 0.31 rad");
        assert_eq!(measured(&parameter("amplitude", "")), "amplitude 55.20 ± 0.31");
    }
}
