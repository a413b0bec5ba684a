//! # Equidistant projection
//!
//! ## What it does
//!
//! A fisheye whose distances from the centre are proportional to the angle from the boresight (zenithal equidistant,
//! f-theta).
//!
//! ## Equation
//!
//! r = f·θ, θ = angle from the boresight; (x, y) = (x0, y0) + r·(X, Y)/√(X² + Y²). Directions up to θ < 180° have an image.
//!
//! ## Parameters
//!
//! `x0`, `y0`: the principal point, the pixel that the boresight falls on; `f`: focal length over pixel pitch, the scale at
//! the centre. All in px.
//!
//! ## Signature
//!
//! As a pinhole, a fisheye misses the stars by a cubic that k1 absorbs in a narrow field:
//! θ²/3 = 1.0 % of the distance from the centre at 10°, more than k1 can take from 20° on. A pinhole has no image at 90° at all.
//!
//! ## Confused with
//!
//! The equisolid and stereographic projections and k1, by f·θ³, in fields below about 40°.
//!
//! ## Neglected
//!
//! Departures of a real lens from the ideal law: those are the terms of `kannala-brandt`.
//!
//! ## Source
//!
//! M. R. Calabretta and E. W. Greisen, A&A 395, 1077 (2002), section 5.1 (ARC).

use super::field_angle::{angle_over_sine, sine_over_angle_and_cosine};
use crate::dual::Real;
use crate::effects::{Context, Displacement, Light, Observation, ParameterSpec, ReferenceValue, Segment, StarState};

/// The equidistant projection.
#[derive(Clone, Copy, Debug)]
pub struct Equidistant;

impl Displacement for Equidistant {
    const ID: &'static str = "equidistant";
    const SEGMENT: Segment = Segment::Projection;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "y0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "f", unit: "px", typical: 500.0, range: (1.0, 1e8) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let scale = parameters[2] * angle_over_sine(light.direction);
        Light { point_px: [parameters[0] + light.direction[0] * scale, parameters[1] + light.direction[1] * scale], ..light }
    }

    fn ray<T: Real>(parameters: &[T], light: Light<T>) -> Option<[T; 3]> {
        let [x, y] = light.point_px.map(|coordinate| coordinate / parameters[2]);
        let square = x * x + y * y;
        if square.value() >= std::f64::consts::PI * std::f64::consts::PI {
            return None;
        }
        let [sine_over_angle, cosine] = sine_over_angle_and_cosine(square);
        Some([x * sine_over_angle, y * sine_over_angle, cosine])
    }

    fn unmet_requirement(_: &Observation) -> Option<&'static str> {
        None
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        None
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // astropy 8.0.2: WCS with CTYPE GLON-ARC, GLAT-ARC, CRVAL (0, 0), CDELT (180/(500 π)), wcs_world2pix of the longitude atan2(x, z)
        // and the latitude asin(y), counted from 0; the last direction lies 99.9° from the boresight.
        [
            ([0.107_832_773_203_438_41, -0.215_665_546_406_876_82, 0.970_494_958_830_945_7], [566.452_993_427_608, 271.094_013_144_783_96]),
            (
                [0.829_561_355_784_340_2, 0.518_475_847_365_212_6, 0.207_390_338_946_085_05],
                [1_089.440_114_204_493_5, 740.900_071_377_808_4],
            ),
            (
                [-0.572_598_334_313_868_2, 0.801_637_668_039_415_5, -0.171_779_500_294_160_45],
                [5.325_348_283_660_844, 1_089.344_512_402_875],
            ),
        ]
        .into_iter()
        .map(|(direction, point_px)| ReferenceValue {
            source: "astropy 8.0.2, WCS ARC",
            context: Context::new(StarState::default(), Observation::default()),
            parameters: vec![512.0, 380.0, 500.0],
            before: Light::from(direction),
            after: Light { point_px, ..Light::from(direction) },
            tolerance: 1e-10,
        })
        .collect()
    }

    fn source() -> &'static str {
        page_source!("equidistant.rs")
    }
}
