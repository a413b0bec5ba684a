//! FITS images: header and pixels.
//!
//! The header is checked here, every number against the length of the file, before `fitsio-pure` decodes the pixels:
//! a damaged file must not ask for memory that it cannot fill.
//! Source: FITS Standard 4.0 (2018), sections 3.3, 4.4, 5; keywords beyond it as the common capture programs write them
//! (SBFITSEXT, MaxIm DL, NINA, SharpCap, Siril).

use std::io::{ErrorKind, Read};

use fitsio_pure::BLOCK_SIZE;
use fitsio_pure::hdu::{Hdu, HduInfo};
use fitsio_pure::header::{Card, parse_header_blocks};
use fitsio_pure::image::{extract_bscale_bzero, read_image_physical_into_f32};
use fitsio_pure::value::Value;
use hifitime::{Duration, Epoch, TimeScale};

use super::Plane;
use super::error::{FrameProblem, FrameSize};
use super::fits_tiles::Tiling;
use super::image_file::{MAXIMUM_PIXELS, Samples, check_size, luminance};
use super::time;
use crate::guard::guarded;

/// The largest header that is read, blocks of 2880 bytes (36 cards each).
const MAXIMUM_HEADER_BLOCKS: usize = 1000;
/// The largest number of header-data units that are walked through to find the image.
const MAXIMUM_UNITS: usize = 1000;

/// The header of an image.
#[derive(Clone, Debug)]
pub(super) struct FitsHeader {
    pub(super) size: FrameSize,
    bitpix: i64,
    /// Images in the array: 1, 3 for colour planes, or the depth of a cube.
    planes: usize,
    data_start: usize,
    data_bytes: u64,
    /// How the image is packed, if it is.
    tiling: Option<Tiling>,
    cards: Vec<Card>,
    /// `ROWORDER` says BOTTOM-UP.
    pub(super) bottom_up: bool,
}

/// What a header knows beyond the image.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FitsMetadata {
    /// Middle of the exposure where its length is known, else `DATE-OBS`.
    pub(super) time_utc: Option<Epoch>,
    pub(super) exposure_s: Option<f64>,
    pub(super) temperature_c: Option<f64>,
    pub(super) latitude_deg: Option<f64>,
    pub(super) longitude_deg: Option<f64>,
    pub(super) height_m: Option<f64>,
    pub(super) focal_length_mm: Option<f64>,
    pub(super) pixel_pitch_um: Option<[f64; 2]>,
    pub(super) gain_e_per_dn: Option<f64>,
    /// `GAIN` as a setting of the camera without a unit.
    pub(super) gain_setting: Option<f64>,
    /// What was seen and not used.
    pub(super) notes: Vec<String>,
}

/// Reads on, block by block, until the header's END card or something that is none.
pub(super) fn read_header_bytes(file: &mut impl Read, bytes: &mut Vec<u8>) -> std::io::Result<()> {
    for _ in 0..MAXIMUM_HEADER_BLOCKS {
        let want = (bytes.len() / BLOCK_SIZE + 1) * BLOCK_SIZE - bytes.len();
        let before = bytes.len();
        match file.by_ref().take(want as u64).read_to_end(bytes) {
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
        let block = bytes.get(bytes.len().saturating_sub(BLOCK_SIZE)..).unwrap_or(&[]);
        if bytes.len() == before || block.chunks_exact(80).any(|card| card.starts_with(b"END     ")) {
            break;
        }
    }
    Ok(())
}

impl FitsHeader {
    /// Finds the image: the primary one, or else the first image extension. `None` where the bytes end before it.
    pub(super) fn parse(bytes: &[u8]) -> Result<Option<Self>, FrameProblem> {
        let mut start = 0;
        for unit in 0..MAXIMUM_UNITS {
            let Some(rest) = bytes.get(start..).filter(|rest| unit == 0 || rest.len() >= BLOCK_SIZE) else {
                return Ok(None);
            };
            let limit = rest.len().min(MAXIMUM_HEADER_BLOCKS * BLOCK_SIZE);
            let parsed = guarded(|| parse_header_blocks(&rest[..limit])).map_err(|panicked| FrameProblem::Fits(panicked.to_string()))?;
            let cards = match parsed {
                Ok(cards) => cards,
                // what stands behind the last unit is none of ours
                Err(_) if unit > 0 && !rest.starts_with(b"XTENSION") => return Ok(None),
                Err(fitsio_pure::Error::UnexpectedEof) => {
                    return Err(FrameProblem::Fits("its header has no END card; the file is cut off or damaged, copy it again".to_owned()));
                }
                Err(_) => {
                    let problem = "a card of its header is no FITS card; the file is damaged, copy it again";
                    return Err(FrameProblem::Fits(problem.to_owned()));
                }
            };
            // an END card stands among the 36 of the last block; continued strings were merged, so the bytes are counted anew
            let data_start = start + header_length(rest).unwrap_or(limit);
            let shape = Shape::read(&cards, unit == 0)?;
            if let Some(header) = shape.image(cards, data_start)? {
                return Ok(Some(header));
            }
            let length = shape.data_bytes()?.div_ceil(BLOCK_SIZE as u64) * BLOCK_SIZE as u64;
            start = usize::try_from(data_start as u64 + length).map_err(|_| too_long())?;
        }
        Ok(None)
    }

    /// The length of the file's part up to the last pixel.
    fn end(&self) -> u64 {
        self.data_start as u64 + self.data_bytes
    }

    /// Which of the planes are read: one, or all three that are colours. A cube whose header does not say that it holds colours is refused.
    fn wanted(&self, plane: Option<Plane>) -> Result<Wanted, FrameProblem> {
        let planes = self.planes;
        match plane {
            Some(Plane::Index(index)) if index < planes => Ok(Wanted::One(index)),
            Some(Plane::Index(index)) => Err(FrameProblem::NoSuchPlane { plane: index + 1, planes }),
            Some(Plane::Colours) if planes == 3 => Ok(Wanted::Colours),
            None | Some(Plane::Colours) if planes == 1 => Ok(Wanted::One(0)),
            None if planes == 3 && self.says_colours() => Ok(Wanted::Colours),
            None | Some(Plane::Colours) => Err(FrameProblem::Cube { planes }),
        }
    }

    /// Refuses a cube of which nobody says which plane is meant.
    pub(super) fn check_plane(&self, plane: Option<Plane>) -> Result<(), FrameProblem> {
        self.wanted(plane).map(|_| ())
    }

    /// Whether the third axis is said to be one of colours (Siril and others, PixInsight).
    fn says_colours(&self) -> bool {
        let says = |keyword: &str| self.text(keyword).is_some_and(|text| text.to_uppercase().contains("RGB"));
        says("CTYPE3") || says("COLORSPC")
    }

    /// Where the next header-data unit begins, if there is one.
    pub(super) fn next_unit(&self) -> u64 {
        self.end().next_multiple_of(BLOCK_SIZE as u64)
    }

    /// Refuses a file that ends before its last pixel.
    pub(super) fn check_length(&self, found_bytes: u64) -> Result<(), FrameProblem> {
        let expected_bytes = self.end();
        if found_bytes < expected_bytes {
            return Err(FrameProblem::Truncated { kind: "FITS", expected_bytes, found_bytes });
        }
        Ok(())
    }

    /// The largest count that the file's kind of number can hold; infinite for floating point.
    fn top_of_range(&self) -> f32 {
        let (scale, zero) = extract_bscale_bzero(&self.cards);
        let (low, high) = match self.bitpix {
            8 => (0.0, f64::from(u8::MAX)),
            16 => (f64::from(i16::MIN), f64::from(i16::MAX)),
            32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
            64 => (i64::MIN as f64, i64::MAX as f64),
            _ => return f32::INFINITY,
        };
        (zero + scale * low).max(zero + scale * high) as f32
    }

    fn value(&self, keyword: &str) -> Option<&Value> {
        value(&self.cards, keyword).filter(|value| !matches!(value, Value::Undefined))
    }

    fn text(&self, keyword: &str) -> Option<&str> {
        match self.value(keyword)? {
            Value::String(text) => Some(text.trim()).filter(|text| !text.is_empty()),
            _ => None,
        }
    }

    /// A finite number; a number written as text is understood too.
    fn number(&self, keyword: &str) -> Result<Option<f64>, FrameProblem> {
        let Some(value) = self.value(keyword) else {
            return Ok(None);
        };
        let found = match value {
            Value::Integer(whole) => Some(*whole as f64),
            Value::Float(number) => Some(*number),
            Value::String(text) if text.trim().is_empty() => return Ok(None),
            Value::String(text) => text.trim().parse().ok(),
            _ => None,
        };
        match found.filter(|number| number.is_finite()) {
            Some(number) => Ok(Some(number)),
            None => Err(fault(keyword, format!("{} is no number; correct or remove it", text_of(value)))),
        }
    }

    /// A number greater than zero; zero stands for unknown, as capture programs write it.
    fn positive(&self, keyword: &str) -> Result<Option<f64>, FrameProblem> {
        match self.number(keyword)? {
            Some(number) if number < 0.0 => Err(fault(keyword, format!("{number} is negative; correct or remove it"))),
            Some(0.0) => Ok(None),
            other => Ok(other),
        }
    }

    /// Degrees, as a number or as degrees, minutes and seconds.
    fn degrees(&self, keyword: &str, limit: f64) -> Result<Option<f64>, FrameProblem> {
        let Some(value) = self.value(keyword) else {
            return Ok(None);
        };
        let found = match value {
            Value::String(text) if text.trim().is_empty() => return Ok(None),
            Value::String(text) => sexagesimal(text),
            _ => self.number(keyword)?,
        };
        match found.filter(|degrees| degrees.abs() <= limit) {
            Some(degrees) => Ok(Some(degrees)),
            None => Err(fault(keyword, format!("{} is no angle from -{limit}° to {limit}°; correct or remove it", text_of(value)))),
        }
    }

    /// What the header knows beyond the image.
    pub(super) fn metadata(&self) -> Result<FitsMetadata, FrameProblem> {
        let mut metadata = FitsMetadata { exposure_s: self.positive("EXPTIME")?, ..FitsMetadata::default() };
        if metadata.exposure_s.is_none() {
            metadata.exposure_s = self.positive("EXPOSURE")?;
        }
        metadata.time_utc = self.date_obs(&mut metadata.notes)?.map(|start| match metadata.exposure_s {
            Some(exposure_s) => start + Duration::from_seconds(exposure_s / 2.0),
            None => start,
        });
        metadata.temperature_c = self.number("CCD-TEMP")?;
        metadata.latitude_deg = self.degrees("SITELAT", 90.0)?;
        metadata.longitude_deg = self.degrees("SITELONG", 360.0)?.map(|east| if east > 180.0 { east - 360.0 } else { east });
        metadata.height_m = self.number("SITEELEV")?;
        metadata.focal_length_mm = self.positive("FOCALLEN")?;
        metadata.pixel_pitch_um = match (self.positive("XPIXSZ")?, self.positive("YPIXSZ")?) {
            (Some(x), Some(y)) => Some([x, y]),
            (Some(one), None) | (None, Some(one)) => Some([one, one]),
            (None, None) => None,
        };
        metadata.gain_e_per_dn = self.positive("EGAIN")?;
        if let Some(gain) = self.number("GAIN")? {
            // Observatories write electrons per count here, capture programs the number on the camera's dial.
            let comment = self.cards.iter().find(|card| card.keyword_str() == "GAIN").and_then(|card| card.comment.as_deref());
            let comment = comment.unwrap_or("").to_lowercase();
            let electrons =
                comment.contains("e-/") || comment.contains("electron") || comment.contains("e/adu") || comment.contains("e/dn");
            if electrons && gain > 0.0 {
                metadata.gain_e_per_dn = metadata.gain_e_per_dn.or(Some(gain));
            } else {
                metadata.gain_setting = Some(gain);
            }
        }
        Ok(metadata)
    }

    /// `DATE-OBS`, with the old `TIME-OBS`, in the scale of `TIMESYS`.
    fn date_obs(&self, notes: &mut Vec<String>) -> Result<Option<Epoch>, FrameProblem> {
        let Some(date) = self.text("DATE-OBS") else {
            return Ok(None);
        };
        let scale = match self.text("TIMESYS").unwrap_or("UTC").to_uppercase().as_str() {
            "UTC" | "UT" | "UTC(NIST)" | "UTC(USNO)" => TimeScale::UTC,
            "TAI" | "IAT" => TimeScale::TAI,
            "TT" | "TDT" => TimeScale::TT,
            "TDB" => TimeScale::TDB,
            "GPS" => TimeScale::GPST,
            other => return Err(fault("TIMESYS", format!("{other:?} is not known; known are UTC, TAI, TT, TDB and GPS"))),
        };
        let text = match (date.contains(['T', ' ']), self.text("TIME-OBS")) {
            (true, _) => date.to_owned(),
            (false, Some(clock)) => format!("{date}T{clock}"),
            (false, None) => {
                notes.push(format!("DATE-OBS {date:?} has no time of day and is not used"));
                return Ok(None);
            }
        };
        time::parse_in(&text, scale).map(Some).map_err(|problem| fault("DATE-OBS", problem))
    }
}

/// Which planes of an array are read.
enum Wanted {
    One(usize),
    Colours,
}

/// Reads the pixels; those that are undefined (NaN or BLANK) are NaN.
pub(super) fn decode(bytes: &[u8], plane: Option<Plane>) -> Result<Samples, FrameProblem> {
    let header = FitsHeader::parse(bytes)?.ok_or_else(|| FrameProblem::Fits("it holds no image".to_owned()))?;
    check_size(header.size)?;
    header.check_length(bytes.len() as u64)?;
    let wanted = header.wanted(plane)?;
    let (saturation_dn, bottom_up, size) = (header.top_of_range(), header.bottom_up, header.size);
    let planes = header.planes;
    if size.width_px * size.height_px * planes > 3 * MAXIMUM_PIXELS {
        return Err(FrameProblem::TooLarge { size, maximum_px: 3 * MAXIMUM_PIXELS / planes });
    }
    let values = guarded(|| header.values(bytes, &wanted)).map_err(|panicked| FrameProblem::Fits(panicked.to_string()))??;
    let pixels = size.width_px * size.height_px;
    let mut pixels_dn: Vec<f32> = match wanted {
        Wanted::One(_) => values,
        Wanted::Colours => (0..pixels).map(|pixel| luminance([0, 1, 2].map(|plane| f64::from(values[plane * pixels + pixel])))).collect(),
    };
    if bottom_up {
        pixels_dn = pixels_dn.chunks_exact(size.width_px).rev().flatten().copied().collect();
    }
    Ok(Samples { size, pixels_dn, saturation_dn })
}

impl FitsHeader {
    /// The planes that are wanted, one behind the other.
    fn values(self, bytes: &[u8], wanted: &Wanted) -> Result<Vec<f32>, FrameProblem> {
        let pixels = self.size.width_px * self.size.height_px;
        let (first, count) = match wanted {
            Wanted::One(index) => (*index, 1),
            Wanted::Colours => (0, 3),
        };
        let damaged = |_| FrameProblem::Fits("its packed pixels are damaged; copy the file again".to_owned());
        if let Some(tiling) = &self.tiling {
            tiling.check(&self.cards, bytes.get(self.data_start..self.end() as usize).unwrap_or(&[]))?;
            let hdu = Hdu::from_cards(self.cards, 0, self.data_start).map_err(damaged)?;
            let mut all = vec![0.0_f32; pixels * self.planes];
            read_image_physical_into_f32(bytes, &hdu, &mut all).map_err(damaged)?;
            return Ok(all[first * pixels..(first + count) * pixels].to_vec());
        }
        let plane_bytes = pixels * (self.bitpix.unsigned_abs() / 8) as usize;
        let info = HduInfo::Primary { bitpix: self.bitpix, naxes: vec![self.size.width_px, self.size.height_px, count] };
        let data_start = self.data_start + first * plane_bytes;
        let hdu = Hdu { info, header_start: 0, data_start, data_len: count * plane_bytes, cards: self.cards };
        let mut values = vec![0.0_f32; pixels * count];
        read_image_physical_into_f32(bytes, &hdu, &mut values).map_err(damaged)?;
        Ok(values)
    }
}

/// The mandatory keywords of a unit.
struct Shape {
    bitpix: i64,
    axes: Vec<u64>,
    /// Bytes beside the main array (the heap of a table), and the number of groups.
    parameters: u64,
    groups: u64,
    /// `None` for the primary unit.
    extension: Option<String>,
    compressed: bool,
}

impl Shape {
    fn read(cards: &[Card], primary: bool) -> Result<Self, FrameProblem> {
        let whole = |keyword: &str, high: i64| match value(cards, keyword) {
            Some(Value::Integer(number)) if (0..=high).contains(number) => Ok(*number as u64),
            Some(other) => Err(fault(keyword, format!("{} is not a whole number from 0 to {high}", text_of(other)))),
            None => Err(fault(keyword, "is missing, the file is damaged".to_owned())),
        };
        let optional = |keyword: &str, absent: u64| if value(cards, keyword).is_some() { whole(keyword, i64::MAX) } else { Ok(absent) };
        let bitpix = match value(cards, "BITPIX") {
            Some(Value::Integer(bits @ (8 | 16 | 32 | 64 | -32 | -64))) => *bits,
            Some(other) => return Err(fault("BITPIX", format!("{} is none of 8, 16, 32, 64, -32, -64", text_of(other)))),
            None => return Err(fault("BITPIX", "is missing, the file is damaged".to_owned())),
        };
        let count = whole("NAXIS", 999)?;
        let axes = (1..=count).map(|axis| whole(&format!("NAXIS{axis}"), i64::MAX)).collect::<Result<_, _>>()?;
        let extension = match value(cards, "XTENSION") {
            Some(Value::String(name)) if !primary => Some(name.trim().to_owned()),
            _ if primary => None,
            _ => return Err(fault("XTENSION", "is missing, the file is damaged".to_owned())),
        };
        let (parameters, groups) = if primary { (0, 1) } else { (optional("PCOUNT", 0)?, optional("GCOUNT", 1)?.max(1)) };
        let compressed = matches!(value(cards, "ZIMAGE"), Some(Value::Logical(true)));
        Ok(Self { bitpix, axes, parameters, groups, extension, compressed })
    }

    /// Bytes of the data.
    fn data_bytes(&self) -> Result<u64, FrameProblem> {
        if self.axes.is_empty() {
            return Ok(0);
        }
        let mut values: u64 = 1;
        for axis in &self.axes {
            values = values.checked_mul(*axis).ok_or_else(too_long)?;
        }
        let bytes = values.checked_add(self.parameters).and_then(|all| all.checked_mul(self.groups));
        bytes.and_then(|all| all.checked_mul(self.bitpix.unsigned_abs() / 8)).filter(|&all| all < 1 << 48).ok_or_else(too_long)
    }

    /// The header, if the unit is an image: `None` if it holds no pixels or a table.
    fn image(&self, cards: Vec<Card>, data_start: usize) -> Result<Option<FitsHeader>, FrameProblem> {
        let tiling = if self.compressed { Some(Tiling::read(&cards)?) } else { None };
        let is_table = self.extension.as_deref().is_some_and(|name| name != "IMAGE");
        if tiling.is_some() && self.extension.as_deref() != Some("BINTABLE") {
            return Err(fault("ZIMAGE", "stands in a header that is not that of a table, the file is damaged".to_owned()));
        }
        if tiling.is_none() && (self.axes.is_empty() || is_table) {
            return Ok(None);
        }
        if self.extension.is_none() && self.axes[0] == 0 && matches!(value(&cards, "GROUPS"), Some(Value::Logical(true))) {
            return Err(FrameProblem::Fits("it holds random groups (interferometer data), not an image".to_owned()));
        }
        let (bitpix, axes) = tiling.as_ref().map_or((self.bitpix, &self.axes), |tiling| (tiling.bitpix, &tiling.axes));
        let axis = |at: usize| axes.get(at).copied().unwrap_or(1);
        let size = |length: u64| usize::try_from(length).unwrap_or(usize::MAX);
        let size = FrameSize { width_px: size(axis(0)), height_px: size(axis(1)) };
        check_size(size)?;
        let planes = axes.iter().skip(2).try_fold(1_u64, |all, length| all.checked_mul(*length)).ok_or_else(too_long)?;
        let planes = usize::try_from(planes).map_err(|_| too_long())?;
        let row_order = match value(&cards, "ROWORDER") {
            Some(Value::String(order)) => order.trim().to_uppercase(),
            _ => String::new(),
        };
        let bottom_up = match row_order.as_str() {
            "" | "TOP-DOWN" => false,
            "BOTTOM-UP" => true,
            other => return Err(fault("ROWORDER", format!("{other:?} is neither TOP-DOWN nor BOTTOM-UP; correct or remove it"))),
        };
        let data_bytes = self.data_bytes()?;
        Ok(Some(FitsHeader { size, bitpix, planes, data_start, data_bytes, tiling, cards, bottom_up }))
    }
}

/// A value as it stands in the header.
pub(super) fn text_of(value: &Value) -> String {
    match value {
        Value::Integer(number) => number.to_string(),
        Value::Float(number) => number.to_string(),
        Value::String(text) => format!("{text:?}"),
        Value::Logical(is) => if *is { "T" } else { "F" }.to_owned(),
        _ => "it".to_owned(),
    }
}

/// The first card of that name that has a value.
pub(super) fn value<'c>(cards: &'c [Card], keyword: &str) -> Option<&'c Value> {
    cards.iter().find(|card| card.keyword_str() == keyword).and_then(|card| card.value.as_ref())
}

/// Bytes of the header up to the end of the block with its END card.
fn header_length(bytes: &[u8]) -> Option<usize> {
    let end = bytes.chunks_exact(80).position(|card| card.starts_with(b"END     "))?;
    Some((end * 80 / BLOCK_SIZE + 1) * BLOCK_SIZE)
}

/// `+52 13 12.5`, `52:13:12.5` or `52d13m12.5s` in degrees.
fn sexagesimal(text: &str) -> Option<f64> {
    let text = text.trim();
    if let Ok(number) = text.parse::<f64>() {
        return Some(number).filter(|number| number.is_finite());
    }
    let (sign, text) = match text.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, text.strip_prefix('+').unwrap_or(text)),
    };
    let mut degrees = 0.0;
    let mut unit = 1.0;
    let separators = [' ', ':', 'd', 'm', 's', '°', '\'', '"', '*'];
    let parts: Vec<&str> = text.split(separators).filter(|part| !part.is_empty()).collect();
    if parts.is_empty() || parts.len() > 3 {
        return None;
    }
    for (at, part) in parts.iter().enumerate() {
        let number: f64 = part.parse().ok()?;
        if !number.is_finite() || number.is_sign_negative() || (at > 0 && number >= 60.0) {
            return None;
        }
        degrees += number * unit;
        unit /= 60.0;
    }
    Some(sign * degrees)
}

pub(super) fn fault(keyword: &str, problem: String) -> FrameProblem {
    FrameProblem::FitsKeyword { keyword: keyword.to_owned(), problem }
}

fn too_long() -> FrameProblem {
    FrameProblem::Fits("its header claims more data than any file can hold; the file is damaged".to_owned())
}
