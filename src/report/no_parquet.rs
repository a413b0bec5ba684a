//! In the place of the Parquet file where the feature `parquet` is off: the CSV file beside it has the same rows.

use std::path::Path;

use super::{DataTable, ParquetTables, ReportError};
use crate::dataset::{TableColumn, TableFile, TableWriter};

impl DataTable {
    #[expect(clippy::unnecessary_wraps, clippy::unused_self, reason = "the twin of what writes the file")]
    pub(super) fn write_parquet(&self, path: &Path, _: &[(&str, String)]) -> Result<(), ReportError> {
        static SAID: std::sync::Once = std::sync::Once::new();
        SAID.call_once(|| {
            tracing::warn!(
                "this build writes no Parquet: it was compiled without the feature `parquet`; {} and all others are left out, \
                 the CSV files beside them have the same rows",
                path.display()
            );
        });
        Ok(())
    }
}

impl TableWriter for ParquetTables {
    fn begin(&self, _: &[TableColumn]) -> Option<Result<Box<dyn TableFile>, String>> {
        static SAID: std::sync::Once = std::sync::Once::new();
        SAID.call_once(|| {
            tracing::warn!(
                "this build writes no tables: it was compiled without the feature `parquet`; the labels in the archives say the same"
            );
        });
        None
    }
}
