//! The air dims stars in proportion to the air mass: m − V = k·X, k 0.1 to 0.4 magnitudes in V (Bessell 1990, PASP 102, 1181).
//!
//! With a zero point for every frame only what differs within a frame tells.

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// Light of the stars lost to clear air.
pub(in crate::diagnose) const EXTINCTION: &str = "extinction";

/// Loss of light in the air.
pub(super) struct Extinction;

impl ImageEffect for Extinction {
    fn id(&self) -> &'static str {
        EXTINCTION
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("mag_per_airmass", "mag")]
    }
    fn follows(&self) -> &'static str {
        "zenith"
    }
    fn sign(&self) -> Option<f64> {
        Some(1.0)
    }
    fn needs(&self) -> &'static str {
        "place and time"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.2, "0.1 to 0.4 magnitudes an air mass in V (Bessell 1990)")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let magnitude = image.airmass?;
        Some(vec![ImageResponse { magnitude, ..ImageResponse::default() }])
    }
}
