//! What something does to a frame: the frame without it, with it, and their difference, whole and close by.

use std::path::Path;

use plotters::style::RGBColor;
use plotters::style::text_anchor::{HPos, VPos};

use super::canvas::{Canvas, Drawn, FrameBox, INK, PAPER, nice_above, picture, short};
use crate::report::{OffOn, ReportError};

/// Pixels of the sheet along a frame.
const SIDE: f64 = 320.0;
const LEFT: f64 = 66.0;
const GAP: f64 = 26.0;
const TOP: f64 = 122.0;
const BETWEEN: f64 = 62.0;
/// Pixels along the part that is shown close by.
const CLOSE_PX: usize = 40;
/// The difference is white where it is nothing, and of these colours where it is largest.
const LESS: [f64; 3] = [0.0, 90.0, 170.0];
const MORE: [f64; 3] = [200.0, 70.0, 0.0];

/// A square part of a frame.
#[derive(Clone, Copy)]
struct Part {
    x: usize,
    y: usize,
    side: usize,
}

impl OffOn {
    /// Writes the picture as PNG. Frames that are the same all over are refused: their picture would show nothing.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let (columns, rows) = self.frame_px;
        let side = columns.min(rows);
        if side < CLOSE_PX || self.off_dn.len() != columns * rows || self.on_dn.len() != columns * rows {
            return Err(ReportError::Empty { path: path.to_owned(), what: "there are no two frames of one size" });
        }
        if self.largest_dn() == 0.0 {
            return Err(ReportError::Empty { path: path.to_owned(), what: "the frames are the same" });
        }
        let size = (LEFT + 3.0 * (SIDE + GAP), TOP + 2.0 * SIDE + BETWEEN + 44.0);
        picture(path, (size.0 as usize, size.1 as usize), PAPER, |sheet| self.draw(sheet))
    }

    fn draw(&self, sheet: &Canvas) -> Drawn {
        sheet.text(&self.title, (LEFT, 14.0), 22.0, &INK, HPos::Left, VPos::Top)?;
        for (number, line) in self.summary_lines(sheet)?.iter().enumerate() {
            sheet.text(line, (LEFT, 44.0 + 20.0 * number as f64), 15.0, &INK, HPos::Left, VPos::Top)?;
        }
        let (columns, rows) = self.frame_px;
        let difference: Vec<f32> = self.on_dn.iter().zip(&self.off_dn).map(|(on, off)| on - off).collect();
        let whole = Part { x: 0, y: 0, side: columns.min(rows) };
        let near = self.close_by(&difference);
        for (row, part) in [whole, near].into_iter().enumerate() {
            // Hot pixels alone are more than a few; the rest of the light must be seen beside them.
            let largest = reach(self.of(part, &difference), if row == 0 { 0.998 } else { 1.0 });
            let titles = ["off".to_owned(), "on".to_owned(), format!("on − off, colours to ±{} DN", short(nice_above(largest)))];
            let both = || self.of(part, &self.off_dn).chain(self.of(part, &self.on_dn));
            let (black, white) = (low(both()), reach(both(), 1.0));
            for (column, title) in titles.iter().enumerate() {
                let corner = (LEFT + column as f64 * (SIDE + GAP), TOP + row as f64 * (SIDE + BETWEEN));
                sheet.text(title, (corner.0, corner.1 - 20.0), 15.0, &INK, HPos::Left, VPos::Top)?;
                let values = [&self.off_dn, &self.on_dn, &difference][column];
                let colour = |value: f32| match column {
                    2 => diverging(f64::from(value) / nice_above(largest)),
                    _ => grey((f64::from(value) - black) / (white - black).max(1.0)),
                };
                self.pixels(sheet, corner, part, values, colour)?;
                let frame_box = FrameBox { corner, size: (SIDE, SIDE), frame_px: (part.side, part.side) };
                edge(sheet, &frame_box, part)?;
            }
        }
        Ok(())
    }

    /// The summary cut between words, so that it fits the sheet.
    fn summary_lines(&self, sheet: &Canvas) -> Result<Vec<String>, Box<dyn std::error::Error>> {
        let mut lines = vec![String::new()];
        for word in self.summary.split_whitespace() {
            let last = lines.len() - 1;
            let longer = if lines[last].is_empty() { word.to_owned() } else { format!("{} {word}", lines[last]) };
            if sheet.text_size(&longer, 15.0)?.0 <= 3.0 * SIDE + 2.0 * GAP || lines[last].is_empty() {
                lines[last] = longer;
            } else {
                lines.push(word.to_owned());
            }
        }
        Ok(lines)
    }

    fn of<'a>(&self, part: Part, values: &'a [f32]) -> impl Iterator<Item = f32> + Clone + 'a {
        let columns = self.frame_px.0;
        (part.y..part.y + part.side).flat_map(move |y| values[y * columns + part.x..][..part.side].iter().copied())
    }

    /// The part around the place where the light that changed is most.
    fn close_by(&self, difference: &[f32]) -> Part {
        let (columns, rows) = self.frame_px;
        let (mut best, mut place) = (f32::NEG_INFINITY, 0);
        for (index, change) in difference.iter().enumerate() {
            if change.abs() > best {
                (best, place) = (change.abs(), index);
            }
        }
        let corner = |at: usize, length: usize| at.saturating_sub(CLOSE_PX / 2).min(length - CLOSE_PX);
        Part { x: corner(place % columns, columns), y: corner(place / columns, rows), side: CLOSE_PX }
    }

    fn pixels(&self, sheet: &Canvas, corner: (f64, f64), part: Part, values: &[f32], colour: impl Fn(f32) -> RGBColor) -> Drawn {
        let step = SIDE / part.side as f64;
        for (place, value) in self.of(part, values).enumerate() {
            let (x, y) = (corner.0 + (place % part.side) as f64 * step, corner.1 + (place / part.side) as f64 * step);
            sheet.fill((x, y), (x + step, y + step), colour(value))?;
        }
        Ok(())
    }
}

/// The value that this share of the sizes does not exceed.
fn reach(values: impl Iterator<Item = f32>, share: f64) -> f64 {
    let mut sizes: Vec<f32> = values.map(f32::abs).collect();
    sizes.sort_by(f32::total_cmp);
    let at = ((sizes.len().max(1) - 1) as f64 * share) as usize;
    let found = f64::from(sizes.get(at).copied().unwrap_or_default());
    let largest = f64::from(sizes.last().copied().unwrap_or_default());
    if found > 0.0 { found } else { largest.max(1e-3) }
}

fn low(values: impl Iterator<Item = f32>) -> f64 {
    f64::from(values.fold(f32::INFINITY, f32::min))
}

/// Linear in the dark, logarithmic where it is bright.
fn grey(share: f64) -> RGBColor {
    const SOFT: f64 = 0.003;
    let level = ((share.clamp(0.0, 1.0) / SOFT).asinh() / (1.0 / SOFT).asinh() * 255.0).round() as u8;
    RGBColor(level, level, level)
}

fn diverging(share: f64) -> RGBColor {
    // The root shows what is a hundredth of the largest as a tenth.
    let depth = share.abs().min(1.0).sqrt();
    let end = if share < 0.0 { LESS } else { MORE };
    let [red, green, blue] = end.map(|level| (255.0 + depth * (level - 255.0)).round() as u8);
    RGBColor(red, green, blue)
}

fn edge(sheet: &Canvas, frame_box: &FrameBox, part: Part) -> Drawn {
    let (left, top) = frame_box.corner;
    let (right, bottom) = (left + SIDE, top + SIDE);
    sheet.line(&[(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], INK, 1.0)?;
    for along in [0, part.side - 1] {
        let (x, y) = frame_box.place(along as f64, along as f64);
        sheet.text(&(part.x + along).to_string(), (x, bottom + 6.0), 13.0, &INK, HPos::Center, VPos::Top)?;
        if left < LEFT + 1.0 {
            sheet.text(&(part.y + along).to_string(), (left - 6.0, y), 13.0, &INK, HPos::Right, VPos::Center)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_are_the_same_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("same.png");
        let mut two = OffOn {
            title: "nothing".into(),
            summary: String::new(),
            frame_px: (64, 48),
            off_dn: vec![100.0; 64 * 48],
            on_dn: vec![100.0; 64 * 48],
        };
        assert!(matches!(two.write(&path), Err(ReportError::Empty { .. })));
        two.on_dn[20 * 64 + 30] = 90.0;
        two.write(&path).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let blue = read.pixels().filter(|pixel| pixel[2] > 150 && pixel[0] < 40).count();
        assert!(blue > 80, "{blue} blue pixels: one of the frame, close by {} wide", SIDE / CLOSE_PX as f64);
    }
}
