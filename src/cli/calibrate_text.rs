//! Summary page of a calibration: camera, residuals, uncertainty, warnings. Fits a terminal of 100 columns.

use boresight::calibrate::{Calibration, Combination, ModelSelection, Status};
use boresight::report::table;

use super::pictures::{arcsec_per_px, significant};

/// Columns of a terminal.
const WIDTH: usize = 100;
/// Columns of the words on the left.
const LABEL: usize = 12;
/// The most combinations of parameters shown.
const MAX_COMBINATIONS: usize = 6;

/// The calibration as text; `calibration` in the columns of the images as stored.
pub(crate) fn text(calibration: &Calibration) -> String {
    let mut text = parameters(calibration) + "\n";
    text += &overview(calibration);
    if !calibration.combinations.is_empty() {
        text += "\n";
        text += &combinations(&calibration.combinations);
    }
    if let Some(selection) = &calibration.selection {
        text += "\n";
        text += &selected(selection);
    }
    // What stands under the table of combinations is not said twice.
    let said: Vec<&String> =
        calibration.combinations.iter().take(MAX_COMBINATIONS).filter_map(|combination| combination.sentence.as_ref()).collect();
    let warnings: Vec<&String> = calibration.warnings.iter().filter(|warning| !said.contains(warning)).collect();
    if !warnings.is_empty() {
        text += "\n";
    }
    for warning in warnings {
        text += &wrapped("warning:", warning, "warning: ".len());
    }
    text
}

/// The table of parameters.
fn parameters(calibration: &Calibration) -> String {
    let rows: Vec<Vec<String>> = calibration
        .parameters
        .iter()
        .map(|parameter| {
            let [value, sigma] = with_sigma(parameter.value, parameter.sigma);
            vec![parameter.name.clone(), value, format!("± {sigma}"), parameter.unit.clone()]
        })
        .collect();
    table(&["parameter", "value", "σ", "unit"], &rows)
}

/// How it was solved, from what, and how well it fits: one line each.
fn overview(calibration: &Calibration) -> String {
    let mut text = String::new();
    let mut line = |label: &str, words: &str| text += &wrapped(label, words, LABEL);

    let plural = |count: usize, what: &str| if count == 1 { format!("1 {what}") } else { format!("{count} {what}s") };
    let how = match calibration.status {
        Status::Converged => "converged in",
        Status::NotConverged => "NOT CONVERGED after",
    };
    let mut method = format!("{}, {how} {}", calibration.method.name(), plural(calibration.iterations.len(), "iteration"));
    if calibration.pairs > 0 {
        method += &format!(" over {}", plural(calibration.pairs, "pair"));
    }
    if calibration.seconds > 0.0 {
        method += &format!(", {} s", significant(calibration.seconds));
    }
    line("method", &method);
    line("physics", &if calibration.physics.is_empty() { "none".to_owned() } else { calibration.physics.join(", ") });

    let left_out: usize = calibration.left_out.iter().map(|group| group.points).sum();
    let mut images = format!(
        "{} used of {} offered: {}, {}; {} rejected",
        calibration.stars,
        calibration.stars_offered,
        plural(calibration.distinct_stars, "star"),
        plural(calibration.frames, "frame"),
        calibration.rejected.len()
    );
    if left_out > 0 {
        images += &format!(", {left_out} left out beforehand");
    }
    line("star images", &images);
    if let Some(anew) = calibration.reidentified {
        line(
            "identified",
            &format!(
                "anew with the improved camera in {}: {} changed, {} added, {} taken away",
                plural(anew.rounds, "round"),
                anew.changed,
                anew.added,
                anew.removed
            ),
        );
    }

    // The scale of the residuals themselves, where they have one; else that of the middle of the frame.
    let own = calibration.rms_px.zip(calibration.rms_arcsec).filter(|(px, _)| *px > 0.0).map(|(px, arcsec)| arcsec / px);
    let size = |px: Option<f64>, scale: Option<f64>| match (px, scale) {
        (None, _) => "unknown".to_owned(),
        (Some(px), None) => format!("{} px", significant(px)),
        (Some(px), Some(scale)) => format!("{} px ({} arcsec)", significant(px), significant(px * scale)),
    };
    line("rms", &format!("{} in sample, {} held out", size(calibration.rms_px, own), size(calibration.held_out_rms_px, own)));
    if let Some(noise) = calibration.noise {
        line(
            "noise",
            &format!(
                "floor {} px per axis beyond the stated errors; unit-weight variance {:.3}; predicted rms {} px",
                significant(noise.floor_px),
                noise.unit_weight_variance,
                significant(noise.predicted_rms_px)
            ),
        );
        line("wrong", &format!("{} % of the identifications, as the fit sees it", significant(100.0 * noise.wrong_share)));
    }
    let scale = arcsec_per_px(calibration);
    if let Some(sigma) = calibration.map_sigma_px {
        let over = calibration.lit.map_or_else(|| "the frame".to_owned(), |lit| lit.in_words());
        line("map", &format!("σ {} median over {over}, {} at most", size(Some(sigma.median), scale), size(Some(sigma.max), scale)));
    }
    if !calibration.gauge.is_empty() {
        line("gauge", &calibration.gauge);
    }
    text
}

/// The table of singular values, the worst first.
fn combinations(all: &[Combination]) -> String {
    let shown = &all[..all.len().min(MAX_COMBINATIONS)];
    let rows: Vec<[String; 3]> = shown
        .iter()
        .map(|combination| {
            let mut parts = String::new();
            for (name, share) in &combination.parameters {
                let part = format!("{name} {}{:.2}", if *share < 0.0 { "−" } else { "+" }, share.abs());
                if parts.chars().count() + part.chars().count() + 14 > WIDTH - 16 {
                    parts += " …";
                    break;
                }
                parts += if parts.is_empty() { "" } else { "  " };
                parts += &part;
            }
            [significant(combination.singular_value), significant(combination.sigma_px), parts]
        })
        .collect();
    let lines = table(&["singular value", "σ map / px", "combination, worst determined first"], &rows);
    let mut text = String::new();
    for (index, line) in lines.lines().enumerate() {
        text += line;
        text += "\n";
        if let Some(sentence) = index.checked_sub(2).and_then(|row| shown[row].sentence.as_ref()) {
            text += &wrapped("", sentence, LABEL);
        }
    }
    if all.len() > shown.len() {
        text += &format!("{} better determined ones follow in the file\n", all.len() - shown.len());
    }
    text
}

/// What the selection of parameters has tried.
fn selected(selection: &ModelSelection) -> String {
    let rows: Vec<Vec<String>> = selection
        .tried
        .iter()
        .map(|tried| {
            vec![
                tried.added.join(", "),
                signed(tried.delta_chi2),
                signed(tried.delta_bic),
                signed(tried.delta_aic),
                tried.held_out_rms_px.map_or_else(|| "–".to_owned(), significant),
                if tried.taken { "taken" } else { "left" }.to_owned(),
            ]
        })
        .collect();
    wrapped("model", &format!("begun with {}; a negative ΔBIC supports what was tried", selection.begun_with.join(", ")), LABEL)
        + &table(&["tried", "Δχ²", "ΔBIC", "ΔAIC", "held-out rms / px", ""], &rows)
}

/// A difference with its sign and one decimal.
fn signed(value: f64) -> String {
    let text = if value.abs() >= 1e6 { format!("{value:+.2e}") } else { format!("{value:+.1}") };
    text.replace('-', "−")
}

/// A word in front and text beside it, broken between words so that no line is wider than a terminal.
pub(super) fn wrapped(label: &str, words: &str, indent: usize) -> String {
    let mut lines = vec![format!("{label:<indent$}")];
    let mut empty = true;
    for word in words.split_whitespace() {
        if let Some(line) = lines.last_mut()
            && (empty || line.chars().count() + 1 + word.chars().count() <= WIDTH)
        {
            *line += if empty { "" } else { " " };
            *line += word;
        } else {
            lines.push(" ".repeat(indent) + word);
        }
        empty = false;
    }
    lines.iter().map(|line| line.trim_end().to_owned() + "\n").collect()
}

/// A value and its standard error with as many digits as the error deserves.
pub(super) fn with_sigma(value: f64, sigma: f64) -> [String; 2] {
    if value != 0.0 && value.abs() < 1e-3 {
        return [format!("{value:.4e}"), format!("{sigma:.1e}")];
    }
    let digits = if sigma > 0.0 { (1.0 - sigma.log10().floor()).clamp(0.0, 8.0) as usize } else { 3 };
    [format!("{value:.digits$}"), format!("{sigma:.digits$}")]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_broken_between_words() {
        let words = "a word and ".repeat(30);
        let text = wrapped("noise", &words, LABEL);
        assert!(text.lines().count() > 3 && text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(text.starts_with("noise       a word") && text.lines().skip(1).all(|line| line.starts_with("            ")), "{text}");
        assert_eq!(text.split_whitespace().count(), 91, "no word is lost");
        assert_eq!(wrapped("x", "", 4), "x\n");
    }

    #[test]
    fn combinations_are_listed_worst_first_with_their_sentence() {
        let combination = |sigma_px: f64, sentence: Option<&str>| Combination {
            singular_value: 0.141,
            sigma_px,
            parameters: vec![("x0".to_owned(), -0.8), ("p1".to_owned(), 0.6)],
            sentence: sentence.map(str::to_owned),
        };
        let mut all = vec![combination(5.03, Some("x0 and p1 cannot be separated well here"))];
        all.extend((0..9).map(|k| combination(0.01 / f64::from(k + 1), None)));
        let text = combinations(&all);
        assert!(text.contains("0.141") && text.contains("5.03  x0 −0.80  p1 +0.60\n"), "{text}");
        assert!(text.contains("            x0 and p1 cannot be separated"), "{text}");
        assert!(text.ends_with("4 better determined ones follow in the file\n"), "{text}");
    }

    #[test]
    fn the_selection_says_what_was_tried() {
        let candidate = boresight::calibrate::Candidate {
            added: vec!["p1".to_owned(), "p2".to_owned()],
            delta_chi2: -312.44,
            delta_bic: -298.0,
            delta_aic: -308.44,
            held_out_rms_px: Some(0.0967),
            taken: true,
        };
        let refused = boresight::calibrate::Candidate { delta_bic: 6.5, held_out_rms_px: None, taken: false, ..candidate.clone() };
        let text = selected(&ModelSelection { begun_with: vec!["f".to_owned()], tried: vec![candidate, refused] });
        assert!(text.contains("p1, p2  −312.4  −298.0  −308.4             0.0967  taken"), "{text}");
        assert!(text.contains("+6.5") && text.contains("left"), "{text}");
    }
}
