//! In the detector: from light on a pixel to a count.

pub mod adc;
pub mod amplifier_step;
pub mod bayer;
pub mod blooming;
pub mod charge_transfer_inefficiency;
pub mod detector_tilt;
pub mod edge_roll_off;
pub mod even_odd;
pub mod magnitude_equation;
pub mod overshoot;
pub mod photon_noise;
pub mod pixel_aspect;
pub mod read_noise;
pub mod s_curve;
pub mod sensor_step;
pub mod shear;
pub mod stray_light;
