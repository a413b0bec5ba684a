//! The integration tests, one binary.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "tests report what they ran")]
mod camera;
mod displacements;
