//! The figures of what is hidden in pixels, as a page of Markdown.

use std::fmt::Write as _;

use super::Rate;
use super::images::{ImagePairScore, ImageRung, ImageScore, Names};
use crate::statistics::order::sort_by_key;

/// The page; `commit` is the program's.
#[must_use]
pub fn image_markdown(score: &ImageScore, commit: &str) -> String {
    let mut page = String::new();
    head(&mut page, score, commit);
    nulls(&mut page, score);
    ladders(&mut page, score);
    pool(&mut page, score);
    pairs(&mut page, score);
    groups(&mut page, score);
    pulls(&mut page, score);
    held_out(&mut page, score);
    page
}

fn line(page: &mut String, text: &str) {
    let _ = writeln!(page, "{text}"); // writing to a String cannot fail
}

fn names(names: &Names) -> String {
    most_frequent(names, usize::MAX)
}

/// The most frequent of them, and how often there were others.
fn most_frequent(names: &Names, most: usize) -> String {
    let mut all: Vec<(&String, &usize)> = names.iter().collect();
    sort_by_key(&mut all, |(_, count)| std::cmp::Reverse(**count));
    let others: usize = all.iter().skip(most).map(|(_, count)| **count).sum();
    let told = all.into_iter().take(most).map(|(name, count)| format!("{name} {count}"));
    let told: Vec<String> = told.chain((others > 0).then(|| format!("others {others}"))).collect();
    if told.is_empty() { "–".to_owned() } else { told.join(", ") }
}

fn head(page: &mut String, score: &ImageScore, commit: &str) {
    line(page, "# Effects concealed in pixels\n");
    let unanswered: usize = score.unanswered.values().sum();
    let reasons = if unanswered == 0 { String::new() } else { format!(" ({})", names(&score.unanswered)) };
    line(
        page,
        &format!(
            "Written by `boresight blind score-images`; seed {}, commit {commit}, answered by boresight {}; {} answers, {unanswered} recordings without \
             one{reasons}. Median {:.1} s, longest {:.1} s a recording.\n",
            score.seed, score.version, score.answers, score.seconds[0], score.seconds[1],
        ),
    );
    line(
        page,
        "Frames of 512 × 512 pixels are painted with a star image (Gaussian core, Moffat wings), a sky and a detector of the generator's own, and with effects \
         from the equations of the literature; the whole program then works on them as `boresight diagnose` does. Strengths are multiples of what is just seen, \
         a signal-to-noise ratio of 5 by Fisher information (reckoned by *stamps*, *background* or *noise*; nuisances are each star's place, background and \
         width, the error of its magnitude in the catalogue, each frame's zero point, the mean width, the wings of the image), or *steps* of a physical unit where no such figure is simple. Shares of sizes that had to be cut, \
         because more would be no camera's, stand as \"reached\". Jitter is hidden in space alone: on the ground seeing, haze and dew do the same.\n",
    );
}

fn nulls(page: &mut String, score: &ImageScore) {
    if score.nulls.is_empty() {
        return;
    }
    line(page, "## Nulls\n");
    line(page, "`clouds` is the right name of frames behind clouds, and no false one.\n");
    line(page, "| kind | a false name | not \"consistent\" | names | unexplained |");
    line(page, "|---|---|---|---|---|");
    for own in &score.nulls {
        let counts = &own.counts;
        line(
            page,
            &format!(
                "| {} | {} | {} | {} | {} |",
                counts.label,
                counts.named,
                counts.alarmed,
                names(&own.names),
                most_frequent(&own.unexplained, 3)
            ),
        );
    }
    line(page, "");
}

fn cell(rung: &ImageRung) -> String {
    let reached = if rung.reached < 0.9 { format!(" (reached {:.1})", rung.reached) } else { String::new() };
    format!("{} · {} · {} · {} / {}{reached}", rung.first, rung.in_set, rung.withheld, rung.silent, rung.of)
}

fn ladders(page: &mut String, score: &ImageScore) {
    if score.ladders.is_empty() {
        return;
    }
    line(page, "## Ladders: right name first · right name printed · withheld · silent / all\n");
    line(
        page,
        "Half detection: the strength at which half of the recordings are called anything but consistent, interpolated in the logarithm of the \
         strength: none at 1 × and all at 2 × give 1.41, wherever between them it is. SNR found / hidden: the root of \
         the fall of χ² over the hidden signal-to-noise ratio, mean of what is named from 4 × on; below one the program uses less than the pixels hold.\n",
    );
    let mut multiples: Vec<f64> = score.ladders.iter().flat_map(|ladder| &ladder.rungs).map(|rung| rung.multiple).collect();
    multiples.sort_by(f64::total_cmp);
    multiples.dedup();
    let columns: Vec<String> = multiples.iter().map(|multiple| format!("{multiple:.0} ×")).collect();
    line(page, &format!("| hidden | reckoned by | {} | half detection | SNR found / hidden | wrong names |", columns.join(" | ")));
    line(page, &format!("|---|---|{}---|---|---|", "---|".repeat(columns.len())));
    for ladder in &score.ladders {
        let of =
            |multiple: &f64| ladder.rungs.iter().find(|rung| (rung.multiple / multiple - 1.0).abs() < 0.05).map_or_else(String::new, cell);
        let cells: Vec<String> = multiples.iter().map(of).collect();
        let mut wrong = Names::new();
        for (name, count) in ladder.rungs.iter().flat_map(|rung| &rung.wrong) {
            *wrong.entry(name.clone()).or_default() += count;
        }
        let reckoned = serde_json::to_value(ladder.reckoned).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default();
        let unknown = if ladder.known { "" } else { " *(not judged)*" };
        let share = if ladder.sized > 0 { format!("{:.2}", ladder.snr_shares / ladder.sized as f64) } else { "–".to_owned() };
        let half = ladder.half.map_or_else(|| "–".to_owned(), |half| format!("{half:.2}"));
        line(page, &format!("| {}{unknown} | {reckoned} | {} | {half} | {share} | {} |", ladder.label, cells.join(" | "), names(&wrong)));
    }
    line(page, "");
}

fn pool(page: &mut String, score: &ImageScore) {
    if score.ladders.is_empty() {
        return;
    }
    let own = &score.pool;
    line(page, "## All ladders, from 4 × on\n");
    line(page, "| | of the recordings |");
    line(page, "|---|---|");
    for (what, rate) in [
        ("right name first", own.first),
        ("right name printed, where any name is", own.in_set),
        ("right name first where the size had to be cut", own.first_of_cut),
        ("right name first where the effect is not judged", own.first_of_unjudged),
    ] {
        line(page, &format!("| {what} | {rate} |"));
    }
    line(page, "");
}

fn pairs(page: &mut String, score: &ImageScore) {
    if score.pairs.is_empty() {
        return;
    }
    line(page, "## Two at once\n");
    if score.pairs.iter().all(|pair| pair.cosines == 0.0) {
        line(page, "| hidden | exactly the two | at least one | wrong names |");
        line(page, "|---|---|---|---|");
        for pair in &score.pairs {
            line(page, &format!("| {} | {} | {} | {} |", pair.label, pair.exact, pair.one, names(&pair.wrong)));
        }
    } else {
        pairs_with_cosines(page, score);
    }
    line(page, "");
}

fn groups(page: &mut String, score: &ImageScore) {
    if score.groups.is_empty() {
        return;
    }
    line(page, "## Several at once\n");
    line(page, "Each is sized beside those before it.\n");
    line(page, "| hidden | exactly these | at least one | wrong names |");
    line(page, "|---|---|---|---|");
    for group in &score.groups {
        line(page, &format!("| {} | {} | {} | {} |", group.label, group.exact, group.one, names(&group.wrong)));
    }
    line(page, &format!("| all | {} | | |", of_all(&score.groups)));
    line(page, "");
}

/// All that is hidden is named, and nothing else: of all recordings.
fn of_all(groups: &[ImagePairScore]) -> Rate {
    groups.iter().fold(Rate::default(), |sum, own| Rate { hits: sum.hits + own.exact.hits, of: sum.of + own.exact.of })
}

fn pairs_with_cosines(page: &mut String, score: &ImageScore) {
    line(
        page,
        "The cosine is that between what the two change in the stamps of stars, with nuisances taken out, without its sign: beside the other each is seen with \
         √(1 − cos²) of its own signal-to-noise ratio. Effects of which one is not told by stamps have none. The second is sized beside the first.\n",
    );
    line(page, "| hidden | cosine | exactly the two | at least one | wrong names |");
    line(page, "|---|---|---|---|---|");
    for pair in &score.pairs {
        let mean = pair.cosines / pair.exact.of.max(1) as f64;
        let cosine = if mean > 0.0 { format!("{mean:.2}") } else { "–".to_owned() };
        line(page, &format!("| {} | {cosine} | {} | {} | {} |", pair.label, pair.exact, pair.one, names(&pair.wrong)));
    }
    line(page, &format!("| all | | {} | | |", of_all(&score.pairs)));
}

fn pulls(page: &mut String, score: &ImageScore) {
    const FOUND: &str = "Of the recordings in which all that is hidden is named, be it one effect or several.\n";
    const ABSENT: &str = "Standard normal numbers are due where an effect has one shape and its parameter is linear. Of several shapes the largest is told, of a \
        variance the root; and zero is not the truth of a ratio, and of refraction and aberration, which the model has.\n";
    let tables = [
        (&score.pulls, "(found − true)/σ, from 2 × on, where both are the same parameter", FOUND),
        (&score.absent, "found/σ of effects that are not found, of plain nulls", ABSENT),
    ];
    for (pulls, title, remark) in tables.into_iter().filter(|(pulls, ..)| !pulls.is_empty()) {
        line(page, &format!("## Parameters: {title}\n"));
        if !remark.is_empty() {
            line(page, remark);
        }
        line(page, "| parameter | number | mean | sd | within 1σ | within 1.96σ |");
        line(page, "|---|---|---|---|---|---|");
        for own in pulls {
            let figures = format!("{} | {:+.2} | {:.2} | {} | {}", own.count, own.mean, own.sd, own.within_1, own.within_2);
            line(page, &format!("| {} | {figures} |", own.label));
        }
        line(page, "");
    }
}

fn held_out(page: &mut String, score: &ImageScore) {
    if score.held_out.is_empty() {
        return;
    }
    line(page, "## Held out: χ² per degree of freedom of a finding's own channels, from 2 × on, where the name is right\n");
    line(
        page,
        "Effects are chosen and sized, and the noise is found, without a third of the frames and a third of the stars; those stars in those frames are \
         scored.\n",
    );
    line(page, "| hidden | recordings | degrees of freedom | without the finding | with all that was found |");
    line(page, "|---|---|---|---|---|");
    for own in &score.held_out {
        line(page, &format!("| {} | {} | {:.0} | {:.3} | {:.3} |", own.label, own.recordings, own.dof, own.before, own.after));
    }
}
