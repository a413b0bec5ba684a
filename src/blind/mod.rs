//! Concealed recordings: made, sealed, diagnosed and scored.
//!
//! [`generate`] hides something (or nothing) in star lists that it makes from equations of its own. The truth goes into a folder of its own
//! and is sealed by hashes before anything is diagnosed; what is diagnosed never opens it. The scorer then breaks the seal and counts.

pub mod generate;
mod record;

pub use record::{control_points, recording, telemetry};
