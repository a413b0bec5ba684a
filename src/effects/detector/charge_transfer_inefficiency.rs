//! # Losses in the transfer of charge
//!
//! **What it is.** On its way to the register of a CCD a star's charge crosses every row between; traps in the silicon hold some of it and let
//! it go into the rows that follow. The image gets a tail away from the register, and its centre moves there, the more the longer the way
//! and the fainter the star.
//!
//! **Equation.** Δy = κ·n·(F/10 000)^(−½), n = (y + ½)/height the MEASURED row's way to a register before row 0, as a share of the frame, F the
//! electrons of the star, measured where the image has them, else as many as a magnitude of 5 stands for 10 000; the ideal point is the
//! measured one minus Δ. A star of unknown brightness is not moved.
//!
//! **Parameter.** `px_at_far_row_10000e` (κ): displacement at the row farthest from the register of a star of 10 000 electrons, px. Positive
//! for a register before row 0. With a register behind the last row images move to lower rows by κ·(1 − n): κ then comes out negative, and a
//! magnitude equation along y takes the part that does not depend on the row.
//!
//! **What it leaves when left out.** Residuals along y in proportion to the row, larger for faint stars: 0.01 to 0.1 px after years of
//! radiation.
//!
//! **Confused with.** The aspect of the pixels (cosine 0.75), a step between amplifiers (0.67), the magnitude equation (0.56). Bright and faint
//! stars at the same rows tell them apart, and the tails of the images.
//!
//! **Neglected.** The exponent depends on the image's size and on the traps (0.3 to 0.6); a background fills traps, by e^(−B/B₀); losses along
//! the register; stars that went before along the column.
//!
//! **Source.** R. Massey et al., MNRAS 401, 371 (2010); A. Short et al., MNRAS 430, 3078 (2013).

use crate::dual::Real;
use crate::effects::{CentroidShift, Context, Light, Observation, ParameterSpec, ReferenceValue, StarImage, StarState};

/// A shift along the columns in proportion to the row, larger for faint stars.
#[derive(Clone, Copy, Debug)]
pub struct ChargeTransferInefficiency;

impl CentroidShift for ChargeTransferInefficiency {
    const ID: &'static str = "charge-transfer-inefficiency";
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "px_at_far_row_10000e", unit: "px", typical: 0.03, range: (-2.0, 2.0) }];

    fn unit_shift<T: Real>(_: usize, measured: &Light<T>, context: &Context) -> [T; 2] {
        let zero = T::constant(0.0);
        let (Some(sensor), Some(flux)) = (context.observation.sensor, context.relative_flux()) else { return [zero; 2] };
        [zero, (measured.pixel_px[1] + 0.5) / sensor.height_px as f64 / flux.sqrt()]
    }

    fn missing(observation: &Observation) -> Option<&'static str> {
        observation.sensor.is_none().then_some("the size of the frame is not known")
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // The cited power law with 30 digits by mpmath 1.4.1: κ = 0.03 px at row 699.25 of 768, a star of 2500 electrons, and one of
        // magnitude 7.5.
        let case = |flux_e: Option<f64>, shift: f64| {
            let star = StarState { magnitude: 7.5, ..StarState::default() };
            let context = Context::new(star, Observation::of_sensor(1024, 768)).with_image(StarImage { flux_e, ..StarImage::default() });
            let points = [[40.0, 315.25], [40.0, 315.25 - shift]];
            ReferenceValue::of_point("the published power law, mpmath 1.4.1", context, vec![0.03], 2000.0, [512.0, 384.0], points, 1e-12)
        };
        vec![case(Some(2500.0), 0.054_667_968_75), case(None, 0.086_437_648_152_454_04)]
    }

    fn source() -> &'static str {
        include_str!("charge_transfer_inefficiency.rs")
    }
}
