//! Tables and pictures for people.

mod table;

pub use table::table;
