//! Tables for other programs: the same rows as CSV and as Parquet.
//!
//! A row is a struct whose fields are numbers, words or truth values, by the names that the columns have; fields that are missing now and then
//! are options. Both files come from the same numbers, so they cannot differ.
//!
//! Numbers that are missing are nulls in Parquet; a missing word is the empty one, as in CSV: astropy makes the word "None" of a null. It also wants
//! to know how long the words are, in letters, under `table::len::<column>` of the file's metadata (astropy 8.0, `io/misc/parquet.py`).

use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;
use serde::Serialize;
use serde_json::Value;

use super::ReportError;
use crate::recording::write_file;

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Bool,
    Whole,
    Number,
    Text,
}

/// A column.
#[derive(Clone, Debug)]
struct Column {
    name: String,
    kind: Kind,
    /// `Null` where the row has nothing.
    cells: Vec<Value>,
}

/// Rows under named columns.
#[derive(Clone, Debug)]
pub struct DataTable {
    columns: Vec<Column>,
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

    /// Writes `path` with the endings `.csv` and `.parquet`. `about` stands in the Parquet file's metadata: names and texts.
    pub fn write(&self, path: &Path, about: &[(&str, String)]) -> Result<(), ReportError> {
        write_file(&path.with_extension("csv"), self.csv().as_bytes())?;
        let path = path.with_extension("parquet");
        let bytes = self.parquet(about).map_err(|error| ReportError::Draw { path: path.clone(), reason: error.to_string() })?;
        Ok(write_file(&path, &bytes)?)
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

    /// The table as a Parquet file.
    fn parquet(&self, about: &[(&str, String)]) -> Result<Vec<u8>, parquet::errors::ParquetError> {
        let fields = self.columns.iter().map(|column| {
            let repetition = if column.kind == Kind::Text { Repetition::REQUIRED } else { Repetition::OPTIONAL };
            let field = match column.kind {
                Kind::Bool => Type::primitive_type_builder(&column.name, Physical::BOOLEAN),
                Kind::Whole => Type::primitive_type_builder(&column.name, Physical::INT64),
                Kind::Number => Type::primitive_type_builder(&column.name, Physical::DOUBLE),
                Kind::Text => Type::primitive_type_builder(&column.name, Physical::BYTE_ARRAY).with_logical_type(Some(LogicalType::String)),
            };
            Ok(Arc::new(field.with_repetition(repetition).build()?))
        });
        let fields = fields.collect::<Result<Vec<_>, parquet::errors::ParquetError>>()?;
        let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
        let lengths = self.columns.iter().filter(|column| column.kind == Kind::Text).map(|column| {
            let longest = column.cells.iter().filter_map(Value::as_str).map(|text| text.chars().count()).max();
            KeyValue::new(format!("table::len::{}", column.name), longest.unwrap_or_default().max(1).to_string())
        });
        let about = about.iter().map(|(key, text)| KeyValue::new((*key).to_owned(), text.clone())).chain(lengths).collect();
        let properties = WriterProperties::builder()
            .set_compression(Compression::UNCOMPRESSED)
            .set_created_by(format!("boresight {}", env!("CARGO_PKG_VERSION")))
            .set_key_value_metadata(Some(about))
            .build();
        let mut bytes = Vec::new();
        let mut file = SerializedFileWriter::new(&mut bytes, schema, Arc::new(properties))?;
        let mut group = file.next_row_group()?;
        for column in &self.columns {
            if let Some(mut writer) = group.next_column()? {
                column.write(&mut writer)?;
                writer.close()?;
            }
        }
        group.close()?;
        file.close()?;
        Ok(bytes)
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

impl Column {
    fn write(&self, writer: &mut SerializedColumnWriter<'_>) -> Result<(), parquet::errors::ParquetError> {
        // A cell that is there has the definition level 1.
        let levels: Vec<i16> = self.cells.iter().map(|cell| i16::from(!cell.is_null())).collect();
        match self.kind {
            Kind::Bool => {
                let values: Vec<bool> = self.cells.iter().filter_map(Value::as_bool).collect();
                writer.typed::<BoolType>().write_batch(&values, Some(&levels), None)?;
            }
            Kind::Whole => {
                let values: Vec<i64> = self.cells.iter().filter_map(Value::as_i64).collect();
                writer.typed::<Int64Type>().write_batch(&values, Some(&levels), None)?;
            }
            Kind::Number => {
                let values: Vec<f64> = self.cells.iter().filter_map(Value::as_f64).collect();
                writer.typed::<DoubleType>().write_batch(&values, Some(&levels), None)?;
            }
            Kind::Text => {
                let values: Vec<ByteArray> = self.cells.iter().map(|cell| ByteArray::from(cell.as_str().unwrap_or_default())).collect();
                writer.typed::<ByteArrayType>().write_batch(&values, None, None)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;

    #[derive(Serialize, Default)]
    struct Row {
        name: Option<&'static str>,
        hip: u32,
        x_px: f64,
        edge: bool,
    }

    fn rows() -> Vec<Row> {
        vec![Row { name: Some("Vega, α Lyr"), hip: 91_262, x_px: 12.25, edge: false }, Row { name: None, hip: 7, x_px: -0.1, edge: true }]
    }

    #[test]
    fn both_files_hold_the_same_rows() {
        let table = DataTable::new(&rows(), &Row::default()).unwrap();
        assert_eq!(table.csv(), "name,hip,x_px,edge\n\"Vega, α Lyr\",91262,12.25,false\n,7,-0.1,true\n");
        let folder = tempfile::tempdir().unwrap();
        table.write(&folder.path().join("stars"), &[("seed", "5".to_owned())]).unwrap();
        assert_eq!(std::fs::read_to_string(folder.path().join("stars.csv")).unwrap(), table.csv());
        let file = SerializedFileReader::new(std::fs::File::open(folder.path().join("stars.parquet")).unwrap()).unwrap();
        let about = file.metadata().file_metadata().key_value_metadata().unwrap();
        assert!(about.iter().any(|one| one.key == "seed" && one.value.as_deref() == Some("5")));
        let read: Vec<_> = file.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert_eq!(read.len(), 2);
        assert_eq!(read[0].get_string(0).unwrap(), "Vega, α Lyr");
        assert_eq!(read[1].get_string(0).unwrap(), "", "astropy would make the word None of a null");
        assert!(about.iter().any(|one| one.key == "table::len::name" && one.value.as_deref() == Some("11")), "letters of the longest word");
        assert_eq!((read[1].get_long(1).unwrap(), read[0].get_double(2).unwrap(), read[1].get_bool(3).unwrap()), (7, 12.25, true));
    }

    #[test]
    fn a_table_without_rows_has_its_columns_and_one_of_lists_is_none() {
        let table = DataTable::new(&[], &Row::default()).unwrap();
        assert_eq!(table.csv(), "name,hip,x_px,edge\n");
        assert!(table.parquet(&[]).is_ok());
        assert!(DataTable::new(&[[1.0, 2.0]], &[0.0, 0.0]).is_none());
    }
}
