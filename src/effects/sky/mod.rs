//! In the sky: between the star and the camera.

pub mod background;
pub mod parallax;
pub mod proper_motion;
pub mod refraction;
pub mod stellar_aberration;
