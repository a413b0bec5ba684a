//! In the detector: from light on a pixel to a count.

pub mod adc;
pub mod amplifier_step;
pub mod banding;
pub mod bayer;
pub mod blooming;
pub mod brighter_fatter;
pub mod charge_transfer_inefficiency;
pub mod crosstalk;
pub mod dark_current;
pub mod detector_tilt;
pub mod dnl;
pub mod edge_roll_off;
pub mod even_odd;
pub mod hot_pixels;
pub mod jpeg;
pub mod magnitude_equation;
pub mod nonlinearity;
pub mod overshoot;
pub mod photon_noise;
pub mod pixel_aspect;
pub mod prnu;
pub mod read_noise;
pub mod s_curve;
pub mod sensor_step;
pub mod shear;
pub mod stray_light;
