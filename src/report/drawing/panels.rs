//! Small plots side by side that share their axes, the vertical one logarithmic: how several methods do in several cases.

use std::path::Path;

use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, RGBColor};

use super::canvas::{BLUE, Canvas, Drawn, GREEN, INK, ORANGE, PALE, PAPER, PURPLE, Place, SKY, VERMILION, picture, short, tick_step};
use crate::report::{ReportError, Series, SeriesStyle};

/// One of the small plots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// What it shows.
    pub title: String,
    /// The series; the first ones lie below. Series at the same place of different panels belong together.
    pub series: Vec<Series>,
}

/// Panels in rows. The legend below them is that of the first panel.
///
/// Values above the range, infinite ones included, stand at its upper edge, those below at its lower edge; values that are not
/// numbers are left out.
#[derive(Clone, Debug, PartialEq)]
pub struct LogPanels {
    /// What they show.
    pub title: String,
    /// Name and unit of the horizontal axis.
    pub x_label: String,
    /// Name and unit of the vertical axis of each row of panels.
    pub y_labels: Vec<String>,
    /// Panels in a row.
    pub columns: usize,
    /// The panels, row by row.
    pub panels: Vec<Panel>,
    /// Least and greatest value of the vertical axes, above zero.
    pub y_range: [f64; 2],
}

const GREY: RGBColor = RGBColor(140, 140, 146);
const COLOURS: [RGBColor; 8] = [GREY, VERMILION, ORANGE, PURPLE, GREEN, SKY, BLUE, INK];

/// Size of a panel and the spaces around the panels, px.
const PANEL: (f64, f64) = (330.0, 270.0);
const LEFT: f64 = 92.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 56.0;
const GAP: (f64, f64) = (22.0, 42.0);
const AXIS: f64 = 54.0;
const LEGEND_LINE: f64 = 26.0;
const LEGEND_REACH: f64 = 30.0;

/// Where values stand in one panel.
struct Frame {
    corner: Place,
    across: [f64; 2],
    along: [f64; 2],
}

impl Frame {
    fn place(&self, [x, y]: [f64; 2]) -> Place {
        let across = (x - self.across[0]) / (self.across[1] - self.across[0]);
        let [low, high] = self.along;
        let up = ((y / low).ln() / (high / low).ln()).clamp(0.0, 1.0);
        (self.corner.0 + across * PANEL.0, self.corner.1 + (1.0 - up) * PANEL.1)
    }
}

impl LogPanels {
    /// Writes the panels as one PNG.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let empty = |what| ReportError::Empty { path: path.to_owned(), what };
        let [low, high] = self.y_range;
        if !(low > 0.0 && high > low && high.is_finite()) {
            return Err(empty("the range of its vertical axis is empty; give two values above zero, the smaller one first"));
        }
        let values = || self.panels.iter().flat_map(|panel| &panel.series).flat_map(|series| drawable(&series.points));
        let (first, last) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(first, last), [x, _]| (first.min(x), last.max(x)));
        if first > last {
            return Err(empty("no point is a number"));
        }
        let air = if last > first { 0.04 * (last - first) } else { 1.0 };
        let (columns, rows) = (self.columns.max(1), self.panels.len().div_ceil(self.columns.max(1)));
        let width = LEFT + RIGHT + columns as f64 * (PANEL.0 + GAP.0) - GAP.0;
        let panels_end = TOP + rows as f64 * (PANEL.1 + GAP.1) - GAP.1 + 20.0;
        // Letters are about half as wide as they are high; the legend is laid out in columns of the longest name.
        let longest = self.labels().map(|label| label.chars().count()).max().unwrap_or(0) as f64;
        let entry = LEGEND_REACH + 10.0 + 8.5 * longest + 18.0;
        let in_line = (((width - LEFT - RIGHT) / entry) as usize).max(1);
        let lines = self.labels().count().div_ceil(in_line);
        let height = panels_end + AXIS + lines as f64 * LEGEND_LINE + 12.0;
        picture(path, (width.ceil() as usize, height.ceil() as usize), PAPER, |sheet| {
            sheet.text(&self.title, (28.0, 12.0), 21.0, &INK, HPos::Left, VPos::Top)?;
            for (index, panel) in self.panels.iter().enumerate() {
                let (row, column) = (index / columns, index % columns);
                let corner = (LEFT + column as f64 * (PANEL.0 + GAP.0), TOP + 20.0 + row as f64 * (PANEL.1 + GAP.1));
                let frame = Frame { corner, across: [first - air, last + air], along: self.y_range };
                axes(sheet, &frame, column == 0, row + 1 == rows)?;
                sheet.text(&panel.title, (corner.0 + PANEL.0 / 2.0, corner.1 - 22.0), 16.0, &INK, HPos::Center, VPos::Top)?;
                if column == 0 {
                    let label = self.y_labels.get(row).map_or("", String::as_str);
                    sheet.upward_text(label, (corner.0 - 70.0, corner.1 + PANEL.1 / 2.0), 15.0, &INK)?;
                }
                for (series, colour) in panel.series.iter().zip(COLOURS.iter().cycle()) {
                    draw(sheet, &frame, series, *colour)?;
                }
            }
            sheet.text(&self.x_label, (width / 2.0, panels_end + 24.0), 16.0, &INK, HPos::Center, VPos::Top)?;
            for (index, (label, colour)) in self.labels().zip(COLOURS.iter().cycle()).enumerate() {
                let x = LEFT + (index % in_line) as f64 * entry;
                let y = panels_end + AXIS + ((index / in_line) as f64 + 0.5) * LEGEND_LINE;
                sheet.line(&[(x, y), (x + LEGEND_REACH, y)], *colour, 2.0)?;
                sheet.dot((x + LEGEND_REACH / 2.0, y), 4.0, *colour)?;
                sheet.text(label, (x + LEGEND_REACH + 10.0, y), 15.0, &INK, HPos::Left, VPos::Center)?;
            }
            Ok(())
        })
    }

    fn labels(&self) -> impl Iterator<Item = &str> {
        self.panels.first().into_iter().flat_map(|panel| &panel.series).map(|series| series.label.as_str())
    }
}

/// The edge of a panel, its ticks, and the numbers beside them where they are wanted.
fn axes(sheet: &Canvas, frame: &Frame, numbers_left: bool, numbers_below: bool) -> Drawn {
    let (left, top) = frame.corner;
    let (right, bottom) = (left + PANEL.0, top + PANEL.1);
    let [low, high] = frame.along;
    let mut decade = low.log10().floor() as i32;
    while 10_f64.powi(decade) <= high {
        for part in 1..10 {
            let value = f64::from(part) * 10_f64.powi(decade);
            if !(low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(&value) {
                continue;
            }
            let (_, y) = frame.place([frame.across[0], value]);
            let reach = if part == 1 { 6.0 } else { 3.0 };
            if part == 1 {
                sheet.line(&[(left, y), (right, y)], PALE, 1.0)?;
            }
            sheet.line(&[(left - reach, y), (left, y)], INK, 1.0)?;
            if part == 1 && numbers_left {
                sheet.text(&short(value), (left - 10.0, y), 14.0, &INK, HPos::Right, VPos::Center)?;
            }
        }
        decade += 1;
    }
    let step = tick_step(frame.across[1] - frame.across[0], 7.0);
    let mut at = (frame.across[0] / step).ceil() * step;
    while at <= frame.across[1] {
        let (x, _) = frame.place([at, low]);
        sheet.line(&[(x, bottom), (x, bottom + 5.0)], INK, 1.0)?;
        if numbers_below {
            sheet.text(&short(at), (x, bottom + 8.0), 14.0, &INK, HPos::Center, VPos::Top)?;
        }
        at += step;
    }
    sheet.line(&[(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], INK, 1.0)
}

fn draw(sheet: &Canvas, frame: &Frame, series: &Series, colour: impl Color + Copy) -> Drawn {
    let places: Vec<Place> = drawable(&series.points).map(|point| frame.place(point)).collect();
    if series.style == SeriesStyle::Line {
        sheet.line(&places, colour, 2.0)?;
    }
    places.into_iter().try_for_each(|place| sheet.dot(place, 4.0, colour))
}

/// The points that have a place; one at infinity has.
fn drawable(points: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    points.iter().copied().filter(|[x, y]| x.is_finite() && !y.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panels(y: [f64; 3]) -> LogPanels {
        let points = (0..3).map(|k| [f64::from(k as u32) * 10.0, y[k]]).collect();
        let series = vec![Series { label: "a method".into(), style: SeriesStyle::Line, points }];
        LogPanels {
            title: "panels".into(),
            x_label: "share / %".into(),
            y_labels: vec!["error / px".into()],
            columns: 2,
            panels: vec![Panel { title: "one".into(), series: series.clone() }, Panel { title: "two".into(), series }],
            y_range: [0.01, 10.0],
        }
    }

    #[test]
    fn equal_ratios_are_equal_distances() {
        let frame = Frame { corner: (10.0, 20.0), across: [0.0, 1.0], along: [0.01, 10.0] };
        let height = |value: f64| frame.place([0.0, value]).1;
        assert!((height(0.1) - height(1.0) - PANEL.1 / 3.0).abs() < 1e-9);
        assert_eq!((height(10.0), height(f64::INFINITY)), (20.0, 20.0), "what is above the range stands at its edge");
        assert_eq!((height(0.01), height(0.0)), (20.0 + PANEL.1, 20.0 + PANEL.1));
    }

    #[test]
    fn infinite_values_are_drawn_at_the_edge_and_numbers_that_are_none_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("panels.png");
        panels([0.02, 0.5, f64::INFINITY]).write(&path).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        // The last point of the first panel: at the upper edge, in the colour of the first series.
        let x = (LEFT + PANEL.0 * (1.0 - 0.04 / 1.08)).round() as u32;
        assert_eq!(read.get_pixel(x, (TOP + 20.0) as u32 + 2).0, [140, 140, 146]);
        assert!(matches!(panels([f64::NAN; 3]).write(&path), Err(ReportError::Empty { .. })));
        assert!(matches!(LogPanels { y_range: [0.0, 1.0], ..panels([1.0; 3]) }.write(&path), Err(ReportError::Empty { .. })));
    }
}
