//! # Dispersion of a wedge
//!
//! ## What it does
//!
//! A window or filter whose faces are not parallel is a prism: it deflects all light by (n − 1) times its angle, and since n
//! depends on the wavelength, red stars less than blue ones.
//!
//! ## Equation
//!
//! With c = B − V − 0.6: Δ = c·(w_x, w_y), the same all over the field; the ideal point is the measured one minus Δ. The
//! deflection at c = 0 is part of the attitude. A star of unknown colour counts as one with c = 0.
//!
//! ## Parameters
//!
//! `x_px_per_mag`, `y_px_per_mag` (w): displacement per magnitude of B − V, px. For a wedge of angle α: f·α·dn/d(B − V).
//!
//! ## Signature
//!
//! Residuals in proportion to the colour, in one direction of the camera, the same all over the field and
//! in all frames: 0.002 to 0.05 px per magnitude.
//!
//! ## Confused with
//!
//! Chromatic refraction in air, which points to the zenith instead: frames at several parallactic angles or two rolls of
//! the camera tell them apart.
//!
//! ## Neglected
//!
//! Terms in c²; the increase of the deflection with the angle of incidence, 3 % at the edge of a field of 20°.
//!
//! ## Source
//!
//! The deviation of a thin prism, δ = (n − 1)·α: M. Born, E. Wolf, Principles of Optics (1999), section 4.7.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// A displacement in proportion to the star's colour, the same all over the field.
#[derive(Clone, Copy, Debug)]
pub struct WedgeColour;

impl Displacement for WedgeColour {
    const ID: &'static str = "wedge-colour";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(0.02, "0.002 to 0.05 px/mag: a window's deviation (n − 1)·α and its dispersion")),
        profile_covariates: &[("", "colour")],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x_px_per_mag", unit: "px/mag", typical: 0.02, range: (-5.0, 5.0) },
        ParameterSpec { name: "y_px_per_mag", unit: "px/mag", typical: 0.02, range: (-5.0, 5.0) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let colour = context.star.colour_offset();
        Light { point_px: [x - parameters[0] * colour, y - parameters[1] * colour], ..light }
    }

    fn unmet_requirement(_: &Observation) -> Option<&'static str> {
        None
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 2])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // Snell's law without approximation, mpmath 1.4.1 with 30 digits: a wedge of 20' in the direction (0.6, -0.8), light along the normal
        // of its first face, n = 1.5168 - 4e-4·c, deflection asin(n·sin α) - α, images at 2900 px times its tangent. Measured: the star of
        // B - V = 0.9; ideal: that of 0.6. The parameters are 2900·α·(-4e-4)·(0.6, -0.8); the thin prism neglects α² ≈ 4e-5 of them.
        vec![ReferenceValue::of_point(
            "Snell's law in a wedge, mpmath 1.4.1",
            Context::new(StarState { colour: Some(0.9), ..StarState::default() }, Observation::default()),
            vec![-0.004_049_163_864_626_845, 0.005_398_885_152_835_793],
            2900.0,
            [512.0; 2],
            [[5.230_433_340_249_769, -6.973_911_120_333_025], [5.231_648_140_830_432, -6.975_530_854_440_576]],
            2e-7,
        )]
    }

    fn source() -> &'static str {
        page_source!("wedge_colour.rs")
    }
}
