//! # Equisolid projection
//!
//! ## What it does
//!
//! A fisheye that shows equal solid angles as equal areas (zenithal equal-area, Lambert); the most common law of fisheyes
//! for photography.
//!
//! ## Equation
//!
//! r = 2·f·sin(θ/2), θ = angle from the boresight; (x, y) = (x0, y0) + f·(X, Y)·√(2/(1 + Z)). The whole sky lies within r <
//! 2f.
//!
//! ## Parameters
//!
//! `x0`, `y0`: the principal point, the pixel that the boresight falls on; `f`: focal length over pixel pitch, the scale at
//! the centre. All in px.
//!
//! ## Signature
//!
//! As a pinhole, a fisheye misses the stars by a cubic that k1 absorbs in a narrow field:
//! 3θ²/8 = 1.1 % of the distance from the centre at 10°, more than k1 can take from 20° on. A pinhole has no image at 90° at all.
//!
//! ## Confused with
//!
//! The equidistant and stereographic projections and k1, by f·θ³, in fields below about 40°.
//!
//! ## Neglected
//!
//! Departures of a real lens from the ideal law: those are the terms of `kannala-brandt`.
//!
//! ## Source
//!
//! M. R. Calabretta and E. W. Greisen, A&A 395, 1077 (2002), section 5.1 (ZEA).

use crate::dual::Real;
use crate::effects::{Context, Displacement, Light, Observation, ParameterSpec, ReferenceValue, Segment, StarState};

/// The equisolid projection.
#[derive(Clone, Copy, Debug)]
pub struct Equisolid;

impl Displacement for Equisolid {
    const ID: &'static str = "equisolid";
    const SEGMENT: Segment = Segment::Projection;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "y0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "f", unit: "px", typical: 500.0, range: (1.0, 1e8) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y, z] = light.direction;
        let scale = parameters[2] * (T::constant(2.0) / (z + 1.0)).sqrt();
        Light { point_px: [parameters[0] + x * scale, parameters[1] + y * scale], ..light }
    }

    fn ray<T: Real>(parameters: &[T], light: Light<T>) -> Option<[T; 3]> {
        let [x, y] = light.point_px.map(|coordinate| coordinate / parameters[2]);
        let square = x * x + y * y;
        if square.value() >= 4.0 {
            return None;
        }
        let cosine_of_half = (-square * 0.25 + 1.0).sqrt();
        Some([x * cosine_of_half, y * cosine_of_half, -square * 0.5 + 1.0])
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
        // astropy 8.0.2: WCS with CTYPE GLON-ZEA, GLAT-ZEA, CRVAL (0, 0), CDELT (180/(500 π)), wcs_world2pix of the longitude atan2(x, z)
        // and the latitude asin(y), counted from 0; the last direction lies 99.9° from the boresight.
        [
            (
                [0.107_832_773_203_438_41, -0.215_665_546_406_876_82, 0.970_494_958_830_945_7],
                [566.318_543_030_031_8, 271.362_913_939_936_2],
            ),
            (
                [0.829_561_355_784_340_2, 0.518_475_847_365_212_6, 0.207_390_338_946_085_05],
                [1_045.838_223_545_543_3, 713.648_889_715_964_5],
            ),
            (
                [-0.572_598_334_313_868_2, 0.801_637_668_039_415_5, -0.171_779_500_294_160_45],
                [67.100_318_722_253_29, 1_002.859_553_788_845_5],
            ),
        ]
        .into_iter()
        .map(|(direction, point_px)| ReferenceValue {
            source: "astropy 8.0.2, WCS ZEA",
            context: Context::new(StarState::default(), Observation::default()),
            parameters: vec![512.0, 380.0, 500.0],
            before: Light::from(direction),
            after: Light { point_px, ..Light::from(direction) },
            tolerance: 1e-10,
        })
        .collect()
    }

    fn source() -> &'static str {
        page_source!("equisolid.rs")
    }
}
