//! The rows of a table as a Parquet file: everything that knows that crate, and nothing else does.
//!
//! Numbers that are missing are nulls in Parquet; a missing word is the empty one, as in CSV: astropy makes the word "None" of a null. It also wants
//! to know how long the words are, in letters, under `table::len::<column>` of the file's metadata (astropy 8.0, `io/misc/parquet.py`).

use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;
use serde_json::Value;

use super::ReportError;
use super::data_table::{Column, DataTable, Kind, ParquetTables};
use crate::dataset::{TableCells, TableColumn, TableFile, TableWriter};
use crate::recording::write_file;

impl DataTable {
    pub(super) fn write_parquet(&self, path: &Path, about: &[(&str, String)]) -> Result<(), ReportError> {
        let bytes = self.parquet(about).map_err(|error| ReportError::Draw { path: path.to_owned(), reason: error.to_string() })?;
        Ok(write_file(path, &bytes)?)
    }

    /// The table as a Parquet file.
    fn parquet(&self, about: &[(&str, String)]) -> Result<Vec<u8>, ParquetError> {
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
        let fields = fields.collect::<Result<Vec<_>, ParquetError>>()?;
        let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
        let lengths = self.columns.iter().filter(|column| column.kind == Kind::Text).map(|column| {
            let longest = column.cells.iter().filter_map(Value::as_str).map(|text| text.chars().count()).max();
            KeyValue::new(format!("table::len::{}", column.name), longest.unwrap_or_default().max(1).to_string())
        });
        let about = about.iter().map(|(key, text)| KeyValue::new((*key).to_owned(), text.clone())).chain(lengths).collect();
        let mut bytes = Vec::new();
        let mut file = SerializedFileWriter::new(&mut bytes, schema, properties(about))?;
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

impl Column {
    fn write(&self, writer: &mut SerializedColumnWriter<'_>) -> Result<(), ParquetError> {
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

fn properties(about: Vec<KeyValue>) -> Arc<WriterProperties> {
    let properties = WriterProperties::builder()
        .set_compression(Compression::UNCOMPRESSED)
        .set_created_by(format!("boresight {}", env!("CARGO_PKG_VERSION")))
        .set_key_value_metadata(Some(about));
    Arc::new(properties.build())
}

/// The field of a column. An image is what Hugging Face `datasets` knows as one: its bytes and its name.
fn field(column: &TableColumn) -> Result<Arc<Type>, ParquetError> {
    let primitive = |name: &str, kind: Physical, logical: Option<LogicalType>| {
        Type::primitive_type_builder(name, kind).with_repetition(Repetition::REQUIRED).with_logical_type(logical).build()
    };
    let text = |name: &str| primitive(name, Physical::BYTE_ARRAY, Some(LogicalType::String));
    let field = match &column.cells {
        TableCells::Whole(_) => primitive(&column.name, Physical::INT64, None),
        TableCells::Number(_) => primitive(&column.name, Physical::DOUBLE, None),
        TableCells::Flag(_) => primitive(&column.name, Physical::BOOLEAN, None),
        TableCells::Text(_) => text(&column.name),
        TableCells::Image(_) => {
            // What may be missing, as `datasets` has it: it takes no other field for an image.
            let part = |name: &str, logical| {
                let part = Type::primitive_type_builder(name, Physical::BYTE_ARRAY).with_repetition(Repetition::OPTIONAL);
                part.with_logical_type(logical).build().map(Arc::new)
            };
            let parts = vec![part("bytes", None)?, part("path", Some(LogicalType::String))?];
            Type::group_type_builder(&column.name).with_repetition(Repetition::OPTIONAL).with_fields(parts).build()
        }
    };
    Ok(Arc::new(field?))
}

/// What Hugging Face `datasets` reads a column as.
fn feature(column: &TableColumn) -> Value {
    match column.cells {
        TableCells::Whole(_) => serde_json::json!({"dtype": "int64", "_type": "Value"}),
        TableCells::Number(_) => serde_json::json!({"dtype": "float64", "_type": "Value"}),
        TableCells::Flag(_) => serde_json::json!({"dtype": "bool", "_type": "Value"}),
        TableCells::Text(_) => serde_json::json!({"dtype": "string", "_type": "Value"}),
        TableCells::Image(_) => serde_json::json!({"_type": "Image"}),
    }
}

impl TableWriter for ParquetTables {
    fn begin(&self, columns: &[TableColumn]) -> Option<Result<Box<dyn TableFile>, String>> {
        let begin = || -> Result<ParquetStream, ParquetError> {
            let fields = columns.iter().map(field).collect::<Result<Vec<_>, ParquetError>>()?;
            let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
            let features: serde_json::Map<String, Value> = columns.iter().map(|column| (column.name.clone(), feature(column))).collect();
            let about = serde_json::json!({"info": {"features": features}}).to_string();
            let about = vec![KeyValue::new("huggingface".to_owned(), about)];
            Ok(ParquetStream(SerializedFileWriter::new(Vec::new(), schema, properties(about))?))
        };
        Some(begin().map(|stream| Box::new(stream) as Box<dyn TableFile>).map_err(|error| error.to_string()))
    }
}

/// A Parquet file whose groups of rows come one after the other.
struct ParquetStream(SerializedFileWriter<Vec<u8>>);

impl ParquetStream {
    fn add_group(&mut self, columns: &[TableColumn]) -> Result<(), ParquetError> {
        let mut group = self.0.next_row_group()?;
        for column in columns {
            match &column.cells {
                TableCells::Whole(cells) => next(&mut group, |writer| writer.typed::<Int64Type>().write_batch(cells, None, None))?,
                TableCells::Number(cells) => next(&mut group, |writer| writer.typed::<DoubleType>().write_batch(cells, None, None))?,
                TableCells::Flag(cells) => next(&mut group, |writer| writer.typed::<BoolType>().write_batch(cells, None, None))?,
                TableCells::Text(cells) => {
                    let cells: Vec<ByteArray> = cells.iter().map(|cell| ByteArray::from(cell.as_str())).collect();
                    next(&mut group, |writer| writer.typed::<ByteArrayType>().write_batch(&cells, None, None))?;
                }
                TableCells::Image(cells) => {
                    // Image and part are there.
                    let levels = vec![2; cells.len()];
                    let bytes: Vec<ByteArray> = cells.iter().map(|(bytes, _)| ByteArray::from(bytes.clone())).collect();
                    next(&mut group, |writer| writer.typed::<ByteArrayType>().write_batch(&bytes, Some(&levels), None))?;
                    let names: Vec<ByteArray> = cells.iter().map(|(_, name)| ByteArray::from(name.as_str())).collect();
                    next(&mut group, |writer| writer.typed::<ByteArrayType>().write_batch(&names, Some(&levels), None))?;
                }
            }
        }
        group.close()?;
        Ok(())
    }
}

/// Writes the next column of a group.
fn next(
    group: &mut SerializedRowGroupWriter<'_, Vec<u8>>,
    write: impl FnOnce(&mut SerializedColumnWriter<'_>) -> Result<usize, ParquetError>,
) -> Result<(), ParquetError> {
    if let Some(mut writer) = group.next_column()? {
        write(&mut writer)?;
        writer.close()?;
    }
    Ok(())
}

impl TableFile for ParquetStream {
    fn add(&mut self, columns: &[TableColumn]) -> Result<(), String> {
        self.add_group(columns).map_err(|error| error.to_string())
    }

    fn finish(self: Box<Self>) -> Result<Vec<u8>, String> {
        self.0.into_inner().map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;

    use super::super::data_table::tests::{Row, rows};
    use super::*;

    #[test]
    fn both_files_hold_the_same_rows() {
        let table = DataTable::new(&rows(), &Row::default()).unwrap();
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
    fn a_table_without_rows_is_a_file() {
        assert!(DataTable::new(&[], &Row::default()).unwrap().parquet(&[]).is_ok());
    }
}
