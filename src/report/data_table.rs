//! Tables for other programs: the same rows as CSV and as Parquet.
//!
//! A row is a struct whose fields are numbers, words or truth values, by the names that the columns have; fields that are missing now and then
//! are options. Both files come from the same numbers, so they cannot differ.

use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use super::ReportError;
use crate::recording::write_file;

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    Whole,
    Number,
    Text,
}

/// Writes the tables of a dataset as Parquet, if this build can.
#[derive(Clone, Copy, Debug, Default)]
pub struct ParquetTables;

/// A column.
#[derive(Clone, Debug)]
pub(super) struct Column {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// `Null` where the row has nothing.
    pub(super) cells: Vec<Value>,
}

/// Rows under named columns.
#[derive(Clone, Debug)]
pub struct DataTable {
    pub(super) columns: Vec<Column>,
}

impl DataTable {
    /// A table of rows that are structs of plain fields; `None` if a field is a list or a struct itself. A table without rows has the columns of `empty`.
    #[must_use]
    pub fn new<R: Serialize>(rows: &[R], empty: &R) -> Option<Self> {
        let fields = |row: &R| match serde_json::to_value(row) {
            Ok(Value::Object(fields)) => Some(fields),
            _ => None,
        };
        let mut columns: Vec<Column> = fields(empty)?
            .into_iter()
            .map(|(name, _)| Column { name, kind: Kind::Number, cells: Vec::with_capacity(rows.len()) })
            .collect();
        for row in rows {
            let mut fields = fields(row)?;
            for column in &mut columns {
                column.cells.push(fields.get_mut(&column.name).map_or(Value::Null, Value::take));
            }
        }
        for column in &mut columns {
            column.kind = kind(&column.cells)?;
        }
        Some(Self { columns })
    }

    /// Writes `path` with the endings `.csv` and `.parquet`, the latter if this build can. `about` stands in the Parquet file's metadata: names and texts.
    pub fn write(&self, path: &Path, about: &[(&str, String)]) -> Result<(), ReportError> {
        write_file(&path.with_extension("csv"), self.csv().as_bytes())?;
        self.write_parquet(&path.with_extension("parquet"), about)
    }

    fn rows(&self) -> usize {
        self.columns.first().map_or(0, |column| column.cells.len())
    }

    /// The table as CSV: a line of names, then one for each row; nothing between two commas where a row has nothing.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut lines = csv::Writer::from_writer(Vec::new());
        let mut line = |cells: Vec<String>| lines.write_record(cells).is_ok(); // writing to memory does not fail
        line(self.columns.iter().map(|column| column.name.clone()).collect());
        for row in 0..self.rows() {
            let cell = |column: &Column| match &column.cells[row] {
                Value::Null => String::new(),
                Value::String(text) => text.clone(),
                other => other.to_string(),
            };
            line(self.columns.iter().map(cell).collect());
        }
        lines.into_inner().map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default()
    }
}

/// The narrowest kind that holds all cells; `None` if one is a list or a struct.
fn kind(cells: &[Value]) -> Option<Kind> {
    let mut found: Option<Kind> = None;
    for cell in cells {
        let one = match cell {
            Value::Null => continue,
            Value::Bool(_) => Kind::Bool,
            Value::Number(number) if number.is_i64() => Kind::Whole,
            Value::Number(_) => Kind::Number,
            Value::String(_) => Kind::Text,
            Value::Array(_) | Value::Object(_) => return None,
        };
        found = match (found, one) {
            (None, one) => Some(one),
            (Some(known), one) if known == one => Some(one),
            (Some(Kind::Whole | Kind::Number), Kind::Whole | Kind::Number) => Some(Kind::Number),
            _ => return None,
        };
    }
    Some(found.unwrap_or(Kind::Number))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    #[derive(Serialize, Default)]
    pub(in crate::report) struct Row {
        name: Option<&'static str>,
        hip: u32,
        x_px: f64,
        edge: bool,
    }

    pub(in crate::report) fn rows() -> Vec<Row> {
        vec![Row { name: Some("Vega, α Lyr"), hip: 91_262, x_px: 12.25, edge: false }, Row { name: None, hip: 7, x_px: -0.1, edge: true }]
    }

    #[test]
    fn a_row_is_a_line_with_nothing_where_something_is_missing() {
        let table = DataTable::new(&rows(), &Row::default()).unwrap();
        assert_eq!(table.csv(), "name,hip,x_px,edge\n\"Vega, α Lyr\",91262,12.25,false\n,7,-0.1,true\n");
    }

    #[test]
    fn a_table_without_rows_has_its_columns_and_one_of_lists_is_none() {
        let table = DataTable::new(&[], &Row::default()).unwrap();
        assert_eq!(table.csv(), "name,hip,x_px,edge\n");
        assert!(DataTable::new(&[[1.0, 2.0]], &[0.0, 0.0]).is_none());
    }
}
