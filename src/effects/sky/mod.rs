//! In the sky: between the star and the camera.

pub mod airglow;
pub mod background;
pub mod chromatic_refraction;
pub mod frame_rotation;
pub mod glow;
pub mod light_deflection;
pub mod moonlight;
pub mod parallax;
pub mod proper_motion;
pub mod refraction;
pub mod starlight;
pub mod stellar_aberration;
pub mod time_tag;
pub mod twilight;
pub mod zodiacal_light;
