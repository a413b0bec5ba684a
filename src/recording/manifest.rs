//! Manifest of a recording, `recording.toml`: every key is known, every fault is stated with its line.
//!
//! Serde reads the types of `schema`, of which each value is checked by a function of `values`. Frames are read one by one, so that a fault in one
//! is no fault of the others.

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, UnitQuaternion};
use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue, ValueDeserializer};

use super::error::{ManifestKey, RecordingError};
use super::image_file::{MAXIMUM_PIXELS, MINIMUM_PX};
use super::places::{Document, FRAME, Section, TOP, explain, known};
use super::schema::{RecordingFile, RecordingFrameTable, RecordingSiteTable};
use super::{CameraInfo, FrameEntry, Mount, Site, time};
use crate::coordinates::Attitude;
use crate::guard::guarded;

/// The format that is read and written.
pub const FORMAT: &str = "star-recording/1";
/// The manifest's name in its folder.
pub(super) const FILE_NAME: &str = "recording.toml";

/// A frame's number whose name is within so many edits of a known key is taken for a typing error.
const TYPING_ERROR_EDITS: usize = 2;

/// A manifest as read.
pub(super) struct Manifest {
    pub(super) path: PathBuf,
    pub(super) camera: CameraInfo,
    /// Line of `width_px`.
    pub(super) width_line: usize,
    pub(super) mount: Option<Mount>,
    pub(super) site: Option<Site>,
    /// The star list, and where it is named.
    pub(super) stars: Option<(PathBuf, ManifestKey)>,
    pub(super) frames: Vec<ListedFrame>,
}

/// A frame as a manifest lists it.
pub(super) struct ListedFrame {
    /// The name it goes by.
    pub(super) name: String,
    /// Where its time stands.
    pub(super) time_place: ManifestKey,
    /// The frame, or what is wrong with it.
    pub(super) entry: Result<FrameEntry, RecordingError>,
}

/// Reads a manifest. Faults outside `[[frames]]` are errors at once, a frame's fault stays with the frame.
pub(super) fn read(path: &Path) -> Result<Manifest, RecordingError> {
    let bytes = fs::read(path).map_err(|source| RecordingError::Read { path: path.to_owned(), source })?;
    let source = match std::str::from_utf8(&bytes) {
        Ok(text) => text.strip_prefix('\u{feff}').unwrap_or(text),
        Err(error) => {
            let line = 1 + bytes.iter().take(error.valid_up_to()).filter(|&&byte| byte == b'\n').count();
            let problem = "is not UTF-8 text; save the manifest as UTF-8".to_owned();
            return Err(RecordingError::Manifest { path: path.to_owned(), line, key: String::new(), problem });
        }
    };
    parse(path, source)
}

/// Reads the text of a manifest that lies, or will lie, at `path`.
pub(super) fn parse(path: &Path, source: &str) -> Result<Manifest, RecordingError> {
    let document = Document::new(path, source);
    guarded(|| manifest(path, &document)).map_err(|panicked| document.fault(0, "", format!("not valid TOML: {panicked}")))?
}

fn manifest(path: &Path, document: &Document<'_>) -> Result<Manifest, RecordingError> {
    let parsed = document.parse()?;
    let span = parsed.span();
    let mut table = parsed.into_inner();
    let mut sections = vec![Section::new(document, TOP, 0, &table)];
    check_format(&sections[0], &table)?;
    for (key, name) in [("camera", "[camera]"), ("mount", "[mount]"), ("site", "[site]")] {
        match table.get_key_value(key).map(|(place, value)| (place.span().start, value.get_ref())) {
            Some((start, DeValue::Table(inner))) => sections.push(Section::new(document, name, start, inner)),
            Some((_, other)) => {
                return Err(sections[0].fault(key, format!("{key:?} must be a table [{key}], but it is a {}", other.type_str())));
            }
            None => {}
        }
    }
    let tables = frame_tables(document, &mut table)?;
    let value = Spanned::new(span, DeValue::Table(table));
    let file = RecordingFile::deserialize(ValueDeserializer::from(value)).map_err(|error| explain(document, &sections, &error))?;
    let RecordingFile { format: _, stars, camera, mount, site, frames: _ } = file;
    // [camera] stands next to the top: it was read, so it is there
    let width_line = check_size(&sections[1], &camera)?.line;
    let stars = stars.map(|stars| (PathBuf::from(stars), sections[0].place("stars")));
    let frames = tables.into_iter().enumerate().map(|(number, table)| frame(document, table, number, stars.is_some())).collect();
    let mount = mount.and_then(|table| table.kind);
    Ok(Manifest { path: path.to_owned(), camera, width_line, mount, site: site.map(Site::from), stars, frames })
}

/// The format goes before all else: of a file of another, other keys are no faults.
fn check_format(top: &Section<'_, '_>, table: &DeTable<'_>) -> Result<(), RecordingError> {
    match table.get("format").map(|format| format.get_ref().as_str()) {
        None => Err(top.fault("format", format!("\"format\" is missing; write format = {FORMAT:?} on the first line"))),
        Some(Some(format)) if format != FORMAT => {
            Err(top.fault("format", format!("format {format:?} is not known; this program reads {FORMAT:?}")))
        }
        // what is no text is refused by serde
        Some(_) => Ok(()),
    }
}

/// The place of the width of a camera whose frames can be read.
fn check_size(section: &Section<'_, '_>, camera: &CameraInfo) -> Result<ManifestKey, RecordingError> {
    let (width_px, height_px) = (camera.width_px, camera.height_px);
    if width_px < MINIMUM_PX || height_px < MINIMUM_PX || width_px * height_px > MAXIMUM_PIXELS {
        let problem = format!(
            "[camera] is {width_px} × {height_px} px; a frame has at least {MINIMUM_PX} × {MINIMUM_PX} and at most {MAXIMUM_PIXELS} pixels"
        );
        return Err(section.fault("", problem));
    }
    Ok(section.place("width_px"))
}

impl From<RecordingSiteTable> for Site {
    fn from(table: RecordingSiteTable) -> Self {
        let RecordingSiteTable { latitude_deg, longitude_deg, height_m, pressure_hpa, temperature_c, relative_humidity } = table;
        Self { latitude_deg, longitude_deg, height_m, pressure_hpa, temperature_c, relative_humidity }
    }
}

/// Takes `[[frames]]` out of the file, table by table.
fn frame_tables<'s>(document: &Document<'s>, top: &mut DeTable<'s>) -> Result<Vec<Spanned<DeTable<'s>>>, RecordingError> {
    let Some((key, value)) = top.remove_entry("frames") else {
        return Ok(Vec::new());
    };
    let fault = |at: usize, kind: &str| {
        document.fault(at, "frames", format!("\"frames\" must be written as tables [[frames]] (double brackets), but it is a {kind}"))
    };
    let DeValue::Array(array) = value.into_inner() else {
        return Err(fault(key.span().start, "single table or value"));
    };
    let tables = array.into_iter().map(|item| {
        let span = item.span();
        match item.into_inner() {
            DeValue::Table(table) => Ok(Spanned::new(span, table)),
            other => Err(fault(span.start, &format!("list with a {}", other.type_str()))),
        }
    });
    tables.collect()
}

fn frame(document: &Document<'_>, table: Spanned<DeTable<'_>>, number: usize, is_star_list: bool) -> ListedFrame {
    let section = Section::new(document, FRAME, table.span().start, table.get_ref());
    let time_place = section.place("time_utc");
    let file = table.get_ref().get("file").and_then(|file| file.get_ref().as_str());
    let file = file.filter(|file| !file.is_empty() && !is_star_list);
    let name = file.map_or_else(|| format!("frame {number}"), str::to_owned);
    let entry = frame_entry(document, section, table, number, is_star_list);
    ListedFrame { name, time_place, entry }
}

fn frame_entry(
    document: &Document<'_>,
    section: Section<'_, '_>,
    table: Spanned<DeTable<'_>>,
    number: usize,
    is_star_list: bool,
) -> Result<FrameEntry, RecordingError> {
    if let Some((key, _)) = table.get_ref().iter().find(|(key, value)| !is_taken(key.get_ref(), value)) {
        return Err(section.unknown(key.get_ref()));
    }
    let value = Spanned::new(table.span(), DeValue::Table(table.into_inner()));
    let sections = [section];
    let read = RecordingFrameTable::deserialize(ValueDeserializer::from(value)).map_err(|error| explain(document, &sections, &error))?;
    let [section] = sections;
    let problem = match (read.file.as_deref(), is_star_list) {
        (None, false) => "\"file\" is missing in [[frames]]; name the frame's image",
        (Some(""), false) => "\"file\" is empty; name the frame's image",
        (Some(_), true) => "\"file\" and a star list (\"stars\" at the top) exclude each other; leave one of them out",
        _ => "",
    };
    if !problem.is_empty() {
        return Err(section.fault("file", problem.to_owned()));
    }
    let time_utc = read.time_utc.as_deref().map(time::parse_utc).transpose();
    Ok(FrameEntry {
        file: read.file.map(PathBuf::from),
        number,
        time_utc: time_utc.map_err(|problem| section.fault("time_utc", format!("\"time_utc\" {problem}")))?,
        exposure_s: read.exposure_s,
        temperature_c: read.temperature_c,
        velocity_km_s: read.velocity_km_s,
        rate_deg_s: read.rate_deg_s,
        camera_from_icrs: read.camera_from_icrs.map(attitude),
        attitude_sigma_arcsec: read.attitude_sigma_arcsec,
        boresight_radec_deg: read.boresight_radec_deg,
        altitude_azimuth_deg: read.altitude_azimuth_deg,
        covariates: read.telemetry,
        place: Some(section.place("file")),
        ..FrameEntry::default()
    })
}

/// Whether a key of a frame is known, or is telemetry: a number whose name is no known key with a typing error.
fn is_taken(key: &str, value: &Spanned<DeValue<'_>>) -> bool {
    let known = known(FRAME);
    let is_number = || f64::deserialize(ValueDeserializer::from(value.clone())).is_ok_and(f64::is_finite);
    let is_near = || known.iter().any(|known| strsim::levenshtein(key, known) <= TYPING_ERROR_EDITS);
    known.iter().any(|known| known == key) || (is_number() && !is_near())
}

/// From a quaternion, scalar last. Kept to the bit if its length is one within rounding, so that what is written is read back.
fn attitude([i, j, k, scalar]: [f64; 4]) -> Attitude {
    let quaternion = Quaternion::new(scalar, i, j, k);
    if (quaternion.norm() - 1.0).abs() <= 4.0 * f64::EPSILON {
        Attitude::new(UnitQuaternion::new_unchecked(quaternion))
    } else {
        Attitude::new(UnitQuaternion::from_quaternion(quaternion))
    }
}
