//! The focus moves with temperature, or with time.
//!
//! The blur of a defocus z adds z² to the variance: about the best focus the change is a square, elsewhere a slope. Both are columns. Where the focal
//! surface is curved or tilted the square has products of the field and the temperature, or the time, which tell it from a camera that shakes: that one
//! widens all images of a frame alike. Their parameters are for one half-diagonal from the middle, along the radius, x or y.

use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// What a defocus of field and drift together is made of.
const OF_FOCUS: &[&str] = &["psf-shape", "focus-drift"];

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

/// A width that goes with the temperature and the place: what a drift does to a curved or tilted focal surface.
pub(super) struct FocusWithTemperatureBeyond;

impl ImageEffect for FocusWithTemperatureBeyond {
    fn id(&self) -> &'static str {
        "focus-drift"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("sigma_px_per_kelvin_at_corner", "px/K"), ("sigma_px_per_kelvin_x", "px/K"), ("sigma_px_per_kelvin_y", "px/K")]
    }
    fn follows(&self) -> &'static str {
        "temperature"
    }
    fn products_of(&self) -> &'static [&'static str] {
        OF_FOCUS
    }
    /// A curved focal surface, a tilted one.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0], &[1, 2]]
    }
    fn name_rank(&self) -> u8 {
        2
    }
    fn needs(&self) -> &'static str {
        "second moments of the images, and temperatures that differ"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.01, "depth of focus over tens of kelvin")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        Some(by_place(image, image.temperature_offset_k?))
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

/// A width that goes with the time and the place: what a drift does to a curved or tilted focal surface.
pub(super) struct FocusWithTimeBeyond;

impl ImageEffect for FocusWithTimeBeyond {
    fn id(&self) -> &'static str {
        "focus-drift"
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("sigma_px_per_hour_at_corner", "px/h"), ("sigma_px_per_hour_x", "px/h"), ("sigma_px_per_hour_y", "px/h")]
    }
    fn follows(&self) -> &'static str {
        "time"
    }
    fn products_of(&self) -> &'static [&'static str] {
        OF_FOCUS
    }
    /// A curved focal surface, a tilted one.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0], &[1, 2]]
    }
    fn name_rank(&self) -> u8 {
        3
    }
    fn needs(&self) -> &'static str {
        "second moments of the images, and the times of the frames"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.02, "a lens that cools through a night")
    }
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        Some(by_place(image, image.time_offset_h?))
    }
}

/// What widens images by the product of a drift and the place: the square of the radius, x and y.
fn by_place(image: &ImageContext, drift: f64) -> Vec<ImageResponse> {
    let [u, v] = image.at;
    [u * u + v * v, u, v].map(|place| ImageResponse::width(image.sigma_px, drift * place)).to_vec()
}
