//! One image file → pixels in DN, whatever its kind: the content decides, not the name.

use std::fs;
use std::io::{BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::error::{FrameProblem, Size};
use super::fits::{self, FitsHeader};
use crate::frame::Frame;

/// A frame has at least so many columns and rows: the light of one star needs about that.
pub(super) const MINIMUM_PX: usize = 8;
/// And at most so many pixels (16384²): more is a damaged header.
pub(super) const MAXIMUM_PIXELS: usize = 1 << 28;
/// The largest file that is read, bytes: a frame of [`MAXIMUM_PIXELS`] of 8 bytes and its header.
const MAXIMUM_FILE_BYTES: u64 = (1 << 31) + (1 << 20);
/// The most that a decoder may allocate, bytes.
const MAXIMUM_DECODER_BYTES: u64 = 3 << 30;
/// Endings of image files in a folder, in lower case; FITS first.
pub(super) const FITS_ENDINGS: [&str; 3] = ["fits", "fit", "fts"];
/// Endings of the other image files.
pub(super) const IMAGE_ENDINGS: [&str; 6] = ["png", "tif", "tiff", "jpg", "jpeg", "bmp"];

/// What a file says of itself before its pixels are read.
#[derive(Clone, Debug)]
pub(super) struct Probe {
    pub(super) size: Size,
    /// `None` for anything but FITS.
    pub(super) fits: Option<FitsHeader>,
    /// Whether the file holds further images, which are not read.
    pub(super) more_images: bool,
}

/// The kind of a file by its first bytes.
enum Kind {
    Fits,
    Image(ImageFormat, &'static str),
}

fn kind(head: &[u8]) -> Result<Kind, FrameProblem> {
    if head.is_empty() {
        return Err(FrameProblem::EmptyFile);
    }
    if head.starts_with(b"SIMPLE  =") {
        return Ok(Kind::Fits);
    }
    match image::guess_format(head) {
        Ok(ImageFormat::Png) => Ok(Kind::Image(ImageFormat::Png, "PNG")),
        Ok(ImageFormat::Tiff) => Ok(Kind::Image(ImageFormat::Tiff, "TIFF")),
        Ok(ImageFormat::Jpeg) => Ok(Kind::Image(ImageFormat::Jpeg, "JPEG")),
        Ok(ImageFormat::Bmp) => Ok(Kind::Image(ImageFormat::Bmp, "BMP")),
        _ => Err(FrameProblem::NotAnImage),
    }
}

/// Reads size and header; checks that the file is an image that can be meant.
pub(super) fn probe(path: &Path) -> Result<Probe, FrameProblem> {
    let mut file = open(path)?;
    let length = file.metadata().map_err(FrameProblem::Read)?.len();
    let mut head = Vec::new();
    file.by_ref().take(64).read_to_end(&mut head).map_err(FrameProblem::Read)?;
    let probe = match kind(&head)? {
        Kind::Fits => {
            let mut bytes = head;
            fits::read_header_bytes(&mut file, &mut bytes).map_err(FrameProblem::Read)?;
            let header = match FitsHeader::parse(&bytes) {
                // the image stands in an extension further down
                Ok(None) => {
                    file.take(MAXIMUM_FILE_BYTES).read_to_end(&mut bytes).map_err(FrameProblem::Read)?;
                    FitsHeader::parse(&bytes)?
                }
                parsed => parsed?,
            };
            let header = header.ok_or_else(|| FrameProblem::Fits("it holds no image".to_owned()))?;
            header.check_length(length)?;
            let mut next = [0; 19];
            let more_images = read_at(path, header.next_unit(), &mut next) && &next == b"XTENSION= 'IMAGE   ";
            Probe { size: header.size, fits: Some(header), more_images }
        }
        Kind::Image(format, name) => {
            let mut reader = ImageReader::with_format(BufReader::new(open(path)?), format);
            reader.limits(limits());
            let (width, height) = reader.into_dimensions().map_err(|error| decode_problem(name, &error))?;
            let more_images = format == ImageFormat::Tiff && tiff_has_more(path, &head);
            Probe { size: Size { width_px: width as usize, height_px: height as usize }, fits: None, more_images }
        }
    };
    check_size(probe.size)?;
    Ok(probe)
}

/// Reads the pixels of an image file (FITS, PNG, TIFF, JPEG, BMP), whatever its name. Rows stored from the bottom up (FITS `ROWORDER`) are turned over.
pub fn load(path: &Path) -> Result<Frame, FrameProblem> {
    let file = open(path)?;
    let mut bytes = Vec::new();
    file.take(MAXIMUM_FILE_BYTES).read_to_end(&mut bytes).map_err(FrameProblem::Read)?;
    let frame = match kind(&bytes)? {
        Kind::Fits => fits::decode(&bytes)?,
        Kind::Image(format, name) => decode_image(&bytes, format, name)?,
    };
    check_finite(&frame)?;
    Ok(frame)
}

/// Fills `bytes` from a place in a file, if it reaches so far.
fn read_at(path: &Path, at: u64, bytes: &mut [u8]) -> bool {
    let read = fs::File::open(path).and_then(|mut file| {
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(bytes)
    });
    read.is_ok()
}

/// Whether the first directory of a TIFF file (not BigTIFF) names a second (TIFF 6.0, section 2).
fn tiff_has_more(path: &Path, head: &[u8]) -> bool {
    let little = head.starts_with(b"II\x2A\0");
    if !little && !head.starts_with(b"MM\0\x2A") {
        return false;
    }
    let number = |bytes: [u8; 4]| u64::from(if little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) });
    let Some(&[a, b, c, d]) = head.get(4..8) else {
        return false;
    };
    let first = number([a, b, c, d]);
    let (mut count, mut next) = ([0; 2], [0; 4]);
    if !read_at(path, first, &mut count) {
        return false;
    }
    let entries = u64::from(if little { u16::from_le_bytes(count) } else { u16::from_be_bytes(count) });
    read_at(path, first + 2 + 12 * entries, &mut next) && number(next) != 0
}

fn open(path: &Path) -> Result<fs::File, FrameProblem> {
    let metadata = fs::metadata(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => FrameProblem::Missing,
        _ => FrameProblem::Read(error),
    })?;
    if metadata.is_dir() {
        return Err(FrameProblem::Folder);
    }
    fs::File::open(path).map_err(FrameProblem::Read)
}

pub(super) fn check_size(size: Size) -> Result<(), FrameProblem> {
    if size.width_px < MINIMUM_PX || size.height_px < MINIMUM_PX {
        return Err(FrameProblem::TooSmall { size, minimum_px: MINIMUM_PX });
    }
    if size.width_px.checked_mul(size.height_px).is_none_or(|pixels| pixels > MAXIMUM_PIXELS) {
        return Err(FrameProblem::TooLarge { size, maximum_px: MAXIMUM_PIXELS });
    }
    Ok(())
}

fn check_finite(frame: &Frame) -> Result<(), FrameProblem> {
    let Some(first) = frame.pixels_dn.iter().position(|pixel| !pixel.is_finite()) else {
        return Ok(());
    };
    let count = frame.pixels_dn.iter().filter(|pixel| !pixel.is_finite()).count();
    let nan = frame.pixels_dn.iter().any(|pixel| pixel.is_nan());
    let infinite = frame.pixels_dn.iter().any(|pixel| pixel.is_infinite());
    let value = match (nan, infinite) {
        (true, true) => "NaN (undefined) or infinite",
        (true, false) => "NaN (undefined)",
        _ => "infinite",
    };
    Err(FrameProblem::NotFinite { count, value, x: first % frame.width_px, y: first / frame.width_px })
}

fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAXIMUM_DECODER_BYTES);
    limits
}

fn decode_problem(kind: &'static str, error: &image::ImageError) -> FrameProblem {
    FrameProblem::Decode { kind, message: error.to_string().replace('\n', " ") }
}

fn decode_image(bytes: &[u8], format: ImageFormat, kind: &'static str) -> Result<Frame, FrameProblem> {
    // The JPEG decoder fills what is missing with grey; a file that was cut off has lost its end mark.
    if format == ImageFormat::Jpeg && !jpeg_has_end(bytes) {
        return Err(FrameProblem::NoEndMark { kind });
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits());
    let decoder = reader.into_decoder().map_err(|error| decode_problem(kind, &error))?;
    let (width, height) = decoder.dimensions();
    let size = Size { width_px: width as usize, height_px: height as usize };
    check_size(size)?;
    let image = DynamicImage::from_decoder(decoder).map_err(|error| decode_problem(kind, &error))?;
    let (pixels_dn, saturation_dn) = luminance(&image)
        .ok_or_else(|| FrameProblem::Decode { kind, message: format!("its pixels are {:?}; 8 or 16 bits are read", image.color()) })?;
    Ok(Frame { width_px: size.width_px, height_px: size.height_px, pixels_dn, saturation_dn })
}

/// Whether an end mark (EOI) follows the start of the image data. Embedded previews, which have end marks of their own, stand
/// in segments before it and are stepped over (ITU-T T.81, annex B).
fn jpeg_has_end(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[0xFF, marker]) = bytes.get(at..at + 2) {
        match marker {
            0xFF => at += 1,
            0xDA => return bytes[at..].windows(2).any(|pair| pair == [0xFF, 0xD9]),
            _ => match bytes.get(at + 2..at + 4) {
                Some(&[high, low]) => at += 2 + usize::from(u16::from_be_bytes([high, low])).max(2),
                _ => return false,
            },
        }
    }
    false
}

/// The counts and the top of their range. Colours are joined by the weights of ITU-R BT.709 (as they are stored, no gamma is
/// taken off); alpha is ignored.
fn luminance(image: &DynamicImage) -> Option<(Vec<f32>, f32)> {
    fn joined<T: Copy + Into<f64>>(samples: &[T], channels: usize) -> Vec<f32> {
        let colour = |pixel: &[T]| {
            let [red, green, blue] = [pixel[0], pixel[1], pixel[2]].map(Into::into);
            // whole weights: grey stays exactly what it was
            ((2126.0 * red + 7152.0 * green + 722.0 * blue) / 10_000.0) as f32
        };
        samples.chunks_exact(channels).map(|pixel| if channels < 3 { pixel[0].into() as f32 } else { colour(pixel) }).collect()
    }
    let (eight, sixteen) = (f32::from(u8::MAX), f32::from(u16::MAX));
    Some(match image {
        DynamicImage::ImageLuma8(buffer) => (joined(buffer.as_raw(), 1), eight),
        DynamicImage::ImageLumaA8(buffer) => (joined(buffer.as_raw(), 2), eight),
        DynamicImage::ImageRgb8(buffer) => (joined(buffer.as_raw(), 3), eight),
        DynamicImage::ImageRgba8(buffer) => (joined(buffer.as_raw(), 4), eight),
        DynamicImage::ImageLuma16(buffer) => (joined(buffer.as_raw(), 1), sixteen),
        DynamicImage::ImageLumaA16(buffer) => (joined(buffer.as_raw(), 2), sixteen),
        DynamicImage::ImageRgb16(buffer) => (joined(buffer.as_raw(), 3), sixteen),
        DynamicImage::ImageRgba16(buffer) => (joined(buffer.as_raw(), 4), sixteen),
        _ => return None,
    })
}
