//! In the detector: from light on a pixel to a count.

pub mod adc;
pub mod photon_noise;
pub mod read_noise;
