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
//! use boresight::imaging::Backend;
//! use boresight::render::Renderer;
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
//! `examples/{simulate,identify,calibrate,diagnose}.rs` do the same with files. Conventions (pixel origin, axes, rotations, units) are those of
//! CONVENTIONS.md in the repository, the rooms those of ARCHITECTURE.md.

pub mod blind;
pub mod calibrate;
pub mod camera;
pub mod catalog;
pub mod coordinates;
pub mod detect;
pub mod diagnose;
pub mod dual;
pub mod effects;
pub mod exchange;
pub mod formats;
pub mod frame;
pub mod gpu;
pub mod guard;
pub mod identify;
pub mod imaging;
pub mod pipeline;
pub mod provenance;
pub mod recording;
pub mod render;
pub mod report;
pub mod rng;
pub mod scene;
pub mod statistics;
pub mod units;

mod error;

pub use error::{Error, Result};
