//! # Stray light under the images
//!
//! **What it is.** The background rises from one side of a star's image to the other: Moon, Sun, Earth or twilight shine into the lens. An
//! estimator that takes the background for level moves the centre up the slope.
//!
//! **Equation.** Δ = g·(∇B/G)·K/F: ∇B the gradient of the background measured under this image, G the root mean square of its size over the
//! recording's images, F the star's measured electrons; the ideal point is the measured one minus Δ. K = 8π·(σ² + 1/12)² is that of an
//! unweighted fit of a Gaussian of width σ that is integrated over pixels: the slope projected on the image's derivative. σ is the
//! measured width, 0.7 px where there is none. Where G is not known the size of ∇B itself stands in its place.
//!
//! **Parameter.** `gradient_e_per_px` (g): the slope that the estimator leaves in, electrons per pixel per pixel, as the root mean square over
//! the images. It is G for an estimator that knows of no slope, and zero for one that takes all of it away, whatever the slopes are; where
//! the slope is the same everywhere, it is that slope.
//!
//! **What it leaves when left out.** Residuals along the measured gradient, in proportion to 1/F: 0.013 px for g = 0.5, F = 1000 and
//! σ = 1 px; 0.025 px for a centre of mass over 5 × 5 px, whose K is 50.
//!
//! **Confused with.** The magnitude equation (cosine 0.92) if the gradient has the same direction in all images: frames at other angles to the
//! Moon tell them apart.
//!
//! **Neglected.** Estimators other than the unweighted fit: they change K, and so g, by a factor that is the same for all images of one width
//! (centre of mass over (2w + 1)² px: K = (2w + 1)²·w·(w + 1)/3). K is 4 % too small for σ = 0.7 px and 0.3 % for 1 px. The
//! error of the measured ∇B makes g too small where it is not small beside the gradient. Structure of the background on the scale of an image.
//!
//! **Source.** The projection is that of linear least squares; for the centre of mass see R. C. Stone, AJ 97, 1227 (1989).

use crate::dual::Real;
use crate::effects::{CentroidShift, Context, Light, Observation, ParameterSpec, ReferenceValue, StarImage, StarState};

/// A shift along the gradient of the background, the larger the fainter the star.
#[derive(Clone, Copy, Debug)]
pub struct StrayLight;

/// Width of an image where it is not measured, px.
const TYPICAL_SIGMA_PX: f64 = 0.7;

/// Shift per e/px of g, and zero where the image does not tell.
fn shift_px(image: &StarImage) -> Option<[f64; 2]> {
    let gradient = image.background_gradient_e_px?;
    let flux_e = image.flux_e.filter(|flux| *flux > 0.0)?;
    let scale = image.recording_gradient_e_px.unwrap_or(gradient[0].hypot(gradient[1]));
    let sigma_px = image.psf_sigma_px.unwrap_or(TYPICAL_SIGMA_PX);
    let factor = 8.0 * std::f64::consts::PI * (sigma_px * sigma_px + 1.0 / 12.0).powi(2);
    let shift = gradient.map(|along| along / scale * factor / flux_e);
    shift.iter().all(|along| along.is_finite()).then_some(shift)
}

impl CentroidShift for StrayLight {
    const ID: &'static str = "stray-light";
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "gradient_e_per_px", unit: "e/px", typical: 0.5, range: (-1000.0, 1000.0) }];

    fn unit_shift<T: Real>(_: usize, _: &Light<T>, context: &Context) -> [T; 2] {
        shift_px(&context.image).unwrap_or([0.0; 2]).map(T::constant)
    }

    fn missing_in(context: &Context) -> Option<&'static str> {
        shift_px(&context.image).is_none().then_some("the background's gradient under the star images and their electrons are not known")
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // scipy 1.17.1: a Gaussian of 4000 electrons, σ = 2 px, at (0.2, −0.3), integrated over 41 × 41 pixels by differences of norm.cdf, on
        // a slope of (0.06, −0.08) e/px per px, fitted by least_squares for place, flux and a level background. The page's K is 2e-4 less.
        let image = StarImage {
            flux_e: Some(4000.0),
            background_gradient_e_px: Some([0.06, -0.08]),
            recording_gradient_e_px: Some(0.1),
            psf_sigma_px: Some(2.0),
            ..StarImage::default()
        };
        vec![ReferenceValue::of_point(
            "fit of a Gaussian over a slope, scipy 1.17.1, least_squares",
            Context::new(StarState::default(), Observation::default()).with_image(image),
            vec![0.1],
            2000.0,
            [0.0; 2],
            [[0.206_287_039_138_534_94, -0.308_382_718_599_071_2], [0.2, -0.3]],
            2.5e-6,
        )]
    }

    fn source() -> &'static str {
        include_str!("stray_light.rs")
    }
}
