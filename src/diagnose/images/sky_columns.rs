//! What effects do to the level of the sky over the frame, per unit of their parameters.

use super::rows::{Parameter, Shown};
use super::sky_light::{SkyFrame, SkyLight};
use crate::effects::detector::amplifier_step::AmplifierHalves;
use crate::effects::detector::stray_light::StrayLightSlope;
use crate::effects::optics::vignetting::{Vignetting, orders};
use crate::effects::pixel::PixelEffect;

/// Glow of the electronics at a corner; the registry renders none.
pub(super) const AMPLIFIER_GLOW: &str = "amplifier-glow";
/// Distances (in half-diagonals) over which a glow may fall by a factor of e: each is longer than the one before by a quarter.
const GLOW_LENGTHS: [f64; 10] = [0.08, 0.1, 0.125, 0.156, 0.195, 0.244, 0.305, 0.381, 0.477, 0.596];
/// Corners from the top left one clockwise: signs of x and y.
const CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];

/// An effect with its columns over the cells.
#[derive(Clone, Debug)]
pub(super) struct Asked {
    pub(super) id: &'static str,
    pub(super) follows: &'static str,
    pub(super) columns: Vec<(Parameter, Vec<f64>)>,
    pub(super) sign: Option<f64>,
    /// Whether the stars' columns of the same effect belong to it.
    pub(super) is_shared: bool,
    /// The corner that it is about.
    pub(super) corner: Option<u8>,
}

/// Sizes that real cameras have, of the first column, and where they are from.
const ORDINARY: &[(&str, f64, &str)] = &[
    (AMPLIFIER_GLOW, 1.0, "an electron a second at the corner, as CMOS sensors have in long exposures"),
    (<StrayLightSlope as PixelEffect>::ID, 0.1, "the typical slope of the effect's page"),
];

/// The size that real cameras have.
pub(super) fn ordinary(id: &str) -> Option<(f64, &'static str)> {
    ORDINARY.iter().find(|(own, ..)| *own == id).map(|(_, size, source)| (*size, *source))
}

const fn parameter(name: &'static str, unit: &'static str) -> Parameter {
    Parameter { name, unit, shown: Shown::Same }
}

/// Rates of light: in electrons where a gain is known, else in counts.
struct Rates {
    /// Counts per unit.
    dn: f64,
    /// Slopes along columns and rows, and a rate at a corner.
    parameters: [Parameter; 3],
}

impl Rates {
    fn new(gain_e_per_dn: Option<f64>) -> Self {
        let slope = |name| parameter(name, if gain_e_per_dn.is_some() { "e-/px²/s" } else { "DN/px/s" });
        let parameters = match gain_e_per_dn {
            Some(_) => [slope("slope_x_e_per_px_s"), slope("slope_y_e_per_px_s"), parameter("e_per_px_s", "e-/px/s")],
            None => [slope("slope_x_dn_per_px_s"), slope("slope_y_dn_per_px_s"), parameter("dn_per_s", "DN/s")],
        };
        Self { dn: gain_e_per_dn.map_or(1.0, f64::recip), parameters }
    }
}

/// The effects that can be asked for, and of the others why not.
pub(super) fn asked(light: &SkyLight, gain_e_per_dn: Option<f64>, knows_bias: bool) -> (Vec<Asked>, Vec<(&'static str, String)>) {
    let one = |id: &'static str, follows, columns, sign| Asked { id, follows, columns, sign, is_shared: true, corner: None };
    let mut all = Vec::new();
    let mut unasked = Vec::new();
    let radius2 = |at: [f64; 2]| at[0] * at[0] + at[1] * at[1];
    // The light itself falls; without a bias nobody knows how much of the level is light.
    let whole = |frame: &SkyFrame| if light.is_relative { 1.0 } else { frame.light_dn };
    if knows_bias {
        let lost = |(name, order): (&'static str, usize)| {
            (parameter(name, ""), light.column(|frame, cell| -whole(frame) * orders(radius2(cell.at))[order]))
        };
        let columns = [("loss_at_corner", 0), ("loss_fourth_order", 1), ("loss_sixth_order", 2)].map(lost).into();
        all.push(one(<Vignetting as PixelEffect>::ID, "field-radius", columns, Some(1.0)));
    }
    let mut halves = Vec::new();
    for (axis, gain, offset) in [(1, "gain_relative", "offset_dn"), (0, "gain_right_relative", "offset_right_dn")] {
        let is_beyond = |at: [f64; 2]| if at[axis] > 0.0 { 1.0 } else { 0.0 };
        if knows_bias {
            halves.push((parameter(gain, ""), light.column(|frame, cell| whole(frame) * is_beyond(cell.at))));
        }
        halves.push((parameter(offset, "DN"), light.added(|_, cell| is_beyond(cell.at))));
    }
    all.push(one(<AmplifierHalves as PixelEffect>::ID, "row", halves, None));
    if light.frames.iter().any(|frame| frame.exposure_s.is_none()) {
        let lacks = "it needs exposure times".to_owned();
        unasked.extend([(AMPLIFIER_GLOW, lacks.clone()), (<StrayLightSlope as PixelEffect>::ID, lacks)]);
        return (all, unasked);
    }
    let of_rates = Rates::new(gain_e_per_dn);
    // What a rate adds to the number.
    let by_rate = |shape: &dyn Fn(&SkyFrame, [f64; 2]) -> f64| {
        light.added(|frame, cell| frame.exposure_s.unwrap_or(0.0) * of_rates.dn * shape(frame, cell.at))
    };
    let [along_x, along_y, of_glow] = of_rates.parameters;
    let slopes = [(along_x, 0), (along_y, 1)].map(|(parameter, axis)| (parameter, by_rate(&|frame, at| at[axis] * frame.half_px)));
    all.push(one(<StrayLightSlope as PixelEffect>::ID, "x", slopes.into(), None));
    for (corner, signs) in (0..).zip(CORNERS) {
        for length in GLOW_LENGTHS {
            let shape = |frame: &SkyFrame, at: [f64; 2]| {
                let [dx, dy] = [0, 1].map(|axis| at[axis] - signs[axis] * frame.edge[axis]);
                (-dx.hypot(dy) / length).exp()
            };
            all.push(Asked {
                id: AMPLIFIER_GLOW,
                follows: "edge-distance",
                columns: vec![(of_glow, by_rate(&shape))],
                sign: Some(1.0),
                is_shared: false,
                corner: Some(corner),
            });
        }
    }
    if !knows_bias {
        unasked.push((<Vignetting as PixelEffect>::ID, "in the sky it needs a bias".to_owned()));
    }
    (all, unasked)
}
