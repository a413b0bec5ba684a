//! Curves and clouds of points with axes.

use std::ops::Range;
use std::path::Path;

use plotters::chart::ChartBuilder;
use plotters::element::{Circle, PathElement};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, RGBColor, TextStyle};

use super::canvas::{BLUE, Canvas, Drawn, FONT, GREEN, INK, ORANGE, PALE, PAPER, PURPLE, SKY, VERMILION, picture, short};
use crate::report::{Plot, ReportError, Series, SeriesStyle};

const SIZE: (usize, usize) = (960, 600);
/// From the sheet's edges to the axes.
const TOP: f64 = 52.0;
const RIGHT: f64 = 28.0;
const COLOURS: [RGBColor; 6] = [BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY];

impl Plot {
    /// Writes the plot as PNG.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let points = || self.series.iter().flat_map(|series| finite(&series.points));
        let empty = || ReportError::Empty { path: path.to_owned(), what: "no point is finite" };
        let across = span(points().map(|[x, _]| x)).ok_or_else(empty)?;
        let along = span(points().map(|[_, y]| y)).ok_or_else(empty)?;
        picture(path, SIZE, PAPER, |sheet| self.draw(sheet, across, along))
    }

    fn draw(&self, sheet: &Canvas, across: Range<f64>, along: Range<f64>) -> Drawn {
        let (area, factor) = sheet.raw();
        let scaled = |length: f64| (length * factor) as i32;
        let style = |size: f64| TextStyle::from((FONT, size * factor)).color(&INK);
        sheet.text(&self.title, (28.0, 12.0), 21.0, &INK, HPos::Left, VPos::Top)?;
        let mut chart = ChartBuilder::on(area)
            .margin_top(scaled(TOP))
            .margin_right(scaled(RIGHT))
            .margin_bottom(scaled(8.0))
            .margin_left(scaled(8.0))
            .x_label_area_size(scaled(52.0))
            .y_label_area_size(scaled(84.0))
            .build_cartesian_2d(across.clone(), along.clone())?;
        let [x_digits, y_digits] = [across, along].map(|range| move |number: &f64| tick_label(*number, &range));
        chart
            .configure_mesh()
            .light_line_style(PAPER)
            .bold_line_style(PALE.stroke_width(factor as u32))
            .axis_style(INK.stroke_width(factor as u32))
            .label_style(style(14.0))
            .axis_desc_style(style(16.0))
            .x_labels(9)
            .y_labels(8)
            .x_label_formatter(&x_digits)
            .y_label_formatter(&y_digits)
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .draw()?;
        for (index, series) in self.series.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            let points = finite(&series.points).map(|[x, y]| (x, y));
            let line = colour.stroke_width((2.0 * factor) as u32);
            match series.style {
                SeriesStyle::Line => chart.draw_series([PathElement::new(points.collect::<Vec<_>>(), line)])?,
                SeriesStyle::Points => {
                    let radius = scaled(if series.points.len() > 500 { 1.5 } else { 3.0 });
                    chart.draw_series(points.map(|point| Circle::new(point, radius, colour.mix(0.75).filled())))?
                }
            };
        }
        self.legend(sheet)
    }

    /// The names of the series, in the upper right corner of the axes.
    fn legend(&self, sheet: &Canvas) -> Drawn {
        const LETTERS: f64 = 15.0;
        const ROW: f64 = 19.0;
        const SIGN: f64 = 22.0;
        const MARGIN: f64 = 10.0;
        let named: Vec<(usize, &Series)> = self.series.iter().enumerate().filter(|(_, series)| !series.label.is_empty()).collect();
        let mut widest: f64 = 0.0;
        for (_, series) in &named {
            widest = widest.max(sheet.text_size(&series.label, LETTERS)?.0);
        }
        if named.is_empty() {
            return Ok(());
        }
        let (right, top) = (SIZE.0 as f64 - RIGHT - MARGIN, TOP + MARGIN);
        let (left, bottom) = (right - widest - SIGN - 3.0 * 8.0, top + ROW * named.len() as f64 + 8.0);
        sheet.fill((left, top), (right, bottom), PAPER.mix(0.85))?;
        sheet.line(&[(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], PALE, 1.0)?;
        for (row, (index, series)) in named.into_iter().enumerate() {
            let (colour, y) = (COLOURS[index % COLOURS.len()], top + 4.0 + ROW * (row as f64 + 0.5));
            match series.style {
                SeriesStyle::Line => sheet.line(&[(left + 8.0, y), (left + 8.0 + SIGN, y)], colour, 2.0)?,
                SeriesStyle::Points => sheet.dot((left + 8.0 + SIGN / 2.0, y), 3.0, colour)?,
            }
            sheet.text(&series.label, (left + 16.0 + SIGN, y), LETTERS, &INK, HPos::Left, VPos::Center)?;
        }
        Ok(())
    }
}

/// Ticks come as sums of steps: what rounding leaves of nought is nought.
fn tick_label(number: f64, range: &Range<f64>) -> String {
    let is_rounding = number.abs() < 1e-9 * (range.end - range.start);
    short(if is_rounding { 0.0 } else { number })
}

fn finite(points: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    points.iter().copied().filter(|[x, y]| x.is_finite() && y.is_finite())
}

/// From the least to the greatest value with some air; `None` of nothing.
fn span(values: impl Iterator<Item = f64>) -> Option<Range<f64>> {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return None;
    }
    // A single value gets an axis as well, one on which it can be told from its neighbours.
    let air = if high > low { 0.05 * (high - low) } else { (0.1 * high.abs()).max(1e-3) };
    Some(low - air..high + air)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: Vec<[f64; 2]>) -> Plot {
        let series = vec![Series { label: "σ".into(), style: SeriesStyle::Points, points }];
        Plot { title: "a plot".into(), x_label: "x / px".into(), y_label: "y / px".into(), series }
    }

    #[test]
    fn points_that_are_not_finite_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plot.png");
        plot(vec![[1.0, f64::NAN], [2.0, 2.0], [f64::INFINITY, 1.0]]).write(&path).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let blue = read.pixels().filter(|pixel| pixel[2] > 150 && pixel[0] < 120).count();
        assert!((10..200).contains(&blue), "{blue} blue pixels: one dot and its entry in the legend");
        assert!(matches!(plot(vec![[f64::NAN; 2]]).write(&path), Err(ReportError::Empty { .. })));
        assert!(matches!(plot(vec![]).write(&path), Err(ReportError::Empty { .. })));
    }

    #[test]
    fn spans_hold_their_values() {
        assert_eq!(span([].into_iter()), None);
        for values in [vec![3.0], vec![0.0, 0.0], vec![-1.0, 5.0], vec![1e-9, 2e-9], vec![-7e6]] {
            let range = span(values.iter().copied()).unwrap();
            assert!(values.iter().all(|value| range.contains(value)) && range.end > range.start, "{values:?} in {range:?}");
        }
    }

    #[test]
    fn what_rounding_leaves_of_nought_is_nought() {
        let labels = [-0.2, -0.2 + 0.1 + 0.1 - 5.6e-17, 0.2].map(|number| tick_label(number, &(-0.5..0.5)));
        assert_eq!(labels, ["−0.2", "0", "0.2"]);
        assert_eq!(tick_label(5e-17, &(0.0..1e-16)), "5e-17".replace('-', "−"));
    }
}
