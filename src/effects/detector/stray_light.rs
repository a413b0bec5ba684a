//! # Stray light under the images
//!
//! ## What it does
//!
//! The background rises from one side of a star's image to the other: Moon, Sun, Earth or twilight shine into the lens. An
//! estimator that takes the background for level moves the centre up the slope.
//!
//! ## Equation
//!
//! Δ = g·(∇B/G)·K/F: ∇B the gradient of the frame's background at this image, G the root mean square of its size over the
//! recording's images, F the star's measured electrons; the ideal point is the measured one minus Δ. ∇B is the robust polynomial of
//! second degree through what all stars' images in the frame tell: the slope in one image alone may be the light of a neighbour that
//! no catalogue lists, which moves the image as well. K = 8π·(σ² + 1/12)² is that of an
//! unweighted fit of a Gaussian of width σ that is integrated over pixels: the slope projected on the image's derivative. σ is the
//! measured width, 0.7 px where there is none. Where G is not known the size of ∇B itself stands in its place.
//!
//! ### In the pixels
//!
//! electrons = max(N + t·(a·(x − x_m) + b·(y − y_m)), 0), t the exposure time, (x_m, y_m) the middle of the frame: a background that
//! rises evenly. Its level is the sky background's.
//!
//! ## Parameters
//!
//! `gradient_e_per_px` (g): the slope that the estimator leaves in, electrons per pixel per pixel, as the root mean square over
//! the images. It is G for an estimator that knows of no slope, and zero for one that takes all of it away, whatever the slopes are; where
//! the slope is the same everywhere, it is that slope. In the pixels: `slope_x_e_per_px_s` (a) and `slope_y_e_per_px_s` (b), rise of the
//! background's rate from a pixel to the next, electrons per pixel and second.
//!
//! ## Signature
//!
//! Residuals along the measured gradient, in proportion to 1/F: 0.013 px for g = 0.5, F = 1000 and
//! σ = 1 px; 0.025 px for a centre of mass over 5 × 5 px, whose K is 50.
//!
//! ## Confused with
//!
//! The magnitude equation (cosine 0.92) if the gradient has the same direction in all images: frames at other angles to the
//! Moon tell them apart.
//!
//! ## Neglected
//!
//! Estimators other than the unweighted fit: they change K, and so g, by a factor that is the same for all images of one width
//! (centre of mass over (2w + 1)² px: K = (2w + 1)²·w·(w + 1)/3). K is 4 % too small for σ = 0.7 px and 0.3 % for 1 px. The
//! program's own fit trusts bright pixels less and looks more at an image's edges: rendered with σ = 0.9 px on a sky of 50 electrons, its shift is
//! 1.7 times for 3000, 3.2 times for 30 000 and 6 times for 300 000 electrons that of this K. The
//! error of the measured ∇B makes g too small where it is not small beside the gradient. Structure of the background on the scale of an image.
//!
//! ## Source
//!
//! The projection is that of linear least squares; for the centre of mass see R. C. Stone, AJ 97, 1227 (1989).

use bytemuck::{Pod, Zeroable};

use crate::dual::Real;
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, by_rows, uniform_fields};
use crate::effects::{
    CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Rendering, StarImage, StarState,
};
use crate::rng::StageKey;

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
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.5, "0.5 electrons a pixel, 0.025 px at 1000 electrons")),
        not_shown: Some("the shift follows a slope that is measured; its light is shown by its second half, on pixels"),
        ..Facts::NONE
    };
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "gradient_e_per_px", unit: "e/px", typical: 0.5, range: (-1000.0, 1000.0) }];

    fn unit_shift<T: Real>(_: usize, _: &Light<T>, context: &Context) -> [T; 2] {
        shift_px(&context.image).unwrap_or([0.0; 2]).map(T::constant)
    }

    fn missing_in(context: &Context) -> Option<&'static str> {
        shift_px(&context.image).is_none().then_some("the background's gradient under the star images and their electrons are not known")
    }

    fn rendering(_: usize) -> Option<Rendering> {
        Some(Rendering::Slope)
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
        page_source!("stray_light.rs")
    }
}

/// A background that rises evenly, in the pixels.
#[derive(Clone, Copy, Debug)]
pub struct StrayLightSlope;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct StrayLightUniforms {
    slope_x_e: f32,
    slope_y_e: f32,
    middle_x_px: f32,
    middle_y_px: f32,
    width: u32,
}

/// The twin.
fn stray_light(uniforms: &StrayLightUniforms, first_pixel: u32, pixels: &mut [f32]) {
    by_rows(uniforms.width, first_pixel, pixels, |x, y, row| {
        let of_row = uniforms.slope_y_e * (y as f32 - uniforms.middle_y_px);
        for (i, electrons) in (0..).zip(row) {
            let light = *electrons + (uniforms.slope_x_e * ((x + i) as f32 - uniforms.middle_x_px) + of_row);
            *electrons = if light > 0.0 { light } else { 0.0 };
        }
    });
}

impl PixelEffect for StrayLightSlope {
    const ID: &'static str = "stray-light";
    const STAGE: Stage = Stage::Light;
    const ROLE: Role = Role::Adds;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "slope_x_e_per_px_s", unit: "e-/px²/s", typical: 0.1, range: (-1e6, 1e6) },
        ParameterSpec { name: "slope_y_e_per_px_s", unit: "e-/px²/s", typical: -0.05, range: (-1e6, 1e6) },
    ];
    const WGSL: &'static str = include_str!("../../../shaders/stray_light.wgsl");
    const SOURCE: &'static str = page_source!("stray_light.rs");
    type Uniforms = StrayLightUniforms;
    const FIELDS: &'static [(&'static str, usize)] =
        uniform_fields!(StrayLightUniforms { slope_x_e, slope_y_e, middle_x_px, middle_y_px, width });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> StrayLightUniforms {
        let middle = exposure.middle_px();
        StrayLightUniforms {
            slope_x_e: (parameters[0] * exposure.exposure_s) as f32,
            slope_y_e: (parameters[1] * exposure.exposure_s) as f32,
            middle_x_px: middle[0] as f32,
            middle_y_px: middle[1] as f32,
            width: exposure.width_px as u32,
        }
    }
    fn apply(uniforms: &StrayLightUniforms, _key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        stray_light(uniforms, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0; 2])
    }
    fn least_e(parameters: &[f64], exposure: &ExposureContext, least_e: f64) -> f64 {
        let middle_px = exposure.middle_px();
        (least_e - exposure.exposure_s * (parameters[0].abs() * middle_px[0] + parameters[1].abs() * middle_px[1])).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_turns_about_the_middle_and_light_is_never_negative() {
        let exposure = ExposureContext { width_px: 3, height_px: 3, exposure_s: 2.0, ..ExposureContext::default() };
        let mut pixels = [5.0; 9];
        stray_light(&StrayLightSlope::uniforms(&[1.0, 2.0], &exposure), 0, &mut pixels);
        assert_eq!(pixels, [0.0, 1.0, 3.0, 3.0, 5.0, 7.0, 7.0, 9.0, 11.0]);
    }
}
