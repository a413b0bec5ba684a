//! The integration tests, one binary.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "tests report what they ran")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test that meets the unexpected must fail")]
mod binning;
mod blind;
mod calibrate;
mod calibrate_cli;
mod camera;
mod catalog;
mod centroids;
mod cli;
mod clutter;
mod common;
mod detect;
mod detector;
mod diagnose;
mod diagnose_cli;
mod displacements;
mod examples;
mod exchange;
mod house;
mod identify;
mod identify_files;
mod joining;
mod layering;
#[cfg(unix)]
mod manners;
mod moments;
mod motion;
mod nature;
mod noise;
mod orbit;
mod pairs;
mod recording;
mod rendered_columns;
mod scene;
mod signatures;
mod sky_light;
mod spreads;
mod stages;
mod star_images;
mod summary;
mod told;
mod trails;
mod truth;
mod twins;
mod wide_angle;
mod world;
