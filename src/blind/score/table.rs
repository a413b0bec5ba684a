//! The figures of merit as a page of Markdown.

use std::fmt::Write as _;

use super::{NullScore, Rate, Score, pixels};

/// The page.
#[must_use]
pub fn markdown(score: &Score) -> String {
    let mut page = String::new();
    head(&mut page, score);
    merit(&mut page, score);
    nulls(&mut page, score);
    ladders(&mut page, score);
    confusers(&mut page, score);
    off_library(&mut page, score);
    pulls(&mut page, score);
    held_out(&mut page, score);
    if let Some(pixels) = &score.pixels {
        page += &pixels::section(pixels);
    }
    page
}

fn line(page: &mut String, text: &str) {
    let _ = writeln!(page, "{text}"); // writing to a String cannot fail
}

fn rate(rate: &Rate) -> String {
    rate.to_string()
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.filter(|value| value.is_finite()).map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
}

fn head(page: &mut String, score: &Score) {
    line(page, "# Concealed recordings\n");
    line(
        page,
        &format!(
            "Written by `boresight blind score`; seed {}, answered by boresight {}; {} answers, {} recordings without one{}. Shares stand with their \
             Wilson 95 % intervals. Strengths are multiples of what is just seen: 5σ after one free attitude for each frame and x0, y0, f, k1, \
             p1, p2. Median {:.2} s, longest {:.1} s a recording.\n",
            score.seed,
            score.version,
            score.answers,
            score.unanswered,
            score.unanswered_reason.as_ref().map_or_else(String::new, |reason| format!(" (first reason: {reason})")),
            score.seconds[0],
            score.seconds[1],
        ),
    );
    line(
        page,
        "What this proves: generator and diagnosis share no code, but both write down the same equations (an S-curve is a·sin 2πx for both, coma is (m − 5)·r·(u, v)), \
         the errors of star images are independent of each other and as declared, and the catalogue is exact. So the page says how well effects are found and \
         told apart where their equations hold and errors are independent. It does not say that the equations are those of a camera: what both have wrong \
         cannot show here, nor can errors that stars share. Real frames decide that.\n",
    );
}

fn merit(page: &mut String, score: &Score) {
    line(page, "## Figures of merit\n");
    line(page, "| figure | good | moonshot | here |");
    line(page, "|---|---|---|---|");
    let null = |total: &Option<NullScore>| total.as_ref().map_or_else(|| "–".to_owned(), |total| rate(&total.named));
    let rows: [(&str, &str, &str, String); 16] = [
        ("a name in a null", "≤ 1 %", "≤ 0.1 %", null(&score.null_totals[0])),
        ("a name in a hard null", "", "≤ 1 %", null(&score.null_totals[1])),
        ("half detection, × what is just seen", "≤ 1.5", "≤ 1.1", number(score.all_ladders.half, 2)),
        ("first name right, from 4 ×, cos < 0.9", "90 %", "99 %", rate(&score.named)),
        ("truth among the names", "95 %", "99.5 %", rate(&score.in_set)),
        ("names in a set, mean", "≤ 2", "≤ 1.2", number(score.set_size, 2)),
        ("needlessly \"indistinguishable\"", "", "", rate(&score.needless)),
        ("\"cannot tell\" said, cos > 0.95, SNR < 15", "80 %", "98 %", rate(&score.cannot_tell)),
        ("not observable: said", "90 %", "100 %", rate(&score.absorbed_told)),
        ("not observable: nothing named", "", "", rate(&score.absorbed_quiet)),
        ("two at once (SNR 7–15): exact pair", "80 %", "92 %", rate(&score.two_exact)),
        ("two at once: wrong names a recording", "", "", number(score.two_false, 3)),
        ("off library, SNR ≥ 15: not misnamed", "85 %", "98 %", rate(&score.off_library_totals[0])),
        ("off library, SNR ≥ 15: found", "80 %", "95 %", rate(&score.off_library_totals[1])),
        ("first covariate right, from 2 ×", "90 %", "99 %", rate(&score.located)),
        (
            "pulls: mean, sd",
            "± 0.1, 0.9–1.1",
            "± 0.03, 0.97–1.03",
            format!("{:+.2}, {:.2} ({})", score.all_pulls.mean, score.all_pulls.sd, score.all_pulls.count),
        ),
    ];
    for (figure, good, moonshot, here) in rows {
        line(page, &format!("| {figure} | {good} | {moonshot} | {here} |"));
    }
    line(page, &format!("| within 1σ | 68 ± 3 % | ± 1 % | {} |", rate(&score.all_pulls.within_1)));
    line(page, &format!("| within 1.96σ | 95 ± 3 % | ± 1 % | {} |", rate(&score.all_pulls.within_2)));
    for (label, named) in &score.natural {
        line(page, &format!("| left out at its natural size: {label} | | | {} |", rate(named)));
    }
    line(page, "");
    line(page, "LASSO on the same library (penalty by cross-validation over frames, one standard error), beside the diagnosis:\n");
    line(page, "| figure | diagnosis | LASSO |");
    line(page, "|---|---|---|");
    let rows = [
        ("a name in a null", null(&score.null_totals[0]), &score.lasso_null),
        ("one effect, from 4 ×: exactly it", rate(&score.exact), &score.lasso_exact),
        ("two at once: exactly the two", rate(&score.two_exact), &score.lasso_two),
    ];
    for (figure, here, lasso) in rows {
        line(page, &format!("| {figure} | {here} | {} |", rate(lasso)));
    }
    line(page, "");
}

fn nulls(page: &mut String, score: &Score) {
    line(page, "## Nulls\n");
    line(page, "| kind | a name | not \"consistent\" |");
    line(page, "|---|---|---|");
    for null in score.nulls.iter().chain(score.null_totals.iter().flatten()) {
        line(page, &format!("| {} | {} | {} |", null.label, rate(&null.named), rate(&null.alarmed)));
    }
    line(page, "");
}

fn ladders(page: &mut String, score: &Score) {
    line(page, "## Ladders: detected (first name right), of all\n");
    let multiples: Vec<f64> = score.all_ladders.rungs.iter().map(|rung| rung.multiple).collect();
    let multiples = if multiples.is_empty() {
        score.ladders.first().map_or_else(Vec::new, |l| l.rungs.iter().map(|r| r.multiple).collect())
    } else {
        multiples
    };
    let columns: Vec<String> = multiples.iter().map(|multiple| format!("{multiple:.1} ×")).collect();
    line(page, &format!("| effect | {} | half at |", columns.join(" | ")));
    line(page, &format!("|---|{}---|", "---|".repeat(columns.len())));
    for ladder in score.ladders.iter().chain([&score.all_ladders]) {
        let cells: Vec<String> = multiples
            .iter()
            .map(|multiple| {
                let rung = ladder.rungs.iter().find(|rung| (rung.multiple / multiple - 1.0).abs() < 0.05);
                rung.map_or_else(String::new, |rung| format!("{} ({}) / {}", rung.detected.hits, rung.named.hits, rung.detected.of))
            })
            .collect();
        let unknown = if ladder.known { "" } else { " *(not in this build)*" };
        line(page, &format!("| {}{unknown} | {} | {} |", ladder.label, cells.join(" | "), number(ladder.half, 2)));
    }
    line(page, "");
}

fn confusers(page: &mut String, score: &Score) {
    line(page, "## Effects that look alike\n");
    line(page, "\"Expected\" is Φ(SNR·√((1 − cos)/2)), the share of right names between two that both have one column.\n");
    line(page, "| hidden | most alike | cos | SNR | first name right | among the names | expected |");
    line(page, "|---|---|---|---|---|---|---|");
    for case in &score.confusers {
        line(
            page,
            &format!(
                "| {} | {} | {:.2} | {:.0} | {} | {} | {:.0} % |",
                case.label,
                case.rival,
                case.cos,
                case.snr,
                rate(&case.named),
                rate(&case.in_set),
                100.0 * case.expected
            ),
        );
    }
    line(page, "");
}

fn off_library(page: &mut String, score: &Score) {
    line(page, "## In no library\n");
    line(page, "| hidden | SNR | found | given a name without reservation | first covariate right |");
    line(page, "|---|---|---|---|---|");
    for case in &score.off_library {
        let cells = [rate(&case.found), rate(&case.misnamed), rate(&case.located)].join(" | ");
        line(page, &format!("| {} | {:.0} | {cells} |", case.label, case.snr));
    }
    line(page, "");
}

fn pulls(page: &mut String, score: &Score) {
    line(page, "## Parameters: (found − true)/σ\n");
    line(page, "| parameter | number | mean | sd | within 1σ | within 1.96σ |");
    line(page, "|---|---|---|---|---|---|");
    for pulls in score.pulls.iter().chain([&score.all_pulls]) {
        let cells = format!("{} | {:+.2} | {:.2}", pulls.count, pulls.mean, pulls.sd);
        line(page, &format!("| {} | {cells} | {} | {} |", pulls.label, rate(&pulls.within_1), rate(&pulls.within_2)));
    }
    line(page, "");
}

fn held_out(page: &mut String, score: &Score) {
    line(page, "## Held-out χ² per degree of freedom, from 4 × what is just seen\n");
    line(
        page,
        "Frames set aside, attitudes refitted; all judged by one function, plain χ² on the same star images under the errors that the generator \
         declared, which are the true ones. The diagnosis: the effects that it names, fitted on the other frames. Rivals: k2, k3 with outliers beyond \
         3.5σ clipped; a polynomial of the seventh degree; LASSO.\n",
    );
    line(page, "| hidden | recordings | camera alone | diagnosis | k2, k3, clipped | polynomial | LASSO |");
    line(page, "|---|---|---|---|---|---|---|");
    for row in &score.held_out {
        line(
            page,
            &format!(
                "| {} | {} | {:.3} | {} | {} | {} | {} |",
                row.label,
                row.count,
                row.before,
                number(row.after, 3),
                number(row.radial_clipped, 3),
                number(row.polynomial, 3),
                number(row.lasso, 3)
            ),
        );
    }
}
