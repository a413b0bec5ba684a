//! The image is not the same over the frame: a curved or tilted focal surface, astigmatism.
//!
//! σ changes in proportion to ρ² (curvature) and along x and y (tilt); astigmatism draws images out along the radius, or across it, in proportion
//! to ρ². Against one image constant over the field these are findings; a constant width is not (it is measured).

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// What of the image follows the field.
pub(super) struct FieldOfFocus;

impl ImageEffect for FieldOfFocus {
    fn id(&self) -> &'static str {
        "psf-shape"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("sigma_px_at_corner", "px"),
            ("sigma_px_per_half_diagonal_x", "px"),
            ("sigma_px_per_half_diagonal_y", "px"),
            ("astigmatism_at_corner_px2", "px2"),
        ]
    }
    fn follows(&self) -> &'static str {
        "field-map"
    }
    fn needs(&self) -> &'static str {
        "second moments of the images"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.1, "commercial lenses: the corner a tenth to half of a pixel wider")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let ([u, v], sigma) = (image.at, image.sigma_px);
        let radius2 = u * u + v * v;
        // Along the radius by as much as across it is narrower.
        let radial = [u * u - v * v, 2.0 * u * v];
        let astigmatic = ImageResponse { second_px2: [radial[0], radial[1], -radial[0]], ..ImageResponse::default() };
        let wider = |share: f64| ImageResponse::width(sigma, share);
        Some(vec![wider(radius2), wider(u), wider(v), astigmatic])
    }
}
