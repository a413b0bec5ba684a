//! boresight

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
