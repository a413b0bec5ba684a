//! # Losses in the transfer of charge
//!
//! ## What it does
//!
//! On its way to the register of a CCD a star's charge crosses every row between; traps in the silicon hold some of it and let
//! it go into the rows that follow. The image gets a tail away from the register, and its centre moves there, the more the longer the way
//! and the fainter the star.
//!
//! ## Equation
//!
//! Δy = κ·n·(F/10 000)^(−½), n = (y + ½)/height the MEASURED row's way to a register before row 0, as a share of the frame, F the
//! electrons of the star, measured where the image has them, else as many as a magnitude of 5 stands for 10 000; the ideal point is the
//! measured one minus Δ. A star of unknown brightness is not moved.
//!
//! ### In the pixels
//!
//! The charge distortion model CDM: the packet N of row y goes through y + 1 transfers and meets on its way
//! t = ρ·(y + 1)·(N/W)^β traps, of which n still hold charge of the packets before it. It loses
//! c = max((t − n)/(t/N + 1)·(1 − e^(−a·(N/W)^(1−β))), 0) to them, n becomes n + c; then the part 1 − e^(−1/τ) of n is let go into it. The
//! same along the rows, with the register's own traps and the column for the row. Every electron taken is given back, but for what is still
//! trapped when the last row (the last column) has gone by. Two kinds of traps act one after the other.
//!
//! ## Parameters
//!
//! `px_at_far_row_10000e` (κ): displacement at the row farthest from the register of a star of 10 000 electrons, px. Positive
//! for a register before row 0. With a register behind the last row images move to lower rows by κ·(1 − n): κ then comes out negative, and a
//! magnitude equation along y takes the part that does not depend on the row.
//! In the pixels: `traps_per_px` and `second_traps_per_px` (ρ), traps of a kind in a pixel filled to the full well, 0 to 10 after years of
//! radiation; `release_px` and `second_release_px` (τ), transfers until a trap has let go of its charge, as a mean; `serial_traps_per_px`,
//! `serial_release_px`, the same for the register before column 0, which has one kind; `full_well_e` (W), electrons of a full pixel;
//! `cloud_exponent` (β), how the cloud of charge grows with its charge, 0 to 1; `capture_per_transfer` (a), captures that a full pixel's
//! density allows a trap during one transfer: large means that every empty trap within the cloud is filled.
//!
//! ## Signature
//!
//! Residuals along y in proportion to the row, larger for faint stars: 0.01 to 0.1 px after years of
//! radiation.
//!
//! ### Rendered
//!
//! Stars of one brightness are moved in proportion to the row (cosine 0.995 and more). With β = ½ on a dark sky, over 10³ to 10⁵ electrons,
//! the exponent is 0.46 by the centre of mass and 0.39 by the fit, 0.33 and 0.31 under a sky of 50 electrons, which fills traps; the cosine with the
//! formula's ½ is 0.994 and more, and 0.975. A diagnosis of frames has both columns, the rendered one and the formula.
//!
//! ## Confused with
//!
//! The aspect of the pixels (cosine 0.75), a step between amplifiers (0.67), the magnitude equation (0.56). Bright and faint
//! stars at the same rows tell them apart, and the tails of the images.
//!
//! ## Neglected
//!
//! The exponent depends on the image's size and on the traps (0.3 to 0.6); a background fills traps, by e^(−B/B₀); losses along
//! the register; stars that went before along the column. In the pixels: chance in capture and release; traps lie evenly over the column and
//! are empty when the readout begins; readout to two sides; the phases of a pixel.
//!
//! ## Source
//!
//! R. Massey et al., MNRAS 401, 371 (2010); A. Short et al., MNRAS 430, 3078 (2013), whose equations 22 to 25 are CDM.

use bytemuck::{Pod, Zeroable};

use crate::dual::Real;
use crate::effects::pixel::pass::{Along, Carries, Carry, LinePass, PassHead, Sweep};
use crate::effects::pixel::pattern::{exponential, power};
use crate::effects::pixel::{ExposureContext, Stage, uniform_fields};
use crate::effects::{
    CentroidShift, Context, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Rendering, StarImage, StarState,
};
use crate::effects::{ImageContext, ImageEffect, ImageResponse};

/// A shift along the columns in proportion to the row, larger for faint stars.
#[derive(Clone, Copy, Debug)]
pub struct ChargeTransferInefficiency;

impl CentroidShift for ChargeTransferInefficiency {
    const ID: &'static str = "charge-transfer-inefficiency";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.05, "0.01 to 0.1 px (Massey et al. 2010; ACS ISR 2007-04)")),
        profile_covariates: &[("", "row")],
        follows_sky_level: true,
        ..Facts::NONE
    };
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

    fn rendering(_: usize) -> Option<Rendering> {
        // One kind of traps, which lets go over a few pixels.
        Some(Rendering::Stage {
            effect: "charge-transfer-inefficiency",
            parameters: &[("traps_per_px", [0.1, 0.3]), ("second_traps_per_px", [0.0; 2]), ("serial_traps_per_px", [0.0; 2])],
            step: None,
            by_colour: false,
        })
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
        page_source!("charge_transfer_inefficiency.rs")
    }
}

/// Charge that is trapped and let go, in the pixels.
#[derive(Clone, Copy, Debug)]
pub struct TrappedCharge;

/// What the shader gets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct TrappedChargeUniforms {
    traps_per_px: f32,
    released: f32,
    second_traps_per_px: f32,
    second_released: f32,
    serial_traps_per_px: f32,
    serial_released: f32,
    per_full_well: f32,
    cloud_exponent: f32,
    capture: f32,
}

/// Below so many electrons a packet loses nothing.
const MIN_E: f32 = 0.01;

/// The twin, for one kind of traps, of which the whole way has `traps` and `held` are full.
#[inline(always)]
#[allow(clippy::inline_always, reason = "inlined into the loop over columns, which is vectorised only then")]
fn charge_transfer_inefficiency(uniforms: &TrappedChargeUniforms, traps: f32, released: f32, electrons: f32, held: &mut f32) -> f32 {
    let filling = electrons * uniforms.per_full_well;
    let (exponent, rest) = (uniforms.cloud_exponent, 1.0 - uniforms.cloud_exponent);
    let volume = power(filling, exponent);
    let met = traps * volume;
    // The usual exponent is a half, and powers are most of the work.
    let certain = 1.0 - exponential(-uniforms.capture * if rest == exponent { volume } else { power(filling, rest) });
    let at_least = if electrons > MIN_E { electrons } else { MIN_E };
    let taken = (met - *held) / (met / at_least + 1.0) * certain;
    let taken = if taken > 0.0 && electrons > MIN_E { taken } else { 0.0 };
    let full = *held + taken;
    let let_go = full * released;
    *held = full - let_go;
    electrons - taken + let_go
}

/// The twin for packets side by side.
fn trapped(uniforms: &TrappedChargeUniforms, traps: f32, released: f32, row: &mut [f32], held: &mut [f32]) {
    // No traps, none that are full: the same without the powers.
    if traps == 0.0 {
        return;
    }
    for (electrons, held) in row.iter_mut().zip(held) {
        *electrons = charge_transfer_inefficiency(uniforms, traps, released, *electrons, held);
    }
}

impl PassHead for TrappedCharge {
    const ID: &'static str = "charge-transfer-inefficiency";
    const DEMO_SIZES: &'static [(&'static str, f64)] = &[("full_well_e", 4e4)];
    const STAGE: Stage = Stage::Readout;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "traps_per_px", unit: "1/px", typical: 0.5, range: (0.0, 1e3) },
        ParameterSpec { name: "release_px", unit: "px", typical: 2.0, range: (1e-3, 1e5) },
        ParameterSpec { name: "second_traps_per_px", unit: "1/px", typical: 0.3, range: (0.0, 1e3) },
        ParameterSpec { name: "second_release_px", unit: "px", typical: 12.0, range: (1e-3, 1e5) },
        ParameterSpec { name: "serial_traps_per_px", unit: "1/px", typical: 0.05, range: (0.0, 1e3) },
        ParameterSpec { name: "serial_release_px", unit: "px", typical: 1.5, range: (1e-3, 1e5) },
        ParameterSpec { name: "full_well_e", unit: "e-", typical: 1e5, range: (1.0, 1e9) },
        ParameterSpec { name: "cloud_exponent", unit: "", typical: 0.5, range: (0.0, 1.0) },
        ParameterSpec { name: "capture_per_transfer", unit: "", typical: 100.0, range: (0.0, 1e9) },
    ];
    const CONSERVES_CHARGE: bool = true;
    const WGSL: &'static str = include_str!("../../../shaders/charge_transfer_inefficiency.wgsl");
    const SOURCE: &'static str = page_source!("charge_transfer_inefficiency.rs");
    type Uniforms = TrappedChargeUniforms;
    const FIELDS: &'static [(&'static str, usize)] = uniform_fields!(TrappedChargeUniforms {
        traps_per_px,
        released,
        second_traps_per_px,
        second_released,
        serial_traps_per_px,
        serial_released,
        per_full_well,
        cloud_exponent,
        capture
    });

    fn uniforms(parameters: &[f64], _: &ExposureContext) -> TrappedChargeUniforms {
        let released = |release_px: f64| -(-1.0 / release_px).exp_m1() as f32;
        TrappedChargeUniforms {
            traps_per_px: parameters[0] as f32,
            released: released(parameters[1]),
            second_traps_per_px: parameters[2] as f32,
            second_released: released(parameters[3]),
            serial_traps_per_px: parameters[4] as f32,
            serial_released: released(parameters[5]),
            per_full_well: (1.0 / parameters[6]) as f32,
            cloud_exponent: parameters[7] as f32,
            capture: parameters[8] as f32,
        }
    }
    fn identity() -> Option<Vec<f64>> {
        Some(vec![0.0, 2.0, 0.0, 12.0, 0.0, 1.5, 1e5, 0.5, 100.0])
    }
}

impl LinePass for TrappedCharge {
    const SWEEPS: &'static [Sweep] = &[Sweep { along: Along::Columns, backward: false }, Sweep { along: Along::Rows, backward: false }];

    fn step(uniforms: &TrappedChargeUniforms, sweep: usize, place: [usize; 2], electrons: f32, carry: &mut Carry) -> f32 {
        let mut own = [electrons];
        let [first, second, ..] = carry;
        if sweep == 1 {
            let traps = uniforms.serial_traps_per_px * (place[0] + 1) as f32;
            trapped(uniforms, traps, uniforms.serial_released, &mut own, std::slice::from_mut(first));
        } else {
            let way = (place[1] + 1) as f32;
            trapped(uniforms, uniforms.traps_per_px * way, uniforms.released, &mut own, std::slice::from_mut(first));
            trapped(uniforms, uniforms.second_traps_per_px * way, uniforms.second_released, &mut own, std::slice::from_mut(second));
        }
        own[0]
    }

    /// Columns alone are walked side by side.
    fn step_row(uniforms: &TrappedChargeUniforms, _: usize, place: [usize; 2], row: &mut [f32], carries: &mut Carries) {
        let way = (place[1] + 1) as f32;
        let [first, second, ..] = carries;
        trapped(uniforms, uniforms.traps_per_px * way, uniforms.released, row, first);
        trapped(uniforms, uniforms.second_traps_per_px * way, uniforms.second_released, row, second);
    }
}

impl ImageEffect for ChargeTransferInefficiency {
    fn id(&self) -> &'static str {
        <Self as CentroidShift>::ID
    }
    fn parameters(&self) -> &'static [(&'static str, &'static str)] {
        &[("loss_at_far_row_10000e", ""), ("tail_px2_at_far_row_10000e", "px2"), ("tail_skewness_at_far_row_10000e", "")]
    }
    fn follows(&self) -> &'static str {
        "row"
    }
    fn name_rank(&self) -> u8 {
        2
    }
    fn sign(&self) -> Option<f64> {
        Some(1.0)
    }
    fn needs(&self) -> &'static str {
        "the brightness of the stars"
    }
    fn ordinary(&self) -> (f64, &'static str) {
        (0.02, "0.01 to 0.1 after years of radiation (Massey et al. 2014)")
    }
    /// The tail is light that the image lacks: a share in proportion to the way and to F^(−1/2); along the columns it widens the image, on one side.
    fn responses(&self, image: &ImageContext) -> Option<Vec<ImageResponse>> {
        let flux = image.relative_flux.filter(|flux| *flux > 0.0)?;
        let trail = image.rows_moved / flux.sqrt();
        let wider = ImageResponse { second_px2: [0.0, 0.0, trail], ..ImageResponse::default() };
        let skew = ImageResponse { skewness: [0.0, trail], ..ImageResponse::default() };
        Some(vec![ImageResponse::loss(trail), wider, skew])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tail of a packet in an empty column falls as the traps let go, by e^(−1/τ) a pixel, and begins with what the packet lost; the loss
    /// is that of the published equation.
    #[test]
    fn a_packet_leaves_the_published_tail() {
        let (rho, tau, row, packet) = (0.5, 3.0, 400_usize, 2_000.0_f64);
        let uniforms = TrappedCharge::uniforms(&[rho, tau, 0.0, 1.0, 0.0, 1.0, 1e5, 0.4, 50.0], &ExposureContext::default());
        let mut carry = Carry::default();
        let mut column = vec![0.0_f32; 480];
        column[row] = packet as f32;
        for (y, electrons) in column.iter_mut().enumerate() {
            *electrons = TrappedCharge::step(&uniforms, 0, [0, y], *electrons, &mut carry);
        }
        let traps = rho * (row as f64 + 1.0) * (packet / 1e5).powf(0.4);
        let taken = traps / (traps / packet + 1.0) * -(-50.0 * (packet / 1e5).powf(0.6)).exp_m1();
        let released = -(-1.0_f64 / tau).exp_m1();
        assert!((f64::from(column[row]) - (packet - taken + taken * released)).abs() < 2e-3, "{}", column[row]);
        let mut held = taken * (1.0 - released);
        for seen in &column[row + 1..row + 12] {
            let expected = held * released;
            held -= expected;
            assert!((f64::from(*seen) - expected).abs() < 1e-5 * packet, "{seen} for {expected}");
        }
        assert!(column[..row].iter().all(|electrons| *electrons == 0.0));
        let total: f64 = column.iter().map(|e| f64::from(*e)).sum::<f64>() + f64::from(carry[0]);
        assert!((total / packet - 1.0).abs() < 1e-6, "{total}");
    }
}
