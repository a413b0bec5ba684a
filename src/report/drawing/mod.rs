//! Draws: everything that knows the drawing library and the letters, and nothing else does. `undrawn.rs` stands in its place where the feature `plots` is off.

mod canvas;
mod colours;
mod contours;
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
mod vectors;

pub use frame_picture::frame_picture;
pub use letters::Lettered;
pub use panels::{LogPanels, Panel};
pub use remainder::remainder_map;
pub use vectors::{residual_vectors, residual_vectors_on_one_scale};
