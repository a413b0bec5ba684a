//! TIFF and BigTIFF: whole numbers and floating point of every width that the `tiff` crate unpacks, grey or colours, any page.
//!
//! Source: TIFF 6.0 (1992); the sample formats of its section 19.

use std::io::{Cursor, Read, Seek};

use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::{TiffError, TiffUnsupportedError};

use super::error::{FrameProblem, FrameSize};
use super::exif::Exif;
use super::image_file::{MAXIMUM_PIXELS, Samples, check_size, joined};
use super::tags::{Directory, Tags};
use crate::guard::guarded;

const WIDTH: u16 = 256;
const HEIGHT: u16 = 257;
const PHOTOMETRIC: u16 = 262;
const MAKE: u16 = 271;
const SUB_DIRECTORIES: u16 = 330;
const BITS: u16 = 258;
const COMPRESSION: u16 = 259;
const SAMPLES: u16 = 277;
const STRIP_BYTES: u16 = 279;
const TOO_SHORT: &str = "its strips or tiles hold fewer pixels than its directory says; copy the file again";
/// PhotometricInterpretation of an image behind colour filters (DNG 1.7, chapter 4).
const MOSAIC: f64 = 32803.0;

/// What a file says before its pixels are read.
pub(super) struct TiffProbe {
    pub(super) size: FrameSize,
    pub(super) pages: usize,
    pub(super) exif: Exif,
}

fn fault(message: impl Into<String>) -> FrameProblem {
    FrameProblem::Decode { kind: "TIFF", message: message.into() }
}

/// The directory of a page, from 0.
fn page_at<R: Read + Seek>(tags: &mut Tags<R>, page: usize) -> Option<Directory> {
    let mut next = tags.first;
    for _ in 0..page {
        next = tags.directory(next)?.next;
    }
    if next == 0 { None } else { tags.directory(next) }
}

/// Reads size, number of pages and EXIF.
pub(super) fn probe<R: Read + Seek>(from: R, page: usize) -> Result<TiffProbe, FrameProblem> {
    let damaged = || fault("its directory leads out of the file; copy the file again");
    let mut tags = Tags::open(from).ok_or_else(damaged)?;
    let pages = tags.count();
    if page >= pages.max(1) {
        return Err(FrameProblem::NoSuchPlane { plane: page + 1, planes: pages });
    }
    let directory = page_at(&mut tags, page).ok_or_else(damaged)?;
    refuse_raw(&mut tags, &directory)?;
    let side = |tags: &mut Tags<R>, tag: u16, name: &str| {
        let found = tags.number(&directory, tag).filter(|side| *side >= 0.0);
        found.map(|side| side as usize).ok_or_else(|| fault(format!("its directory tells no {name}; copy the file again")))
    };
    let size = FrameSize { width_px: side(&mut tags, WIDTH, "width")?, height_px: side(&mut tags, HEIGHT, "height")? };
    check_size(size)?;
    check_strips(&mut tags, &directory, size)?;
    let exif = Exif::of(&mut tags, &directory);
    Ok(TiffProbe { size, pages, exif })
}

/// Refuses strips of plain samples that are too short: what stands behind them in the file is no pixel.
fn check_strips<R: Read + Seek>(tags: &mut Tags<R>, directory: &Directory, size: FrameSize) -> Result<(), FrameProblem> {
    if tags.number(directory, COMPRESSION).unwrap_or(1.0) != 1.0 {
        return Ok(());
    }
    let Some(strips) = tags.numbers(directory, STRIP_BYTES) else { return Ok(()) };
    let first = |tags: &mut Tags<R>, tag| tags.number(directory, tag).unwrap_or(1.0);
    let bits = first(tags, BITS) * first(tags, SAMPLES);
    let needed = (size.width_px as f64 * bits / 8.0).floor() * size.height_px as f64;
    if strips.iter().sum::<f64>() < needed { Err(fault(TOO_SHORT)) } else { Ok(()) }
}

/// Raw files of cameras begin like TIFF files, and what their first page holds is a preview.
fn refuse_raw<R: Read + Seek>(tags: &mut Tags<R>, directory: &Directory) -> Result<(), FrameProblem> {
    let mosaic = |tags: &mut Tags<R>, directory: &Directory| tags.number(directory, PHOTOMETRIC) == Some(MOSAIC);
    let mut is_raw = mosaic(tags, directory);
    for at in tags.numbers(directory, SUB_DIRECTORIES).unwrap_or_default().into_iter().take(16) {
        let below = tags.directory(at as u64);
        is_raw |= below.is_some_and(|below| mosaic(tags, &below));
    }
    if !is_raw {
        return Ok(());
    }
    let make = tags.text(directory, MAKE).map_or_else(String::new, |make| format!(" of {make}"));
    Err(FrameProblem::OtherKind { kind: format!("a camera's raw file{make}"), remedy: RAW_REMEDY })
}

/// What to do with a raw file.
pub(super) const RAW_REMEDY: &str =
    "make a 16-bit TIFF or PGM of it without interpolation, with `dcraw -D -4 -T` or its successors (`unprocessed_raw -T` of LibRaw)";

fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = 8 * MAXIMUM_PIXELS;
    limits.intermediate_buffer_size = MAXIMUM_PIXELS;
    limits
}

/// Reads the pixels of a page, from 0.
pub(super) fn decode(bytes: &[u8], page: usize) -> Result<Samples, FrameProblem> {
    let TiffProbe { size, .. } = probe(Cursor::new(bytes), page)?;
    let (color, samples) = guarded(|| unpack(bytes, page, size)).map_err(|panicked| fault(panicked.to_string()))??;
    let channels = match color {
        ColorType::Gray(_) => 1,
        ColorType::GrayA(_) | ColorType::Multiband { num_samples: 2, .. } => 2,
        ColorType::RGB(_) => 3,
        ColorType::RGBA(_) => 4,
        ColorType::Multiband { num_samples, .. } => {
            return Err(fault(format!("each of its pixels has {num_samples} samples; grey, grey and alpha, and RGB are read")));
        }
        ColorType::CMYK(_) | ColorType::CMYKA(_) => return Err(other_colours("CMYK")),
        ColorType::YCbCr(_) => return Err(other_colours("YCbCr")),
        ColorType::Lab(_) => return Err(other_colours("Lab")),
        _ => return Err(other_colours("of a palette")),
    };
    let samples = if channels == 1 { unpacked_bits(samples, color.bit_depth(), size)? } else { samples };
    let top = match (&samples, color.bit_depth()) {
        (DecodingResult::U8(_), bits) if bits < 8 => f32::from((1_u16 << bits) - 1),
        (DecodingResult::U8(_), _) => f32::from(u8::MAX),
        (DecodingResult::U16(_), _) => f32::from(u16::MAX),
        (DecodingResult::U32(_), _) => u32::MAX as f32,
        (DecodingResult::U64(_), _) => u64::MAX as f32,
        (DecodingResult::I8(_), _) => f32::from(i8::MAX),
        (DecodingResult::I16(_), _) => f32::from(i16::MAX),
        (DecodingResult::I32(_), _) => i32::MAX as f32,
        (DecodingResult::I64(_), _) => i64::MAX as f32,
        (DecodingResult::F16(_) | DecodingResult::F32(_) | DecodingResult::F64(_), _) => f32::INFINITY,
    };
    let short = || fault(TOO_SHORT);
    let pixels = size.width_px * size.height_px;
    macro_rules! counts {
        ($values:expr, $number:expr) => {
            joined(&$values, channels, pixels, $number)
        };
    }
    let pixels_dn = match samples {
        DecodingResult::U8(values) => counts!(values, f64::from),
        DecodingResult::U16(values) => counts!(values, f64::from),
        DecodingResult::U32(values) => counts!(values, f64::from),
        DecodingResult::U64(values) => counts!(values, |value| value as f64),
        DecodingResult::I8(values) => counts!(values, f64::from),
        DecodingResult::I16(values) => counts!(values, f64::from),
        DecodingResult::I32(values) => counts!(values, f64::from),
        DecodingResult::I64(values) => counts!(values, |value| value as f64),
        DecodingResult::F16(values) => counts!(values, |value| f64::from(value.to_f32())),
        DecodingResult::F32(values) => counts!(values, f64::from),
        DecodingResult::F64(values) => counts!(values, |value| value),
    };
    Ok(Samples { size, pixels_dn: pixels_dn.ok_or_else(short)?, saturation_dn: top })
}

fn other_colours(name: &str) -> FrameProblem {
    fault(format!("its colours are {name}; save it as grey or RGB"))
}

/// The samples as the crate unpacks them, planes joined pixel by pixel.
fn unpack(bytes: &[u8], page: usize, size: FrameSize) -> Result<(ColorType, DecodingResult), FrameProblem> {
    let mut decoder = Decoder::new(Cursor::new(bytes)).map_err(|error| own_words(&error))?.with_limits(limits());
    if page > 0 {
        decoder.seek_to_image(page).map_err(|error| own_words(&error))?;
    }
    let color = decoder.colortype().map_err(|error| own_words(&error))?;
    if decoder.dimensions().map_err(|error| own_words(&error))? != (size.width_px as u32, size.height_px as u32) {
        return Err(fault("its directory names two sizes; copy the file again"));
    }
    let mut result = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut result).map_err(|error| own_words(&error))?;
    if layout.planes > 1 {
        if result.as_buffer(0).as_bytes().len() < layout.complete_len {
            return Err(fault("its colour planes are too large together; save it as grey"));
        }
        result = interleaved(result, layout.planes);
    }
    Ok((color, result))
}

/// Planes one behind the other as samples beside each other.
fn interleaved(planes: DecodingResult, count: usize) -> DecodingResult {
    fn turned<T: Copy>(values: &[T], count: usize) -> Vec<T> {
        let pixels = values.len() / count;
        (0..pixels * count).map(|index| values[index % count * pixels + index / count]).collect()
    }
    match planes {
        DecodingResult::U8(values) => DecodingResult::U8(turned(&values, count)),
        DecodingResult::U16(values) => DecodingResult::U16(turned(&values, count)),
        DecodingResult::U32(values) => DecodingResult::U32(turned(&values, count)),
        DecodingResult::U64(values) => DecodingResult::U64(turned(&values, count)),
        DecodingResult::I8(values) => DecodingResult::I8(turned(&values, count)),
        DecodingResult::I16(values) => DecodingResult::I16(turned(&values, count)),
        DecodingResult::I32(values) => DecodingResult::I32(turned(&values, count)),
        DecodingResult::I64(values) => DecodingResult::I64(turned(&values, count)),
        DecodingResult::F16(values) => DecodingResult::F16(turned(&values, count)),
        DecodingResult::F32(values) => DecodingResult::F32(turned(&values, count)),
        DecodingResult::F64(values) => DecodingResult::F64(turned(&values, count)),
    }
}

/// Grey samples of fewer than 8 bits, of which rows begin at whole bytes, one a byte.
fn unpacked_bits(samples: DecodingResult, bits: u8, size: FrameSize) -> Result<DecodingResult, FrameProblem> {
    let (DecodingResult::U8(bytes), 1..8) = (&samples, bits) else { return Ok(samples) };
    if 8 % bits != 0 {
        return Err(fault(format!("its samples have {bits} bits; 1, 2, 4, 8, 16, 32 and 64 are read")));
    }
    let (bits, mask) = (usize::from(bits), (1_u16 << bits) - 1);
    let row_bytes = (size.width_px * bits).div_ceil(8);
    let sample = |row: &[u8], x: usize| {
        let byte = row.get(x * bits / 8).copied().unwrap_or(0);
        (u16::from(byte) >> (8 - bits - x * bits % 8) & mask) as u8
    };
    Ok(DecodingResult::U8(bytes.chunks(row_bytes).flat_map(|row| (0..size.width_px).map(move |x| sample(row, x))).collect()))
}

/// What the crate's error means, in our words.
fn own_words(error: &TiffError) -> FrameProblem {
    match error {
        TiffError::UnsupportedError(
            TiffUnsupportedError::UnsupportedCompressionMethod(_) | TiffUnsupportedError::UnknownCompressionMethod,
        ) => fault("its compression is not read; save it uncompressed, or with LZW or Deflate"),
        TiffError::UnsupportedError(TiffUnsupportedError::UnsupportedSampleFormat(_)) => {
            fault("its samples are of a format that is not read (complex or mixed); save it as whole numbers or floating point")
        }
        TiffError::UnsupportedError(TiffUnsupportedError::UnsupportedColorType(color)) => {
            let bits = color.bit_depth();
            fault(format!("its samples have {bits} bits in a packing that is not read; save it with 8, 16 or 32 bits"))
        }
        TiffError::UnsupportedError(TiffUnsupportedError::InterpretationWithBits(..)) => {
            fault("its colours are those of a palette, or of a kind that is not read; save it as grey or RGB")
        }
        TiffError::UnsupportedError(_) => {
            fault("it uses a part of the format that is not read; save it as plain grey or RGB, 8 or 16 bits")
        }
        TiffError::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            fault("it ends before its pixels do; copy the file again")
        }
        TiffError::LimitsExceeded | TiffError::IntSizeError => fault("it claims more data than a frame can hold; copy the file again"),
        _ => fault("its directory or its compressed data are damaged; copy the file again"),
    }
}
