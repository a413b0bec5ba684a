//! Star lists: the output of flight units in the place of images, one line a star image.

use std::collections::BTreeMap;
use std::path::Path;

use super::error::{FrameSize, RecordingError};
use crate::guard::{Panicked, guarded};
use crate::toml_file::suggestion;

pub(super) const COLUMNS: [&str; 11] =
    ["frame", "x_px", "y_px", "flux_e", "magnitude", "sigma_x_px", "sigma_y_px", "cov_xy_px2", "hip", "ra_deg", "dec_deg"];
/// Columns that must be there.
pub(super) const REQUIRED: [&str; 3] = ["frame", "x_px", "y_px"];

/// The centre of a star whose image is cut by the edge may be measured this much beyond it, px.
const BEYOND_PX: f64 = 1.0;
/// A correlation this near to ±1 leaves a covariance that cannot be inverted.
const SINGULAR_MARGIN: f64 = 1e-6;

/// A star image as a flight unit measured it.
#[derive(Clone, Debug, PartialEq)]
pub struct ListedStar {
    /// Column.
    pub x_px: f64,
    /// Row.
    pub y_px: f64,
    /// Electrons of the star.
    pub flux_e: Option<f64>,
    /// Magnitude as measured on board.
    pub magnitude: Option<f64>,
    /// Covariance of the position: xx, xy, yy.
    pub covariance_px2: Option<[f64; 3]>,
    /// Catalogue number, if the unit has identified the star.
    pub hip: Option<u32>,
    /// Right ascension and declination, if the unit has identified the star.
    pub radec_deg: Option<[f64; 2]>,
}

/// The stars of every frame as listed: the list for frame i of the recording stands at i.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StarList {
    /// Frame → its stars, in the order of the file.
    pub frames: Vec<Vec<ListedStar>>,
}

/// The stars by the frame's number in the manifest, and the first fault of each frame that has one.
pub(super) struct Listed {
    pub(super) stars: Vec<Vec<ListedStar>>,
    pub(super) faults: BTreeMap<usize, RecordingError>,
}

/// Reads a star list of `frame_count` frames of that size. What cannot be laid to one frame is an error at once.
pub(super) fn read(path: &Path, frame_count: usize, size: FrameSize) -> Result<Listed, RecordingError> {
    let damaged = |panicked: Panicked| RecordingError::StarList { path: path.to_owned(), line: 1, problem: panicked.to_string() };
    guarded(|| parse(path, frame_count, size)).map_err(damaged)?
}

fn parse(path: &Path, frame_count: usize, size: FrameSize) -> Result<Listed, RecordingError> {
    let bytes = std::fs::read(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => RecordingError::Missing { path: path.to_owned() },
        _ => RecordingError::Read { path: path.to_owned(), source },
    })?;
    let fault = |line: u64, problem: String| RecordingError::StarList { path: path.to_owned(), line: line as usize, problem };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(bytes.as_slice());
    let header = reader.headers().map_err(|error| csv_fault(&error, &fault))?.clone();
    let header_line = header.position().map_or(1, csv::Position::line);
    let mut columns: BTreeMap<&'static str, usize> = BTreeMap::new();
    for (at, name) in header.iter().enumerate() {
        let name = name.trim_start_matches('\u{feff}');
        let Some(known) = COLUMNS.iter().find(|known| **known == name) else {
            let hint = suggestion(name, &COLUMNS)
                .map_or_else(|| format!("known columns are {}", COLUMNS.join(", ")), |meant| format!("did you mean {meant:?}?"));
            return Err(fault(header_line, format!("unknown column {name:?}; {hint}")));
        };
        if columns.insert(known, at).is_some() {
            return Err(fault(header_line, format!("column {name:?} is there twice; remove one of them")));
        }
    }
    if let Some(missing) = REQUIRED.iter().find(|required| !columns.contains_key(**required)) {
        return Err(fault(header_line, format!("column {missing:?} is missing; a star list has at least {}", REQUIRED.join(", "))));
    }
    for (one, other) in [
        ("sigma_x_px", "sigma_y_px"),
        ("sigma_y_px", "sigma_x_px"),
        ("cov_xy_px2", "sigma_x_px"),
        ("ra_deg", "dec_deg"),
        ("dec_deg", "ra_deg"),
    ] {
        if columns.contains_key(one) && !columns.contains_key(other) {
            return Err(fault(header_line, format!("column {one:?} is of no use without {other:?}; add it or leave both out")));
        }
    }
    let mut listed = Listed { stars: vec![Vec::new(); frame_count], faults: BTreeMap::new() };
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).map_err(|error| csv_fault(&error, &fault))? {
        let line = record.position().map_or(0, csv::Position::line);
        let row = Row { record: &record, columns: &columns };
        let frame = row.text("frame").unwrap_or("");
        let frame: usize = frame.parse().map_err(|_| fault(line, format!("frame {frame:?} is no whole number from 0")))?;
        if frame >= frame_count {
            let problem = format!("there is no frame {frame}: the manifest lists {frame_count} frames, counted from 0");
            return Err(fault(line, problem));
        }
        match row.star(size) {
            Ok(star) => listed.stars[frame].push(star),
            Err(problem) => {
                listed.faults.entry(frame).or_insert_with(|| fault(line, problem));
            }
        }
    }
    Ok(listed)
}

fn csv_fault(error: &csv::Error, fault: &impl Fn(u64, String) -> RecordingError) -> RecordingError {
    let line = error.position().map_or(1, csv::Position::line);
    let problem = match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            format!("has {len} fields, but the header names {expected_len} columns; correct the line")
        }
        csv::ErrorKind::Utf8 { .. } => "is not UTF-8 text; save the star list as UTF-8".to_owned(),
        _ => format!("cannot be read as CSV: {error}"),
    };
    fault(line, problem)
}

/// A line of the list.
struct Row<'r> {
    record: &'r csv::StringRecord,
    columns: &'r BTreeMap<&'static str, usize>,
}

impl Row<'_> {
    /// The field, if it is there and not empty.
    fn text(&self, column: &str) -> Option<&str> {
        self.record.get(*self.columns.get(column)?).filter(|field| !field.is_empty())
    }

    fn number(&self, column: &str, what: &str, accept: impl Fn(f64) -> bool) -> Result<Option<f64>, String> {
        let Some(text) = self.text(column) else {
            return Ok(None);
        };
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite() && accept(*number));
        number.map(Some).ok_or_else(|| format!("{column} is {text:?}; it must be {what}"))
    }

    fn star(&self, size: FrameSize) -> Result<ListedStar, String> {
        let coordinate = |column: &str, length: usize| {
            let high = length as f64 - 0.5;
            let what =
                format!("on the frame, from -0.5 to {high}, or within {BEYOND_PX} px of it (pixel centres are whole numbers from 0)");
            let near = -0.5 - BEYOND_PX..=high + BEYOND_PX;
            self.number(column, &what, |number| near.contains(&number))?.ok_or_else(|| format!("{column} is missing"))
        };
        let (x_px, y_px) = (coordinate("x_px", size.width_px)?, coordinate("y_px", size.height_px)?);
        let sigma = |column: &str| self.number(column, "a number greater than 0", |number| number > 0.0);
        let covariance = self.number("cov_xy_px2", "a number", |_| true)?;
        let covariance_px2 = match (sigma("sigma_x_px")?, sigma("sigma_y_px")?) {
            (Some(x), Some(y)) => {
                let xy = covariance.unwrap_or(0.0);
                if xy.abs() >= (1.0 - SINGULAR_MARGIN) * x * y {
                    return Err(format!("cov_xy_px2 is {xy}; its size must be below sigma_x_px · sigma_y_px = {}", x * y));
                }
                Some([x * x, xy, y * y])
            }
            (None, None) if covariance.is_none() => None,
            _ => return Err("sigma_x_px, sigma_y_px and cov_xy_px2 are given in part; give both sigmas or none".to_owned()),
        };
        let hip = match self.text("hip") {
            None => None,
            Some(text) => {
                let number =
                    text.parse::<u32>().map_err(|_| format!("hip is {text:?}; it must be a whole number (empty or 0 if unknown)"))?;
                Some(number).filter(|&number| number > 0)
            }
        };
        let ra = self.number("ra_deg", "from -180 to 360", |ra| (-180.0..=360.0).contains(&ra))?;
        let dec = self.number("dec_deg", "from -90 to 90", |dec| (-90.0..=90.0).contains(&dec))?;
        if ra.is_some() != dec.is_some() {
            return Err("only one of ra_deg and dec_deg is given; give both or none".to_owned());
        }
        Ok(ListedStar {
            x_px,
            y_px,
            flux_e: self.number("flux_e", "a number", |_| true)?,
            magnitude: self.number("magnitude", "a number", |_| true)?,
            covariance_px2,
            hip,
            radec_deg: ra.zip(dec).map(|(ra, dec)| [ra, dec]),
        })
    }
}
