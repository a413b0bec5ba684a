//! Noise model, robust location and scale, weights, tests: one place for all of them.

pub(crate) mod cholesky;
pub mod crowding;
pub(crate) mod levenberg_marquardt;
pub mod robust;
pub mod significance;

pub use robust::{Clipped, clipped, mad_sigma, median, median_in_place};
