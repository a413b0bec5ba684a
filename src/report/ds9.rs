//! Region files of SAOImage DS9: stars as circles with their names, in the image's own pixels.

use std::fmt::Write;

use super::{Mark, MarkKind};

/// Radius of the circles, px.
const RADIUS_PX: f64 = 6.0;

/// The text of a region file that marks these places. DS9 counts pixels from 1; rows go as they are stored.
#[must_use]
pub fn ds9_regions(marks: &[Mark], title: &str) -> String {
    let mut text =
        format!("# Region file format: DS9 version 4.1\n# {}\nglobal width=1 font=\"helvetica 10 normal roman\"\nimage\n", one_line(title));
    for mark in marks.iter().filter(|mark| mark.x_px.is_finite() && mark.y_px.is_finite()) {
        let (x, y) = (mark.x_px + 1.0, mark.y_px + 1.0);
        let (shape, colour) = match mark.kind {
            MarkKind::Identified | MarkKind::Answered => (format!("circle({x:.4},{y:.4},{RADIUS_PX})"), "green"),
            MarkKind::Detected | MarkKind::Unanswered => (format!("point({x:.4},{y:.4})"), "yellow"),
            MarkKind::Rejected | MarkKind::Starless => (format!("circle({x:.4},{y:.4},{RADIUS_PX})"), "red"),
        };
        let point = if mark.kind == MarkKind::Detected { " point=box" } else { "" };
        // Braces hold the text; one inside would end it.
        let label = mark.label.as_deref().map(|label| format!(" text={{{}}}", one_line(label).replace(['{', '}'], ""))).unwrap_or_default();
        let _ = writeln!(text, "{shape} # color={colour}{point}{label}");
    }
    text
}

fn one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_count_from_one_and_keep_their_names_whole() {
        let mark = |kind, label: Option<&str>| Mark { x_px: 10.0, y_px: 20.5, label: label.map(str::to_owned), kind };
        let marks = [
            mark(MarkKind::Identified, Some("Vega}\n")),
            mark(MarkKind::Detected, None),
            Mark { x_px: f64::NAN, ..mark(MarkKind::Rejected, None) },
        ];
        let text = ds9_regions(&marks, "a frame\nof two lines");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1], "# a frame of two lines");
        assert_eq!(lines[4..], ["circle(11.0000,21.5000,6) # color=green text={Vega }", "point(11.0000,21.5000) # color=yellow point=box"]);
    }
}
