//! In the sky: between the star and the camera.

pub mod background;
pub mod chromatic_refraction;
pub mod frame_rotation;
pub mod light_deflection;
pub mod parallax;
pub mod proper_motion;
pub mod refraction;
pub mod stellar_aberration;
pub mod time_tag;
