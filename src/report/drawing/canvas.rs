//! What the pictures share: the sheet, its letters, ticks, and the way into a file.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use plotters::backend::BitMapBackend;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::PathElement;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontDesc, FontTransform, RGBColor, TextStyle};

use super::letters::Lettered;
use crate::recording::write_file;
use crate::report::ReportError;

/// What drawing code returns; the sheet puts the path to it.
pub(super) type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Everything is drawn this many times larger and then averaged down, which smooths lines and letters alike.
const OVERSAMPLING: usize = 2;

/// The drawing library puts letters this share of their size above the box that it says they fill.
const DROP: f64 = 0.2;

// The colours of Okabe and Ito, which people with any colour vision can tell apart.
pub(super) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(super) const SKY: RGBColor = RGBColor(86, 180, 233);
pub(super) const GREEN: RGBColor = RGBColor(0, 158, 115);
pub(super) const ORANGE: RGBColor = RGBColor(230, 159, 0);
pub(super) const VERMILION: RGBColor = RGBColor(213, 94, 0);
pub(super) const PURPLE: RGBColor = RGBColor(204, 121, 167);
pub(super) const INK: RGBColor = RGBColor(35, 35, 40);
pub(super) const PALE: RGBColor = RGBColor(222, 222, 226);
pub(super) const PAPER: RGBColor = RGBColor(255, 255, 255);

/// A font's name, which the drawing library asks for; it has no say in the letters ([`super::letters`]).
pub(super) const FONT: &str = "boresight";

/// A sheet to draw on. Places and sizes are in pixels of the finished picture, from its upper left corner.
pub(super) struct Canvas<'a> {
    area: DrawingArea<Lettered<'a>, Shift>,
}

/// A place on the sheet.
pub(super) type Place = (f64, f64);

fn enlarged(length: f64) -> i32 {
    (length * OVERSAMPLING as f64).round() as i32
}

fn enlarged_place((x, y): Place) -> (i32, i32) {
    (enlarged(x), enlarged(y))
}

impl<'a> Canvas<'a> {
    /// The drawing library's own area, in pixels that are `factor` times smaller than those of the finished picture.
    pub(super) fn raw(&self) -> (&DrawingArea<Lettered<'a>, Shift>, f64) {
        (&self.area, OVERSAMPLING as f64)
    }

    /// A line through places.
    pub(super) fn line(&self, places: &[Place], colour: impl Color, width: f64) -> Drawn {
        let style = colour.stroke_width(enlarged(width).max(1) as u32);
        let places: Vec<(i32, i32)> = places.iter().copied().map(enlarged_place).collect();
        Ok(self.area.draw(&PathElement::new(places, style))?)
    }

    /// A circle; drawn as a polygon, since the library's own circles have steps.
    pub(super) fn circle(&self, (x, y): Place, radius: f64, colour: impl Color, width: f64) -> Drawn {
        let corners = 48;
        let places: Vec<Place> = (0..=corners)
            .map(|corner| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(corner) / f64::from(corners)).sin_cos();
                (x + radius * cos, y + radius * sin)
            })
            .collect();
        self.line(&places, colour, width)
    }

    /// A filled dot.
    pub(super) fn dot(&self, place: Place, radius: f64, colour: impl Color) -> Drawn {
        Ok(self.area.draw(&plotters::element::Circle::new(enlarged_place(place), enlarged(radius).max(1), colour.filled()))?)
    }

    /// A filled rectangle from its upper left to its lower right corner.
    pub(super) fn fill(&self, from: Place, to: Place, colour: impl Color) -> Drawn {
        let (left, top) = enlarged_place(from);
        let (right, bottom) = enlarged_place(to);
        if right <= left || bottom <= top {
            return Ok(());
        }
        Ok(self.area.draw(&plotters::element::Rectangle::new([(left, top), (right, bottom)], colour.filled()))?)
    }

    fn style(size: f64, colour: &impl Color, across: HPos, along: VPos) -> TextStyle<'static> {
        text_style(FontDesc::from((FONT, size * OVERSAMPLING as f64)), colour, across, along)
    }

    /// A line of text at a place, which its anchor says how to stand to.
    pub(super) fn text(&self, text: &str, place: Place, size: f64, colour: &impl Color, across: HPos, along: VPos) -> Drawn {
        let lowered = (place.0, place.1 + DROP * size);
        Ok(self.area.draw_text(text, &Self::style(size, colour, across, along), enlarged_place(lowered))?)
    }

    /// A line of text that is read from below upwards, centred on a place.
    pub(super) fn upward_text(&self, text: &str, place: Place, size: f64, colour: &impl Color) -> Drawn {
        let upward = FontDesc::from((FONT, size * OVERSAMPLING as f64)).transform(FontTransform::Rotate270);
        let style = text_style(upward, colour, HPos::Center, VPos::Center);
        Ok(self.area.draw_text(text, &style, enlarged_place((place.0 + DROP * size, place.1)))?)
    }

    /// Width and height of a line of text.
    pub(super) fn text_size(&self, text: &str, size: f64) -> Result<(f64, f64), Box<dyn std::error::Error>> {
        let (width, height) = self.area.estimate_text_size(text, &Self::style(size, &INK, HPos::Left, VPos::Top))?;
        Ok((f64::from(width) / OVERSAMPLING as f64, f64::from(height) / OVERSAMPLING as f64))
    }

    /// The text, or as many of its words from the first on as there is room for.
    pub(super) fn fitting(&self, text: &str, size: f64, width: f64) -> Result<String, Box<dyn std::error::Error>> {
        let mut fitting = text.to_owned();
        let mut words = text;
        while self.text_size(&fitting, size)?.0 > width {
            let Some((before, _)) = words.rsplit_once(' ') else { break };
            words = before;
            fitting = format!("{} …", before.trim_end_matches(','));
        }
        Ok(fitting)
    }

    /// An arrow; its head grows with it up to a limit.
    pub(super) fn arrow(&self, from: Place, to: Place, colour: impl Color + Copy, width: f64) -> Drawn {
        self.line(&[from, to], colour, width)?;
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length = dx.hypot(dy);
        let head = (length * 0.35).min(7.0);
        if head < 1.5 {
            return Ok(());
        }
        let (ux, uy) = (dx / length, dy / length);
        let wing = |side: f64| (to.0 - head * ux + side * head * 0.45 * uy, to.1 - head * uy - side * head * 0.45 * ux);
        self.line(&[wing(1.0), to, wing(-1.0)], colour, width)
    }
}

fn text_style(font: FontDesc<'static>, colour: &impl Color, across: HPos, along: VPos) -> TextStyle<'static> {
    TextStyle { font, color: colour.to_backend_color(), pos: Pos::new(across, along) }
}

/// Draws a picture of a size in pixels and writes it as PNG: whole, or not at all.
pub(super) fn picture(
    path: &Path,
    (width, height): (usize, usize),
    paper: RGBColor,
    draw: impl FnOnce(&Canvas) -> Drawn,
) -> Result<(), ReportError> {
    let refused = |reason: String| ReportError::Draw { path: path.to_owned(), reason };
    let (wide, high) = (width * OVERSAMPLING, height * OVERSAMPLING);
    let mut large = vec![0_u8; wide * high * 3];
    {
        let area = Lettered::new(BitMapBackend::with_buffer(&mut large, (wide as u32, high as u32))).into_drawing_area();
        area.fill(&paper).map_err(|error| refused(error.to_string()))?;
        let sheet = Canvas { area };
        draw(&sheet).map_err(|error| refused(error.to_string()))?;
        sheet.area.present().map_err(|error| refused(error.to_string()))?;
    }
    let mut bytes = Cursor::new(Vec::new());
    let small = image::RgbImage::from_fn(width as u32, height as u32, |x, y| averaged(&large, wide, x as usize, y as usize));
    // Noise takes most of the bytes: no filter can predict it, and without one equal steps of grey look alike.
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::NoFilter);
    small.write_with_encoder(encoder).map_err(|error| refused(error.to_string()))?;
    Ok(write_file(path, bytes.get_ref())?)
}

/// The mean of the oversampled pixels of one pixel.
fn averaged(large: &[u8], wide: usize, x: usize, y: usize) -> image::Rgb<u8> {
    image::Rgb([0, 1, 2].map(|channel| {
        let sum: u32 = (0..OVERSAMPLING * OVERSAMPLING)
            .map(|part| {
                let (column, row) = (x * OVERSAMPLING + part % OVERSAMPLING, y * OVERSAMPLING + part / OVERSAMPLING);
                u32::from(large[(row * wide + column) * 3 + channel])
            })
            .sum();
        let parts = (OVERSAMPLING * OVERSAMPLING) as u32;
        ((sum + parts / 2) / parts) as u8
    }))
}

/// The step between ticks: 1, 2 or 5 times a power of ten, so that about `count` of them fit into a length.
pub(super) fn tick_step(length: f64, count: f64) -> f64 {
    nice_above(length / count)
}

/// The smallest of 1, 2, 5 times a power of ten that is not below a positive number.
pub(super) fn nice_above(least: f64) -> f64 {
    let decade = 10_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0].map(|factor| factor * decade).into_iter().find(|nice| *nice >= least * (1.0 - 1e-9)).unwrap_or(10.0 * decade)
}

/// A number without needless digits: 12.5, 300, 0.002, 4e−7.
pub(super) fn short(number: f64) -> String {
    let size = number.abs();
    let text = if size != 0.0 && !(1e-3..1e5).contains(&size) {
        format!("{number:.1e}").replace(".0e", "e")
    } else {
        let digits = if size >= 100.0 { 1 } else { 4 };
        let text = format!("{number:.digits$}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    if text == "-0" { "0".to_owned() } else { text.replace('-', "−") }
}

/// A box on the sheet that shows the camera's frame, with ticks in its pixels along the left and the lower edge.
pub(super) struct FrameBox {
    /// Upper left corner.
    pub(super) corner: Place,
    /// Width and height on the sheet.
    pub(super) size: (f64, f64),
    /// The frame shown, px.
    pub(super) frame_px: (usize, usize),
}

impl FrameBox {
    /// How many pixels of the sheet one pixel of the frame takes.
    pub(super) fn scale(&self) -> f64 {
        self.size.0 / self.frame_px.0 as f64
    }

    /// Where a point of the frame lies on the sheet; every pixel reaches half a pixel around its centre.
    pub(super) fn place(&self, x_px: f64, y_px: f64) -> Place {
        let scale = self.scale();
        (self.corner.0 + (x_px + 0.5) * scale, self.corner.1 + (y_px + 0.5) * scale)
    }

    /// Whether a place lies inside, with a margin.
    pub(super) fn holds(&self, (x, y): Place, margin: f64) -> bool {
        let (x, y) = (x - self.corner.0, y - self.corner.1);
        (margin..=self.size.0 - margin).contains(&x) && (margin..=self.size.1 - margin).contains(&y)
    }

    /// The edge, the ticks and what they count.
    pub(super) fn axes(&self, sheet: &Canvas, colour: RGBColor) -> Drawn {
        let (left, top) = self.corner;
        let (right, bottom) = (left + self.size.0, top + self.size.1);
        sheet.line(&[(left, top), (right, top), (right, bottom), (left, bottom), (left, top)], colour, 1.0)?;
        let step = tick_step(self.frame_px.0.max(self.frame_px.1) as f64, 8.0).max(1.0);
        let ticks = |count: usize| (0..).map(move |tick| f64::from(tick) * step).take_while(move |at| *at <= count as f64 - 1.0);
        for at in ticks(self.frame_px.0) {
            let (x, _) = self.place(at, 0.0);
            sheet.line(&[(x, bottom), (x, bottom + 5.0)], colour, 1.0)?;
            sheet.text(&short(at), (x, bottom + 8.0), 14.0, &colour, HPos::Center, VPos::Top)?;
        }
        for at in ticks(self.frame_px.1) {
            let (_, y) = self.place(0.0, at);
            sheet.line(&[(left - 5.0, y), (left, y)], colour, 1.0)?;
            sheet.text(&short(at), (left - 8.0, y), 14.0, &colour, HPos::Right, VPos::Center)?;
        }
        sheet.text("x / px", (right, bottom + 8.0 + 18.0), 14.0, &colour, HPos::Right, VPos::Top)?;
        sheet.upward_text("y / px", (left - 48.0, top + 22.0), 14.0, &colour)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_cut_between_words() {
        let folder = tempfile::tempdir().unwrap();
        picture(&folder.path().join("text.png"), (400, 100), PAPER, |sheet| {
            let text = "refraction, lateral-colour, wedge-colour";
            let width = |text: &str| sheet.text_size(text, 18.0).map(|(width, _)| width);
            assert_eq!(sheet.fitting(text, 18.0, width(text)?)?, text);
            assert_eq!(sheet.fitting(text, 18.0, width(text)? - 5.0)?, "refraction, lateral-colour …");
            assert_eq!(sheet.fitting(text, 18.0, 0.0)?, "refraction …", "a first word stays");
            Ok(())
        })
        .unwrap();
    }

    #[test]
    fn ticks_are_one_two_or_five() {
        let steps = [1024.0, 3.0, 0.07, 800.0].map(|length| tick_step(length, 8.0));
        for (step, expected) in steps.into_iter().zip([200.0, 0.5, 0.01, 100.0]) {
            assert!((step / expected - 1.0).abs() < 1e-12, "{step} instead of {expected}");
        }
    }

    #[test]
    fn numbers_are_short() {
        let texts = [0.0, 12.5, -0.25, 300.0, 0.002, 4e-7, -2.5e6, 1024.0].map(short);
        assert_eq!(texts, ["0", "12.5", "−0.25", "300", "0.002", "4e−7", "−2.5e6", "1024"]);
    }

    #[test]
    fn a_picture_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let error = picture(&path, (20, 10), PAPER, |_| Err("no".into())).unwrap_err();
        assert!(error.to_string().contains("a.png"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing half-written");
        picture(&path, (20, 10), PAPER, |sheet| sheet.line(&[(2.5, 0.0), (2.5, 10.0)], INK, 5.0)).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        assert_eq!((read.width(), read.height()), (20, 10));
        assert_eq!((read.get_pixel(2, 5).0, read.get_pixel(15, 5).0), ([35, 35, 40], [255, 255, 255]));
        // A filled rectangle takes all of its pixels, and no others.
        picture(&path, (20, 10), PAPER, |sheet| sheet.fill((2.0, 1.0), (5.0, 3.0), INK)).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        let dark = |x: u32, y: u32| (2..5).contains(&x) && (1..3).contains(&y);
        assert!(read.enumerate_pixels().all(|(x, y, pixel)| pixel.0 == if dark(x, y) { [35, 35, 40] } else { [255, 255, 255] }));
        let impossible = path.join("b.png"); // a folder that is a file
        assert!(matches!(picture(&impossible, (20, 10), PAPER, |_| Ok(())), Err(ReportError::Write(_))));
    }
}
