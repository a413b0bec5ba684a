//! A number over the camera's frame as colours with contours and a bar; on it dots for star images, or arrows.

use std::path::Path;

use plotters::style::Color;
use plotters::style::text_anchor::{HPos, VPos};

use super::canvas::{Canvas, Drawn, FrameBox, INK, PAPER, Place, nice_above, picture, short};
use super::colours::{Scale, colour};
use super::contours::Grid;
use crate::report::{FieldMap, ReportError};

const MAP_WIDTH: f64 = 640.0;
const MARGIN_LEFT: f64 = 76.0;
const TOP: f64 = 112.0;
const BOTTOM: f64 = 104.0;
/// Between the map and the bar: room for the bar's numbers on its left.
const BAR_GAP: f64 = 92.0;
const BAR_WIDTH: f64 = 24.0;
const BAR_RIGHT: f64 = 104.0;
const FLATTEST_BAR: f64 = 220.0;
/// Contour labels keep this distance from each other, and half of it from the edge.
const LABEL_DISTANCE: f64 = 48.0;
/// Contour labels keep this distance from the middle of an arrow.
const OFF_ARROWS: f64 = 27.0;
/// The longest arrow is at most so long, and at least two fifths of it.
const LONGEST_ARROW: f64 = 56.0;

impl FieldMap {
    /// Writes the picture of a frame of this size (columns, rows) as PNG.
    pub fn write(&self, path: &Path, frame_px: (usize, usize)) -> Result<(), ReportError> {
        let (columns, rows) = frame_px;
        if columns == 0 || rows == 0 || self.side < 2 || self.values.len() != self.side * self.side {
            return Err(ReportError::Empty { path: path.to_owned(), what: "there is no grid of values" });
        }
        if !self.values.iter().any(|value| value.is_finite()) {
            return Err(ReportError::Empty { path: path.to_owned(), what: "no value is finite" });
        }
        let aspect = rows as f64 / columns as f64;
        let width = if aspect > 1.0 { MAP_WIDTH / aspect } else { MAP_WIDTH }.max(MAP_WIDTH / 3.0);
        let height = (width * aspect).clamp(60.0, MAP_WIDTH * 1.5);
        let sheet_width = (MARGIN_LEFT + width + BAR_GAP + BAR_WIDTH + BAR_RIGHT).max(720.0);
        let size = (sheet_width.ceil() as usize, (TOP + height.max(FLATTEST_BAR) + BOTTOM).ceil() as usize);
        let frame_box = FrameBox { corner: (MARGIN_LEFT, TOP), size: (width, height), frame_px };
        picture(path, size, PAPER, |sheet| self.draw(sheet, &frame_box))
    }

    fn draw(&self, sheet: &Canvas, frame_box: &FrameBox) -> Drawn {
        let scale = Scale::holding(&[&self.values[..], &self.reach].concat());
        sheet.text(&self.title, (MARGIN_LEFT, 16.0), 22.0, &INK, HPos::Left, VPos::Top)?;
        sheet.text(&self.summary, (MARGIN_LEFT, 50.0), 15.0, &INK, HPos::Left, VPos::Top)?;
        self.colours(sheet, frame_box, &scale)?;
        self.contours(sheet, frame_box, &scale)?;
        for [x_px, y_px] in &self.dots {
            let place = frame_box.place(*x_px, *y_px);
            if frame_box.holds(place, 0.0) {
                sheet.dot(place, if self.dots.len() > 3000 { 0.8 } else { 1.5 }, INK.mix(0.75))?;
            }
        }
        let key = self.draw_arrows(sheet, frame_box)?;
        frame_box.axes(sheet, INK)?;
        self.bar(sheet, frame_box, &scale)?;
        let (left, y) = (frame_box.corner.0, frame_box.corner.1 + frame_box.size.1 + 64.0);
        let mut note_at = (left, y);
        if let Some((length, text)) = key {
            self.draw_arrow(sheet, (left, y), (left + length, y))?;
            sheet.text(&text, (left + length + 8.0, y), 15.0, &INK, HPos::Left, VPos::Center)?;
            note_at = (left, y + 24.0);
        }
        sheet.text(&self.note, note_at, 15.0, &INK, HPos::Left, VPos::Center)
    }

    /// The grid's place of a place on the sheet.
    fn on_grid(&self, frame_box: &FrameBox, (x, y): Place) -> (f64, f64) {
        let steps = self.side as f64 - 1.0;
        let along = |at: f64, length: f64, count: usize| (at / length * count as f64 - 0.5) / (count as f64 - 1.0).max(1.0) * steps;
        (
            along(x - frame_box.corner.0, frame_box.size.0, frame_box.frame_px.0),
            along(y - frame_box.corner.1, frame_box.size.1, frame_box.frame_px.1),
        )
    }

    /// The place on the sheet of a place on the grid.
    fn on_sheet(&self, frame_box: &FrameBox, (column, row): (f64, f64)) -> Place {
        let along =
            |at: f64, length: f64, count: usize| (at / (self.side as f64 - 1.0) * (count as f64 - 1.0) + 0.5) / count as f64 * length;
        (
            frame_box.corner.0 + along(column, frame_box.size.0, frame_box.frame_px.0),
            frame_box.corner.1 + along(row, frame_box.size.1, frame_box.frame_px.1),
        )
    }

    fn colours(&self, sheet: &Canvas, frame_box: &FrameBox, scale: &Scale) -> Drawn {
        let grid = Grid { values: &self.values, side: self.side };
        let (left, top) = frame_box.corner;
        for row in 0..frame_box.size.1.ceil() as usize {
            for column in 0..frame_box.size.0.ceil() as usize {
                let corner = (left + column as f64, top + row as f64);
                let (x, y) = self.on_grid(frame_box, (corner.0 + 0.5, corner.1 + 0.5));
                let value = grid.between(x, y);
                let shade = if value.is_finite() { colour(scale.share(value)) } else { PAPER };
                let end = ((corner.0 + 1.0).min(left + frame_box.size.0), (corner.1 + 1.0).min(top + frame_box.size.1));
                sheet.fill(corner, end, shade)?;
            }
        }
        Ok(())
    }

    /// The contours at the bar's ticks, each piece with its number where there is room for it.
    fn contours(&self, sheet: &Canvas, frame_box: &FrameBox, scale: &Scale) -> Drawn {
        let grid = Grid { values: &self.values, side: self.side };
        let arrows: Vec<Place> = self.arrows.iter().map(|arrow| frame_box.place(arrow.x_px, arrow.y_px)).collect();
        let mut labels: Vec<Place> = Vec::new();
        let mut texts = Vec::new();
        for tick in &scale.ticks {
            for piece in grid.pieces(*tick) {
                let mut middles = Vec::new();
                for segment in piece {
                    let [a, b] = segment.map(|place| self.on_sheet(frame_box, place));
                    sheet.line(&[a, b], INK.mix(0.55), 1.0)?;
                    let middle = (f64::midpoint(a.0, b.0), f64::midpoint(a.1, b.1));
                    let hidden = arrows.iter().any(|arrow| (arrow.0 - middle.0).hypot(arrow.1 - middle.1) < OFF_ARROWS);
                    if frame_box.holds(middle, LABEL_DISTANCE / 2.0) && !hidden {
                        middles.push(middle);
                    }
                }
                // The place that is farthest from all labels so far.
                let free = |middle: &Place| labels.iter().map(|l| (l.0 - middle.0).hypot(l.1 - middle.1)).fold(f64::INFINITY, f64::min);
                let places = middles.iter().map(|middle| (free(middle), *middle)).filter(|(free, _)| *free >= LABEL_DISTANCE);
                if let Some((_, place)) = places.max_by(|a, b| a.0.total_cmp(&b.0)) {
                    labels.push(place);
                    texts.push((place, scale.label(*tick)));
                }
            }
        }
        for (place, text) in texts {
            let (width, height) = sheet.text_size(&text, 13.0)?;
            let (wide, high) = (width / 2.0 + 3.0, height / 2.0 + 1.0);
            sheet.fill((place.0 - wide, place.1 - high), (place.0 + wide, place.1 + high), PAPER.mix(0.8))?;
            sheet.text(&text, place, 13.0, &INK, HPos::Center, VPos::Center)?;
        }
        Ok(())
    }

    /// Draws the arrows; the length of the key's arrow on the sheet and what it stands for.
    fn draw_arrows(&self, sheet: &Canvas, frame_box: &FrameBox) -> Result<Option<(f64, String)>, Box<dyn std::error::Error>> {
        let longest =
            self.arrows.iter().map(|arrow| arrow.dx_px.hypot(arrow.dy_px)).filter(|length| length.is_finite()).fold(0.0, f64::max);
        if longest <= 0.0 {
            return Ok(None);
        }
        let factor = nice_above(LONGEST_ARROW / 2.5 / (longest * frame_box.scale()));
        for arrow in self.arrows.iter().filter(|arrow| arrow.dx_px.is_finite() && arrow.dy_px.is_finite()) {
            let from = frame_box.place(arrow.x_px, arrow.y_px);
            let by = factor * frame_box.scale();
            // Centred on its point, so that none leaves the frame.
            let half = (arrow.dx_px * by / 2.0, arrow.dy_px * by / 2.0);
            self.draw_arrow(sheet, (from.0 - half.0, from.1 - half.1), (from.0 + half.0, from.1 + half.1))?;
        }
        let key = nice_above(longest / 2.0);
        let told = match &self.whiskers {
            Some(unit) => format!("{} {unit}", short(key)),
            None => format!("{} px, arrows × {}", short(key), short(factor)),
        };
        Ok(Some((key * factor * frame_box.scale(), told)))
    }

    /// A dark arrow, or a line without a head, with a light edge, which is seen on any colour.
    fn draw_arrow(&self, sheet: &Canvas, from: Place, to: Place) -> Drawn {
        if self.whiskers.is_some() {
            sheet.line(&[from, to], PAPER, 4.5)?;
            return sheet.line(&[from, to], INK, 2.0);
        }
        sheet.arrow(from, to, PAPER, 4.0)?;
        sheet.arrow(from, to, INK, 1.4)
    }

    fn bar(&self, sheet: &Canvas, frame_box: &FrameBox, scale: &Scale) -> Drawn {
        let (left, top) = (frame_box.corner.0 + frame_box.size.0 + BAR_GAP, frame_box.corner.1);
        let (right, height) = (left + BAR_WIDTH, frame_box.size.1.max(FLATTEST_BAR));
        let bottom = top + height;
        let steps = height.ceil() as usize;
        for step in 0..steps {
            let y = top + step as f64;
            sheet.fill((left, y), (right, (y + 1.0).min(bottom)), colour(1.0 - (step as f64 + 0.5) / height))?;
        }
        sheet.line(&[(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], INK, 1.0)?;
        let at = |scale: &Scale, tick: f64| bottom - scale.share(tick) * height;
        for tick in &scale.ticks {
            let y = at(scale, *tick);
            sheet.line(&[(left - 5.0, y), (left, y)], INK, 1.0)?;
            sheet.text(&scale.label(*tick), (left - 8.0, y), 14.0, &INK, HPos::Right, VPos::Center)?;
        }
        sheet.text(&self.unit, (left - 8.0, top - 14.0), 14.0, &INK, HPos::Right, VPos::Bottom)?;
        if let Some((unit, factor)) = &self.second_unit {
            let second = scale.times(*factor);
            for tick in &second.ticks {
                let y = at(&second, *tick);
                sheet.line(&[(right, y), (right + 5.0, y)], INK, 1.0)?;
                sheet.text(&second.label(*tick), (right + 8.0, y), 14.0, &INK, HPos::Left, VPos::Center)?;
            }
            sheet.text(unit, (right + 8.0, top - 14.0), 14.0, &INK, HPos::Left, VPos::Bottom)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Vector;

    fn cone() -> FieldMap {
        let values = (0..25).map(|k| f64::from(k % 5 - 2).hypot(f64::from(k / 5 - 2))).collect();
        FieldMap {
            title: "a cone".into(),
            values,
            side: 5,
            unit: "px".into(),
            second_unit: Some(("arcsec".into(), 40.0)),
            ..FieldMap::default()
        }
    }

    #[test]
    fn colours_follow_the_values() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.png");
        cone().write(&path, (1000, 1000)).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let at = |x: f64, y: f64| read.get_pixel((MARGIN_LEFT + x * MAP_WIDTH) as u32, (TOP + y * MAP_WIDTH) as u32).0;
        let green = |place: [u8; 3]| place[1];
        assert!(green(at(0.5, 0.5)) > 235 && green(at(0.02, 0.02)) < 190, "{:?} {:?}", at(0.5, 0.5), at(0.02, 0.02));
        let close = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) < 6);
        // Contours and their labels lie on some of the places.
        let places = (0..400).map(|k| (0.02 + 0.96 * f64::from(k % 20) / 19.0, 0.02 + 0.96 * f64::from(k / 20) / 19.0));
        let symmetric = places.filter(|(x, y)| close(at(*x, *y), at(1.0 - x, 1.0 - y))).count();
        assert!(symmetric > 300, "{symmetric} of 400 places are as their opposites");
    }

    #[test]
    fn an_arrow_points_as_it_should() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.png");
        let arrow = Vector { x_px: 500.0, y_px: 500.0, dx_px: 0.02, dy_px: 0.0, rejected: false };
        FieldMap { arrows: vec![arrow], values: vec![0.0; 25], ..cone() }.write(&path, (1001, 1001)).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        // Dark pixels in a column of the sheet beside the arrow's middle: the shaft alone, or the wings of the head too.
        let dark = |dx: i32| {
            let (x, y) = ((MARGIN_LEFT + MAP_WIDTH / 2.0) as i32 + dx, (TOP + MAP_WIDTH / 2.0) as i32);
            (-12..=12).filter(|dy| read.get_pixel(x as u32, (y + dy) as u32).0.iter().all(|c| *c < 140)).count()
        };
        let widest = |range: std::ops::Range<i32>| range.map(dark).max().unwrap();
        assert!(dark(0) >= 1 && widest(2..40) >= 3 && widest(-40..-2) < 3, "{:?}", (-40..40).map(dark).collect::<Vec<_>>());
    }

    #[test]
    fn nothing_to_show_is_refused() {
        let path = std::env::temp_dir().join("never-written-map.png");
        for map in [FieldMap::default(), FieldMap { values: vec![f64::NAN; 25], ..cone() }, FieldMap { side: 4, ..cone() }] {
            assert!(matches!(map.write(&path, (10, 10)), Err(ReportError::Empty { .. })));
        }
        assert!(matches!(cone().write(&path, (0, 10)), Err(ReportError::Empty { .. })));
        assert!(!path.exists());
    }
}
