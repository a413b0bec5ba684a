//! Tables and pictures for people.
//!
//! Pictures are PNG files with the same letters on every machine; each appears whole or not at all.

mod canvas;
mod colours;
mod contours;
mod data_table;
mod ds9;
mod field_map;
mod frame_picture;
#[cfg(test)]
mod glyphs;
mod letters;
mod off_on;
mod panels;
mod plot;
mod profile;
mod ranking;
mod remainder;
mod table;
mod vectors;

pub use canvas::ReportError;
pub use data_table::DataTable;
pub use ds9::ds9_regions;
pub use field_map::FieldMap;
pub use frame_picture::{Figure, Mark, MarkKind, frame_picture};
pub use letters::Lettered;
pub use off_on::OffOn;
pub use panels::{LogPanels, Panel};
pub use plot::{Plot, Series, SeriesStyle};
pub use profile::{ProfilePlot, ProfilePoint};
pub use ranking::{Rank, RankKind, Ranking};
pub use remainder::remainder_map;
pub use table::table;
pub use vectors::{FitNumbers, Vector, VectorPanel, residual_vectors, residual_vectors_on_one_scale};
