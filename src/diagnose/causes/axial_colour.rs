//! The focus of a lens differs with the colour: images of red stars are wider, or narrower, than those of blue ones.
//!
//! σ = σ₀ + a·c + b·c², c = B − V − reference: the blur of a defocus is a square of it, and the defocus goes with the colour.

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// A width that goes with the colour.
pub(super) struct AxialColour;

impl ImageEffect for AxialColour {
    fn id(&self) -> &'static str {
        "axial-colour"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("sigma_px_per_mag", "px/mag"), ("sigma_px_per_mag2", "px/mag2")]
    }
    fn follows(&self) -> &'static str {
        "colour"
    }
    /// Away from the best focus the slope alone.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0]]
    }
    fn needs(&self) -> &'static str {
        "second moments of the images, and the colours of the stars"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.03, "commercial lenses without a filter")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let colour = image.colour_offset?;
        Some(vec![ImageResponse::width(image.sigma_px, colour), ImageResponse::width(image.sigma_px, colour * colour)])
    }
}
