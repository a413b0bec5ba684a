//! EXIF metadata of JPEG, PNG and TIFF files.
//!
//! Source: CIPA DC-008 (Exif 2.32), sections 4.6.4 to 4.6.6. Nothing here is needed, so what cannot be read is absent.

use std::io::{Cursor, Read, Seek};

use hifitime::Epoch;

use super::tags::{Directory, Tags};
use super::time;

const ORIENTATION: u16 = 0x0112;
const EXIF_DIRECTORY: u16 = 0x8769;
const GPS_DIRECTORY: u16 = 0x8825;
const EXPOSURE_TIME: u16 = 0x829A;
const TIME_ORIGINAL: u16 = 0x9003;
const OFFSET_ORIGINAL: u16 = 0x9011;
const SUBSECONDS_ORIGINAL: u16 = 0x9291;
const FOCAL_LENGTH: u16 = 0x920A;
const GPS_TIME: u16 = 7;
const GPS_DATE: u16 = 29;

/// What EXIF says of an image.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Exif {
    /// How viewers turn the image, 2 to 8; `None` where it stands as it is stored.
    pub(super) orientation: Option<u8>,
    /// Start of the exposure. Where no zone is given it is taken for UTC, and the second value says so.
    pub(super) start: Option<(Epoch, bool)>,
    pub(super) exposure_s: Option<f64>,
    pub(super) focal_length_mm: Option<f64>,
}

impl Exif {
    /// From the tags of a file, of which `directory` is the main one.
    pub(super) fn of<R: Read + Seek>(tags: &mut Tags<R>, directory: &Directory) -> Self {
        let orientation = tags.number(directory, ORIENTATION).filter(|way| (2.0..=8.0).contains(way)).map(|way| way as u8);
        let below = |tags: &mut Tags<R>, tag| {
            let at = tags.number(directory, tag)?;
            tags.directory(at as u64)
        };
        let (camera, gps) = (below(tags, EXIF_DIRECTORY).unwrap_or_default(), below(tags, GPS_DIRECTORY).unwrap_or_default());
        let positive = |number: &f64| *number > 0.0;
        Self {
            orientation,
            start: by_satellite(tags, &gps).map(|epoch| (epoch, false)).or_else(|| by_clock(tags, &camera)),
            exposure_s: tags.number(&camera, EXPOSURE_TIME).filter(positive),
            focal_length_mm: tags.number(&camera, FOCAL_LENGTH).filter(positive),
        }
    }

    /// From a block that begins like a TIFF file.
    fn parse(block: &[u8]) -> Option<Self> {
        let mut tags = Tags::open(Cursor::new(block))?;
        let first = tags.first;
        let directory = tags.directory(first)?;
        Some(Self::of(&mut tags, &directory)).filter(|exif| *exif != Self::default())
    }

    /// From the beginning of a JPEG file: the APP1 segment.
    pub(super) fn of_jpeg(bytes: &[u8]) -> Option<Self> {
        let mut at = 2;
        while let Some(&[0xFF, marker, high, low]) = bytes.get(at..at + 4) {
            let length = usize::from(u16::from_be_bytes([high, low])).max(2);
            if marker == 0xDA {
                return None;
            }
            let segment = bytes.get(at + 4..at + 2 + length)?;
            if let (0xE1, Some(block)) = (marker, segment.strip_prefix(b"Exif\0\0")) {
                return Self::parse(block);
            }
            at += 2 + length;
        }
        None
    }

    /// From the beginning of a PNG file: the eXIf chunk.
    pub(super) fn of_png(bytes: &[u8]) -> Option<Self> {
        let mut at = 8;
        while let Some(&[a, b, c, d, ref name @ ..]) = bytes.get(at..at + 8) {
            let length = u32::from_be_bytes([a, b, c, d]) as usize;
            if name == b"eXIf" {
                return Self::parse(bytes.get(at + 8..at.checked_add(8)?.checked_add(length)?)?);
            }
            at = at.checked_add(length)?.checked_add(12)?;
        }
        None
    }
}

/// The time that a receiver gave, UTC.
fn by_satellite<R: Read + Seek>(tags: &mut Tags<R>, gps: &Directory) -> Option<Epoch> {
    let date = tags.text(gps, GPS_DATE)?.replace(':', "-");
    let clock = tags.numbers(gps, GPS_TIME)?;
    let &[hour, minute, second] = clock.as_slice() else { return None };
    time::parse_utc(&format!("{date}T{hour:02.0}:{minute:02.0}:{second:06.3}")).ok()
}

/// The time of the camera's own clock, and whether its zone is unknown.
fn by_clock<R: Read + Seek>(tags: &mut Tags<R>, camera: &Directory) -> Option<(Epoch, bool)> {
    let text = tags.text(camera, TIME_ORIGINAL)?;
    let (date, clock) = text.split_once(' ')?;
    let subseconds = tags.text(camera, SUBSECONDS_ORIGINAL).filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()));
    let fraction = subseconds.map_or_else(String::new, |digits| format!(".{digits}"));
    let local = format!("{}T{clock}{fraction}", date.replace(':', "-"));
    let zoned = tags.text(camera, OFFSET_ORIGINAL).and_then(|zone| time::parse_utc(&format!("{local}{zone}")).ok());
    zoned.map(|epoch| (epoch, false)).or_else(|| Some((time::parse_utc(&local).ok()?, true)))
}
