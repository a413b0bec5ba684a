//! # Banding of rows and columns
//!
//! ## What it does
//!
//! The reference of a row, and the amplifier of a column, are not the same for all: whole rows are brighter or darker, anew in every
//! frame, and whole columns by an offset that stays.
//!
//! ## Equation
//!
//! electrons += r·u(row, frame) + c·v(column), u and v standard normal.
//!
//! ## Parameters
//!
//! `row_sigma_e` (r): standard deviation of the rows, electrons, 0.1 to 5; `column_sigma_e` (c): that of the columns.
//!
//! ## Signature
//!
//! Centres of faint stars that scatter more along y than along x; means of rows that vary more than their
//! pixels' noise allows.
//!
//! ## Confused with
//!
//! Read noise, from whose variance it cannot be told pixel by pixel; clouds and gradients are smooth.
//!
//! ## Neglected
//!
//! Correlation from row to row (1/f noise), bands that run through the columns of one amplifier only, tones of a power supply.
//!
//! ## Source
//!
//! EMVA Standard 1288, release 4.0 (2021), section 4.7 (row and column noise); B. Pain et al., for column-parallel CMOS readout.

use bytemuck::{Pod, Zeroable};

use crate::effects::ParameterSpec;
use crate::effects::pixel::math::standard_normal;
use crate::effects::pixel::pattern::fixed_words;
use crate::effects::pixel::{ExposureContext, PixelEffect, Role, Stage, by_rows, uniform_fields};
use crate::rng::StageKey;

/// Offsets of rows and columns.
#[derive(Clone, Copy, Debug)]
pub struct Banding;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct BandingUniforms {
    row_sigma_e: f32,
    column_sigma_e: f32,
    width: u32,
}

/// The twin.
fn banding(uniforms: &BandingUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
    let column = |x: u32| {
        let words = fixed_words(key, x, 0);
        uniforms.column_sigma_e * standard_normal(words[0], words[1])
    };
    let columns: Vec<f32> = if uniforms.column_sigma_e > 0.0 { (0..uniforms.width).map(column).collect() } else { Vec::new() };
    by_rows(uniforms.width, first_pixel, pixels, |x, y, row| {
        let words = key.words(y, 0);
        let offset = uniforms.row_sigma_e * standard_normal(words[0], words[1]);
        for electrons in &mut *row {
            *electrons += offset;
        }
        for (electrons, offset) in row.iter_mut().zip(columns.iter().skip(x as usize)) {
            *electrons += offset;
        }
    });
}

impl PixelEffect for Banding {
    const ID: &'static str = "banding";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("row_sigma_e", 4.0), ("column_sigma_e", 2.0)];
    const STAGE: Stage = Stage::Readout;
    const ROLE: Role = Role::Noise;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "row_sigma_e", unit: "e-", typical: 1.0, range: (0.0, 1e6) },
        ParameterSpec { name: "column_sigma_e", unit: "e-", typical: 0.5, range: (0.0, 1e6) },
    ];
    const DRAWS: bool = true;
    const RNG_STAGE: u32 = 6;
    const WGSL: &'static str = include_str!("../../../shaders/banding.wgsl");
    const SOURCE: &'static str = page_source!("banding.rs");
    type Uniforms = BandingUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(BandingUniforms { row_sigma_e, column_sigma_e, width });

    fn uniforms(parameters: &[f64], exposure: &ExposureContext) -> BandingUniforms {
        BandingUniforms { row_sigma_e: parameters[0] as f32, column_sigma_e: parameters[1] as f32, width: exposure.width_px as u32 }
    }
    fn apply(uniforms: &BandingUniforms, key: StageKey, first_pixel: u32, pixels: &mut [f32]) {
        banding(uniforms, key, first_pixel, pixels);
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0; 2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_change_and_columns_stay() {
        let (width, height) = (900_usize, 1100_usize);
        let exposure = ExposureContext { width_px: width, height_px: height, ..ExposureContext::default() };
        let frame = |parameters: &[f64], frame: u32| {
            let mut pixels = vec![0.0_f32; width * height];
            banding(&Banding::uniforms(parameters, &exposure), StageKey { seed: 8, frame, stage: Banding::RNG_STAGE }, 0, &mut pixels);
            pixels
        };
        let (rows, columns) = (frame(&[2.0, 0.0], 0), frame(&[0.0, 3.0], 0));
        assert!(rows.chunks(width).all(|row| row.iter().all(|e| *e == row[0])));
        assert!(columns.chunks(width).all(|row| row == &columns[..width]));
        assert_eq!(columns, frame(&[0.0, 3.0], 1));
        assert_ne!(rows, frame(&[2.0, 0.0], 1));
        let variance = |values: &mut dyn Iterator<Item = f32>| {
            let (sum, count) = values.fold((0.0, 0.0), |(sum, count), e| (sum + f64::from(e).powi(2), count + 1.0));
            (sum / count, 4.5 * (2.0_f64 / count).sqrt())
        };
        for (values, expected) in
            [(&mut rows.iter().step_by(width).copied() as &mut dyn Iterator<Item = f32>, 4.0), (&mut columns[..width].iter().copied(), 9.0)]
        {
            let (seen, tolerance) = variance(values);
            assert!((seen / expected - 1.0).abs() < tolerance, "{seen} for {expected}");
        }
    }
}
