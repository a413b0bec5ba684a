//! Tables and pictures for people.
//!
//! Pictures are PNG files with the same letters on every machine; each appears whole or not at all.

mod data_table;
#[cfg(feature = "plots")]
mod drawing;
#[cfg(not(feature = "plots"))]
#[path = "undrawn.rs"]
mod drawing;
mod ds9;
mod error;
#[cfg(not(feature = "parquet"))]
mod no_parquet;
#[cfg(feature = "parquet")]
mod parquet_file;
mod shown;
mod table;

pub use data_table::{DataTable, ParquetTables};
pub use drawing::*;
pub use ds9::ds9_regions;
pub use error::ReportError;
pub use shown::{
    FieldMap, Figure, FitNumbers, Mark, MarkKind, OffOn, Plot, ProfilePlot, ProfilePoint, Rank, RankKind, Ranking, Series, SeriesStyle,
    Vector, VectorPanel,
};
pub use table::table;

/// Whether this build draws; where it does not, pictures are left out.
pub const DRAWS: bool = cfg!(feature = "plots");
