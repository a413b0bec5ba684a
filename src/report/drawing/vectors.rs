//! Residual vectors over the frame, before and after.

use std::path::Path;

use plotters::style::RGBColor;
use plotters::style::text_anchor::{HPos, VPos};

use super::canvas::{BLUE, Canvas, Drawn, FrameBox, INK, PAPER, VERMILION, nice_above, picture, short};
use crate::report::{ReportError, Vector, VectorPanel};

/// Longer arrows (share of the frame's larger side) are cut and drawn broken off.
const LONGEST: f64 = 0.12;
/// The median of the kept residuals is drawn about this long (share of the larger side). The median, since a fifth of the stars
/// may be wrong before a calibration has told which.
const USUAL: f64 = 0.025;
/// More arrows than these on a common scale hide each other.
const MAX_ARROWS: usize = 700;
const PANEL_WIDTH: f64 = 640.0;
const MARGIN_LEFT: f64 = 76.0;
/// The lines of text need this.
const MIN_SLOT: f64 = 460.0;
/// Height of the letters above a panel.
const TITLE: f64 = 18.0;
const GAP: f64 = 92.0;
const MARGIN_RIGHT: f64 = 24.0;
const TOP: f64 = 106.0;
const BOTTOM: f64 = 100.0;

/// Writes two panels of residual vectors side by side, as PNG.
///
/// Each panel enlarges its own arrows by a round factor, which it states with an arrow of known length: residuals before and after
/// a calibration may differ by a factor of a hundred. The 2-D rms of the kept ones stands above.
pub fn residual_vectors(path: &Path, title: &str, frame_px: (usize, usize), panels: [&VectorPanel; 2]) -> Result<(), ReportError> {
    write(path, title, frame_px, panels, None)
}

/// The same with arrows of both panels enlarged by one factor, that of the panel with the larger residuals: what is gained is seen. Of many
/// arrows only every so manieth is drawn, and that is said.
pub fn residual_vectors_on_one_scale(
    path: &Path,
    title: &str,
    frame_px: (usize, usize),
    panels: [&VectorPanel; 2],
) -> Result<(), ReportError> {
    let larger_px = frame_px.0.max(frame_px.1) as f64;
    let factor = |panel: &VectorPanel| {
        let lengths = panel.vectors.iter().filter(|v| !v.rejected).map(|v| v.dx_px.hypot(v.dy_px));
        enlargement(lengths.filter(|length| length.is_finite()).collect(), larger_px)
    };
    let factors = panels.map(|panel| (panel.vectors.iter().any(|v| !v.rejected), factor(panel)));
    let factor = factors.iter().filter(|(any, _)| *any).map(|(_, factor)| *factor).fold(f64::INFINITY, f64::min);
    write(path, title, frame_px, panels, Some(if factor.is_finite() { factor } else { 1.0 }))
}

/// Writes the panels with this factor, or each with its own.
fn write(path: &Path, title: &str, frame_px: (usize, usize), panels: [&VectorPanel; 2], factor: Option<f64>) -> Result<(), ReportError> {
    let (columns, rows) = frame_px;
    if columns == 0 || rows == 0 || panels.iter().all(|panel| panel.vectors.is_empty()) {
        return Err(ReportError::Empty { path: path.to_owned(), what: "there are no residuals" });
    }
    // Frames that are higher than wide become narrow rather than the sheet high; very flat ones keep room for the ticks.
    let aspect = rows as f64 / columns as f64;
    let width = if aspect > 1.0 { PANEL_WIDTH / aspect } else { PANEL_WIDTH }.max(PANEL_WIDTH / 3.0);
    let height = (width * aspect).clamp(60.0, PANEL_WIDTH * 1.5);
    let slot = width.max(MIN_SLOT);
    let sheet_size = (MARGIN_LEFT + slot + GAP + slot + MARGIN_RIGHT, TOP + height + BOTTOM);
    picture(path, (sheet_size.0.ceil() as usize, sheet_size.1.ceil() as usize), PAPER, |sheet| {
        sheet.text(title, (MARGIN_LEFT, 14.0), 22.0, &INK, HPos::Left, VPos::Top)?;
        for (index, panel) in panels.into_iter().enumerate() {
            let left = MARGIN_LEFT + index as f64 * (slot + GAP);
            draw(sheet, &FrameBox { corner: (left, TOP), size: (width, height), frame_px }, panel, factor)?;
        }
        Ok(())
    })
}

fn draw(sheet: &Canvas, frame_box: &FrameBox, panel: &VectorPanel, factor: Option<f64>) -> Drawn {
    let (left, top) = frame_box.corner;
    let finite = |v: &&Vector| [v.x_px, v.y_px, v.dx_px, v.dy_px].iter().all(|number| number.is_finite());
    let vectors: Vec<&Vector> = panel.vectors.iter().filter(finite).collect();
    let kept: Vec<f64> = vectors.iter().filter(|v| !v.rejected).map(|v| v.dx_px.hypot(v.dy_px)).collect();
    let rejected = vectors.len() - kept.len();
    let rms = (kept.iter().map(|length| length * length).sum::<f64>() / kept.len().max(1) as f64).sqrt();

    let title = sheet.fitting(&panel.title, TITLE, frame_box.size.0.max(MIN_SLOT))?;
    sheet.text(&title, (left, top - 58.0), TITLE, &INK, HPos::Left, VPos::Top)?;
    let summary = if kept.is_empty() { "no stars kept".to_owned() } else { format!("rms {} px, {} stars", significant(rms), kept.len()) };
    let summary = match panel.told {
        Some(told) => format!("rms {} px, {} stars", significant(told.rms_px), told.stars),
        None => summary,
    };
    let lost = panel.vectors.len() - vectors.len();
    let summary = if lost > 0 { format!("{summary}, {lost} without a finite residual") } else { summary };
    sheet.text(&summary, (left, top - 30.0), 15.0, &BLUE, HPos::Left, VPos::Top)?;
    frame_box.axes(sheet, INK)?;

    let larger_px = frame_box.frame_px.0.max(frame_box.frame_px.1) as f64;
    // On a common scale all panels show the same stars; each by itself shows them all.
    let every = if factor.is_some() { vectors.len().div_ceil(MAX_ARROWS).max(1) } else { 1 };
    let factor = factor.unwrap_or_else(|| enlargement(kept, larger_px));
    // Rejected ones below, so that they hide nothing.
    let (mut cut, longest_px) = (0, LONGEST * larger_px);
    for wrong in [true, false] {
        for vector in vectors.iter().step_by(every).filter(|v| v.rejected == wrong) {
            let (dx, dy) = (vector.dx_px * factor, vector.dy_px * factor);
            let length = dx.hypot(dy);
            let colour = if wrong { VERMILION } else { BLUE };
            let from = frame_box.place(vector.x_px, vector.y_px);
            if !frame_box.holds(from, 0.0) {
                continue;
            }
            let mut share = (longest_px / length.max(f64::MIN_POSITIVE)).min(1.0);
            let mut to = frame_box.place(vector.x_px + dx * share, vector.y_px + dy * share);
            while !frame_box.holds(to, 0.0) {
                share *= 0.9; // nothing reaches into the neighbouring panel
                to = frame_box.place(vector.x_px + dx * share, vector.y_px + dy * share);
            }
            if share < 1.0 && wrong {
                cross(sheet, from, colour)?; // how wrong a rejected one is says nothing; a field of lines hides the others
                continue;
            }
            if share < 1.0 {
                cut += 1;
                broken(sheet, from, to, colour)?;
            } else {
                sheet.arrow(from, to, colour, 1.2)?;
            }
            sheet.dot(from, 1.5, colour)?;
        }
    }
    let all = panel.told.map_or(rejected, |told| told.rejected);
    legend(sheet, frame_box, factor, (rejected, all, cut), every)
}

/// The round factor that makes usual residuals well visible.
fn enlargement(mut lengths: Vec<f64>, larger_px: f64) -> f64 {
    lengths.sort_by(f64::total_cmp);
    let usual = lengths.get(lengths.len() / 2).copied().unwrap_or(0.0);
    // from 1 to 2.5 times as much
    if usual > 0.0 { nice_above(USUAL * larger_px / usual / 1.6) } else { 1.0 }
}

/// Three significant digits.
fn significant(number: f64) -> String {
    if number == 0.0 {
        return "0".to_owned();
    }
    let digits = (2 - number.abs().log10().floor() as i32).clamp(0, 6) as usize;
    if number.abs() < 1e-4 { short(number) } else { format!("{number:.digits$}") }
}

/// A rejected point whose arrow would be longer than drawn.
fn cross(sheet: &Canvas, (x, y): (f64, f64), colour: RGBColor) -> Drawn {
    const ARM: f64 = 4.0;
    sheet.line(&[(x - ARM, y - ARM), (x + ARM, y + ARM)], colour, 1.5)?;
    sheet.line(&[(x - ARM, y + ARM), (x + ARM, y - ARM)], colour, 1.5)
}

/// An arrow that is longer than drawn: dashed at its end, without a head.
fn broken(sheet: &Canvas, from: (f64, f64), to: (f64, f64), colour: RGBColor) -> Drawn {
    let at = |share: f64| (from.0 + (to.0 - from.0) * share, from.1 + (to.1 - from.1) * share);
    for (start, end) in [(0.0, 0.7), (0.76, 0.82), (0.88, 0.92), (0.97, 1.0)] {
        sheet.line(&[at(start), at(end)], colour, 1.0)?;
    }
    Ok(())
}

fn legend(sheet: &Canvas, frame_box: &FrameBox, factor: f64, (drawn, rejected, cut): (usize, usize, usize), every: usize) -> Drawn {
    let left = frame_box.corner.0;
    let y = frame_box.corner.1 + frame_box.size.1 + 60.0;
    // A round length that is drawn 60 to 150 pixels long.
    let key_px = nice_above(60.0 / frame_box.scale() / factor);
    let key = key_px * factor * frame_box.scale();
    sheet.arrow((left, y), (left + key, y), INK, 1.5)?;
    let times = format!("{} px, arrows × {}", short(key_px), short(factor));
    let times = if every > 1 { format!("{times}; one star image in {every} is drawn") } else { times };
    sheet.text(&times, (left + key + 8.0, y), 15.0, &INK, HPos::Left, VPos::Center)?;
    let mut x = left;
    let what = match rejected.checked_sub(drawn) {
        Some(beyond) if beyond > 0 => format!("rejected, {beyond} of them beyond what is drawn"),
        _ => "rejected".to_owned(),
    };
    for (count, what, colour) in [(rejected, what.as_str(), VERMILION), (cut, "longer than drawn (dashed)", INK)] {
        if count > 0 {
            let text = format!("{count} {what}");
            sheet.text(&text, (x, y + 24.0), 15.0, &colour, HPos::Left, VPos::Center)?;
            x += sheet.text_size(&text, 15.0)?.0 + 16.0;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vector(x_px: f64, y_px: f64, dx_px: f64, dy_px: f64) -> Vector {
        Vector { x_px, y_px, dx_px, dy_px, rejected: false }
    }

    #[test]
    fn the_factor_is_round_and_shows_the_usual_residual() {
        for usual in [0.003, 0.05, 1.7, 40.0] {
            let mut lengths = vec![usual; 99];
            lengths.push(1e6); // one wrong star must not make the others invisible
            let factor = enlargement(lengths, 1000.0);
            let drawn_px = factor * usual;
            assert!((15.0..=50.0).contains(&drawn_px), "{usual} px is drawn {drawn_px} px long");
        }
        assert!((enlargement(vec![], 1000.0) - 1.0).abs() < 1e-12 && (enlargement(vec![0.0], 1000.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn numbers_keep_three_digits() {
        assert_eq!([0.0512, 3.1376, 41.27, 0.0, 0.000_02, 1234.4].map(significant), ["0.0512", "3.14", "41.3", "0", "2e−5", "1234"]);
    }

    #[test]
    fn an_arrow_lies_where_its_residual_points() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vectors.png");
        let panel = VectorPanel { title: "before".into(), vectors: vec![vector(500.0, 500.0, 1.0, 0.0)], told: None };
        let empty = VectorPanel { title: "after".into(), vectors: vec![vector(f64::NAN, 0.0, 0.0, 0.0)], told: None };
        residual_vectors(&path, "residuals", (1001, 1001), [&panel, &empty]).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let blue = |dx: f64, dy: f64| {
            let (x, y) = (MARGIN_LEFT + PANEL_WIDTH / 2.0 + dx, TOP + PANEL_WIDTH / 2.0 + dy);
            let [red, _, blue] = read.get_pixel(x as u32, y as u32).0;
            blue > 120 && red < 160
        };
        assert!(blue(5.0, 0.0) && blue(9.0, 0.0), "to the right, ×20, 0.64 pixels of the sheet each");
        assert!(!blue(-8.0, 0.0) && !blue(0.0, 8.0) && !blue(0.0, -8.0));
    }

    #[test]
    fn on_one_scale_the_smaller_residual_is_drawn_shorter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vectors.png");
        let panel = |dx_px| VectorPanel { title: "panel".into(), vectors: vec![vector(500.0, 500.0, dx_px, 0.0)], told: None };
        let length = |path: &Path, second: f64| {
            let read = image::open(path).unwrap().to_rgb8();
            let left = MARGIN_LEFT + second * (PANEL_WIDTH + GAP) + PANEL_WIDTH / 2.0;
            let row = (TOP + PANEL_WIDTH / 2.0) as u32;
            (0..120).filter(|dx| read.get_pixel(left as u32 + dx, row).0[0] < 160).count()
        };
        residual_vectors_on_one_scale(&path, "", (1001, 1001), [&panel(1.0), &panel(0.25)]).unwrap();
        let (first, second) = (length(&path, 0.0), length(&path, 1.0));
        assert!(first > 10 && second < first / 2, "{first} {second}");
        residual_vectors(&path, "", (1001, 1001), [&panel(1.0), &panel(0.25)]).unwrap();
        assert!(length(&path, 1.0) > second, "on a scale of its own it is longer");
    }

    #[test]
    fn no_residuals_are_refused() {
        let empty = VectorPanel::default();
        let path = std::env::temp_dir().join("never-written.png");
        assert!(matches!(residual_vectors(&path, "", (10, 10), [&empty, &empty]), Err(ReportError::Empty { .. })));
        assert!(!path.exists());
    }
}
