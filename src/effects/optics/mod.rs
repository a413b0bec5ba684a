//! In the optics: from the camera's ray to light on the pixels.

pub mod brown_conrady;
pub mod coma;
pub mod equidistant;
pub mod equisolid;
mod field_angle;
pub mod field_stop;
pub mod focal_length_drift;
pub mod gaussian_psf;
pub mod kannala_brandt;
pub mod lateral_colour;
pub mod pinhole;
pub mod pressure_scale;
pub mod projection;
pub mod quadratic_rest;
pub mod radial_high_order;
pub mod spiral;
pub mod stereographic;
pub mod thermal_distortion;
pub mod thermal_focal_length;
pub mod thin_prism;
pub mod veiling_glare;
pub mod vignetting;
pub mod wedge_colour;
