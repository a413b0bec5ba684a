//! In the optics: from the camera's ray to light on the pixels.

pub mod brown_conrady;
pub mod equidistant;
pub mod equisolid;
mod field_angle;
pub mod gaussian_psf;
pub mod kannala_brandt;
pub mod pinhole;
pub mod stereographic;
