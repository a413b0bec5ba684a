//! In the optics: from the camera's ray to light on the pixels.

pub mod brown_conrady;
pub mod gaussian_psf;
pub mod pinhole;
