//! The forms of image files that counts are written as: every count is kept, in each of them.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use fitsio_pure::compress::{TileCompression, compress_image_hdu};
use fitsio_pure::header::{Card, serialize_header};
use fitsio_pure::primary::build_primary_header;
use fitsio_pure::value::Value;
use png::{BitDepth, ColorType, Encoder};
use tiff::encoder::{TiffEncoder, colortype};

use super::output::{OutputError, write_file};
use super::write::{FitsHeaders, check_count, fits_cards, write_fits_u8, write_fits_u16};

/// The form of an image file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageFileForm {
    /// FITS: integers of 8 bits where the converter has no more, else of 16.
    #[default]
    Fits,
    /// FITS, packed row by row without loss (Rice; FITS Standard 4.0, section 10).
    FitsRice,
    /// PNG of 16 bits, grey.
    Png16,
    /// PNG of 8 bits, grey: for converters of 8 bits.
    Png8,
    /// TIFF of 16 bits, grey, not packed.
    Tiff16,
    /// Bare counts of 16 bits, row by row, low byte first.
    Raw16,
}

impl ImageFileForm {
    /// The ending of its files.
    #[must_use]
    pub fn ending(self) -> &'static str {
        match self {
            Self::Fits | Self::FitsRice => "fits",
            Self::Png16 | Self::Png8 => "png",
            Self::Tiff16 => "tiff",
            Self::Raw16 => "raw",
        }
    }

    /// Whether it holds all counts of so many bits.
    #[must_use]
    pub fn holds(self, bits: u32) -> bool {
        self != Self::Png8 || bits <= 8
    }
}

/// Writes counts of so many bits, row by row, the first row on top, as an image file. What lies beyond the top of 8 bits is cut there, in every form
/// alike: rounding of frequencies (JPEG) may have added it. Only FITS files take `headers`.
pub fn write_image(
    path: &Path,
    form: ImageFileForm,
    [width_px, height_px]: [usize; 2],
    (pixels_dn, bits): (&[u16], u32),
    headers: &FitsHeaders,
) -> Result<(), OutputError> {
    check_count(path, width_px, height_px, pixels_dn.len())?;
    let size = [width_px, height_px];
    let fault = |message: String| OutputError::Encode { path: path.to_owned(), message };
    if !form.holds(bits) {
        return Err(fault(format!("counts of {bits} bits do not fit 8; write 16")));
    }
    let is_of_bytes = bits <= 8;
    let cut: Vec<u16> = if is_of_bytes { pixels_dn.iter().map(|count| (*count).min(u8::MAX.into())).collect() } else { Vec::new() };
    let pixels_dn = if is_of_bytes { &cut } else { pixels_dn };
    let as_bytes = || -> Vec<u8> { pixels_dn.iter().map(|count| *count as u8).collect() };
    let bytes = match form {
        ImageFileForm::Fits if is_of_bytes => return write_fits_u8(path, width_px, height_px, &as_bytes(), headers),
        ImageFileForm::Fits => return write_fits_u16(path, width_px, height_px, pixels_dn, headers),
        ImageFileForm::FitsRice => fits_rice_u16(size, pixels_dn, headers),
        ImageFileForm::Png16 => png_u16(size, pixels_dn),
        ImageFileForm::Png8 => png_u8(size, &as_bytes()),
        ImageFileForm::Tiff16 => tiff_u16(size, pixels_dn),
        ImageFileForm::Raw16 => Ok(low_byte_first(pixels_dn).into_owned()),
    };
    write_file(path, &bytes.map_err(fault)?)
}

/// A grey PNG; `rows` are bytes as PNG has them, 16 bits with the high byte first. Each row less the one above it, then the fastest way to pack it: a frame
/// of a camera is noise, of which slower ways take off little more.
fn png([width_px, height_px]: [usize; 2], depth: BitDepth, rows: &[u8]) -> Result<Vec<u8>, String> {
    let wrong = |error: png::EncodingError| error.to_string();
    let side = |length: usize| u32::try_from(length).map_err(|_| format!("{length} px are too many"));
    let mut bytes = Vec::with_capacity(rows.len() / 2 + 1024);
    let mut encoder = Encoder::new(&mut bytes, side(width_px)?, side(height_px)?);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().map_err(wrong)?;
    let packed = packed(rows, rows.len() / height_px.max(1)).map_err(|error| error.to_string())?;
    writer.write_chunk(png::chunk::IDAT, &packed).map_err(wrong)?;
    writer.finish().map_err(wrong)?;
    Ok(bytes)
}

/// Rows of bytes, each less the one above it, packed. The encoder of PNG hands each row over with the filter's number before it; then the compressor's words of
/// eight bytes end with the high byte of a count, which is mostly zero and takes its slow way. Here they end with a low one.
fn packed(rows: &[u8], row_bytes: usize) -> std::io::Result<Vec<u8>> {
    /// The filter's number: less the byte above.
    const UP: [u8; 1] = [2];
    let mut compressor = fdeflate::Compressor::new(Vec::with_capacity(rows.len() / 2))?;
    let mut above = vec![0; row_bytes];
    let mut difference = vec![0; row_bytes];
    for row in rows.chunks_exact(row_bytes.max(1)) {
        for ((difference, own), above) in difference.iter_mut().zip(row).zip(&above) {
            *difference = own.wrapping_sub(*above);
        }
        above.copy_from_slice(row);
        compressor.write_data(&UP)?;
        compressor.write_data(&difference)?;
    }
    compressor.finish()
}

/// The bytes of a grey PNG of 16 bits.
pub(crate) fn png_u16(size: [usize; 2], pixels: &[u16]) -> Result<Vec<u8>, String> {
    // Written in place: that is what vectorises.
    let mut rows = vec![0; 2 * pixels.len()];
    for (bytes, pixel) in rows.as_chunks_mut().0.iter_mut().zip(pixels) {
        *bytes = pixel.to_be_bytes();
    }
    png(size, BitDepth::Sixteen, &rows)
}

/// The bytes of a grey PNG of 8 bits.
pub(crate) fn png_u8(size: [usize; 2], pixels: &[u8]) -> Result<Vec<u8>, String> {
    png(size, BitDepth::Eight, pixels)
}

/// Numbers as bytes, the low one of each first.
pub(crate) fn low_byte_first(pixels: &[u16]) -> Cow<'_, [u8]> {
    // On most processors they lie so already.
    if cfg!(target_endian = "little") {
        return Cow::Borrowed(bytemuck::cast_slice(pixels));
    }
    Cow::Owned(pixels.iter().flat_map(|pixel| pixel.to_le_bytes()).collect())
}

/// The bytes of a FITS file with an image of 16 bits that is packed by Rice coding, a tile a row as cfitsio does it.
pub(crate) fn fits_rice_u16([width_px, height_px]: [usize; 2], pixels_dn: &[u16], headers: &FitsHeaders) -> Result<Vec<u8>, String> {
    let wrong = |error: fitsio_pure::Error| error.to_string();
    let row_order = ("ROWORDER", Value::String("TOP-DOWN".to_owned()), "the first row stored is the top one");
    let mut cards = Vec::new();
    for (keyword, value, comment) in [row_order].into_iter().chain(fits_cards(headers)) {
        let mut card = Card::new(keyword, value).map_err(wrong)?;
        card.comment = Some(comment.to_owned()).filter(|comment| !comment.is_empty());
        cards.push(card);
    }
    let mut bytes = serialize_header(&build_primary_header(8, &[]).map_err(wrong)?).map_err(wrong)?;
    bytes.extend(compress_image_hdu(&[width_px, height_px], pixels_dn, &TileCompression::rice(), &cards).map_err(wrong)?);
    Ok(bytes)
}

/// The bytes of a grey TIFF of 16 bits.
fn tiff_u16([width_px, height_px]: [usize; 2], pixels_dn: &[u16]) -> Result<Vec<u8>, String> {
    let side = |length: usize| u32::try_from(length).map_err(|_| format!("{length} px are too many"));
    let mut bytes = Cursor::new(Vec::with_capacity(2 * pixels_dn.len() + 1024));
    let mut encoder = TiffEncoder::new(&mut bytes).map_err(|error| error.to_string())?;
    encoder.write_image::<colortype::Gray16>(side(width_px)?, side(height_px)?, pixels_dn).map_err(|error| error.to_string())?;
    Ok(bytes.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::load_image;

    const FORMS: [ImageFileForm; 4] = [ImageFileForm::Fits, ImageFileForm::FitsRice, ImageFileForm::Png16, ImageFileForm::Tiff16];

    #[test]
    fn every_form_keeps_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        let pixels: Vec<u16> = (0..12 * 9_u32).map(|index| (index * index * 7919 % 65_536) as u16).collect();
        for form in FORMS {
            let path = folder.path().join(format!("{form:?}.{}", form.ending()));
            write_image(&path, form, [12, 9], (&pixels, 16), &FitsHeaders::default()).unwrap();
            let read = load_image(&path).unwrap();
            assert_eq!((read.width_px, read.height_px), (12, 9), "{form:?}");
            assert!(read.pixels_dn.iter().zip(&pixels).all(|(read, written)| *read == f32::from(*written)), "{form:?}");
        }
        let raw = folder.path().join("a.raw");
        write_image(&raw, ImageFileForm::Raw16, [12, 9], (&pixels, 16), &FitsHeaders::default()).unwrap();
        let bytes = std::fs::read(&raw).unwrap();
        assert_eq!(bytes.len(), 2 * 12 * 9);
        assert!(bytes.as_chunks().0.iter().zip(&pixels).all(|(pair, written)| u16::from_le_bytes(*pair) == *written));
    }

    #[test]
    fn eight_bits_are_for_converters_of_eight_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let pixels: Vec<u16> = (0..80).map(|index| if index == 7 { 256 } else { index }).collect();
        let refused = write_image(&path, ImageFileForm::Png8, [10, 8], (&pixels, 12), &FitsHeaders::default()).unwrap_err();
        assert!(refused.to_string().contains("counts of 12 bits do not fit 8") && !path.exists(), "{refused}");
        for form in FORMS.into_iter().chain([ImageFileForm::Png8]) {
            write_image(&path, form, [10, 8], (&pixels, 8), &FitsHeaders::default()).unwrap();
            let read = load_image(&path).unwrap();
            assert_eq!((read.pixels_dn[6], read.pixels_dn[7], read.pixels_dn[79]), (6.0, 255.0, 79.0), "{form:?}");
        }
    }
}
