//! # Lateral colour
//!
//! ## What it does
//!
//! The focal length of a lens depends on the wavelength, so red and blue stars are imaged at different scales.
//!
//! ## Equation
//!
//! With c = B − V − 0.6, at the MEASURED point (x̄, ȳ) relative to the principal point: Δ = c·q·(x̄, ȳ), and the ideal point is
//! (x̄, ȳ) − Δ. A star of unknown colour counts as one with c = 0.
//!
//! ## Parameters
//!
//! `relative_scale_per_mag` (q): relative change of the scale per magnitude of B − V; positive: red stars lie further out.
//! 1e-4 displaces a star one magnitude redder than the Sun by 0.05 px at 512 px from the axis.
//!
//! ## Signature
//!
//! Residuals along the radius in proportion to radius and colour: 0.02 to 0.1 px per magnitude at the edge
//! for a star tracker, 0.2 to 1 px for a consumer camera. Hardly any of it is taken up by other parameters (0.98 survives).
//!
//! ## Confused with
//!
//! Its own cubic member, c·r³ (cosine 0.92); chromatic refraction a little (0.26). Stars of both extremes of colour at all
//! radii tell them apart.
//!
//! ## Neglected
//!
//! The cubic member and terms in c²: an effective wavelength is not linear in B − V, and red giants and reddened blue stars of
//! one colour differ.
//!
//! ## Source
//!
//! Characterization of chromatic effects in small star trackers, 30th AIAA/USU Conference on Small Satellites (2016): a focal
//! length for every star improved the separations of stars by 3 to 15 % on six trackers in flight.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// A scale in proportion to the star's colour, as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct LateralColour;

impl Displacement for LateralColour {
    const ID: &'static str = "lateral-colour";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(
            1e-4,
            "0.02 to 0.1 px/mag at the edge of star trackers (SmallSat 2016), 0.2 to 1 of commercial lenses",
        )),
        profile_covariates: &[("", "colour")],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "relative_scale_per_mag", unit: "1/mag", typical: 1e-4, range: (-0.01, 0.01) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let factor = parameters[0] * context.star.colour_offset();
        Light { point_px: [x - factor * x, y - factor * y], ..light }
    }

    fn unmet_requirement(_: &Observation) -> Option<&'static str> {
        None
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // opencv-python-headless 5.0.0.93: 2000 times undistortPoints([[[410, -330]]], diag(f, f, 1), 0) with the focal length of a star of
        // B - V = 0.9, f = 2000·(1 + 0.3·2e-4). The exact ratio differs from the first order by (0.3·2e-4)² of the coordinate, 1.5e-6 px.
        vec![ReferenceValue::of_point(
            "OpenCV, undistortPoints with the focal length of a colour",
            Context::new(StarState { colour: Some(0.9), ..StarState::default() }, Observation::default()),
            vec![2e-4],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [409.975_401_475_911_44, -329.980_201_187_928_74]],
            2e-6,
        )]
    }

    fn source() -> &'static str {
        page_source!("lateral_colour.rs")
    }
}
