//! Statistics used by several modules: robust location and scale, significance, crowding.

pub mod crowding;
pub mod robust;
pub mod significance;

pub use robust::{Clipped, clipped, mad_sigma, median, median_in_place};
