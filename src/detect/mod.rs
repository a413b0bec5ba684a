//! Frame → Detections: finds stars and measures them.

use serde::{Deserialize, Serialize};

/// What is special about a detection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flags {
    /// At least one pixel of the stamp is at or above saturation.
    pub saturated: bool,
    /// Another detection's light reaches into the stamp.
    pub blended: bool,
    /// The stamp is cut by the edge of the frame.
    pub edge: bool,
}

/// A star image as measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Column of the centre.
    pub x_px: f64,
    /// Row of the centre.
    pub y_px: f64,
    /// Covariance of the centre: xx, xy, yy.
    pub covariance_px2: [f64; 3],
    /// Flux above the background, DN.
    pub flux_dn: f64,
    /// Its standard error.
    pub flux_sigma_dn: f64,
    /// Local background under the star, DN per pixel.
    pub background_dn: f64,
    /// Gradient of the local background in x and y, DN per pixel per pixel.
    pub background_gradient_dn: [f64; 2],
    /// Width (Gaussian σ) of the star's image.
    pub width_px: f64,
    /// χ² of the stamp over its degrees of freedom.
    pub chi2_per_dof: f64,
    /// Highest count in the stamp, DN.
    pub peak_dn: f64,
    /// Flags.
    pub flags: Flags,
}

impl Detection {
    /// Flux over its standard error.
    #[must_use]
    pub fn snr(&self) -> f64 {
        self.flux_dn / self.flux_sigma_dn
    }
}

/// All star images of one frame, brightest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Detections {
    /// Columns of the frame.
    pub width_px: usize,
    /// Rows of the frame.
    pub height_px: usize,
    /// Median background, DN.
    pub background_dn: f64,
    /// Noise of one background pixel (standard deviation), DN.
    pub noise_dn: f64,
    /// The star images.
    pub stars: Vec<Detection>,
}
