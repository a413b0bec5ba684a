//! The focus moves with temperature, or with time.
//!
//! The blur of a defocus z adds z² to the variance: about the best focus the change is a square, elsewhere a slope. Both are columns.

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// A width that goes with the temperature.
pub(super) struct FocusWithTemperature;

impl ImageEffect for FocusWithTemperature {
    fn id(&self) -> &'static str {
        "focus-drift"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("sigma_px_per_kelvin", "px/K"), ("sigma_px_per_kelvin2", "px/K2")]
    }
    fn follows(&self) -> &'static str {
        "temperature"
    }
    /// Away from the best focus the slope alone.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0]]
    }
    fn needs(&self) -> &'static str {
        "second moments of the images, and temperatures that differ"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.01, "depth of focus over tens of kelvin")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let kelvin = image.temperature_offset_k?;
        let wider = |change: f64| ImageResponse::width(image.sigma_px, change);
        Some(vec![wider(kelvin), wider(kelvin * kelvin)])
    }
}

/// A width that goes with the time.
pub(super) struct FocusWithTime;

impl ImageEffect for FocusWithTime {
    fn id(&self) -> &'static str {
        "focus-drift"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("sigma_px_per_hour", "px/h"), ("sigma_px_per_hour2", "px/h2")]
    }
    fn follows(&self) -> &'static str {
        "time"
    }
    /// Away from the best focus the slope alone.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0]]
    }
    fn name_rank(&self) -> u8 {
        2
    }
    fn needs(&self) -> &'static str {
        "second moments of the images, and the times of the frames"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.02, "a lens that cools through a night")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let hours = image.time_offset_h?;
        let wider = |change: f64| ImageResponse::width(image.sigma_px, change);
        Some(vec![wider(hours), wider(hours * hours)])
    }
}
