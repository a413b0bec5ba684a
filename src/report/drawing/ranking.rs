//! How significant each hypothesis is: horizontal bars, the most significant on top.

use std::path::Path;

use plotters::style::RGBColor;
use plotters::style::text_anchor::{HPos, VPos};

use super::canvas::{BLUE, Canvas, Drawn, INK, ORANGE, PALE, PAPER, PURPLE, VERMILION, picture};
use crate::report::{Rank, RankKind, Ranking, ReportError};
use crate::statistics::order::sort_by;

const WIDTH: f64 = 900.0;
const RIGHT: f64 = 96.0;
const TOP: f64 = 84.0;
const BAR: f64 = 22.0;
const AXIS: f64 = 62.0;
const LEGEND: f64 = 34.0;
/// The ends of bars: lengths grow as the square root, so that the threshold and a finding of a hundred σ are seen on one axis.
fn length(deviations: f64) -> f64 {
    deviations.max(0.0).sqrt()
}

/// Numbers of the axis.
const TICKS: [f64; 10] = [0.0, 1.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0];

fn colour(kind: RankKind) -> RGBColor {
    match kind {
        RankKind::Found => VERMILION,
        RankKind::InSet => ORANGE,
        RankKind::Withheld => PURPLE,
        RankKind::Tested => BLUE,
    }
}

impl Ranking {
    /// Writes the bars as PNG.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let mut ranks: Vec<&Rank> = self.ranks.iter().filter(|rank| rank.deviations.is_finite() && rank.deviations >= 0.0).collect();
        if ranks.is_empty() {
            return Err(ReportError::Empty { path: path.to_owned(), what: "no hypothesis has a score" });
        }
        let order = |kind: RankKind| kind as u8;
        sort_by(&mut ranks, |a, b| {
            b.deviations.total_cmp(&a.deviations).then(order(a.kind).cmp(&order(b.kind))).then(a.label.cmp(&b.label))
        });
        let height = TOP + ranks.len() as f64 * BAR + AXIS + LEGEND;
        picture(path, (WIDTH as usize, height.ceil() as usize), PAPER, |sheet| self.draw(sheet, &ranks))
    }

    fn draw(&self, sheet: &Canvas, ranks: &[&Rank]) -> Drawn {
        sheet.text(&self.title, (28.0, 12.0), 21.0, &INK, HPos::Left, VPos::Top)?;
        sheet.text(&self.summary, (28.0, 44.0), 15.0, &INK, HPos::Left, VPos::Top)?;
        let mut widest: f64 = 0.0;
        for rank in ranks {
            widest = widest.max(sheet.text_size(&rank.label, 14.0)?.0);
        }
        let left = 28.0 + widest + 12.0;
        let bottom = TOP + ranks.len() as f64 * BAR;
        let longest = ranks.iter().map(|rank| length(rank.deviations)).chain(self.threshold.map(length)).fold(1.0, f64::max) * 1.04;
        let place = |length: f64| left + length / longest * (WIDTH - RIGHT - left);
        let mut last = f64::NEG_INFINITY;
        for tick in TICKS.into_iter().filter(|tick| length(*tick) <= longest) {
            let x = place(length(tick));
            if x - last < 44.0 {
                continue;
            }
            last = x;
            sheet.line(&[(x, TOP), (x, bottom)], PALE, 1.0)?;
            sheet.line(&[(x, bottom), (x, bottom + 5.0)], INK, 1.0)?;
            sheet.text(&tick.to_string(), (x, bottom + 8.0), 14.0, &INK, HPos::Center, VPos::Top)?;
        }
        if let Some(threshold) = self.threshold {
            dashed(sheet, place(length(threshold)), TOP - 6.0, bottom)?;
        }
        for (index, rank) in ranks.iter().enumerate() {
            let y = TOP + (index as f64 + 0.5) * BAR;
            let end = place(length(rank.deviations));
            sheet.text(&rank.label, (left - 10.0, y), 14.0, &INK, HPos::Right, VPos::Center)?;
            sheet.fill((left, y - 0.34 * BAR), (end.max(left + 1.0), y + 0.34 * BAR), colour(rank.kind))?;
            let text = written(rank.deviations);
            let (wide, high) = sheet.text_size(&text, 13.0)?;
            // A number that the threshold crosses stands on paper.
            if self.threshold.is_some_and(|threshold| (end..end + 12.0 + wide).contains(&place(length(threshold)))) {
                sheet.fill((end + 3.0, y - high / 2.0), (end + 9.0 + wide, y + high / 2.0), PAPER)?;
            }
            sheet.text(&text, (end + 6.0, y), 13.0, &INK, HPos::Left, VPos::Center)?;
        }
        sheet.line(&[(left, TOP), (left, bottom), (WIDTH - RIGHT, bottom)], INK, 1.0)?;
        sheet.text(
            "standard deviations, this effect alone (a normal number that chance makes as rarely)",
            (left, bottom + 32.0),
            15.0,
            &INK,
            HPos::Left,
            VPos::Top,
        )?;
        legend(sheet, left, bottom + AXIS + 12.0, ranks, self.threshold)
    }
}

fn dashed(sheet: &Canvas, x: f64, top: f64, bottom: f64) -> Drawn {
    const DASH: f64 = 6.0;
    let mut y = top;
    while y < bottom {
        sheet.line(&[(x, y), (x, (y + DASH).min(bottom))], INK, 1.5)?;
        y += 1.6 * DASH;
    }
    Ok(())
}

/// The colours that occur, and the threshold.
fn legend(sheet: &Canvas, left: f64, y: f64, ranks: &[&Rank], threshold: Option<f64>) -> Drawn {
    let kinds = [
        (RankKind::Found, "found"),
        (RankKind::InSet, "not told apart from a finding"),
        (RankKind::Withheld, "stands out, name withheld"),
        (RankKind::Tested, "tested, not found"),
    ];
    let mut x = left;
    for (kind, text) in kinds.into_iter().filter(|(kind, _)| ranks.iter().any(|rank| rank.kind == *kind)) {
        sheet.fill((x, y - 7.0), (x + 20.0, y + 7.0), colour(kind))?;
        sheet.text(text, (x + 26.0, y), 14.0, &INK, HPos::Left, VPos::Center)?;
        x += 26.0 + sheet.text_size(text, 14.0)?.0 + 24.0;
    }
    if let Some(threshold) = threshold {
        dashed(sheet, x + 6.0, y - 9.0, y + 9.0)?;
        sheet.text(&format!("a finding needs {}", written(threshold)), (x + 16.0, y), 14.0, &INK, HPos::Left, VPos::Center)?;
    }
    Ok(())
}

/// A number as it stands beside its bar.
fn written(deviations: f64) -> String {
    if deviations >= 99.95 { format!("{deviations:.0} σ") } else { format!("{deviations:.1} σ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rank(label: &str, deviations: f64, kind: RankKind) -> Rank {
        Rank { label: label.into(), deviations, kind }
    }

    #[test]
    fn bars_are_as_long_as_significant_and_the_first_is_on_top() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ranking.png");
        let ranks = vec![rank("b", 0.7, RankKind::Tested), rank("a", 40.0, RankKind::Found), rank("c", 10.0, RankKind::InSet)];
        Ranking { title: "ranking".into(), ranks, threshold: Some(5.0), ..Ranking::default() }.write(&path).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let bar = |row: usize, colour: RGBColor| {
            let y = (TOP + (row as f64 + 0.5) * BAR) as u32;
            (0..read.width()).filter(|x| read.get_pixel(*x, y).0 == [colour.0, colour.1, colour.2]).count()
        };
        let (first, second) = (bar(0, VERMILION), bar(1, ORANGE));
        assert!(first > 100 && second.abs_diff(first / 2) < 8, "√10 is half of √40: {second} of {first}");
        assert!(bar(2, BLUE) > 10 && bar(1, VERMILION) == 0);
    }

    #[test]
    fn what_has_no_score_is_left_out() {
        let path = std::env::temp_dir().join("never-written-ranking.png");
        let none = Ranking { ranks: vec![rank("a", f64::NAN, RankKind::Tested)], ..Ranking::default() };
        assert!(matches!(none.write(&path), Err(ReportError::Empty { .. })));
        assert_eq!([0.0, 5.24, 123.4].map(written), ["0.0 σ", "5.2 σ", "123 σ"]);
    }
}
