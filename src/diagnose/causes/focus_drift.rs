//! The focus moves with temperature, or with time.
//!
//! The blur of a defocus z adds z² to the variance: about the best focus the change is a square, elsewhere a slope. Both are columns. Where the focal
//! surface is curved or tilted the square has products of the field and the temperature, or the time, which tell it from a camera that shakes: that one
//! widens all images of a frame alike. Their parameters are for one half-diagonal from the middle, along the radius, x or y.

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// What a defocus of field and drift together is made of.
const OF_FOCUS: &[&str] = &["psf-shape", "focus-drift"];

/// What the focus moves with.
pub(super) struct Drift {
    follows: &'static str,
    /// Slope and square, and what [`by_place`] gives.
    parameters: [&'static [(&'static str, &'static str)]; 2],
    needs: &'static str,
    ordinary: (f64, &'static str),
    rank: u8,
    offset: fn(&ImageContext) -> Option<f64>,
}

pub(super) static WITH_TEMPERATURE: Drift = Drift {
    follows: "temperature",
    parameters: [
        &[("sigma_px_per_kelvin", "px/K"), ("sigma_px_per_kelvin2", "px/K2")],
        &[("sigma_px_per_kelvin_at_corner", "px/K"), ("sigma_px_per_kelvin_x", "px/K"), ("sigma_px_per_kelvin_y", "px/K")],
    ],
    needs: "second moments of the images, and temperatures that differ",
    ordinary: (0.01, "depth of focus over tens of kelvin"),
    rank: 1,
    offset: |image| image.temperature_offset_k,
};

pub(super) static WITH_TIME: Drift = Drift {
    follows: "time",
    parameters: [
        &[("sigma_px_per_hour", "px/h"), ("sigma_px_per_hour2", "px/h2")],
        &[("sigma_px_per_hour_at_corner", "px/h"), ("sigma_px_per_hour_x", "px/h"), ("sigma_px_per_hour_y", "px/h")],
    ],
    needs: "second moments of the images, and the times of the frames",
    ordinary: (0.02, "a lens that cools through a night"),
    rank: 2,
    offset: |image| image.time_offset_h,
};

/// A width that goes with the drift.
pub(super) struct FocusDrift(pub(super) &'static Drift);

impl ImageEffect for FocusDrift {
    fn id(&self) -> &'static str {
        "focus-drift"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        self.0.parameters[0]
    }
    fn follows(&self) -> &'static str {
        self.0.follows
    }
    /// Away from the best focus the slope alone.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0]]
    }
    fn name_rank(&self) -> u8 {
        self.0.rank
    }
    fn needs(&self) -> &'static str {
        self.0.needs
    }
    fn ordinary(&self) -> (f64, &'static str) {
        self.0.ordinary
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let drift = (self.0.offset)(image)?;
        Some([drift, drift * drift].map(|change| ImageResponse::width(image.sigma_px, change)).to_vec())
    }
}

/// A width that goes with the drift and the place: what a drift does to a curved or tilted focal surface.
pub(super) struct FocusDriftByPlace(pub(super) &'static Drift);

impl ImageEffect for FocusDriftByPlace {
    fn id(&self) -> &'static str {
        "focus-drift"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        self.0.parameters[1]
    }
    fn follows(&self) -> &'static str {
        self.0.follows
    }
    fn products_of(&self) -> &'static [&'static str] {
        OF_FOCUS
    }
    /// A curved focal surface, a tilted one.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0], &[1, 2]]
    }
    fn name_rank(&self) -> u8 {
        self.0.rank + 1
    }
    fn needs(&self) -> &'static str {
        self.0.needs
    }
    fn ordinary(&self) -> (f64, &'static str) {
        self.0.ordinary
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        Some(by_place(image, (self.0.offset)(image)?))
    }
}

/// What widens images by the product of a drift and the place: the square of the radius, x and y.
fn by_place(image: &ImageContext, drift: f64) -> Vec<ImageResponse> {
    let [u, v] = image.at;
    [u * u + v * v, u, v].map(|place| ImageResponse::width(image.sigma_px, drift * place)).to_vec()
}
