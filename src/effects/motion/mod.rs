//! In the motion of the camera.

pub mod rolling_shutter;
