//! Binned residuals with error bars against what they follow, and a model through them.

use std::path::Path;

use plotters::style::RGBColor;
use plotters::style::text_anchor::{HPos, VPos};

use super::canvas::{BLUE, Canvas, Drawn, INK, PALE, PAPER, Place, VERMILION, picture, short, tick_step};
use crate::report::{ProfilePlot, ProfilePoint, ReportError};
use crate::statistics::order::sort_by;

const SIZE: (usize, usize) = (900, 560);
const LEFT: f64 = 100.0;
const RIGHT: f64 = 28.0;
const TOP: f64 = 92.0;
const BOTTOM: f64 = 96.0;
const GREY: RGBColor = RGBColor(140, 140, 146);

/// Where numbers stand on the sheet.
struct Axes {
    across: [f64; 2],
    along: [f64; 2],
}

impl Axes {
    fn size() -> (f64, f64) {
        (SIZE.0 as f64 - LEFT - RIGHT, SIZE.1 as f64 - TOP - BOTTOM)
    }

    fn place(&self, x: f64, y: f64) -> Place {
        let (width, height) = Self::size();
        let share = |value: f64, [low, high]: [f64; 2]| (value - low) / (high - low);
        (LEFT + share(x, self.across) * width, TOP + (1.0 - share(y, self.along)) * height)
    }
}

impl ProfilePlot {
    /// Writes the plot as PNG.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let finite = |bin: &&ProfilePoint| [bin.at, bin.mean, bin.sigma, bin.model].iter().all(|number| number.is_finite());
        let mut bins: Vec<ProfilePoint> = self.bins.iter().filter(finite).copied().collect();
        sort_by(&mut bins, |a, b| a.at.total_cmp(&b.at));
        if bins.is_empty() {
            return Err(ReportError::Empty { path: path.to_owned(), what: "no bin is finite" });
        }
        let across = widened(bins.iter().map(|bin| bin.at));
        // Zero is always seen: it is what a complete model leaves.
        let heights = bins.iter().flat_map(|bin| [bin.mean - bin.sigma, bin.mean + bin.sigma, bin.model]);
        let along = widened(heights.chain([0.0]));
        let axes = Axes { across, along };
        picture(path, SIZE, PAPER, |sheet| {
            sheet.text(&self.title, (28.0, 12.0), 21.0, &INK, HPos::Left, VPos::Top)?;
            sheet.text(&self.summary, (28.0, 44.0), 15.0, &INK, HPos::Left, VPos::Top)?;
            self.frame(sheet, &axes)?;
            let model: Vec<Place> = bins.iter().map(|bin| axes.place(bin.at, bin.model)).collect();
            if model.len() > 1 {
                sheet.line(&model, VERMILION, 2.5)?;
            }
            for bin in &bins {
                error_bar(sheet, &axes, bin)?;
            }
            counts(sheet, &axes, &bins, &self.counted)?;
            legend(sheet, &self.points)
        })
    }

    /// The edge, the ticks, the numbers and what they count.
    fn frame(&self, sheet: &Canvas, axes: &Axes) -> Drawn {
        let (width, height) = Axes::size();
        let (right, bottom) = (LEFT + width, TOP + height);
        for at in ticks(axes.along, 7.0) {
            let (_, y) = axes.place(axes.across[0], at);
            sheet.line(&[(LEFT, y), (right, y)], PALE, 1.0)?;
            sheet.line(&[(LEFT - 5.0, y), (LEFT, y)], INK, 1.0)?;
            sheet.text(&short(at), (LEFT - 9.0, y), 14.0, &INK, HPos::Right, VPos::Center)?;
        }
        for at in ticks(axes.across, 8.0) {
            let (x, _) = axes.place(at, axes.along[0]);
            sheet.line(&[(x, bottom), (x, bottom + 5.0)], INK, 1.0)?;
            sheet.text(&short(at), (x, bottom + 8.0), 14.0, &INK, HPos::Center, VPos::Top)?;
        }
        let (_, zero) = axes.place(axes.across[0], 0.0);
        sheet.line(&[(LEFT, zero), (right, zero)], GREY, 1.5)?;
        sheet.line(&[(LEFT, TOP), (right, TOP), (right, bottom), (LEFT, bottom), (LEFT, TOP)], INK, 1.0)?;
        sheet.text(&self.x_label, (LEFT + width / 2.0, bottom + 30.0), 16.0, &INK, HPos::Center, VPos::Top)?;
        sheet.upward_text(&self.y_label, (26.0, TOP + height / 2.0), 16.0, &INK)
    }
}

/// A dot with a bar from one standard error below to one above.
fn error_bar(sheet: &Canvas, axes: &Axes, bin: &ProfilePoint) -> Drawn {
    const CAP: f64 = 4.0;
    let (x, low) = axes.place(bin.at, bin.mean - bin.sigma);
    let (_, high) = axes.place(bin.at, bin.mean + bin.sigma);
    sheet.line(&[(x, low), (x, high)], BLUE, 1.5)?;
    for y in [low, high] {
        sheet.line(&[(x - CAP, y), (x + CAP, y)], BLUE, 1.5)?;
    }
    sheet.dot(axes.place(bin.at, bin.mean), 4.0, BLUE)
}

/// How many each bin has, above it; of bins that stand close together every so manieth.
fn counts(sheet: &Canvas, axes: &Axes, bins: &[ProfilePoint], counted: &str) -> Drawn {
    sheet.text(counted, (LEFT - 9.0, TOP - 9.0), 13.0, &GREY, HPos::Right, VPos::Center)?;
    let mut free_from = f64::NEG_INFINITY;
    for bin in bins {
        let (x, _) = axes.place(bin.at, axes.along[0]);
        let text = bin.stars.to_string();
        let wide = sheet.text_size(&text, 13.0)?.0;
        if x - wide / 2.0 >= free_from {
            sheet.text(&text, (x, TOP - 9.0), 13.0, &GREY, HPos::Center, VPos::Center)?;
            free_from = x + wide / 2.0 + 5.0;
        }
    }
    Ok(())
}

fn legend(sheet: &Canvas, points: &str) -> Drawn {
    let y = SIZE.1 as f64 - 22.0;
    sheet.dot((LEFT + 12.0, y), 4.0, BLUE)?;
    sheet.line(&[(LEFT + 12.0, y - 9.0), (LEFT + 12.0, y + 9.0)], BLUE, 1.5)?;
    sheet.text(points, (LEFT + 26.0, y), 15.0, &INK, HPos::Left, VPos::Center)?;
    let next = LEFT + 26.0 + sheet.text_size(points, 15.0)?.0 + 30.0;
    sheet.line(&[(next, y), (next + 28.0, y)], VERMILION, 2.5)?;
    sheet.text("model", (next + 36.0, y), 15.0, &INK, HPos::Left, VPos::Center)
}

/// The round numbers within a range, about `count` of them.
fn ticks([low, high]: [f64; 2], count: f64) -> impl Iterator<Item = f64> {
    let step = tick_step(high - low, count);
    let first = (low / step - 1e-9).ceil();
    (0..).map(move |k| (first + f64::from(k)) * step).take_while(move |at| *at <= high + 1e-9 * step)
}

/// From the least to the greatest value with some air.
fn widened(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    let air = if high > low { 0.05 * (high - low) } else { (0.1 * high.abs()).max(1e-6) };
    [low - air, high + air]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(bins: Vec<ProfilePoint>) -> ProfilePlot {
        ProfilePlot { title: "a profile".into(), x_label: "row".into(), y_label: "px".into(), bins, ..ProfilePlot::default() }
    }

    #[test]
    fn the_model_is_drawn_where_it_is_and_zero_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("profile.png");
        let bins = (0..9).map(|k| ProfilePoint { at: f64::from(k), mean: 1.0, sigma: 0.1, model: 2.0, stars: 40 }).collect();
        plot(bins).write(&path).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let axes = Axes { across: widened([0.0, 8.0].into_iter()), along: widened([0.0, 2.0].into_iter()) };
        let colour = |x: f64, y: f64| {
            let (x, y) = axes.place(x, y);
            read.get_pixel(x.round() as u32, y.round() as u32).0
        };
        let near = |a: [u8; 3], b: RGBColor| a.iter().zip([b.0, b.1, b.2]).all(|(a, b)| a.abs_diff(b) < 60);
        assert!(near(colour(3.4, 2.0), VERMILION) && near(colour(3.0, 1.0), BLUE) && near(colour(3.4, 0.0), GREY));
        assert!(near(colour(3.4, 1.5), PAPER));
    }

    #[test]
    fn bins_that_are_no_numbers_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("profile.png");
        let good = ProfilePoint { at: 1.0, mean: 0.0, sigma: 0.0, model: 0.0, stars: 1 };
        plot(vec![ProfilePoint { mean: f64::NAN, ..good }, good]).write(&path).unwrap();
        assert!(path.exists());
        assert!(matches!(plot(vec![ProfilePoint { at: f64::INFINITY, ..good }]).write(&path), Err(ReportError::Empty { .. })));
        assert_eq!(ticks([-0.21, 0.2], 4.0).map(short).collect::<Vec<_>>(), ["−0.2", "0", "0.2"].map(String::from).to_vec());
    }
}
