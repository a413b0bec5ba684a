//! `statistics.html`: what was asked for against what is there, in one file without any other. Drawn as SVG, with the same bytes everywhere.

use super::contact_sheet::{contact_sheet, escaped};
use super::drawn_shares::DrawnShares;
use super::error::DatasetError;
use super::shard_statistics::{FIRST_MAGNITUDE, FIRST_RATIO, PLACES, SKY, ShardStatistics};
use super::whole_dataset::WholeDataset;
use crate::statistics::significance::neg_ln_chi2_sf;

/// Colours of the splits: told apart by those who see no red or green, too (Okabe & Ito, 2008).
const COLOURS: [&str; 3] = ["#0072b2", "#e69f00", "#009e73"];
const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222;background:#fff}\
    h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.2rem}table{border-collapse:collapse}td,th{padding:.2rem .7rem;text-align:left;\
    border-bottom:1px solid #ddd;vertical-align:top}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}svg{max-width:100%;height:auto}\
    figure{display:inline-block;margin:.3rem}figure img{image-rendering:pixelated;display:block}figcaption{font-size:12px;color:#555}\
    .key{display:inline-block;width:.8em;height:.8em;margin:0 .3em 0 1em}.warn{color:#a00;font-weight:600}p.note{color:#555}";

/// A split with the sums over its frames.
struct SplitSums<'w> {
    name: &'w str,
    frames: u64,
    colour: &'static str,
    sums: ShardStatistics,
}

/// The page.
pub(super) fn statistics_page(whole: &WholeDataset<'_>) -> Result<String, DatasetError> {
    let dataset = whole.file;
    let mut splits: Vec<SplitSums<'_>> = Vec::new();
    let mut all = ShardStatistics::default();
    for (split, colour) in dataset.splits.iter().zip(COLOURS) {
        let mut sums = ShardStatistics::default();
        for (_, mark) in whole.marks.iter().filter(|(shard, _)| shard.split.name() == split.name) {
            sums.merge(&mark.statistics);
        }
        all.merge(&sums);
        splits.push(SplitSums { name: &split.name, frames: split.frames, colour, sums });
    }
    let name = escaped(&dataset.name);
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{name}: statistics</title>\
         <meta name=\"viewport\" content=\"width=device-width\"><style>{STYLE}</style></head><body>\n<h1>{name}</h1>\n\
         <p>{} frames, made by boresight {} with the seed {}. “Stars” are those of the catalogue that are visible: electrons of at least 5 times their \
         standard error, and the centre on the frame.</p>\n",
        dataset.frames(),
        dataset.version,
        dataset.seed
    );
    page += &overview(&splits);
    page += "<h2>What was drawn</h2>\n";
    page += &draws(&all.draws);
    page += "<h2>Stars in a frame</h2>\n";
    page += &legend(&splits);
    let counts = |bin: usize| if bin < 2 { bin.to_string() } else { format!("{}–{}", 1_u64 << (bin - 1), (1_u64 << bin) - 1) };
    page += &bars(&splits, "share of the frames, by their stars", &|sums| &sums.frames_by_stars, &counts);
    page += "<h2>How bright they are</h2>\n";
    let magnitudes = |bin: usize| format!("{:.1}", FIRST_MAGNITUDE + 0.5 * bin as f64);
    page += &bars(&splits, "share of the stars, by V magnitude (from)", &|sums| &sums.stars_by_magnitude, &magnitudes);
    let ratios = |bin: usize| format!("{}", FIRST_RATIO * f64::from(1_u32 << bin));
    page += &bars(&splits, "share of the stars, by signal-to-noise ratio (from)", &|sums| &sums.stars_by_snr, &ratios);
    page += "<h2>Where they are on the frame</h2>\n";
    page += &places(&all);
    page += "<h2>Where the camera points</h2>\n";
    page += &legend(&splits);
    page += &sky(&splits);
    page += &effects(&splits);
    page += "<h2>Some frames</h2>\n";
    page += &contact_sheet(whole)?;
    page += "</body></html>\n";
    Ok(page)
}

fn legend(splits: &[SplitSums<'_>]) -> String {
    let key = |split: &SplitSums<'_>| format!("<span class=\"key\" style=\"background:{}\"></span>{}", split.colour, split.name);
    format!("<p>{}</p>\n", splits.iter().map(key).collect::<String>())
}

fn overview(splits: &[SplitSums<'_>]) -> String {
    let mut text = "<table><tr><th>split<th class=\"n\">frames<th class=\"n\">stars<th class=\"n\">of a frame<th class=\"n\">saturated<th class=\"n\">blended\
                    <th class=\"n\">at the edge<th class=\"n\">frames without any<th class=\"n\">without on purpose<th class=\"n\">with false stars\
                    <th class=\"n\">of a pair</tr>\n"
        .to_owned();
    for SplitSums { name, frames, sums, .. } in splits {
        let stars: u64 = sums.stars_by_magnitude.iter().sum();
        let share = |part: u64| format!("{:.1} %", 100.0 * part as f64 / stars.max(1) as f64);
        let numbers = [
            frames.to_string(),
            stars.to_string(),
            format!("{:.1}", stars as f64 / (*frames).max(1) as f64),
            share(sums.saturated_stars),
            share(sums.blended_stars),
            share(sums.edge_stars),
            sums.frames_by_stars.first().copied().unwrap_or_default().to_string(),
            sums.no_star_frames.to_string(),
            sums.false_star_frames.to_string(),
            sums.paired_frames.to_string(),
        ];
        text += &format!("<tr><td>{name}<td class=\"n\">{}</tr>\n", numbers.join("<td class=\"n\">"));
    }
    text + "</table>\n"
}

/// Fewest values that are expected in a part for the test to hold.
const MIN_EXPECTED: f64 = 5.0;
/// A smaller probability is told in red.
const SUSPECT: f64 = 1e-4;

/// Pearson's test of the shares: the probability that chance makes a larger χ². `None`: too few values, or no share is known.
fn probability(draw: &DrawnShares) -> Option<f64> {
    let count = draw.count() as f64;
    let used: Vec<(f64, f64)> = draw
        .expected
        .iter()
        .zip(&draw.counts)
        .map(|(share, found)| (share * count, *found as f64))
        .filter(|(wanted, _)| *wanted > 0.0)
        .collect();
    if used.len() < 2 || used.iter().any(|(wanted, _)| *wanted < MIN_EXPECTED) {
        return None;
    }
    let chi2: f64 = used.iter().map(|(wanted, found)| (found - wanted).powi(2) / wanted).sum();
    Some((-neg_ln_chi2_sf((used.len() - 1) as f64, chi2)).exp())
}

fn draws(draws: &[DrawnShares]) -> String {
    if draws.is_empty() {
        return "<p>Nothing is drawn but noise.</p>\n".to_owned();
    }
    let mut text =
        "<table><tr><th>path<th>asked<th class=\"n\">values<th>got<th>shares, asked (line) and got<th class=\"n\">p</tr>\n".to_owned();
    for draw in draws {
        let count = draw.count();
        let got = if draw.expected.len() == 2 && draw.asked.starts_with("on with") {
            format!("on in {:.2} %", 100.0 * draw.counts[0] as f64 / count.max(1) as f64)
        } else if count == 0 {
            "nothing".to_owned()
        } else if draw.smallest == 0.0 && draw.largest == 0.0 {
            String::new()
        } else {
            format!("{:.6} to {:.6}, mean {:.6}", draw.smallest, draw.largest, draw.sum / count as f64)
        };
        let told = match probability(draw) {
            None => "–".to_owned(),
            Some(p) if p < SUSPECT => format!("<span class=\"warn\">{p:.1e}</span>"),
            Some(p) => format!("{p:.3}"),
        };
        text += &format!(
            "<tr><td>{}<td>{}<td class=\"n\">{count}<td>{got}<td>{}<td class=\"n\">{told}</tr>\n",
            escaped(&draw.path),
            escaped(&draw.asked),
            small_bars(draw)
        );
    }
    text + "</table>\n<p class=\"note\">Values are counted once for each camera, recording or frame that they are drawn for; of vectors the length. p: the probability that \
            chance alone gives shares as far from those asked for (Pearson's χ²); – where there are too few values, or none are known. Values that are spread \
            evenly have p near 1.</p>\n"
}

/// Shares in the parts of a draw.
fn small_bars(draw: &DrawnShares) -> String {
    let count = draw.count().max(1) as f64;
    if draw.expected.len() < 2 {
        return String::new();
    }
    let top = draw.expected.iter().copied().chain(draw.counts.iter().map(|found| *found as f64 / count)).fold(0.0, f64::max);
    let (width, height) = (150.0 / draw.expected.len() as f64, 36.0);
    let mut text = "<svg width=\"150\" height=\"38\" viewBox=\"0 0 150 38\" role=\"img\" aria-label=\"shares\">".to_owned();
    for (part, (share, found)) in draw.expected.iter().zip(&draw.counts).enumerate() {
        let (left, tall) = (width * part as f64, height * (*found as f64 / count) / top);
        let line = 37.0 - height * share / top;
        text += &format!(
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{tall:.1}\" fill=\"#9bb8cf\"/>\
             <path d=\"M{left:.1} {line:.1}h{width:.1}\" stroke=\"#222\" stroke-width=\"1.2\"/>",
            left + 0.5,
            37.0 - tall,
            width - 1.0
        );
    }
    text + "</svg>"
}

/// Shares of each split side by side.
fn bars<'s>(
    splits: &'s [SplitSums<'_>],
    title: &str,
    of: &dyn Fn(&'s ShardStatistics) -> &'s [u64],
    word: &dyn Fn(usize) -> String,
) -> String {
    let shares: Vec<Vec<f64>> = splits
        .iter()
        .map(|split| {
            let total = of(&split.sums).iter().sum::<u64>().max(1) as f64;
            of(&split.sums).iter().map(|count| *count as f64 / total).collect()
        })
        .collect();
    let is_used = |bin: &usize| shares.iter().any(|own| own.get(*bin).is_some_and(|share| *share > 0.0));
    let bins = shares.iter().map(Vec::len).max().unwrap_or(0);
    let (Some(first), Some(last)) = ((0..bins).find(is_used), (0..bins).rev().find(is_used)) else {
        return format!("<p>{title}: none.</p>\n");
    };
    let top = shares.iter().flatten().copied().fold(0.0, f64::max);
    let (columns, side) = ((last - first + 1) as f64, 760.0);
    let (slot, height) = (side / columns, 150.0);
    let mut text = format!(
        "<svg viewBox=\"0 0 820 205\" width=\"820\" role=\"img\" aria-label=\"{title}\"><g font-size=\"11\" fill=\"#444\">\
         <text x=\"50\" y=\"12\">{title}</text><text x=\"44\" y=\"28\" text-anchor=\"end\">{:.0} %</text><text x=\"44\" y=\"174\" text-anchor=\"end\">0</text>",
        100.0 * top
    );
    // So many labels that they do not run into each other.
    let step = (columns / 20.0).ceil() as usize;
    for bin in (first..=last).step_by(step.max(1)) {
        let middle = 50.0 + slot * ((bin - first) as f64 + 0.5);
        text += &format!("<text x=\"{middle:.1}\" y=\"188\" text-anchor=\"middle\">{}</text>", word(bin));
    }
    text += "</g><path d=\"M50 170.5h760\" stroke=\"#888\"/>";
    let width = 0.8 * slot / splits.len() as f64;
    for (place, (split, own)) in splits.iter().zip(&shares).enumerate() {
        for bin in first..=last {
            let tall = height * own.get(bin).copied().unwrap_or(0.0) / top;
            let left = 50.0 + slot * ((bin - first) as f64 + 0.1) + width * place as f64;
            if tall > 0.0 {
                text += &format!(
                    "<rect x=\"{left:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{tall:.1}\" fill=\"{}\"/>",
                    170.0 - tall,
                    split.colour
                );
            }
        }
    }
    text + "</svg>\n"
}

/// Stars over the frame.
fn places(sums: &ShardStatistics) -> String {
    let total: u64 = sums.stars_by_place.iter().sum();
    if total == 0 {
        return "<p>None.</p>\n".to_owned();
    }
    let mean = total as f64 / sums.stars_by_place.len() as f64;
    let top = sums.stars_by_place.iter().max().copied().unwrap_or(1).max(1) as f64;
    let mut text = "<svg viewBox=\"0 0 340 260\" width=\"340\" role=\"img\" aria-label=\"stars over the frame\">".to_owned();
    for (cell, count) in sums.stars_by_place.iter().enumerate() {
        let (column, row) = (cell % PLACES[0], cell / PLACES[0]);
        let share = *count as f64 / top;
        let grey = (255.0 * (1.0 - 0.85 * share)) as u8;
        text += &format!(
            "<rect x=\"{}\" y=\"{}\" width=\"20\" height=\"20\" fill=\"rgb({grey},{grey},255)\"><title>{count}</title></rect>",
            10 + 20 * column,
            10 + 20 * row
        );
    }
    format!(
        "{text}<rect x=\"10\" y=\"10\" width=\"320\" height=\"240\" fill=\"none\" stroke=\"#888\"/></svg>\n<p class=\"note\">{total} stars, {mean:.1} to a part of 16 × 12; the darkest has {top}. Row 0 is at the top.</p>\n"
    )
}

/// Boresights of each split over the sky, cells of equal area.
fn sky(splits: &[SplitSums<'_>]) -> String {
    let (wide, tall) = (800 / SKY[0], 400 / SKY[1]);
    let top = splits.iter().flat_map(|split| &split.sums.frames_by_boresight).max().copied().unwrap_or(1).max(1) as f64;
    let mut text = "<svg viewBox=\"0 0 830 430\" width=\"830\" role=\"img\" aria-label=\"boresights over the sky\"><rect x=\"15\" y=\"10\" width=\"768\" height=\"384\" \
                    fill=\"#f4f4f4\" stroke=\"#888\"/>"
        .to_owned();
    for split in splits {
        for (cell, count) in split.sums.frames_by_boresight.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (column, band) = (cell % SKY[0], cell / SKY[0]);
            // Right ascension grows to the left, as on maps of the sky.
            let (left, up) = (15 + wide * (SKY[0] - 1 - column), 10 + tall * (SKY[1] - 1 - band));
            text += &format!(
                "<rect x=\"{left}\" y=\"{up}\" width=\"{wide}\" height=\"{tall}\" fill=\"{}\" fill-opacity=\"{:.2}\"><title>{}: {count} frames</title></rect>",
                split.colour,
                0.3 + 0.7 * (*count as f64 / top).sqrt(),
                split.name
            );
        }
    }
    text += "<g font-size=\"11\" fill=\"#444\"><text x=\"15\" y=\"410\">360°</text><text x=\"399\" y=\"410\" text-anchor=\"middle\">right ascension</text>\
             <text x=\"783\" y=\"410\" text-anchor=\"end\">0°</text><text x=\"788\" y=\"18\">+90°</text><text x=\"788\" y=\"206\">0°</text>\
             <text x=\"788\" y=\"394\">−90°</text></g></svg>\n";
    text + "<p class=\"note\">Height is the sine of the declination, so every cell has the same area. The darker, the more frames.</p>\n"
}

fn effects(splits: &[SplitSums<'_>]) -> String {
    let names: std::collections::BTreeSet<&String> = splits.iter().flat_map(|split| split.sums.frames_by_effect.keys()).collect();
    let mut text = "<h2>Effects, and the share of frames in which they are on</h2>\n<table><tr><th>effect".to_owned();
    for split in splits {
        text += &format!("<th class=\"n\">{}", split.name);
    }
    text += "</tr>\n";
    for name in names {
        text += &format!("<tr><td>{}", escaped(name));
        for split in splits {
            let frames = split.sums.frames_by_effect.get(name).copied().unwrap_or_default();
            text += &format!("<td class=\"n\">{:.1} %", 100.0 * frames as f64 / split.frames.max(1) as f64);
        }
        text += "</tr>\n";
    }
    text + "</table>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_that_are_not_those_asked_for_are_suspect() {
        let draw = |counts: [u64; 4]| DrawnShares { expected: vec![0.25; 4], counts: counts.to_vec(), ..DrawnShares::default() };
        assert!(probability(&draw([26, 24, 27, 23])).unwrap() > 0.9);
        assert!(probability(&draw([60, 20, 10, 10])).unwrap() < SUSPECT);
        assert_eq!(probability(&draw([3, 4, 4, 5])), None, "too few");
        // χ² = 4 with 3 degrees of freedom: 0.26146 (Abramowitz & Stegun, table 26.7).
        assert!((probability(&draw([30, 30, 20, 20])).unwrap() - 0.26146).abs() < 1e-5);
        assert_eq!(escaped("<a & \"b\">"), "&lt;a &amp; &quot;b&quot;&gt;");
    }
}
