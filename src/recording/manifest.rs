//! Manifest of a recording, `recording.toml`: every key is known, every fault is stated with its line.

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, UnitQuaternion};

use super::error::{ManifestKey, RecordingError};
use super::image_file::{MAXIMUM_PIXELS, MINIMUM_PX};
use super::toml_table::{Document, Table};
use super::{CameraInfo, FirstRow, FrameEntry, Mount, Shutter, Site, time};
use crate::coordinates::Attitude;

/// The format that is read and written.
pub const FORMAT: &str = "star-recording/1";
/// The manifest's name in its folder.
pub(super) const FILE_NAME: &str = "recording.toml";

/// No camera in the solar system moves faster against its barycentre.
const FASTEST_KM_S: f64 = 1000.0;
pub(super) const TOP_KEYS: &[&str] = &["format", "stars", "camera", "mount", "site", "frames"];
pub(super) const CAMERA_KEYS: &[&str] = &[
    "width_px",
    "height_px",
    "pixel_pitch_um",
    "focal_length_mm",
    "focal_length_px",
    "principal_point_px",
    "k1",
    "p1",
    "p2",
    "gain_e_per_dn",
    "bias_dn",
    "read_noise_e",
    "saturation_dn",
    "zero_point_e_per_s",
    "shutter",
    "line_time_us",
    "first_row",
    "passband",
];
pub(super) const MOUNT_KEYS: &[&str] = &["kind"];
pub(super) const SITE_KEYS: &[&str] = &["latitude_deg", "longitude_deg", "height_m", "pressure_hpa", "temperature_c", "relative_humidity"];
pub(super) const FRAME_KEYS: &[&str] = &[
    "file",
    "time_utc",
    "exposure_s",
    "temperature_c",
    "velocity_km_s",
    "rate_deg_s",
    "camera_from_icrs",
    "attitude_sigma_arcsec",
    "boresight_radec_deg",
    "altitude_azimuth_deg",
];
/// Which keys belong where, for keys that stand in the wrong table.
const TABLES: &[(&str, &[&str])] = &[
    ("the top of the file", TOP_KEYS),
    ("[camera]", CAMERA_KEYS),
    ("[mount]", MOUNT_KEYS),
    ("[site]", SITE_KEYS),
    ("[[frames]]", FRAME_KEYS),
];
/// A frame's number whose name is within so many edits of a known key is taken for a typing error.
const TYPING_ERROR_EDITS: usize = 2;
/// The largest number of columns or rows.
const MAXIMUM_SIDE_PX: usize = 1 << 20;
/// A quaternion's length may be off one by so much (digits cut off in telemetry).
const QUATERNION_LENGTH_TOLERANCE: f64 = 0.01;

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
    let mut top = document.parse(TOP_KEYS)?;
    match top.text("format")? {
        Some(format) if format == FORMAT => {}
        Some(format) => {
            return Err(top.fault("format", format!("format {format:?} is not known; this program reads {FORMAT:?}")));
        }
        None => return Err(top.fault("format", format!("\"format\" is missing; write format = {FORMAT:?} on the first line"))),
    }
    let stars_place = top.place("stars");
    let stars = top.text("stars")?.map(|stars| (PathBuf::from(stars), stars_place));
    let Some(mut camera_table) = top.table("camera", CAMERA_KEYS)? else {
        return Err(top.fault("camera", "[camera] is missing; write at least its width_px and height_px".to_owned()));
    };
    let width_line = camera_table.place("width_px").line;
    let camera = camera(&mut camera_table)?;
    camera_table.finish(TABLES)?;
    let mount = match top.table("mount", MOUNT_KEYS)? {
        Some(mut table) => {
            let kind = table.choice("kind", &[("free", Mount::Free), ("fixed", Mount::Fixed)])?;
            table.finish(TABLES)?;
            kind
        }
        None => None,
    };
    let site = match top.table("site", SITE_KEYS)? {
        Some(table) => Some(site(table)?),
        None => None,
    };
    let tables = top.tables("frames", FRAME_KEYS)?;
    top.finish(TABLES)?;
    let mut frames = Vec::with_capacity(tables.len());
    for (number, table) in tables.into_iter().enumerate() {
        frames.push(frame(table, number, stars.is_some()));
    }
    Ok(Manifest { path: path.to_owned(), camera, width_line, mount, site, stars, frames })
}

fn camera(table: &mut Table<'_>) -> Result<CameraInfo, RecordingError> {
    let mut side = |key| {
        table
            .count(key, 1, MAXIMUM_SIDE_PX)?
            .ok_or_else(|| table.fault("", format!("{key:?} is missing in [camera]; write the frames' size in pixels")))
    };
    let (width_px, height_px) = (side("width_px")?, side("height_px")?);
    if width_px < MINIMUM_PX || height_px < MINIMUM_PX || width_px * height_px > MAXIMUM_PIXELS {
        let problem = format!(
            "[camera] is {width_px} × {height_px} px; a frame has at least {MINIMUM_PX} × {MINIMUM_PX} and at most {MAXIMUM_PIXELS} pixels"
        );
        return Err(table.fault("", problem));
    }
    let two = "two numbers [x, y]";
    Ok(CameraInfo {
        width_px,
        height_px,
        pixel_pitch_um: table.numbers("pixel_pitch_um", "two numbers greater than 0, [x, y]", |pitch| pitch.iter().all(|&um| um > 0.0))?,
        focal_length_mm: table.positive("focal_length_mm")?,
        focal_length_px: table.positive("focal_length_px")?,
        principal_point_px: table.numbers("principal_point_px", two, |_| true)?,
        k1: table.number("k1")?,
        p1: table.number("p1")?,
        p2: table.number("p2")?,
        gain_e_per_dn: table.positive("gain_e_per_dn")?,
        bias_dn: table.number("bias_dn")?,
        read_noise_e: table.not_negative("read_noise_e")?,
        saturation_dn: table.positive("saturation_dn")?,
        zero_point_e_per_s: table.positive("zero_point_e_per_s")?,
        shutter: table.choice("shutter", &[("global", Shutter::Global), ("rolling", Shutter::Rolling)])?,
        line_time_us: table.positive("line_time_us")?,
        first_row: table.choice("first_row", &[("top", FirstRow::Top), ("bottom", FirstRow::Bottom)])?,
        passband: table.text("passband")?,
    })
}

fn site(mut table: Table<'_>) -> Result<Site, RecordingError> {
    let missing = |table: &Table<'_>, key: &str| table.fault("", format!("{key:?} is missing in [site]; write it or leave [site] out"));
    let latitude_deg = table.number_within("latitude_deg", -90.0, 90.0)?.ok_or_else(|| missing(&table, "latitude_deg"))?;
    let longitude_deg = table.number_within("longitude_deg", -180.0, 360.0)?.ok_or_else(|| missing(&table, "longitude_deg"))?;
    let site = Site {
        latitude_deg,
        longitude_deg,
        height_m: table.number_within("height_m", -1000.0, 100_000.0)?.unwrap_or(0.0),
        pressure_hpa: table.number_within("pressure_hpa", 0.0, 1200.0)?,
        temperature_c: table.number_within("temperature_c", -150.0, 100.0)?,
        relative_humidity: table.number_within("relative_humidity", 0.0, 1.0)?,
    };
    table.finish(TABLES)?;
    Ok(site)
}

fn frame(mut table: Table<'_>, number: usize, is_star_list: bool) -> ListedFrame {
    let (place, time_place) = (table.place("file"), table.place("time_utc"));
    let mut name = format!("frame {number}");
    let entry = file(&mut table, &place, is_star_list).and_then(|file| {
        if let Some(file) = &file {
            name.clone_from(file);
        }
        let mut entry = FrameEntry { file: file.map(PathBuf::from), number, place: Some(place), ..FrameEntry::default() };
        telemetry(&mut table, &mut entry, &time_place)?;
        Ok(entry)
    });
    ListedFrame { name, time_place, entry }
}

/// The frame's file; a star list has none.
fn file(table: &mut Table<'_>, place: &ManifestKey, is_star_list: bool) -> Result<Option<String>, RecordingError> {
    let file = table.text("file")?;
    let problem = match (file.as_deref(), is_star_list) {
        (None, false) => "\"file\" is missing in [[frames]]; name the frame's image",
        (Some(""), false) => "\"file\" is empty; name the frame's image",
        (Some(_), true) => "\"file\" and a star list (\"stars\" at the top) exclude each other; leave one of them out",
        _ => return Ok(file),
    };
    Err(at(place, problem.to_owned()))
}

fn at(place: &ManifestKey, problem: String) -> RecordingError {
    RecordingError::Manifest { path: place.path.clone(), line: place.line, key: place.key.to_owned(), problem }
}

fn telemetry(table: &mut Table<'_>, entry: &mut FrameEntry, time_place: &ManifestKey) -> Result<(), RecordingError> {
    let three = "three numbers [x, y, z]";
    if let Some(text) = table.time_text("time_utc")? {
        let time = time::parse_utc(&text).map_err(|problem| at(time_place, format!("\"time_utc\" {problem}")))?;
        entry.time_utc = Some(time);
    }
    entry.exposure_s = table.positive("exposure_s")?;
    entry.temperature_c = table.number_within("temperature_c", -273.15, 1000.0)?;
    entry.velocity_km_s =
        table.numbers("velocity_km_s", "three numbers [x, y, z] in km/s, together below 1000 km/s (is it m/s?)", |velocity| {
            velocity.iter().map(|v| v * v).sum::<f64>().sqrt() < FASTEST_KM_S
        })?;
    entry.rate_deg_s = table.numbers("rate_deg_s", three, |_| true)?;
    let what = "a quaternion of length 1, four numbers [x, y, z, scalar]";
    let quaternion: Option<[f64; 4]> = table.numbers("camera_from_icrs", what, |quaternion| {
        let length = quaternion.iter().map(|part| part * part).sum::<f64>().sqrt();
        (length - 1.0).abs() <= QUATERNION_LENGTH_TOLERANCE
    })?;
    entry.camera_from_icrs = quaternion.map(attitude);
    entry.attitude_sigma_arcsec = table.positive("attitude_sigma_arcsec")?;
    entry.boresight_radec_deg =
        table.numbers("boresight_radec_deg", "[right ascension, declination], from 0 to 360 and -90 to 90", |&[ra, dec]| {
            (-180.0..=360.0).contains(&ra) && (-90.0..=90.0).contains(&dec)
        })?;
    entry.altitude_azimuth_deg =
        table.numbers("altitude_azimuth_deg", "[altitude, azimuth], from -90 to 90 and -180 to 360", |&[altitude, azimuth]| {
            (-90.0..=90.0).contains(&altitude) && (-180.0..=360.0).contains(&azimuth)
        })?;
    for left in table.left() {
        let near = || FRAME_KEYS.iter().any(|known| strsim::levenshtein(&left.key, known) <= TYPING_ERROR_EDITS);
        match left.number {
            Some(number) if !near() => {
                entry.covariates.insert(left.key, number);
            }
            _ => return Err(table.unknown(&left.key, &[])),
        }
    }
    Ok(())
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
