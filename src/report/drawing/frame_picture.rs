//! A frame as people see it: stretched, with its stars marked and named.

use std::path::Path;

use plotters::style::RGBColor;
use plotters::style::text_anchor::{HPos, VPos};

use super::canvas::{Canvas, Drawn, FrameBox, ORANGE, Place, picture};
use crate::frame::Frame;
use crate::report::{Figure, Mark, MarkKind, ReportError};
use crate::statistics::mad_sigma;

/// Width and height of the frame on the sheet are kept below this.
const LARGEST: usize = 1440;
/// Small frames are enlarged up to this.
const SMALL: usize = 720;
/// Space for ticks and legend: left, top, right, bottom.
const MARGIN: (usize, usize, usize, usize) = (72, 14, 20, 78);
/// The legend needs this width, however small the frame is.
const MIN_WIDTH: usize = 560;
const RADIUS: f64 = 9.0;
const NAME_SIZE: f64 = 15.0;
const FIGURE_SIZE: f64 = 18.0;
/// Numbers beyond the brightest of these only fill the picture.
const MAX_NUMBERS: usize = 40;

const NIGHT: RGBColor = RGBColor(14, 15, 20);
const GREY: RGBColor = RGBColor(190, 192, 200);
const BLUE_GREY: RGBColor = RGBColor(95, 125, 175);
const MINT: RGBColor = RGBColor(70, 225, 170);
const RED: RGBColor = RGBColor(255, 105, 90);

/// Writes a picture of a frame with marks, as PNG.
///
/// The brightest marks come first: where names would overlap, theirs are shown and the others' left out (proper names before
/// catalogue numbers). Marks outside the frame are not drawn. Figures lie behind the marks.
pub fn frame_picture(path: &Path, frame: &Frame, marks: &[Mark], figures: &[Figure]) -> Result<(), ReportError> {
    let largest = frame.width_px.max(frame.height_px);
    if largest == 0 || frame.pixels_dn.len() != frame.width_px * frame.height_px {
        return Err(ReportError::Empty { path: path.to_owned(), what: "the frame has no pixels" });
    }
    let shrink = largest.div_ceil(LARGEST);
    let enlarge = (SMALL / largest).max(1);
    let shown = shrunk(frame, shrink);
    let size = (shown.width_px * enlarge, shown.height_px * enlarge);
    let sheet_size = ((size.0 + MARGIN.0 + MARGIN.2).max(MIN_WIDTH), size.1 + MARGIN.1 + MARGIN.3);
    // A last block that is not full makes the shrunk frame a little larger than the frame; the box speaks of whole blocks.
    let frame_box = FrameBox {
        corner: (MARGIN.0 as f64, MARGIN.1 as f64),
        size: (size.0 as f64, size.1 as f64),
        frame_px: (shown.width_px * shrink, shown.height_px * shrink),
    };
    let stretch = Stretch::of(&shown);
    picture(path, sheet_size, NIGHT, |sheet| {
        pixels(sheet, &shown, &stretch, enlarge)?;
        frame_box.axes(sheet, GREY)?;
        let marks: Vec<(Place, &Mark)> = marks
            .iter()
            .map(|mark| (frame_box.place(mark.x_px, mark.y_px), mark))
            .filter(|(place, _)| frame_box.holds(*place, 0.0))
            .collect();
        let figures = drawn_figures(sheet, &frame_box, figures)?;
        for (place, mark) in &marks {
            symbol(sheet, *place, mark.kind)?;
        }
        let (named, nameable) = names(sheet, &frame_box, &marks, &figures)?;
        legend(sheet, &marks, (named, nameable), &stretch, sheet_size)
    })
}

/// The frame made smaller by whole blocks, each its brightest pixel: a mean would lose the faint stars.
fn shrunk(frame: &Frame, factor: usize) -> Frame {
    let (width_px, height_px) = (frame.width_px.div_ceil(factor), frame.height_px.div_ceil(factor));
    let mut pixels_dn = vec![f32::NEG_INFINITY; width_px * height_px];
    for (index, &value) in frame.pixels_dn.iter().enumerate() {
        let (x, y) = (index % frame.width_px / factor, index / frame.width_px / factor);
        let brightest = &mut pixels_dn[y * width_px + x];
        *brightest = brightest.max(value);
    }
    Frame { width_px, height_px, pixels_dn, saturation_dn: frame.saturation_dn }
}

/// Counts → brightness: linear near the background, logarithmic above.
#[allow(clippy::struct_field_names, reason = "the unit is part of every name")]
struct Stretch {
    black_dn: f64,
    soft_dn: f64,
    white_dn: f64,
}

impl Stretch {
    fn of(frame: &Frame) -> Self {
        let step = (frame.pixels_dn.len() / 200_000).max(1);
        let value = |index: usize| f64::from(frame.pixels_dn[index]);
        let mut sample: Vec<f64> = (0..frame.pixels_dn.len()).step_by(step).map(value).collect();
        // Noise from neighbours, which share their background: vignetting and glow do not enter it.
        let differences: Vec<f64> = (1..frame.pixels_dn.len()).step_by(step).map(|index| value(index) - value(index - 1)).collect();
        let noise = mad_sigma(&differences).unwrap_or(0.0) / std::f64::consts::SQRT_2;
        sample.sort_by(f64::total_cmp);
        let share = |share: f64| sample[((sample.len() - 1) as f64 * share) as usize];
        let brightest = f64::from(frame.pixels_dn.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        // On a background without noise the steps of the converter stand in for it, or what there is above it.
        let soft_dn = if noise > 0.0 { 5.0 * noise } else { ((brightest - share(0.5)) / 50.0).max(1.0) };
        // The darkest part of the background is black: the 2nd percentile lies 2σ below it, unless the converter cut it off.
        let black_dn = (share(0.02) + 2.0 * noise).min(share(0.5));
        let white_dn = share(0.9995).max(share(0.5) + 12.0 * soft_dn);
        Self { black_dn, soft_dn, white_dn }
    }

    /// In forty steps: the eye sees no fewer on a noisy frame, and the file becomes a third.
    fn grey(&self, value_dn: f32) -> u8 {
        let bent = |dn: f64| ((dn - self.black_dn) / self.soft_dn).asinh();
        let share = (bent(f64::from(value_dn)) / bent(self.white_dn)).clamp(0.0, 1.0);
        ((share * 40.0).round() * (255.0 / 40.0)).round() as u8
    }
}

fn pixels(sheet: &Canvas, frame: &Frame, stretch: &Stretch, enlarge: usize) -> Drawn {
    let (area, factor) = sheet.raw();
    let side = (enlarge as f64 * factor) as i32;
    let (left, top) = ((MARGIN.0 as f64 * factor) as i32, (MARGIN.1 as f64 * factor) as i32);
    for (row, values) in (0..).zip(frame.pixels_dn.chunks(frame.width_px)) {
        for (column, &value) in (0..).zip(values) {
            let grey = stretch.grey(value);
            for place in 0..side * side {
                let (x, y) = (left + column * side + place % side, top + row * side + place / side);
                area.draw_pixel((x, y), &RGBColor(grey, grey, grey))?;
            }
        }
    }
    Ok(())
}

fn colour(kind: MarkKind) -> RGBColor {
    match kind {
        MarkKind::Detected | MarkKind::Unanswered => ORANGE,
        MarkKind::Identified | MarkKind::Answered => MINT,
        MarkKind::Rejected | MarkKind::Starless => RED,
    }
}

/// Form and colour both tell the kinds apart.
fn symbol(sheet: &Canvas, (x, y): Place, kind: MarkKind) -> Drawn {
    let colour = colour(kind);
    match kind {
        MarkKind::Identified | MarkKind::Answered => sheet.circle((x, y), RADIUS, colour, 1.5),
        MarkKind::Detected | MarkKind::Unanswered => {
            let side = RADIUS * 0.8;
            let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(i, j)| (x + i * side, y + j * side));
            sheet.line(&corners, colour, 1.0)
        }
        MarkKind::Rejected | MarkKind::Starless => {
            sheet.circle((x, y), RADIUS, colour, 1.5)?;
            let (near, far) = (RADIUS * 0.75, RADIUS * 1.5);
            for (i, j) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                sheet.line(&[(x + i * near, y + j * near), (x + i * far, y + j * far)], colour, 1.5)?;
            }
            Ok(())
        }
    }
}

/// Draws the pieces of figures that lie on the frame, clear of the stars at their ends; returns their names, each with the middle of what is seen of
/// it, where that is long enough to bear a name.
fn drawn_figures(sheet: &Canvas, frame_box: &FrameBox, figures: &[Figure]) -> Result<Vec<(Place, String)>, Box<dyn std::error::Error>> {
    const MIN_LENGTH_PX: f64 = 60.0;
    let mut names = Vec::new();
    for figure in figures {
        let (mut sum, mut length) = ((0.0, 0.0), 0.0);
        for chain in &figure.chains {
            let places: Vec<Place> = chain.iter().map(|[x, y]| frame_box.place(*x, *y)).collect();
            let apart = |a: Place, b: Place| (a.0 - b.0).hypot(a.1 - b.1);
            let ends = [places.first(), places.last()];
            let is_clear = |place: Place| ends.iter().flatten().all(|end| apart(**end, place) > RADIUS + 2.0);
            for pair in places.windows(2) {
                if pair.iter().all(|place| frame_box.holds(*place, 1.0) && is_clear(*place)) {
                    sheet.line(pair, BLUE_GREY, 1.0)?;
                    let piece = apart(pair[0], pair[1]);
                    length += piece;
                    sum = (sum.0 + piece * 0.5 * (pair[0].0 + pair[1].0), sum.1 + piece * 0.5 * (pair[0].1 + pair[1].1));
                }
            }
        }
        if length > MIN_LENGTH_PX {
            names.push(((sum.0 / length, sum.1 / length), figure.name.clone()));
        }
    }
    Ok(names)
}

/// A rectangle on the sheet: left, top, right, bottom.
type Area = [f64; 4];

fn overlap(a: &Area, b: &Area) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// Writes the names that find room beside their marks; returns how many, and how many there are.
fn names(
    sheet: &Canvas,
    frame_box: &FrameBox,
    marks: &[(Place, &Mark)],
    figures: &[(Place, String)],
) -> Result<(usize, usize), Box<dyn std::error::Error>> {
    let is_number = |label: &str| label.starts_with(|c: char| c.is_ascii_digit()) || label.starts_with("HIP ");
    let labelled = || marks.iter().filter_map(|(place, mark)| mark.label.as_deref().map(|label| (*place, mark.kind, label)));
    let with_names = labelled().filter(|(_, _, label)| !is_number(label));
    let with_numbers = labelled().filter(|(_, _, label)| is_number(label)).take(MAX_NUMBERS);
    let around = |(x, y): Place| [x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS];
    let mut taken: Vec<Area> = marks.iter().map(|(place, _)| around(*place)).collect();
    for ((x, y), name) in figures {
        let (width, height) = sheet.text_size(name, FIGURE_SIZE)?;
        // A little above or below the middle, where no star is in the way.
        let rows = [0.0, -1.5, 1.5, -3.0, 3.0].map(|line| y + line * height);
        let areas = rows.map(|y| [x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height]);
        let free = |area: &&Area| {
            let is_inside = [(area[0], area[1]), (area[2], area[3])].iter().all(|corner| frame_box.holds(*corner, 2.0));
            is_inside && !taken.iter().any(|other| overlap(area, other))
        };
        let Some(area) = areas.iter().find(free).copied() else { continue };
        sheet.text(name, (area[0], area[1]), FIGURE_SIZE, &BLUE_GREY, HPos::Left, VPos::Top)?;
        taken.push(area);
    }
    let mut written = 0;
    for ((x, y), kind, label) in with_names.chain(with_numbers) {
        let (width, height) = sheet.text_size(label, NAME_SIZE)?;
        let (away, diagonal) = (RADIUS + 4.0, RADIUS * 0.7 + 3.0);
        let half = height / 2.0;
        let corners = [
            (x + away, y - half),
            (x + diagonal, y - diagonal - height),
            (x + diagonal, y + diagonal),
            (x - away - width, y - half),
            (x - diagonal - width, y - diagonal - height),
            (x - diagonal - width, y + diagonal),
            (x - width / 2.0, y - away - height),
            (x - width / 2.0, y + away),
        ];
        let room = corners.into_iter().map(|(left, top)| [left - 2.0, top - 1.0, left + width + 2.0, top + height + 1.0]).find(|area| {
            frame_box.holds((area[0], area[1]), 2.0)
                && frame_box.holds((area[2], area[3]), 2.0)
                && !taken.iter().any(|other| overlap(area, other))
        });
        let Some(area) = room else { continue };
        let place = (area[0] + 2.0, area[1] + 1.0);
        // A rim in the colour of the night keeps letters readable on a bright background.
        for (dx, dy) in [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)] {
            sheet.text(label, (place.0 + dx, place.1 + dy), NAME_SIZE, &NIGHT, HPos::Left, VPos::Top)?;
        }
        sheet.text(label, place, NAME_SIZE, &colour(kind), HPos::Left, VPos::Top)?;
        taken.push(area);
        written += 1;
    }
    Ok((written, labelled().count()))
}

fn legend(sheet: &Canvas, marks: &[(Place, &Mark)], (named, nameable): (usize, usize), stretch: &Stretch, size: (usize, usize)) -> Drawn {
    let (mut x, y) = (MARGIN.0 as f64 + RADIUS, size.1 as f64 - 22.0);
    let kinds = [
        (MarkKind::Identified, "identified"),
        (MarkKind::Detected, "detected only"),
        (MarkKind::Rejected, "rejected"),
        (MarkKind::Answered, "stars answered"),
        (MarkKind::Unanswered, "stars not answered"),
        (MarkKind::Starless, "answers without a star"),
    ];
    for (kind, what) in kinds {
        let count = marks.iter().filter(|(_, mark)| mark.kind == kind).count();
        if count == 0 {
            continue;
        }
        symbol(sheet, (x, y), kind)?;
        let text = format!("{count} {what}");
        sheet.text(&text, (x + RADIUS + 6.0, y), NAME_SIZE, &colour(kind), HPos::Left, VPos::Center)?;
        x += RADIUS * 2.0 + 30.0 + sheet.text_size(&text, NAME_SIZE)?.0;
    }
    let right = size.0 as f64 - MARGIN.2 as f64;
    let shades = format!("black {:.0} DN, white {:.0} DN, asinh", stretch.black_dn, stretch.white_dn);
    let names = if named < nameable { format!("{named} of {nameable} names shown; ") } else { String::new() };
    // What there is room for.
    for text in [format!("{names}{shades}"), shades] {
        if x + sheet.text_size(&text, NAME_SIZE)?.0 < right {
            return sheet.text(&text, (right, y), NAME_SIZE, &GREY, HPos::Right, VPos::Center);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(width_px: usize, height_px: usize, value: impl Fn(usize, usize) -> f32) -> Frame {
        let pixels_dn = (0..width_px * height_px).map(|index| value(index % width_px, index / width_px)).collect();
        Frame { width_px, height_px, pixels_dn, saturation_dn: 4095.0 }
    }

    fn mark(x_px: f64, y_px: f64, label: &str) -> Mark {
        Mark { x_px, y_px, label: Some(label.into()), kind: MarkKind::Identified }
    }

    #[test]
    fn frames_of_any_size_and_content_have_a_picture() {
        let folder = tempfile::tempdir().unwrap();
        let frames = [
            frame(1, 1, |_, _| 0.0),
            frame(64, 3, |_, _| 255.0),
            frame(3, 2000, |x, y| (x * y) as f32),
            frame(300, 200, |x, _| if x == 7 { 4095.0 } else { -3.0 }),
        ];
        for (index, frame) in frames.iter().enumerate() {
            let path = folder.path().join(format!("{index}.png"));
            let marks = [mark(0.0, 0.0, "Vega"), mark(1e9, -5.0, "outside"), mark(f64::NAN, 0.0, "nowhere")];
            let figure = Figure { name: "Lyra".into(), chains: vec![vec![[0.0, 0.0], [5.0, 1.0], [1e12, f64::NAN]], vec![]] };
            frame_picture(&path, frame, &marks, &[figure]).unwrap();
            let read = image::open(&path).unwrap();
            assert!((MIN_WIDTH as u32..=1600).contains(&read.width()) && read.height() <= 1600, "{}", read.width());
        }
        let nothing = frame(0, 0, |_, _| 0.0);
        assert!(matches!(frame_picture(&folder.path().join("x.png"), &nothing, &[], &[]), Err(ReportError::Empty { .. })));
    }

    #[test]
    fn the_mark_stands_where_the_star_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("star.png");
        let night = frame(800, 600, |x, y| 100.0 + if (x, y) == (400, 250) { 3000.0 } else { ((x * 7 + y * 13) % 5) as f32 });
        frame_picture(&path, &night, &[mark(400.0, 250.0, "Vega")], &[]).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let (x, y) = (MARGIN.0 as u32 + 400, MARGIN.1 as u32 + 250);
        assert_eq!(read.get_pixel(x, y).0, [255; 3], "the star's pixel is white");
        let is_mint = |dx: i32, dy: i32| {
            let [red, green, _] = read.get_pixel(x.wrapping_add_signed(dx), y.wrapping_add_signed(dy)).0;
            green > 150 && red < 150
        };
        assert!([(9, 0), (-9, 0), (0, 9), (0, -9)].iter().all(|&(dx, dy)| is_mint(dx, dy)), "a circle of radius 9 around it");
        assert!(!is_mint(4, 0) && !is_mint(-14, 0));
    }

    #[test]
    fn shrinking_keeps_single_bright_pixels() {
        let small = shrunk(&frame(7, 5, |x, y| if (x, y) == (6, 4) { 9.0 } else { 1.0 }), 3);
        assert_eq!((small.width_px, small.height_px), (3, 2));
        assert_eq!(small.pixels_dn, [1.0, 1.0, 1.0, 1.0, 1.0, 9.0]);
    }
}
