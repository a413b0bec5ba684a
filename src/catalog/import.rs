//! Catalogues from CSV tables with named columns.

use std::collections::BTreeMap;
use std::path::Path;

use sha2::{Digest, Sha256};

use super::{Catalog, CatalogError, Star, binary::hex};
use crate::coordinates::Direction;
use crate::units::{DEG_RAD, MAS_RAD};

/// Epoch of a table without a column of epochs.
const DEFAULT_EPOCH_YR: f64 = 2000.0;

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Column {
    Hip,
    Identifier,
    Ra,
    Dec,
    Magnitude,
    MotionEast,
    MotionNorth,
    Parallax,
    Colour,
    Epoch,
}

/// Every column: its usual header, others that are understood (those of the Gaia and Hipparcos tables among them), and the
/// range of its values with what to check where one lies outside.
struct ColumnSpec {
    column: Column,
    header: &'static str,
    aliases: &'static [&'static str],
    range: [f64; 2],
    check: &'static str,
}

const COLUMNS: [ColumnSpec; 10] = [
    ColumnSpec {
        column: Column::Hip,
        header: "hip",
        aliases: &["hip_id", "hipparcos"],
        range: [1.0, 4_294_967_295.0],
        check: "a whole number",
    },
    ColumnSpec { column: Column::Identifier, header: "id", aliases: &["source_id", "name", "designation"], range: [0.0, 0.0], check: "" },
    ColumnSpec { column: Column::Ra, header: "ra_deg", aliases: &["ra", "raj2000", "radeg"], range: [0.0, 360.0], check: "degrees" },
    ColumnSpec {
        column: Column::Dec,
        header: "dec_deg",
        aliases: &["dec", "de", "dej2000", "dedeg"],
        range: [-90.0, 90.0],
        check: "degrees",
    },
    ColumnSpec {
        column: Column::Magnitude,
        header: "magnitude",
        aliases: &["mag", "vmag", "v", "v_mag", "phot_g_mean_mag"],
        range: [-30.0, 40.0],
        check: "magnitudes",
    },
    ColumnSpec {
        column: Column::MotionEast,
        header: "pm_ra_mas_yr",
        aliases: &["pmra", "pm_ra", "pmra_mas_yr", "pmra_cosdec"],
        range: [-20_000.0, 20_000.0],
        check: "mas per year, times cos of the declination",
    },
    ColumnSpec {
        column: Column::MotionNorth,
        header: "pm_dec_mas_yr",
        aliases: &["pmdec", "pmde", "pm_dec", "pmdec_mas_yr"],
        range: [-20_000.0, 20_000.0],
        check: "mas per year",
    },
    ColumnSpec { column: Column::Parallax, header: "parallax_mas", aliases: &["parallax", "plx"], range: [-1000.0, 1000.0], check: "mas" },
    ColumnSpec {
        column: Column::Colour,
        header: "bv",
        aliases: &["b_v", "b-v", "colour", "color"],
        range: [-5.0, 20.0],
        check: "magnitudes",
    },
    ColumnSpec {
        column: Column::Epoch,
        header: "epoch_yr",
        aliases: &["epoch", "ref_epoch"],
        range: [1700.0, 2300.0],
        check: "Julian years",
    },
];

/// A table being read.
struct Table<'a> {
    path: &'a Path,
    headers: Vec<String>,
    columns: Vec<&'static ColumnSpec>,
}

impl Catalog {
    /// Reads a catalogue from a CSV table with a header. Lines that begin with `#` are skipped.
    ///
    /// | column | | unit |
    /// |---|---|---|
    /// | `ra_deg`, `dec_deg` | required | degrees, ICRS at the epoch |
    /// | `magnitude` | required | V, or the band nearest to it |
    /// | `pm_ra_mas_yr`, `pm_dec_mas_yr` | both or neither; a cell may be empty | mas/yr, the first times cos δ |
    /// | `parallax_mas` | optional; a cell may be empty | mas |
    /// | `bv` | optional; a cell may be empty | B − V |
    /// | `epoch_yr` | optional, the same in all rows; without it J2000.0 | Julian year |
    /// | `hip` | optional; without it the rows are numbered from 1 | |
    /// | `id` | optional, not used | |
    ///
    /// Gaia's and other usual headers (`ra`, `pmra`, `phot_g_mean_mag`, `ref_epoch`, …) are understood as well. An unknown
    /// column is refused, so that a mistyped one cannot be lost without a word.
    pub fn from_csv(path: &Path) -> Result<Self, CatalogError> {
        let bytes = std::fs::read(path).map_err(|reason| CatalogError::Read { path: path.to_owned(), reason })?;
        let text = std::str::from_utf8(&bytes).map_err(|error| {
            let line = bytes[..error.valid_up_to()].split(|&byte| byte == b'\n').count() as u64;
            let problem = "these bytes are not text in UTF-8; save the table as CSV in UTF-8".to_owned();
            CatalogError::Table { path: path.to_owned(), line, problem }
        })?;
        read_table(path, text.trim_start_matches('\u{feff}'), hex(&Sha256::digest(&bytes)))
    }
}

fn read_table(path: &Path, text: &str, sha256: String) -> Result<Catalog, CatalogError> {
    let mut reader = csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::All).comment(Some(b'#')).from_reader(text.as_bytes());
    let unreadable = |error: &csv::Error| {
        let line = error.position().map_or(1, csv::Position::line);
        CatalogError::Table { path: path.to_owned(), line, problem: format!("not a comma-separated table ({error})") }
    };
    let headers = reader.headers().map_err(|error| unreadable(&error))?.iter().map(str::to_owned).collect();
    let table = Table::new(path, headers)?;
    let mut stars = Vec::new();
    let mut epoch: Option<(f64, u64)> = None;
    let mut line_of_number = BTreeMap::new();
    for record in reader.records() {
        let record = record.map_err(|error| unreadable(&error))?;
        let line = record.position().map_or(0, |position| line_of_record(text, position));
        let row = Row { table: &table, record: &record, line };
        row.has_every_cell()?;
        let star = row.star(stars.len() as u32 + 1)?;
        if let Some(first_line) = line_of_number.insert(star.hip, line) {
            let problem = format!("stands in line {first_line} too; each star needs a number of its own");
            return Err(row.value_error(Column::Hip, problem));
        }
        stars.push(star);
        if let Some(epoch_yr) = row.epoch()? {
            match epoch {
                Some((first, first_line)) if first != epoch_yr => {
                    let problem = format!("differs from {first} in line {first_line}; bring all stars to one epoch");
                    return Err(row.value_error(Column::Epoch, problem));
                }
                Some(_) => {}
                None => epoch = Some((epoch_yr, line)),
            }
        }
    }
    if stars.is_empty() {
        return Err(CatalogError::Empty { path: path.to_owned() });
    }
    let epoch_yr = epoch.map_or(DEFAULT_EPOCH_YR, |(epoch_yr, _)| epoch_yr);
    let origin = if epoch.is_some() { "" } else { ", taken for granted: the table has no column epoch_yr" };
    let source = format!("{}, {} stars, epoch J{epoch_yr:?}{origin}", path.display(), stars.len());
    if epoch.is_none() {
        tracing::warn!("catalogue {source}");
    }
    let catalog = Catalog::new(stars, epoch_yr, source, sha256);
    Ok(if table.place(Column::Hip).is_some() { catalog.with_hipparcos_numbers() } else { catalog })
}

/// Line of the record that begins at or after `position`: the reader's positions lie before skipped lines.
fn line_of_record(text: &str, position: &csv::Position) -> u64 {
    let rest = text.get(position.byte() as usize..).unwrap_or_default();
    let skipped = rest.lines().take_while(|line| line.is_empty() || line.starts_with('#')).count();
    position.line() + skipped as u64
}

impl<'a> Table<'a> {
    fn new(path: &'a Path, headers: Vec<String>) -> Result<Self, CatalogError> {
        let mut columns: Vec<&'static ColumnSpec> = Vec::new();
        for (place, header) in headers.iter().enumerate() {
            let spec = spec_of(header).ok_or_else(|| unknown_column(path, header, headers.len()))?;
            if let Some(earlier) = columns.iter().position(|known| known.column == spec.column) {
                return Err(CatalogError::RepeatedColumn {
                    path: path.to_owned(),
                    first: headers[earlier].clone(),
                    second: headers[place].clone(),
                    meaning: spec.header,
                });
            }
            columns.push(spec);
        }
        let table = Self { path, headers, columns };
        for required in [Column::Ra, Column::Dec, Column::Magnitude] {
            table.require(required)?;
        }
        if table.place(Column::MotionEast).is_some() || table.place(Column::MotionNorth).is_some() {
            table.require(Column::MotionEast)?;
            table.require(Column::MotionNorth)?;
        }
        Ok(table)
    }

    fn place(&self, column: Column) -> Option<usize> {
        self.columns.iter().position(|spec| spec.column == column)
    }

    fn require(&self, column: Column) -> Result<(), CatalogError> {
        if self.place(column).is_some() {
            return Ok(());
        }
        let header = COLUMNS.iter().find(|spec| spec.column == column).map_or("", |spec| spec.header);
        Err(CatalogError::MissingColumn { path: self.path.to_owned(), column: header, found: self.headers.join(", ") })
    }
}

fn spec_of(header: &str) -> Option<&'static ColumnSpec> {
    let header = header.to_lowercase();
    COLUMNS.iter().find(|spec| spec.header == header || spec.aliases.contains(&header.as_str()))
}

fn unknown_column(path: &Path, header: &str, columns: usize) -> CatalogError {
    let lower = header.to_lowercase();
    let names = COLUMNS.iter().flat_map(|spec| std::iter::once(&spec.header).chain(spec.aliases));
    let nearest = names.map(|name| (strsim::jaro_winkler(name, &lower), *name)).max_by(|a, b| a.0.total_cmp(&b.0));
    let all = COLUMNS.map(|spec| spec.header).join(", ");
    let remedy = match nearest {
        _ if columns == 1 && header.contains([';', '\t', '|']) => "the table must be separated by commas".to_owned(),
        Some((likeness, name)) if likeness > 0.8 => format!("did you mean `{name}`? Otherwise remove the column"),
        _ => format!("known are {all}; remove the column"),
    };
    CatalogError::UnknownColumn { path: path.to_owned(), column: header.to_owned(), remedy }
}

/// A row being read.
struct Row<'a> {
    table: &'a Table<'a>,
    record: &'a csv::StringRecord,
    line: u64,
}

impl Row<'_> {
    fn has_every_cell(&self) -> Result<(), CatalogError> {
        let (found, expected) = (self.record.len(), self.table.headers.len());
        if found == expected {
            return Ok(());
        }
        let problem = format!("{found} cells where the header has {expected}; complete the row");
        Err(CatalogError::Table { path: self.table.path.to_owned(), line: self.line, problem })
    }

    fn cell(&self, column: Column) -> Option<&str> {
        self.record.get(self.table.place(column)?)
    }

    fn value_error(&self, column: Column, problem: String) -> CatalogError {
        CatalogError::Value {
            path: self.table.path.to_owned(),
            line: self.line,
            column: self.table.place(column).map_or(String::new(), |place| self.table.headers[place].clone()),
            value: self.cell(column).unwrap_or_default().to_owned(),
            problem,
        }
    }

    /// The number in a cell; `None` where the cell is empty or the column is not there.
    fn optional(&self, column: Column) -> Result<Option<f64>, CatalogError> {
        let Some((cell, place)) = self.cell(column).zip(self.table.place(column)) else { return Ok(None) };
        if cell.is_empty() {
            return Ok(None);
        }
        let ColumnSpec { range: [low, high], check, .. } = self.table.columns[place];
        match cell.parse::<f64>() {
            Ok(value) if (*low..=*high).contains(&value) => Ok(Some(value)),
            Ok(_) => Err(self.value_error(column, format!("is not in {low}…{high}; check the unit ({check})"))),
            Err(_) => Err(self.value_error(column, format!("is not a number; give it as a decimal number ({check})"))),
        }
    }

    fn required(&self, column: Column) -> Result<f64, CatalogError> {
        self.optional(column)?.ok_or_else(|| self.value_error(column, "is empty; give a value, or remove the row".to_owned()))
    }

    fn epoch(&self) -> Result<Option<f64>, CatalogError> {
        if self.table.place(Column::Epoch).is_none() { Ok(None) } else { self.required(Column::Epoch).map(Some) }
    }

    fn number(&self, row: u32) -> Result<u32, CatalogError> {
        let Some(cell) = self.cell(Column::Hip) else { return Ok(row) };
        match cell.parse::<u32>() {
            Ok(number) if number > 0 => Ok(number),
            _ => {
                let problem = "is not a Hipparcos number; give one in every row, or remove the column to number the rows".to_owned();
                Err(self.value_error(Column::Hip, problem))
            }
        }
    }

    fn star(&self, row: u32) -> Result<Star, CatalogError> {
        let east = self.optional(Column::MotionEast)?;
        let north = self.optional(Column::MotionNorth)?;
        if east.is_some() != north.is_some() {
            let empty = if east.is_none() { Column::MotionEast } else { Column::MotionNorth };
            let problem = "is empty where the other component is given; give both or neither".to_owned();
            return Err(self.value_error(empty, problem));
        }
        Ok(Star {
            hip: self.number(row)?,
            direction: Direction::from_radec_rad(self.required(Column::Ra)? * DEG_RAD, self.required(Column::Dec)? * DEG_RAD),
            proper_motion_rad_yr: east.zip(north).map(|(east, north)| [east * MAS_RAD, north * MAS_RAD]),
            parallax_rad: self.optional(Column::Parallax)?.unwrap_or(0.0).max(0.0) * MAS_RAD,
            magnitude: self.required(Column::Magnitude)?,
            colour: self.optional(Column::Colour)?,
        })
    }
}
