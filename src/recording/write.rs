//! Writing recordings with a manifest, in the form that the readers beside it read.

use std::collections::BTreeMap;
use std::fmt::{Debug, Write as _};
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use fitsio_pure::BLOCK_SIZE;
use fitsio_pure::header::{Card, serialize_header};
use fitsio_pure::value::Value;
use hifitime::{Duration, Epoch};
use serde::Serialize;

use super::image_form::png_u16;
use super::output::{OutputError, write_file};
use super::schema::{RecordingFile, RecordingFrameTable, RecordingMountTable, RecordingSiteTable};
use super::{CameraInfo, FrameEntry, ListedStar, Recording, Site, StarList, manifest, time};
use crate::frame::Frame;

/// Bytes of a card of a FITS header.
const CARD_BYTES: usize = 80;
/// The file of a star list beside its manifest.
const STAR_FILE: &str = "stars.csv";

/// What the header of a FITS image says beside its size. Absent values are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitsHeaders {
    /// Middle of the exposure; written as its start (`DATE-OBS`) where the length is known.
    pub time_utc: Option<Epoch>,
    /// `EXPTIME`.
    pub exposure_s: Option<f64>,
    /// `CCD-TEMP`.
    pub temperature_c: Option<f64>,
    /// `SITELAT`, `SITELONG`, `SITEELEV`.
    pub site: Option<Site>,
    /// `FOCALLEN`.
    pub focal_length_mm: Option<f64>,
    /// `XPIXSZ`, `YPIXSZ`.
    pub pixel_pitch_um: Option<[f64; 2]>,
    /// `EGAIN`.
    pub gain_e_per_dn: Option<f64>,
}

/// A card: keyword, value, comment.
type FitsCard = (&'static str, Value, &'static str);

/// What the headers of a frame say, and who wrote them.
pub(super) fn fits_cards(headers: &FitsHeaders) -> impl Iterator<Item = FitsCard> {
    let creator = ("CREATOR", Value::String(concat!("boresight ", env!("CARGO_PKG_VERSION")).to_owned()), "");
    headers.cards().into_iter().chain([creator])
}

impl FitsHeaders {
    /// What a manifest says of the same frame.
    #[must_use]
    pub fn new(camera: &CameraInfo, site: Option<&Site>, frame: &FrameEntry) -> Self {
        Self {
            time_utc: frame.time_utc,
            exposure_s: frame.exposure_s,
            temperature_c: frame.temperature_c,
            site: site.copied(),
            focal_length_mm: camera.focal_length_mm,
            pixel_pitch_um: camera.pixel_pitch_um,
            gain_e_per_dn: camera.gain_e_per_dn,
        }
    }

    fn cards(&self) -> Vec<FitsCard> {
        let mut cards = Vec::new();
        if let Some(middle) = self.time_utc {
            let start = middle - Duration::from_seconds(self.exposure_s.unwrap_or(0.0) / 2.0);
            let comment = if self.exposure_s.is_some() { "UTC, start of the exposure" } else { "UTC" };
            cards.push(("DATE-OBS", Value::String(time::format_utc(start)), comment));
            cards.push(("TIMESYS", Value::String("UTC".to_owned()), ""));
        }
        let mut number = |keyword, value: Option<f64>, comment| cards.extend(value.map(|value| (keyword, Value::Float(value), comment)));
        number("EXPTIME", self.exposure_s, "[s]");
        number("CCD-TEMP", self.temperature_c, "[C]");
        number("SITELAT", self.site.map(|site| site.latitude_deg), "[deg]");
        number("SITELONG", self.site.map(|site| site.longitude_deg), "[deg] east positive");
        number("SITEELEV", self.site.map(|site| site.height_m), "[m]");
        number("FOCALLEN", self.focal_length_mm, "[mm]");
        number("XPIXSZ", self.pixel_pitch_um.map(|[x, _]| x), "[um]");
        number("YPIXSZ", self.pixel_pitch_um.map(|[_, y]| y), "[um]");
        number("EGAIN", self.gain_e_per_dn, "electrons per count");
        cards
    }
}

/// Writes a 16-bit FITS image, first row on top (`ROWORDER` TOP-DOWN).
///
/// FITS knows signed integers only; the counts are stored less 32768 and `BZERO` says so (FITS Standard 4.0, section 5.2.5).
pub fn write_fits_u16(path: &Path, width_px: usize, height_px: usize, pixels_dn: &[u16], headers: &FitsHeaders) -> Result<(), OutputError> {
    check_count(path, width_px, height_px, pixels_dn.len())?;
    let bytes: Vec<u8> = pixels_dn.iter().flat_map(|pixel| (pixel ^ 0x8000).to_be_bytes()).collect(); // less 32768, as a signed number
    write_fits(path, [width_px, height_px], (16, 32768.0), &bytes, headers)
}

/// Writes an 8-bit FITS image, first row on top. Integers of 8 bits have no sign in FITS (FITS Standard 4.0, section 5.2.1).
pub fn write_fits_u8(path: &Path, width_px: usize, height_px: usize, pixels_dn: &[u8], headers: &FitsHeaders) -> Result<(), OutputError> {
    check_count(path, width_px, height_px, pixels_dn.len())?;
    write_fits(path, [width_px, height_px], (8, 0.0), pixels_dn, headers)
}

/// Writes a FITS image of electrons as 32-bit real numbers, first row on top (FITS Standard 4.0, section 5.3).
pub fn write_fits_f32(path: &Path, width_px: usize, height_px: usize, pixels_e: &[f32], headers: &FitsHeaders) -> Result<(), OutputError> {
    check_count(path, width_px, height_px, pixels_e.len())?;
    let bytes: Vec<u8> = pixels_e.iter().flat_map(|pixel| pixel.to_be_bytes()).collect();
    write_fits(path, [width_px, height_px], (-32, 0.0), &bytes, &FitsHeaders { gain_e_per_dn: None, ..headers.clone() })
}

/// Writes a frame as it was read, first row on top, with more cards in its header: those of `more`, a FITS header itself, but for what it says of
/// an image's form. Whole counts from 0 to 65 535 are written as 16-bit integers, others as 32-bit real numbers.
pub fn write_fits_with(path: &Path, frame: &Frame, headers: &FitsHeaders, more: &[u8]) -> Result<(), OutputError> {
    let Frame { width_px, height_px, pixels_dn, .. } = frame;
    check_count(path, *width_px, *height_px, pixels_dn.len())?;
    let is_count = |value: &f32| value.fract() == 0.0 && (0.0..=65_535.0).contains(value);
    let (form, data): (_, Vec<u8>) = if pixels_dn.iter().all(is_count) {
        ((16, 32768.0), pixels_dn.iter().flat_map(|value| (*value as u16 ^ 0x8000).to_be_bytes()).collect())
    } else {
        ((-32, 0.0), pixels_dn.iter().flat_map(|value| value.to_be_bytes()).collect())
    };
    write_fits_and(path, [*width_px, *height_px], form, &data, headers, more)
}

fn write_fits(path: &Path, size: [usize; 2], form: (i64, f64), data: &[u8], headers: &FitsHeaders) -> Result<(), OutputError> {
    write_fits_and(path, size, form, data, headers, &[])
}

/// The cards of a header that do not say what form an image has.
fn cards_of_content(header: &[u8]) -> impl Iterator<Item = &[u8]> {
    const FORM: [&str; 9] = ["SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "EXTEND", "BZERO", "BSCALE", "END"];
    let keyword = |card: &[u8]| String::from_utf8_lossy(&card[..8]).trim_end().to_owned();
    header.chunks_exact(CARD_BYTES).take_while(move |card| keyword(card) != "END").filter(move |card| {
        let keyword = keyword(card);
        !keyword.is_empty() && !FORM.contains(&keyword.as_str())
    })
}

fn write_fits_and(
    path: &Path,
    [width_px, height_px]: [usize; 2],
    (bits, zero): (i64, f64),
    data: &[u8],
    headers: &FitsHeaders,
    more: &[u8],
) -> Result<(), OutputError> {
    let encode = |error: fitsio_pure::Error| OutputError::Encode { path: path.to_owned(), message: error.to_string() };
    let side = |length: usize| i64::try_from(length).map(Value::Integer).map_err(|_| encode(fitsio_pure::Error::InvalidValue));
    let kind = match bits {
        8 => "8-bit integers",
        16 => "16-bit integers",
        _ => "32-bit real numbers",
    };
    let unit = (bits < 0 && more.is_empty()).then(|| ("BUNIT", Value::String("electron".to_owned()), ""));
    let mandatory = [
        ("SIMPLE", Value::Logical(true), "conforms to FITS standard"),
        ("BITPIX", Value::Integer(bits), kind),
        ("NAXIS", Value::Integer(2), ""),
        ("NAXIS1", side(width_px)?, "columns"),
        ("NAXIS2", side(height_px)?, "rows"),
        ("BZERO", Value::Float(zero), if bits < 0 { "" } else { "counts are unsigned" }),
        ("BSCALE", Value::Float(1.0), ""),
        ("ROWORDER", Value::String("TOP-DOWN".to_owned()), "the first row stored is the top one"),
    ];
    let mut cards = Vec::new();
    for (keyword, value, comment) in mandatory.into_iter().chain(unit).chain(fits_cards(headers)) {
        let mut card = Card::new(keyword, value).map_err(encode)?;
        card.comment = Some(comment.to_owned()).filter(|comment| !comment.is_empty());
        cards.push(card);
    }
    let mut bytes = serialize_header(&cards).map_err(encode)?;
    if !more.is_empty() {
        bytes.truncate(cards.len() * CARD_BYTES); // up to its end card
        bytes.extend(cards_of_content(more).flatten());
        bytes.extend(format!("{:CARD_BYTES$}", "END").bytes());
        bytes.resize(bytes.len().next_multiple_of(BLOCK_SIZE), b' ');
    }
    bytes.reserve(data.len() + BLOCK_SIZE);
    bytes.extend_from_slice(data);
    bytes.resize(bytes.len().next_multiple_of(BLOCK_SIZE), 0);
    write_file(path, &bytes)
}

/// Writes a 16-bit grey PNG image.
pub fn write_png_u16(path: &Path, width_px: usize, height_px: usize, pixels_dn: &[u16]) -> Result<(), OutputError> {
    check_count(path, width_px, height_px, pixels_dn.len())?;
    let bytes = png_u16([width_px, height_px], pixels_dn).map_err(|message| OutputError::Encode { path: path.to_owned(), message })?;
    write_file(path, &bytes)
}

pub(super) fn check_count(path: &Path, width_px: usize, height_px: usize, pixels: usize) -> Result<(), OutputError> {
    if width_px.checked_mul(height_px) == Some(pixels) {
        return Ok(());
    }
    Err(OutputError::PixelCount { path: path.to_owned(), width_px, height_px, pixels })
}

/// Writes `recording.toml`, and `stars.csv` if the recording is a star list, into a folder. The frames' files are written apart.
///
/// The text is read back before it is written: a number that is not finite, a negative exposure and the like are refused here.
pub fn write_manifest(directory: &Path, recording: &Recording) -> Result<PathBuf, OutputError> {
    let path = directory.join(manifest::FILE_NAME);
    let text = manifest_text(recording);
    let read_back = manifest::parse(&path, &text).map_err(Box::new)?;
    for frame in read_back.frames {
        frame.entry.map_err(Box::new)?;
    }
    if let Some(stars) = &recording.stars {
        write_file(&directory.join(STAR_FILE), star_list_text(stars).as_bytes())?;
    }
    write_file(&path, text.as_bytes())?;
    Ok(path)
}

/// Writes `recording.toml` of a recording without frames of its own, whose frames come one after the other and are not held. The folder is one in
/// the making: the file grows. What is written is read back in pieces, as by [`write_manifest`].
pub fn write_manifest_of(
    directory: &Path,
    recording: &Recording,
    frames: impl Iterator<Item = FrameEntry>,
) -> Result<PathBuf, OutputError> {
    const PIECE: usize = 256;
    let path = directory.join(manifest::FILE_NAME);
    let error = |source| OutputError::Write { path: path.clone(), source };
    let head = manifest_text(recording);
    let mut file = BufWriter::new(File::create(&path).map_err(error)?);
    file.write_all(head.as_bytes()).map_err(error)?;
    let mut frames = frames.peekable();
    while frames.peek().is_some() {
        let mut piece = String::new();
        frames.by_ref().take(PIECE).for_each(|frame| push_frame(&mut piece, &frame));
        let read_back = manifest::parse(&path, &format!("{head}{piece}")).map_err(Box::new)?;
        for frame in read_back.frames {
            frame.entry.map_err(Box::new)?;
        }
        file.write_all(piece.as_bytes()).map_err(error)?;
    }
    file.flush().map_err(error)?;
    Ok(path)
}

/// The text of `recording.toml`.
#[must_use]
pub fn manifest_text(recording: &Recording) -> String {
    let head = RecordingFile {
        format: manifest::FORMAT.to_owned(),
        stars: recording.stars.as_ref().map(|_| STAR_FILE.to_owned()),
        camera: recording.camera.clone(),
        mount: recording.mount.map(|mount| RecordingMountTable { kind: Some(mount) }),
        site: recording.site.map(RecordingSiteTable::from),
        frames: Vec::new(), // below, one by one
    };
    let mut text = String::new();
    push_table(&mut text, &head);
    recording.frames.iter().for_each(|frame| push_frame(&mut text, frame));
    text
}

impl From<Site> for RecordingSiteTable {
    fn from(site: Site) -> Self {
        let Site { latitude_deg, longitude_deg, height_m, pressure_hpa, temperature_c, relative_humidity } = site;
        Self { latitude_deg, longitude_deg, height_m, pressure_hpa, temperature_c, relative_humidity }
    }
}

impl From<&FrameEntry> for RecordingFrameTable {
    fn from(frame: &FrameEntry) -> Self {
        Self {
            file: frame.file.as_ref().map(|file| file.to_string_lossy().into_owned()),
            time_utc: frame.time_utc.map(|epoch| format!("{}Z", time::format_utc(epoch))),
            exposure_s: frame.exposure_s,
            temperature_c: frame.temperature_c,
            velocity_km_s: frame.velocity_km_s,
            rate_deg_s: frame.rate_deg_s,
            camera_from_icrs: frame.camera_from_icrs.map(<[f64; 4]>::from),
            attitude_sigma_arcsec: frame.attitude_sigma_arcsec,
            boresight_radec_deg: frame.boresight_radec_deg,
            altitude_azimuth_deg: frame.altitude_azimuth_deg,
            telemetry: BTreeMap::new(), // written apart: a name that is a known key must not take its place unseen
        }
    }
}

/// The text of a star list: the columns that any star uses.
#[must_use]
pub fn star_list_text(stars: &StarList) -> String {
    let all = || stars.frames.iter().flatten();
    let flux = all().any(|star| star.flux_e.is_some());
    let magnitude = all().any(|star| star.magnitude.is_some());
    let covariance = all().any(|star| star.covariance_px2.is_some());
    let hip = all().any(|star| star.hip.is_some());
    let radec = all().any(|star| star.radec_deg.is_some());
    let columns: [Column; 11] = [
        ("frame", true, |frame, _| frame.to_string()),
        ("x_px", true, |_, star| field(Some(star.x_px))),
        ("y_px", true, |_, star| field(Some(star.y_px))),
        ("flux_e", flux, |_, star| field(star.flux_e)),
        ("magnitude", magnitude, |_, star| field(star.magnitude)),
        ("sigma_x_px", covariance, |_, star| field(star.covariance_px2.map(|[xx, ..]| xx.sqrt()))),
        ("sigma_y_px", covariance, |_, star| field(star.covariance_px2.map(|[.., yy]| yy.sqrt()))),
        ("cov_xy_px2", covariance, |_, star| field(star.covariance_px2.map(|[_, xy, _]| xy))),
        ("hip", hip, |_, star| field(star.hip)),
        ("ra_deg", radec, |_, star| field(star.radec_deg.map(|[ra, _]| ra))),
        ("dec_deg", radec, |_, star| field(star.radec_deg.map(|[_, dec]| dec))),
    ];
    let used = || columns.iter().filter(|(_, used, _)| *used);
    let mut table = csv::Writer::from_writer(Vec::new());
    // writing to memory cannot fail, and every record has as many fields as the header
    let _ = table.write_record(used().map(|(name, ..)| *name));
    for (frame, list) in stars.frames.iter().enumerate() {
        for star in list {
            let _ = table.write_record(used().map(|(.., read)| read(frame, star)));
        }
    }
    table.into_inner().ok().and_then(|bytes| String::from_utf8(bytes).ok()).unwrap_or_default()
}

/// A column of a star list: its name, whether any star uses it, and its field for a star of a frame.
type Column = (&'static str, bool, fn(usize, &ListedStar) -> String);

/// What is absent is empty.
fn field(value: Option<impl Debug>) -> String {
    value.map_or_else(String::new, |value| format!("{value:?}"))
}

fn push_frame(text: &mut String, frame: &FrameEntry) {
    text.push_str("\n[[frames]]\n");
    push_table(text, &RecordingFrameTable::from(frame));
    frame.covariates.iter().for_each(|(name, value)| push_value(text, name, &toml::Value::Float(*value)));
}

/// Writes the keys of a table, and its tables after them. The toml crate lays them out; only its numbers are not taken, since it writes 1e-9 as
/// 0.000000001.
fn push_table(text: &mut String, table: &impl Serialize) {
    // of these types only a width beyond what TOML can write is refused; what is then missing is seen on reading back
    let table = toml::Table::try_from(table).unwrap_or_default();
    for (key, value) in &table {
        match value {
            toml::Value::Table(inner) => {
                let _ = writeln!(text, "\n[{key}]"); // writing to a String cannot fail
                push_table(text, inner);
            }
            toml::Value::Array(items) if items.is_empty() => {} // the frames, which follow one by one
            _ => push_value(text, key, value),
        }
    }
}

fn push_value(text: &mut String, name: &str, value: &toml::Value) {
    let _ = writeln!(text, "{} = {}", key(name), shown(value));
}

fn shown(value: &toml::Value) -> String {
    match value {
        toml::Value::Float(number) => digits(*number),
        toml::Value::Array(items) => format!("[{}]", items.iter().map(shown).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}

/// With as many digits as bring the same number back; TOML writes what is no number in lower case.
fn digits(number: f64) -> String {
    format!("{number:?}").to_lowercase()
}

/// A key, in quotes where it must be.
fn key(name: &str) -> String {
    let bare = !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
    if bare { name.to_owned() } else { toml::Value::String(name.to_owned()).to_string() }
}
