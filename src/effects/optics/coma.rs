//! # Coma and the magnitude
//!
//! ## What it does
//!
//! Coma draws the image of a star away from the axis into a tail along the radius. How much of the tail lies above the threshold
//! of the measurement depends on the star's brightness, and so does the measured centre.
//!
//! ## Equation
//!
//! Δ = a·(m − 5)·r·(x̄, ȳ)/R², (x̄, ȳ) the MEASURED point relative to the principal point, r its length, R half the frame's
//! diagonal, m the star's magnitude, the measured one where the image has one, else V of the catalogue; the ideal point is the measured
//! one minus Δ. What stars of all magnitudes share is a distortion. A star of unknown magnitude is not moved.
//!
//! ## Parameters
//!
//! `coma_px_at_corner` (a): displacement outwards, at the distance of the frame's corner, of a star one magnitude fainter, px.
//! Negative for a tail that points outwards: of bright stars more of it is measured.
//!
//! ## Signature
//!
//! Residuals along the radius in proportion to the square of the radius and to the magnitude: 0.01 to 0.1 px per
//! magnitude near the edge. Hardly any of it is taken up by other parameters (0.94 survives).
//!
//! ### Rendered
//!
//! Coma of the third order grows with r itself, and so does the shift by the program's fit (cosine 0.999 with r, 0.976 with r²). It follows the
//! brightness only where the star outshines the sky: 8.3 px per rms wave of coma for 10³ and 10⁴ electrons over a sky of 50 a pixel, 7.3 for 10⁵, 4.9 for
//! 10⁶. What depends on the brightness has a cosine of 0.87 with this formula: it finds that there is coma, and its size is that of a mean slope.
//!
//! ## Confused with
//!
//! The magnitude equation and losses in the transfer of charge (cosine at most 0.23). Images whose tails point along the
//! radius tell the cause.
//!
//! ## Neglected
//!
//! The dependence on threshold and window, which is not linear in the magnitude; astigmatism, which draws images out to both
//! sides; a growth with the radius other than its square; a centre of the coma beside the principal point (a decentred lens).
//!
//! ## Source
//!
//! V. N. Mahajan, Optical Imaging and Aberrations (1998), for the form of the image; W. T. Welford, Aberrations of Optical Systems (1986), 7.3, for its
//! rays.

use crate::dual::Real;
use crate::effects::{
    CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Rendering, StarState,
};
use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// A shift along the radius in proportion to its square and to the magnitude.
#[derive(Clone, Copy, Debug)]
pub struct Coma;

impl CentroidShift for Coma {
    const ID: &'static str = "coma";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.03, "0.01 to 0.1 px/mag near the edge (Mahajan 2013)")),
        profile_covariates: &[("", "magnitude")],
        ..Facts::NONE
    };
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "coma_px_at_corner", unit: "px/mag", typical: 0.03, range: (-5.0, 5.0) }];

    fn unit_shift<T: Real>(_: usize, measured: &Light<T>, context: &Context) -> [T; 2] {
        let [x, y] = measured.point_px;
        let square = x * x + y * y;
        // On the axis the root has no derivative, but the shift has one: zero.
        let Some(sensor) = context.observation.sensor.filter(|_| square.value() > 0.0) else { return [T::constant(0.0); 2] };
        let (width, height) = (sensor.width_px as f64, sensor.height_px as f64);
        let factor = square.sqrt() * (4.0 * context.magnitude_offset() / (width * width + height * height));
        [x * factor, y * factor]
    }

    fn missing(observation: &Observation) -> Option<&'static str> {
        observation.sensor.is_none().then_some("the size of the frame is not known")
    }

    fn rendering(_: usize) -> Option<Rendering> {
        Some(Rendering::Coma { waves: [-0.02, 0.02] })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The page's equation with 30 digits by mpmath 1.4.1: a = 0.05 px, m = 7.25, at (300, −200) px of a frame of 1024 by 768 px.
        vec![ReferenceValue::of_point(
            "the page's equation, mpmath 1.4.1",
            Context::new(StarState { magnitude: 7.25, ..StarState::default() }, Observation::of_sensor(1024, 768)),
            vec![0.05],
            2000.0,
            [512.0, 384.0],
            [[300.0, -200.0], [299.970_291_172_962_2, -199.980_194_115_308_13]],
            1e-12,
        )]
    }

    fn source() -> &'static str {
        page_source!("coma.rs")
    }
}

impl ImageEffect for Coma {
    fn id(&self) -> &'static str {
        <Self as CentroidShift>::ID
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("skewness_at_corner", "")]
    }
    fn follows(&self) -> &'static str {
        "field-radius"
    }
    fn needs(&self) -> &'static str {
        "third moments of the images"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.1, "commercial lenses at full aperture")
    }
    /// Tails along the radius, in proportion to it.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        Some(vec![ImageResponse { skewness: image.at, ..ImageResponse::default() }])
    }
}

/// Coma by rays: images drawn out along the radius, with tails.
#[derive(Clone, Copy, Debug)]
pub struct ComaOfRays;

impl ImageEffect for ComaOfRays {
    fn id(&self) -> &'static str {
        <Coma as CentroidShift>::ID
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("square_at_corner_px2", "px2"), ("skewness_at_corner", ""), ("skewness_at_corner_third_order", "")]
    }
    fn follows(&self) -> &'static str {
        "field-radius"
    }
    fn name_rank(&self) -> u8 {
        2
    }
    fn sign(&self) -> Option<f64> {
        Some(1.0)
    }
    fn needs(&self) -> &'static str {
        "second and third moments of the images"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.1, "commercial lenses at full aperture: tails of a third of a pixel in the corner")
    }
    /// Rays of pupil radius p and azimuth φ land at c·p²·(2 + cos 2φ, sin 2φ), c along the radius and in proportion to it (Welford 1986, 7.3): about their
    /// centre that adds c²/2 to the variance along the radius and c²/6 across. The tail is a skewness, of the first order where the image is that of
    /// waves, of the third where it is that of rays.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let [u, v] = image.at;
        let radius2 = u * u + v * v;
        let across = radius2 / 6.0;
        let drawn = ImageResponse { second_px2: [across + u * u / 3.0, u * v / 3.0, across + v * v / 3.0], ..ImageResponse::default() };
        let tail = |share: f64| ImageResponse { skewness: [u * share, v * share], ..ImageResponse::default() };
        Some(vec![drawn, tail(1.0), tail(radius2)])
    }
}
