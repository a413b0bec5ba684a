//! In the motion of the camera.

pub mod boresight_drift;
pub mod rolling_shutter;
