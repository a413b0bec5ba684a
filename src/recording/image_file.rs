//! One image file → pixels in DN, of any format; the content decides, not the name.

use std::fs;
use std::io::{BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::read::MultiGzDecoder;
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};

use super::error::{FrameProblem, FrameSize};
use super::exif::Exif;
use super::fits::{self, FitsHeader};
use super::{Plane, foreign, pnm, tiff};
use crate::frame::{Frame, MaskedFrame};
use crate::guard::guarded;

/// A frame has at least so many columns and rows: the light of one star needs about that.
pub(super) const MINIMUM_PX: usize = 8;
/// And at most so many pixels (16384²): more is a damaged header.
pub(super) const MAXIMUM_PIXELS: usize = 1 << 28;
/// The largest file that is read, bytes: a frame of [`MAXIMUM_PIXELS`] of 8 bytes and its header.
const MAXIMUM_FILE_BYTES: u64 = (1 << 31) + (1 << 20);
/// The most that a gzipped file may unpack to, bytes.
const MAXIMUM_UNPACKED_BYTES: u64 = 1 << 30;
/// The most that a decoder may allocate, bytes.
const MAXIMUM_DECODER_BYTES: u64 = 3 << 29;
/// EXIF stands so near the beginning of a file, bytes.
const EXIF_REACH_BYTES: u64 = 1 << 18;
/// Endings of image files in a folder, in lower case; FITS first.
pub(super) const FITS_ENDINGS: [&str; 4] = ["fits", "fit", "fts", "fz"];
/// Endings of the other image files.
pub(super) const IMAGE_ENDINGS: [&str; 9] = ["png", "tif", "tiff", "jpg", "jpeg", "bmp", "pgm", "ppm", "pnm"];

/// What a file says of itself before its pixels are read.
#[derive(Clone, Debug)]
pub(super) struct Probe {
    pub(super) size: FrameSize,
    /// `None` for anything but FITS.
    pub(super) fits: Option<FitsHeader>,
    /// What a camera wrote beside the pixels.
    pub(super) exif: Option<Exif>,
    /// Whether the file holds further images, which are not read.
    pub(super) more_images: bool,
}

/// Counts as they were stored; what is no finite number is undefined.
pub(super) struct Samples {
    pub(super) size: FrameSize,
    pub(super) pixels_dn: Vec<f32>,
    pub(super) saturation_dn: f32,
}

/// The kind of a file by its first bytes.
enum Kind {
    Fits,
    Tiff,
    Pnm,
    Image(ImageFormat, &'static str),
}

fn kind(head: &[u8]) -> Result<Kind, FrameProblem> {
    if head.is_empty() {
        return Err(FrameProblem::EmptyFile);
    }
    if head.starts_with(b"SIMPLE  =") {
        return Ok(Kind::Fits);
    }
    if [b"II\x2A\0", b"MM\0\x2A", b"II\x2B\0", b"MM\0\x2B"].iter().any(|mark| head.starts_with(*mark)) {
        return Ok(Kind::Tiff);
    }
    if pnm::Head::is_at(head) {
        return Ok(Kind::Pnm);
    }
    match image::guess_format(head) {
        Ok(ImageFormat::Png) => Ok(Kind::Image(ImageFormat::Png, "PNG")),
        Ok(ImageFormat::Jpeg) => Ok(Kind::Image(ImageFormat::Jpeg, "JPEG")),
        Ok(ImageFormat::Bmp) => Ok(Kind::Image(ImageFormat::Bmp, "BMP")),
        _ => Err(foreign::recognised(head)),
    }
}

/// Reads size and header; checks that the file is an image that can be meant.
pub(super) fn probe(path: &Path, plane: Option<Plane>) -> Result<Probe, FrameProblem> {
    let mut file = open(path)?;
    let length = file.metadata().map_err(FrameProblem::Read)?.len();
    let mut mark = Vec::new();
    file.by_ref().take(2).read_to_end(&mut mark).map_err(FrameProblem::Read)?;
    file.rewind().map_err(FrameProblem::Read)?;
    let probe = if is_gzip(&mark) {
        let bytes = unpacked(file)?;
        probe_from(Cursor::new(&bytes), bytes.len() as u64, plane)?
    } else {
        probe_from(BufReader::new(file), length, plane)?
    };
    check_size(probe.size)?;
    Ok(probe)
}

fn probe_from(mut from: impl BufRead + Seek, length: u64, plane: Option<Plane>) -> Result<Probe, FrameProblem> {
    let mut head = Vec::new();
    from.by_ref().take(300).read_to_end(&mut head).map_err(FrameProblem::Read)?;
    let kind = kind(&head)?;
    if let Some(Plane::Index(index)) = plane.filter(|_| matches!(kind, Kind::Pnm | Kind::Image(..))) {
        check_only_plane(index)?;
    }
    match kind {
        Kind::Fits => probe_fits(from, head, length, plane),
        Kind::Tiff => {
            let tiff::TiffProbe { size, pages, exif } = tiff::probe(from, page(plane))?;
            let more_images = pages > 1 && plane.is_none();
            Ok(Probe { size, fits: None, exif: Some(exif), more_images })
        }
        Kind::Pnm => {
            from.take(EXIF_REACH_BYTES).read_to_end(&mut head).map_err(FrameProblem::Read)?;
            let told = pnm::Head::parse(&head)?;
            told.check_length(length)?;
            Ok(Probe { size: told.size, fits: None, exif: None, more_images: false })
        }
        Kind::Image(format, name) => {
            from.by_ref().take(EXIF_REACH_BYTES).read_to_end(&mut head).map_err(FrameProblem::Read)?;
            let exif = match format {
                ImageFormat::Jpeg => Exif::of_jpeg(&head),
                ImageFormat::Png => Exif::of_png(&head),
                _ => None,
            };
            from.rewind().map_err(FrameProblem::Read)?;
            let mut reader = ImageReader::with_format(from, format);
            reader.limits(limits());
            let (width, height) = of_decoder(name, || reader.into_dimensions())?;
            Ok(Probe { size: FrameSize { width_px: width as usize, height_px: height as usize }, fits: None, exif, more_images: false })
        }
    }
}

fn probe_fits(mut from: impl BufRead + Seek, mut bytes: Vec<u8>, length: u64, plane: Option<Plane>) -> Result<Probe, FrameProblem> {
    fits::read_header_bytes(&mut from, &mut bytes).map_err(FrameProblem::Read)?;
    let header = match FitsHeader::parse(&bytes) {
        // the image stands in an extension further down
        Ok(None) => {
            from.by_ref().take(MAXIMUM_FILE_BYTES).read_to_end(&mut bytes).map_err(FrameProblem::Read)?;
            FitsHeader::parse(&bytes)?
        }
        parsed => parsed?,
    };
    let header = header.ok_or_else(|| FrameProblem::Fits("it holds no image".to_owned()))?;
    header.check_length(length)?;
    header.check_plane(plane)?;
    let mut next = [0; 19];
    let is_there = from.seek(SeekFrom::Start(header.next_unit())).and_then(|_| from.read_exact(&mut next)).is_ok();
    Ok(Probe { size: header.size, fits: Some(header), exif: None, more_images: is_there && &next == b"XTENSION= 'IMAGE   " })
}

/// Reads the pixels of an image file (FITS, PNG, TIFF, JPEG, BMP, PGM), whatever its name; a pixel without a value is an error. Rows stored
/// from the bottom up (FITS `ROWORDER`) are turned over.
pub fn load(path: &Path) -> Result<Frame, FrameProblem> {
    let masked = load_masked(path, None)?;
    match masked.undefined {
        None => Ok(masked.frame),
        Some(mask) => {
            let first = mask.iter().position(|undefined| *undefined).unwrap_or(0);
            let (count, width_px) = (mask.iter().filter(|undefined| **undefined).count(), masked.frame.width_px);
            Err(FrameProblem::NotFinite { count, x: first % width_px, y: first / width_px })
        }
    }
}

/// Columns and rows of an image file, without its pixels.
pub(crate) fn size_of(path: &Path) -> Result<FrameSize, FrameProblem> {
    probe(path, None).map(|probe| probe.size)
}

/// A file of bare counts ([`super::ImageFileForm::Raw16`]) that a recording names: it has no head, so the recording says the size.
pub(super) fn is_raw(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("raw"))
}

/// Refuses bare counts of another length than their frame. Cameras' own files of that ending are told by their first bytes.
pub(super) fn probe_raw(path: &Path, size: FrameSize) -> Result<Probe, FrameProblem> {
    let file = open(path)?;
    let found = file.metadata().map_err(FrameProblem::Read)?.len();
    let expected = 2 * (size.width_px * size.height_px) as u64;
    if found == expected {
        return Ok(Probe { size, fits: None, exif: None, more_images: false });
    }
    let mut head = Vec::new();
    file.take(300).read_to_end(&mut head).map_err(FrameProblem::Read)?;
    if let Err(foreign @ (FrameProblem::OtherKind { .. } | FrameProblem::EmptyFile)) = kind(&head) {
        return Err(foreign);
    }
    let message = format!(
        "it has {found} bytes, but {size} of bare counts are {expected}, 16 bits each, low byte first; correct [camera] or copy the file again"
    );
    Err(FrameProblem::Decode { kind: "raw", message })
}

/// Reads bare counts of 16 bits.
pub(super) fn load_raw(path: &Path, size: FrameSize) -> Result<MaskedFrame, FrameProblem> {
    probe_raw(path, size)?;
    let mut bytes = Vec::new();
    open(path)?.take(MAXIMUM_FILE_BYTES).read_to_end(&mut bytes).map_err(FrameProblem::Read)?;
    let pixels_dn: Vec<f32> = bytes.as_chunks().0.iter().map(|pair| f32::from(u16::from_le_bytes(*pair))).collect();
    let FrameSize { width_px, height_px } = size;
    if pixels_dn.len() != width_px * height_px {
        return Err(FrameProblem::Truncated {
            kind: "raw",
            expected_bytes: 2 * (width_px * height_px) as u64,
            found_bytes: bytes.len() as u64,
        });
    }
    MaskedFrame::new(Frame { width_px, height_px, pixels_dn, saturation_dn: f32::from(u16::MAX) }).ok_or(FrameProblem::NothingDefined)
}

/// Reads the pixels of an image file; those without a value (NaN, infinite, BLANK) are marked, and have the median of the others.
pub(super) fn load_masked(path: &Path, plane: Option<Plane>) -> Result<MaskedFrame, FrameProblem> {
    let file = open(path)?;
    let mut bytes = Vec::new();
    file.take(MAXIMUM_FILE_BYTES).read_to_end(&mut bytes).map_err(FrameProblem::Read)?;
    of_bytes(bytes, plane)
}

/// Reads the pixels of an image file that is in memory.
pub(crate) fn of_bytes(mut bytes: Vec<u8>, plane: Option<Plane>) -> Result<MaskedFrame, FrameProblem> {
    if is_gzip(&bytes) {
        bytes = unpacked(bytes.as_slice())?;
    }
    let kind = kind(&bytes)?;
    if let Some(Plane::Index(index)) = plane.filter(|_| matches!(kind, Kind::Pnm | Kind::Image(..))) {
        check_only_plane(index)?;
    }
    let samples = match kind {
        Kind::Fits => fits::decode(&bytes, plane)?,
        Kind::Tiff => tiff::decode(&bytes, page(plane))?,
        Kind::Pnm => decode_pnm(&bytes)?,
        Kind::Image(format, name) => decode_image(&bytes, format, name)?,
    };
    drop(bytes);
    let Samples { size: FrameSize { width_px, height_px }, pixels_dn, saturation_dn } = samples;
    MaskedFrame::new(Frame { width_px, height_px, pixels_dn, saturation_dn }).ok_or(FrameProblem::NothingDefined)
}

fn page(plane: Option<Plane>) -> usize {
    match plane {
        Some(Plane::Index(index)) => index,
        Some(Plane::Colours) | None => 0,
    }
}

/// Files of other kinds hold one image.
fn check_only_plane(index: usize) -> Result<(), FrameProblem> {
    if index == 0 { Ok(()) } else { Err(FrameProblem::NoSuchPlane { plane: index + 1, planes: 1 }) }
}

fn is_gzip(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// What a gzipped file holds.
fn unpacked(packed: impl Read) -> Result<Vec<u8>, FrameProblem> {
    let fault = |message: String| FrameProblem::Decode { kind: "gzip", message };
    let mut bytes = Vec::new();
    let read = MultiGzDecoder::new(packed).take(MAXIMUM_UNPACKED_BYTES + 1).read_to_end(&mut bytes);
    read.map_err(|_| fault("it cannot be unpacked to its end; copy the file again".to_owned()))?;
    if bytes.len() as u64 > MAXIMUM_UNPACKED_BYTES {
        return Err(fault(format!("it unpacks to more than {} MiB; unpack it with gunzip", MAXIMUM_UNPACKED_BYTES >> 20)));
    }
    Ok(bytes)
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

pub(super) fn check_size(size: FrameSize) -> Result<(), FrameProblem> {
    if size.width_px < MINIMUM_PX || size.height_px < MINIMUM_PX {
        return Err(FrameProblem::TooSmall { size, minimum_px: MINIMUM_PX });
    }
    if size.width_px.checked_mul(size.height_px).is_none_or(|pixels| pixels > MAXIMUM_PIXELS) {
        return Err(FrameProblem::TooLarge { size, maximum_px: MAXIMUM_PIXELS });
    }
    Ok(())
}

fn limits() -> Limits {
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAXIMUM_DECODER_BYTES);
    limits
}

/// What a decoder of the `image` crate gives, or what its error means, in our words.
fn of_decoder<T>(kind: &'static str, decode: impl FnOnce() -> Result<T, ImageError>) -> Result<T, FrameProblem> {
    let fault = |message: &str| FrameProblem::Decode { kind, message: message.to_owned() };
    let decoded = guarded(decode).map_err(|panicked| fault(&panicked.to_string()))?;
    decoded.map_err(|error| {
        let text = error.to_string().to_lowercase();
        let ends = ["unexpected end", "eof", "failed to fill"].iter().any(|words| text.contains(words));
        match error {
            _ if ends => fault("it ends before its pixels do; copy the file again"),
            ImageError::Limits(_) => fault("it claims more pixels than a frame can hold, or unpacks to more memory than that"),
            ImageError::Unsupported(_) => fault("it uses a part of the format that is not read; save it as 8- or 16-bit PNG"),
            _ if text.contains("crc") => fault("a checksum is wrong; copy the file again"),
            ImageError::IoError(error) => fault(&format!("it cannot be read to its end ({})", error.kind())),
            _ => fault("its head or its compressed data are damaged; copy the file again"),
        }
    })
}

fn decode_image(bytes: &[u8], format: ImageFormat, kind: &'static str) -> Result<Samples, FrameProblem> {
    // The JPEG decoder fills what is missing with grey; a file that was cut off has lost its end mark.
    if format == ImageFormat::Jpeg && !jpeg_has_end(bytes) {
        return Err(FrameProblem::NoEndMark { kind });
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits());
    let decoder = of_decoder(kind, || reader.into_decoder())?;
    let (width, height) = decoder.dimensions();
    let size = FrameSize { width_px: width as usize, height_px: height as usize };
    check_size(size)?;
    let image = of_decoder(kind, || DynamicImage::from_decoder(decoder))?;
    let other = || FrameProblem::Decode { kind, message: "its pixels are neither of 8 nor of 16 bits; save it as 16-bit PNG".to_owned() };
    let (pixels_dn, saturation_dn) = counts(&image).ok_or_else(other)?;
    Ok(Samples { size, pixels_dn, saturation_dn })
}

fn decode_pnm(bytes: &[u8]) -> Result<Samples, FrameProblem> {
    let head = pnm::Head::parse(bytes)?;
    let samples = head.samples_of(bytes)?;
    let pixels = head.size.width_px * head.size.height_px;
    let pixels_dn = joined(&samples, head.channels, pixels, f64::from).ok_or(FrameProblem::NothingDefined)?;
    Ok(Samples { size: head.size, pixels_dn, saturation_dn: head.top as f32 })
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

/// Colours joined by the weights of ITU-R BT.709 (as they are stored, no gamma is taken off).
pub(super) fn luminance([red, green, blue]: [f64; 3]) -> f32 {
    // whole weights: grey stays exactly what it was
    ((2126.0 * red + 7152.0 * green + 722.0 * blue) / 10_000.0) as f32
}

/// Samples of grey (1 channel), grey and alpha (2), RGB (3) or RGB and alpha (4) as counts of `pixels`; alpha is ignored. `None` where they are
/// fewer.
pub(super) fn joined<T: Copy>(samples: &[T], channels: usize, pixels: usize, number: impl Fn(T) -> f64) -> Option<Vec<f32>> {
    let count = |pixel: &[T]| match *pixel {
        [red, green, blue, ..] => luminance([number(red), number(green), number(blue)]),
        [grey, ..] => number(grey) as f32,
        [] => f32::NAN,
    };
    (samples.len() >= channels * pixels).then(|| samples.chunks_exact(channels).take(pixels).map(count).collect())
}

/// The counts and the top of their range.
fn counts(image: &DynamicImage) -> Option<(Vec<f32>, f32)> {
    let (eight, sixteen) = (f32::from(u8::MAX), f32::from(u16::MAX));
    let pixels = image.width() as usize * image.height() as usize;
    let of_bytes = |samples: &[u8], channels| Some((joined(samples, channels, pixels, f64::from)?, eight));
    let of_words = |samples: &[u16], channels| Some((joined(samples, channels, pixels, f64::from)?, sixteen));
    match image {
        DynamicImage::ImageLuma8(buffer) => of_bytes(buffer.as_raw(), 1),
        DynamicImage::ImageLumaA8(buffer) => of_bytes(buffer.as_raw(), 2),
        DynamicImage::ImageRgb8(buffer) => of_bytes(buffer.as_raw(), 3),
        DynamicImage::ImageRgba8(buffer) => of_bytes(buffer.as_raw(), 4),
        DynamicImage::ImageLuma16(buffer) => of_words(buffer.as_raw(), 1),
        DynamicImage::ImageLumaA16(buffer) => of_words(buffer.as_raw(), 2),
        DynamicImage::ImageRgb16(buffer) => of_words(buffer.as_raw(), 3),
        DynamicImage::ImageRgba16(buffer) => of_words(buffer.as_raw(), 4),
        _ => None,
    }
}
