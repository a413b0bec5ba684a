//! The camera's passband is not V: measured magnitudes go with the star's colour.
//!
//! m − V = q·(B − V), q about −0.2 for a silicon detector without a filter (its light is redder than V).

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// A slope of the magnitude in the colour.
pub(super) struct Passband;

impl ImageEffect for Passband {
    fn id(&self) -> &'static str {
        "passband"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("mag_per_mag", "mag/mag")]
    }
    fn follows(&self) -> &'static str {
        "colour"
    }
    fn needs(&self) -> &'static str {
        "the colours of the stars"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.2, "a bare silicon detector against V")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let magnitude = image.colour_offset?;
        Some(vec![ImageResponse { magnitude, ..ImageResponse::default() }])
    }
}
