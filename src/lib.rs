//! boresight simulates a star camera, identifies and calibrates a real one from its images, and tells which physical effect explains the
//! difference between the two.
//!
//! ```text
//!   Catalog ──► Scene ──► Frame ──► Detections ──► ControlPoints ──► Calibration ──► Diagnosis
//!              render            detect         identify           calibrate        diagnose
//!                                      camera · effects · coordinates · statistics
//! ```
//!
//! Each arrow is a module that can be used alone:
//!
//! | from | by | to |
//! |---|---|---|
//! | [`catalog::Catalog`], [`scene::Scene`] | [`render::Renderer`] | [`render::Rendered`] |
//! | [`frame::Frame`] | [`detect::detect`] | [`detect::Detections`] |
//! | [`detect::Detections`] | [`identify::identify`] | [`identify::Identification`], [`identify::ControlPoints`] |
//! | [`identify::ControlPoints`] | [`calibrate::calibrate`] | [`calibrate::Calibration`] |
//! | [`identify::ControlPoints`] | [`diagnose::diagnose`] | [`diagnose::Diagnosis`] |
//! | files of a recording | [`pipeline::measure`], [`pipeline::identify_frames`], [`pipeline::control_points`] | [`pipeline::PreparedPoints`] |
//!
//! # Example
//!
//! A frame of the real sky is rendered, its stars are found, and the camera's attitude is recovered with no prior:
//!
//! ```
//! use boresight::catalog::Catalog;
//! use boresight::detect::{DetectOptions, detect};
//! use boresight::frame::Frame;
//! use boresight::identify::{Identification, IdentifyOptions, Index, identify};
//! use boresight::render::{Backend, Renderer};
//! use boresight::scene::Scene;
//!
//! let scene = Scene::parse(
//!     "orion.toml",
//!     r#"
//!     format = "boresight-scene/1"
//!     camera = { width_px = 512, height_px = 512, focal_length_px = 1200.0 }
//!     [[frames]]
//!     exposure_s = 1.0
//!     boresight_radec_deg = [83.8, -1.2]
//!     "#,
//! )?;
//! let catalog = Catalog::embedded();
//! let rendered = Renderer::new(&scene, catalog, Backend::Cpu)?.render(0)?;
//! let frame = Frame {
//!     width_px: 512,
//!     height_px: 512,
//!     pixels_dn: rendered.pixels_dn.iter().map(|count| f32::from(*count)).collect(),
//!     saturation_dn: 65_535.0,
//! };
//! let detections = detect(&frame, &DetectOptions::default())?;
//! let index = Index::new(catalog);
//! let Identification::Identified(solution) = identify(&detections, catalog, &index, &[], &IdentifyOptions::default()) else {
//!     panic!("no match")
//! };
//! let (right_ascension_rad, declination_rad) = solution.centre().radec_rad();
//! assert!((right_ascension_rad.to_degrees() - 83.8).abs() < 0.05 && (declination_rad.to_degrees() + 1.2).abs() < 0.05);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//!
//! | feature | brings | without it |
//! |---|---|---|
//! | `cli` | the program `boresight`, with what it needs of `bench` | the library alone |
//! | `gpu` | wgpu: frames rendered on a GPU | the CPU does the same; `Backend::Gpu` says that there is none |
//! | `plots` | pictures (PNG) of results | they are left out, with a warning |
//! | `parquet` | Parquet beside the CSV tables | CSV alone |
//! | `bench` | datasets, suites of tests, pages and the benchmark of concealed recordings, for the program; inner rooms become public for the project's own tests and studies | a small interface |
//!
//! All are on by default. A library that identifies and calibrates needs none of them: `boresight = { version = "0.1", default-features = false }`. What is
//! public with `bench` alone may change in any version.
//!
//! Results and errors may get more fields and variants, so those that only the library makes are `#[non_exhaustive]`; options and inputs are not, since they
//! are built as `Options { a, ..Options::default() }`.
//!
//! `examples/{simulate,identify,calibrate,diagnose}.rs` do the same with files. Conventions (pixel origin, axes, rotations, units) are those of
//! CONVENTIONS.md in the repository, the rooms those of ARCHITECTURE.md.

#![cfg_attr(
    not(feature = "bench"),
    allow(
        dead_code,
        unreachable_pub,
        unused_imports,
        rustdoc::private_intra_doc_links,
        reason = "the inner rooms and what only the program, the tests and the studies call are closed in this build; the build with them has these lints"
    )
)]

/// Re-exports what is no part of the interface: public for the project's own program, tests and studies (feature `bench`), inside the crate otherwise.
#[cfg(feature = "bench")]
macro_rules! inner {
    ($($path:tt)*) => {
        pub use $($path)*;
    };
}
#[cfg(not(feature = "bench"))]
macro_rules! inner {
    ($($path:tt)*) => {
        pub(crate) use $($path)*;
    };
}

pub mod calibrate;
pub mod camera;
pub mod catalog;
pub mod coordinates;
pub mod detect;
pub mod diagnose;
#[macro_use]
pub mod effects;
pub mod exchange;
pub mod frame;
pub mod identify;
pub mod pipeline;
pub mod provenance;
pub mod recording;
pub mod render;
pub mod scene;

// The inner rooms. Each is declared twice and not by a macro, in which rustfmt would not find the files.
#[cfg(feature = "bench")]
pub mod blind;
#[cfg(feature = "bench")]
pub mod dataset;
#[cfg(feature = "bench")]
pub mod dual;
#[cfg(feature = "bench")]
pub mod formats;
#[cfg(feature = "bench")]
pub mod gpu;
#[cfg(feature = "bench")]
pub mod guard;
#[cfg(feature = "bench")]
pub mod imaging;
#[cfg(feature = "bench")]
pub mod parallel;
#[cfg(feature = "bench")]
pub mod pixel_statistics;
#[cfg(feature = "bench")]
pub mod report;
#[cfg(feature = "bench")]
pub mod rng;
#[cfg(feature = "bench")]
pub mod statistics;
#[cfg(feature = "bench")]
pub mod suite;
#[cfg(feature = "bench")]
pub mod units;

#[cfg(not(feature = "bench"))]
mod dual;
#[cfg(not(feature = "bench"))]
mod gpu;
#[cfg(not(feature = "bench"))]
mod guard;
#[cfg(not(feature = "bench"))]
mod imaging;
#[cfg(not(feature = "bench"))]
mod parallel;
#[cfg(not(feature = "bench"))]
mod pixel_statistics;
#[cfg(not(feature = "bench"))]
mod rng;
#[cfg(not(feature = "bench"))]
mod statistics;
#[cfg(not(feature = "bench"))]
mod units;

mod error;
mod toml_file;

pub use error::{Error, Result};
