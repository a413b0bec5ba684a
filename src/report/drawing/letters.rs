//! Letters: the outlines of the built-in fonts in a line, drawn by their coverage of the pixels. What fonts a machine has must not change the pictures,
//! so they come with the program.

use std::sync::LazyLock;

use plotters::backend::BitMapBackend;
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind};
use skrifa::instance::{LocationRef, Size};
use skrifa::outline::{DrawSettings, OutlinePen};
use skrifa::{FontRef, GlyphId, MetadataProvider};
use zeno::{Command, Mask, PathBuilder};

/// The fonts are tried in this order for every letter: the second has signs that the first lacks (⁻ of an exponent, arrows).
static FACES: LazyLock<Vec<Face>> =
    LazyLock::new(|| [epaint_default_fonts::UBUNTU_LIGHT, epaint_default_fonts::HACK_REGULAR].into_iter().filter_map(Face::new).collect());

/// A line of text takes its size divided by this in height.
const SIZE_OF_HEIGHT: f64 = 1.24;

/// A font.
struct Face {
    font: FontRef<'static>,
    /// Size of the em over the distance from the lowest to the highest reach of letters, which is what sizes mean here.
    em_of_size: f32,
}

impl Face {
    fn new(bytes: &'static [u8]) -> Option<Self> {
        let font = FontRef::new(bytes).ok()?;
        let metrics = font.metrics(Size::unscaled(), LocationRef::default());
        let reach = metrics.ascent - metrics.descent;
        (reach > 0.0).then(|| Self { font, em_of_size: f32::from(metrics.units_per_em) / reach })
    }

    fn em_px(&self, size_px: f64) -> Size {
        Size::new(size_px as f32 * self.em_of_size)
    }
}

/// There is no font to draw with.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("the built-in font cannot be read")]
struct NoFont;

/// A letter of a line, its origin this far to the right of the line's.
struct Letter {
    face: &'static Face,
    glyph: GlyphId,
    x_px: f32,
}

/// The letters of a line of text, and its width, px.
fn line(text: &str, size_px: f64) -> Result<(Vec<Letter>, f32), NoFont> {
    let first = FACES.first().ok_or(NoFont)?;
    let mut x_px = 0.0;
    let letters = text.chars().map(|letter| {
        let found = FACES.iter().find_map(|face| Some((face, face.font.charmap().map(letter)?)));
        let (face, glyph) = found.unwrap_or((first, GlyphId::NOTDEF));
        let own = Letter { face, glyph, x_px };
        x_px += face.font.glyph_metrics(face.em_px(size_px), LocationRef::default()).advance_width(glyph).unwrap_or_default();
        own
    });
    Ok((letters.collect(), x_px))
}

/// Takes outlines to rows that count downwards.
struct Pen<'a>(&'a mut Vec<Command>, [f32; 2]);

impl Pen<'_> {
    fn at(&self, x: f32, y: f32) -> [f32; 2] {
        [self.1[0] + x, self.1[1] - y]
    }
}

impl OutlinePen for Pen<'_> {
    fn move_to(&mut self, x: f32, y: f32) {
        let to = self.at(x, y);
        self.0.move_to(to);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let to = self.at(x, y);
        self.0.line_to(to);
    }

    fn quad_to(&mut self, cx: f32, cy: f32, x: f32, y: f32) {
        let (control, to) = (self.at(cx, cy), self.at(x, y));
        self.0.quad_to(control, to);
    }

    fn curve_to(&mut self, ax: f32, ay: f32, bx: f32, by: f32, x: f32, y: f32) {
        let (a, b, to) = (self.at(ax, ay), self.at(bx, by), self.at(x, y));
        self.0.curve_to(a, b, to);
    }

    fn close(&mut self) {
        self.0.close();
    }
}

/// Draws pixels of letters at places of their own line: x from its start, y from its upper edge, and how much of the pixel is covered.
fn ink<E>(letters: &[Letter], size_px: f64, mut draw: impl FnMut(i32, i32, f64) -> Result<(), E>) -> Result<(), E> {
    let baseline_px = (size_px / 2.0).round() as f32;
    let mut outline = Vec::new();
    for letter in letters {
        outline.clear();
        let settings = DrawSettings::unhinted(letter.face.em_px(size_px), LocationRef::default());
        let glyph = letter.face.font.outline_glyphs().get(letter.glyph);
        let drawn = glyph.is_some_and(|glyph| glyph.draw(settings, &mut Pen(&mut outline, [letter.x_px, baseline_px])).is_ok());
        if !drawn || outline.is_empty() {
            continue;
        }
        let (covered, place) = Mask::new(&outline).render();
        for (y, row) in (place.top..).zip(covered.chunks(place.width.max(1) as usize)) {
            for (x, cover) in (place.left..).zip(row).filter(|(_, cover)| **cover > 0) {
                draw(x, y, f64::from(*cover) / 255.0)?;
            }
        }
    }
    Ok(())
}

/// The drawing library's sheet of pixels, with the letters of the built-in fonts in place of its own.
pub struct Lettered<'a>(BitMapBackend<'a>);

impl<'a> Lettered<'a> {
    /// On a sheet.
    #[must_use]
    pub fn new(sheet: BitMapBackend<'a>) -> Self {
        Self(sheet)
    }
}

type Refused<'a> = DrawingErrorKind<<BitMapBackend<'a> as DrawingBackend>::ErrorType>;

impl<'a> DrawingBackend for Lettered<'a> {
    type ErrorType = <BitMapBackend<'a> as DrawingBackend>::ErrorType;

    fn get_size(&self) -> (u32, u32) {
        self.0.get_size()
    }

    fn ensure_prepared(&mut self) -> Result<(), Refused<'a>> {
        self.0.ensure_prepared()
    }

    fn present(&mut self) -> Result<(), Refused<'a>> {
        self.0.present()
    }

    fn draw_pixel(&mut self, point: BackendCoord, colour: BackendColor) -> Result<(), Refused<'a>> {
        self.0.draw_pixel(point, colour)
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Result<(), Refused<'a>> {
        self.0.draw_line(from, to, style)
    }

    fn draw_rect<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S, fill: bool) -> Result<(), Refused<'a>> {
        self.0.draw_rect(from, to, style, fill)
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, place: BackendCoord) -> Result<(), Refused<'a>> {
        let colour = style.color();
        let (letters, width_px) = line(text, style.size()).map_err(|error| DrawingErrorKind::FontError(Box::new(error)))?;
        let (width, height) = (width_px as i32, (style.size() / SIZE_OF_HEIGHT) as i32);
        let right = match style.anchor().h_pos {
            HPos::Left => 0,
            HPos::Right => -width,
            HPos::Center => -width / 2,
        };
        let down = match style.anchor().v_pos {
            VPos::Top => 0,
            VPos::Center => -height / 2,
            VPos::Bottom => -height,
        };
        let (wide, high) = self.get_size();
        let turn = style.transform();
        ink(&letters, style.size(), |x, y, cover| {
            let (x, y) = turn.transform(x + right, y + down);
            let (x, y) = (place.0 + x, place.1 + y);
            let within = |at: i32, side: u32| u32::try_from(at).is_ok_and(|at| at < side);
            if !within(x, wide) || !within(y, high) {
                return Ok(());
            }
            self.0.draw_pixel((x, y), BackendColor { alpha: colour.alpha * cover, rgb: colour.rgb })
        })
    }

    fn estimate_text_size<S: BackendTextStyle>(&self, text: &str, style: &S) -> Result<(u32, u32), Refused<'a>> {
        let (_, width_px) = line(text, style.size()).map_err(|error| DrawingErrorKind::FontError(Box::new(error)))?;
        Ok((width_px as u32, (style.size() / SIZE_OF_HEIGHT) as u32))
    }

    fn blit_bitmap(&mut self, place: BackendCoord, size: (u32, u32), pixels: &[u8]) -> Result<(), Refused<'a>> {
        self.0.blit_bitmap(place, size, pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Covered pixels, and the least and largest row of them.
    fn drawn(text: &str) -> (usize, i32, i32) {
        let (letters, _) = line(text, 40.0).unwrap();
        let mut pixels = Vec::new();
        ink(&letters, 40.0, |x, y, cover| {
            pixels.push((x, y, cover));
            Ok::<(), ()>(())
        })
        .unwrap();
        let rows = || pixels.iter().filter(|(.., cover)| *cover > 0.5).map(|(_, y, _)| *y);
        (pixels.len(), rows().min().unwrap_or_default(), rows().max().unwrap_or_default())
    }

    #[test]
    fn letters_stand_on_their_line_and_are_as_wide_as_said() {
        // 40 px from the lowest to the highest reach, of 1121 units (932 above the line): an H of 693 units is 24.7 px high.
        let (count, top, bottom) = drawn("H");
        assert!(count > 50 && (top, bottom) == (-5, 19), "{count} pixels from {top} to {bottom}");
        assert!(drawn("g").2 > 25 && drawn(" ").0 == 0);
        let (_, width) = line("HHHH", 40.0).unwrap();
        let (_, one) = line("H", 40.0).unwrap();
        assert!((width - 4.0 * one).abs() < 1e-3 && (20.0..30.0).contains(&one), "{one}");
    }

    #[test]
    fn signs_of_units_and_greek_letters_are_there() {
        for letter in "aβΔσχ²°µ″′±×·−⁻¹⁴→≤".chars() {
            let found = FACES.iter().any(|face| face.font.charmap().map(letter).is_some());
            assert!(found && drawn(&letter.to_string()).0 > 3, "{letter} (U+{:04X}) is in no font", letter as u32);
        }
    }
}
