//! # Vignetting
//!
//! ## What it does
//!
//! Less light reaches the corners: the cosine law of an image plane that the light meets at an angle, and mounts and stops that cut
//! the beam of oblique directions.
//!
//! ## Equation
//!
//! electrons ·= max(1 − L·ρ² − b·(ρ⁴ − ρ²) − c·(ρ⁶ − ρ²), 0) / (1 + ρ²·tan²θ)², ρ the distance from the middle of the frame as a
//! part of that to the corner. The denominator is cos⁴ of the field angle of a lens without distortion.
//!
//! ## Parameters
//!
//! `cos4_corner_deg` (θ): field angle of the corner, degrees, 0 to 85 (0: no cosine law); `loss_at_corner` (L): part of the light
//! lost in the corner, beside the cosine law, 0 to 1; `loss_fourth_order` (b) and `loss_sixth_order` (c): the parts of it that go
//! with ρ⁴ and ρ⁶ and not with ρ², −4 to 4. A rim that cuts the beam from some angle on has all three.
//!
//! ## Signature
//!
//! Fluxes that fall with the radius: 6 % at 10°, 12 % at 14° from the axis by the cosine law alone. No displacement.
//!
//! ## Confused with
//!
//! The flat field, extinction in one frame (a roll of the camera tells), a background that is brighter in the middle.
//!
//! ## Neglected
//!
//! That a cut beam changes the shape of the images; a vignetting centre away from the middle of the frame; colour.
//!
//! ## Source
//!
//! M. Born, E. Wolf, Principles of Optics (1999), 4.8, for the law; P. Asada et al., ICPR 1996 (paraxial vignetting polynomials).

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::{ExposureContext, PixelEffect, Stage, by_radius2, uniform_fields};
use crate::effects::{ImageContext, ImageEffect, ImageResponse};
use crate::rng::StageKey;

/// Loss of light towards the corners.
#[derive(Clone, Copy, Debug)]
pub struct Vignetting;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct VignettingUniforms {
    middle_x_px: f32,
    middle_y_px: f32,
    inverse_radius2: f32,
    tan2_corner: f32,
    loss_second: f32,
    loss_fourth: f32,
    loss_sixth: f32,
    width: u32,
}

/// The twin.
fn vignetting(uniforms: &VignettingUniforms, first_pixel: u32, pixels: &mut [f32]) {
    let middle_px = [uniforms.middle_x_px, uniforms.middle_y_px];
    by_radius2(uniforms.width, middle_px, first_pixel, pixels, |radius2_px2, electrons| {
        let r2 = radius2_px2 * uniforms.inverse_radius2;
        let left = 1.0 - r2 * (uniforms.loss_second + r2 * (uniforms.loss_fourth + r2 * uniforms.loss_sixth));
        let left = if left > 0.0 { left } else { 0.0 };
        let secant2 = 1.0 + r2 * uniforms.tan2_corner;
        *electrons *= left / (secant2 * secant2);
    });
}

impl PixelEffect for Vignetting {
    const ID: &'static str = "vignetting";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("loss_at_corner", 0.5)];
    const STAGE: Stage = Stage::Light;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "cos4_corner_deg", unit: "deg", typical: 14.0, range: (0.0, 85.0) },
        ParameterSpec { name: "loss_at_corner", unit: "", typical: 0.2, range: (0.0, 1.0) },
        ParameterSpec { name: "loss_fourth_order", unit: "", typical: 0.0, range: (-4.0, 4.0) },
        ParameterSpec { name: "loss_sixth_order", unit: "", typical: 0.0, range: (-4.0, 4.0) },
    ];
    const WGSL: &'static str = include_str!("../../../shaders/vignetting.wgsl");
    const SOURCE: &'static str = page_source!("vignetting.rs");
    type Uniforms = VignettingUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(VignettingUniforms {
        middle_x_px,
        middle_y_px,
        inverse_radius2,
        tan2_corner,
        loss_second,
        loss_fourth,
        loss_sixth,
        width
    });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> VignettingUniforms {
        let [middle_x_px, middle_y_px] = exposure.middle_px().map(|middle| middle as f32);
        VignettingUniforms {
            middle_x_px,
            middle_y_px,
            inverse_radius2: exposure.half_diagonal_px().powi(-2) as f32,
            tan2_corner: parameters[0].to_radians().tan().powi(2) as f32,
            loss_second: (parameters[1] - parameters[2] - parameters[3]) as f32,
            loss_fourth: parameters[2] as f32,
            loss_sixth: parameters[3] as f32,
            width: exposure.width_px as u32,
        }
    }
    fn apply(uniforms: &VignettingUniforms, _key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        vignetting(uniforms, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0; 4])
    }
    fn least_e(parameters: &[f64], _exposure: &ExposureContext, least_e: f64) -> f64 {
        let [corner_deg, loss, fourth, sixth] = [parameters[0], parameters[1], parameters[2], parameters[3]];
        let second = loss - fourth - sixth;
        let lost = second.max(0.0) + fourth.max(0.0) + sixth.max(0.0);
        (1.0 - lost).max(0.0) * corner_deg.to_radians().cos().powi(4) * least_e
    }
}

impl ImageEffect for Vignetting {
    fn id(&self) -> &'static str {
        <Self as PixelEffect>::ID
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("loss_at_corner", ""), ("loss_fourth_order", ""), ("loss_sixth_order", "")]
    }
    /// The cosine law and most lenses need no sixth order; a rim that cuts the beam does.
    fn parts(&self) -> &'static [&'static [usize]] {
        &[&[0, 1]]
    }
    fn follows(&self) -> &'static str {
        "field-radius"
    }
    fn sign(&self) -> Option<f64> {
        Some(1.0)
    }
    fn needs(&self) -> &'static str {
        "stars over the frame"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.2, "6 to 12 % by the cosine law at 10 to 14 degrees, 20 to 50 % of fast lenses (Goldman 2010)")
    }
    /// The losses of the page's equation: that of the cosine law is alike, and the magnitudes of a large loss have all orders.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        Some(orders(image.at[0].powi(2) + image.at[1].powi(2)).map(ImageResponse::loss).to_vec())
    }
}

/// ρ², ρ⁴ − ρ² and ρ⁶ − ρ²: of their sizes the first is the whole loss in the corner.
pub(crate) fn orders(radius2: f64) -> [f64; 3] {
    [radius2, radius2 * (radius2 - 1.0), radius2 * (radius2 * radius2 - 1.0)]
}

/// Stars and sky tell the loss to this ρ² or so: the cells of the sky end before the corner, and few stars stand in it.
const REACH: f64 = 0.8;
/// Radii at which the losses are told, evenly spread over the area.
const RADII: usize = 32;
/// Gauss–Newton steps, at most.
const STEPS: usize = 30;

/// The losses of the page's equation whose logarithm is nearest to what magnitudes and logarithms of the sky are linear in, −Σ size·order, as far as
/// [`REACH`]; the zero point is free. The logarithm of the equation has all orders, so the sizes alone are too small in the corner: of a loss of 0.45 by
/// 0.03 with one, 0.01 with two. Value and standard error of each, by the covariance of the sizes.
pub(crate) fn losses(sizes: &[f64], covariance: &nalgebra::DMatrix<f64>) -> Vec<[f64; 2]> {
    let n = sizes.len();
    let design = nalgebra::DMatrix::from_fn(RADII, n, |k, order| -orders(REACH * (k as f64 + 0.5) / RADII as f64)[order]);
    let logarithm = &design * nalgebra::DVector::from_column_slice(sizes);
    let left = |losses: &nalgebra::DVector<f64>| (&design * losses).add_scalar(1.0);
    let is_light = |left: &nalgebra::DVector<f64>| left.iter().all(|left| *left > 0.0);
    // Columns from their means: the zero point is free.
    let centred = |mut matrix: nalgebra::DMatrix<f64>| {
        matrix.column_iter_mut().for_each(|mut column| column.add_scalar_mut(-column.mean()));
        matrix
    };
    let mut losses = nalgebra::DVector::zeros(n);
    let mut losses_from_sizes = nalgebra::DMatrix::identity(n, n);
    for _ in 0..STEPS {
        let now = left(&losses);
        let mut slopes = design.clone();
        slopes.row_iter_mut().zip(now.iter()).for_each(|(mut row, left)| row /= *left);
        let slopes = centred(slopes);
        let Some(inverse) = slopes.tr_mul(&slopes).try_inverse() else { break };
        losses_from_sizes = &inverse * slopes.tr_mul(&centred(design.clone()));
        let mut step = inverse * slopes.tr_mul(&(&logarithm - now.map(f64::ln)));
        if !step.iter().all(|own| own.is_finite()) {
            break;
        }
        while !is_light(&left(&(&losses + &step))) {
            step *= 0.5;
        }
        losses += &step;
        if step.amax() < 1e-12 {
            break;
        }
    }
    let covariance = &losses_from_sizes * covariance * losses_from_sizes.transpose();
    (0..n).map(|k| [losses[k], covariance[(k, k)].max(0.0).sqrt()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes of a fit of the logarithm as far as the mesh of a square frame goes.
    fn sizes_of(true_losses: &[f64], columns: usize) -> Vec<f64> {
        let radius2: Vec<f64> = (0..64).map(|k| ((f64::from(k % 8) - 3.5).powi(2) + (f64::from(k / 8) - 3.5).powi(2)) / 32.0).collect();
        let design = nalgebra::DMatrix::from_fn(64, columns + 1, |k, j| if j == columns { 1.0 } else { -orders(radius2[k])[j] });
        let lost = |radius2: f64| true_losses.iter().zip(orders(radius2)).map(|(loss, order)| loss * order).sum::<f64>();
        let logarithm = nalgebra::DVector::from_fn(64, |k, _| (1.0 - lost(radius2[k])).ln());
        let sizes = design.tr_mul(&design).lu().solve(&design.tr_mul(&logarithm)).unwrap();
        sizes.iter().take(columns).copied().collect()
    }

    /// The logarithm of a loss has higher powers of ρ, and of the sizes that a fit of it has the loss itself is found again.
    #[test]
    fn losses_are_those_of_the_equation() {
        let known = |n: usize| nalgebra::DMatrix::from_diagonal_element(n, n, 1e-4);
        for true_losses in [vec![0.05], vec![0.45], vec![0.05, 0.0], vec![0.45, 0.0], vec![0.3, 0.2], vec![0.3, -0.2, 0.4]] {
            let n = true_losses.len();
            let sizes = sizes_of(&true_losses, n);
            let found = losses(&sizes, &known(n));
            let plain = 1.0 - (-sizes[0]).exp();
            println!("{true_losses:?}: {found:.4?}, by the first size alone {plain:.4}");
            // The cells end at ρ² = 0.77, and not at the reach.
            assert!((found[0][0] - true_losses[0]).abs() < 0.03 * true_losses[0], "{true_losses:?}: {found:?}");
        }
        // What the sizes alone say is off by more.
        let plain = 1.0 - (-sizes_of(&[0.45], 1)[0]).exp();
        assert!((plain - 0.45).abs() > 0.025, "{plain}");
        // No loss is no loss, and a small one has the error of its size.
        let none = losses(&[0.0, 0.0], &known(2));
        assert!(none.iter().all(|[loss, sigma]| *loss == 0.0 && (sigma - 0.01).abs() < 1e-9), "{none:?}");
        // Almost all of the light: still a number.
        assert!(losses(&[6.0], &known(1))[0][0] > 0.9, "{:?}", losses(&[6.0], &known(1)));
    }

    /// The errors are those that the scatter of the sizes gives.
    #[test]
    fn errors_of_losses_are_their_scatter() {
        use rand::{RngExt, SeedableRng};
        let root = nalgebra::Matrix2::new(0.01, 0.0, -0.025, 0.02);
        let square = root * root.transpose();
        let covariance = nalgebra::DMatrix::from_fn(2, 2, |i, j| square[(i, j)]);
        let stated = losses(&[0.6, 0.1], &covariance);
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(5);
        let mut sums = [[0.0; 2]; 2];
        for _ in 0..4000 {
            let draw = root * nalgebra::Vector2::from_fn(|_, _| 12.0_f64.sqrt() * (rng.random::<f64>() - 0.5));
            for (sum, [loss, _]) in sums.iter_mut().zip(losses(&[0.6 + draw.x, 0.1 + draw.y], &covariance)) {
                *sum = [sum[0] + loss, sum[1] + loss * loss];
            }
        }
        for ([first, second], [_, sigma]) in sums.iter().zip(stated) {
            let scatter = (second / 4000.0 - (first / 4000.0).powi(2)).sqrt();
            assert!((scatter / sigma - 1.0).abs() < 0.06, "{scatter} of {sigma}");
        }
    }

    #[test]
    fn light_falls_as_the_fourth_power_of_the_cosine() {
        let exposure = ExposureContext { width_px: 301, height_px: 201, ..ExposureContext::default() };
        let mut pixels = vec![1.0_f32; 301 * 201];
        vignetting(&Vignetting::uniforms(&[30.0, 0.0, 0.0, 0.0], &exposure), 0, &mut pixels);
        let corner_px = 0.5 * 301.0_f64.hypot(201.0);
        for (x, y) in [(150, 100), (0, 0), (300, 200), (20, 170)] {
            let radius_px = (f64::from(x) - 150.0).hypot(f64::from(y) - 100.0);
            let angle = (radius_px / corner_px * 30.0_f64.to_radians().tan()).atan();
            let seen = f64::from(pixels[y as usize * 301 + x as usize]);
            assert!((seen - angle.cos().powi(4)).abs() < 1e-6, "{x}, {y}: {seen}");
        }
        // A run that begins within a row, and a polynomial that ends at nothing.
        let mut part = vec![1.0_f32; 400];
        vignetting(&Vignetting::uniforms(&[30.0, 0.0, 0.0, 0.0], &exposure), 1234, &mut part);
        assert_eq!(part[..], pixels[1234..1634]);
        let mut dark = vec![1.0_f32; 301 * 201];
        vignetting(&Vignetting::uniforms(&[0.0, 2.0, 1.0, 0.0], &exposure), 0, &mut dark);
        assert_eq!(dark[0], 0.0);
        let half = f64::from(dark[100 * 301 + 240]);
        let rho2 = (90.0 / corner_px).powi(2);
        assert!((half - (1.0 - rho2 - rho2 * rho2)).abs() < 1e-6, "{half}");
        let mut rim = vec![1.0_f32; 301 * 201];
        vignetting(&Vignetting::uniforms(&[0.0, 0.3, -0.2, 0.4], &exposure), 0, &mut rim);
        let seen = f64::from(rim[100 * 301 + 240]);
        assert!((seen - (1.0 - 0.1 * rho2 + 0.2 * rho2.powi(2) - 0.4 * rho2.powi(3))).abs() < 1e-6, "{seen}");
    }
}
