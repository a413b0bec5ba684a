//! Statistics used by several modules: robust location and scale, significance, crowding, order.

pub(crate) mod cholesky;
pub mod crowding;
pub(crate) mod levenberg_marquardt;
pub mod order;
pub mod robust;
pub mod significance;
pub(crate) mod student_t;

pub(crate) use robust::median_and_mad_sigma;
pub use robust::{Clipped, clipped, mad_sigma, median, median_in_place};
