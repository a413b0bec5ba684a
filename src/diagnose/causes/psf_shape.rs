//! The image is not the same over the frame: a curved or tilted focal surface, astigmatism.
//!
//! σ changes in proportion to ρ² and ρ⁴ (curvature) and along x and y (tilt); astigmatism draws images out along the radius, or across it, in proportion
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
            // Where the middle is out of focus and the corner too the square alone shows nothing.
            ("sigma_px_at_corner_fourth_order", "px"),
        ]
    }
    fn follows(&self) -> &'static str {
        "field-map"
    }
    /// A curvature alone, a tilt alone, both, a focal surface without astigmatism.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0], &[1, 2], &[0, 4], &[0, 1, 2], &[0, 1, 2, 4]]
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
        Some(vec![wider(radius2), wider(u), wider(v), astigmatic, wider(radius2 * radius2)])
    }
}

/// What of the image follows the field in higher order: the blur of a defocus is its square, so a tilt and a curvature have cross terms; a lens out
/// of line has astigmatism that grows with the first power.
pub(super) struct FieldOfFocusBeyond;

impl ImageEffect for FieldOfFocusBeyond {
    fn id(&self) -> &'static str {
        "psf-shape"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[
            ("sigma_px_xx_less_yy", "px"),
            ("sigma_px_xy", "px"),
            ("sigma_px_third_order_x", "px"),
            ("sigma_px_third_order_y", "px"),
            ("astigmatism_x_px2", "px2"),
            ("astigmatism_y_px2", "px2"),
            ("diagonal_astigmatism_x_px2", "px2"),
            ("diagonal_astigmatism_y_px2", "px2"),
        ]
    }
    fn follows(&self) -> &'static str {
        "field-map"
    }
    fn name_rank(&self) -> u8 {
        2
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
        let wider = |share: f64| ImageResponse::width(sigma, share);
        let along = |share: f64| ImageResponse { second_px2: [share, 0.0, -share], ..ImageResponse::default() };
        let diagonal = |share: f64| ImageResponse { second_px2: [0.0, share, 0.0], ..ImageResponse::default() };
        Some(vec![
            wider(u * u - v * v),
            wider(2.0 * u * v),
            wider(u * radius2),
            wider(v * radius2),
            along(u),
            along(v),
            diagonal(u),
            diagonal(v),
        ])
    }
}
