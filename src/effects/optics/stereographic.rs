//! # Stereographic projection
//!
//! ## What it does
//!
//! A wide-angle projection that shows small circles on the sky as circles: it stretches towards the edge and keeps every
//! angle.
//!
//! ## Equation
//!
//! r = 2·f·tan(θ/2), θ = angle from the boresight; (x, y) = (x0, y0) + 2·f·(X, Y)/(1 + Z). Only the point straight behind has
//! no image.
//!
//! ## Parameters
//!
//! `x0`, `y0`: the principal point, the pixel that the boresight falls on; `f`: focal length over pixel pitch, the scale at
//! the centre. All in px.
//!
//! ## Signature
//!
//! As a pinhole, a fisheye misses the stars by a cubic that k1 absorbs in a narrow field:
//! θ²/4 = 0.8 % of the distance from the centre at 10°, more than k1 can take from 20° on. A pinhole has no image at 90° at all.
//!
//! ## Confused with
//!
//! The equidistant and equisolid projections and k1, by f·θ³, in fields below about 40°.
//!
//! ## Neglected
//!
//! Departures of a real lens from the ideal law.
//!
//! ## Source
//!
//! M. R. Calabretta and E. W. Greisen, A&A 395, 1077 (2002), section 5.1 (STG).

use crate::dual::Real;
use crate::effects::{Context, Displacement, Light, Observation, ParameterSpec, ReferenceValue, Segment, StarState};

/// The stereographic projection.
#[derive(Clone, Copy, Debug)]
pub struct Stereographic;

impl Displacement for Stereographic {
    const ID: &'static str = "stereographic";
    const SEGMENT: Segment = Segment::Projection;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "y0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "f", unit: "px", typical: 500.0, range: (1.0, 1e8) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y, z] = light.direction;
        let scale = parameters[2] * 2.0 / (z + 1.0);
        Light { point_px: [parameters[0] + x * scale, parameters[1] + y * scale], ..light }
    }

    fn ray<T: Real>(parameters: &[T], light: Light<T>) -> Option<[T; 3]> {
        let [x, y] = light.point_px.map(|coordinate| coordinate / parameters[2]);
        Some([x, y, -(x * x + y * y) * 0.25 + 1.0])
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
        // astropy 8.0.2: WCS with CTYPE GLON-STG, GLAT-STG, CRVAL (0, 0), CDELT (180/(500 π)), wcs_world2pix of the longitude atan2(x, z)
        // and the latitude asin(y), counted from 0; the last direction lies 99.9° from the boresight.
        [
            (
                [0.107_832_773_203_438_41, -0.215_665_546_406_876_82, 0.970_494_958_830_945_7],
                [566.723_699_099_140_7, 270.552_601_801_718_5],
            ),
            (
                [0.829_561_355_784_340_2, 0.518_475_847_365_212_6, 0.207_390_338_946_085_05],
                [1_199.069_731_325_209_4, 809.418_582_078_255_9],
            ),
            (
                [-0.572_598_334_313_868_2, 0.801_637_668_039_415_5, -0.171_779_500_294_160_45],
                [-179.359_770_154_492_6, 1_347.903_678_216_289_8],
            ),
        ]
        .into_iter()
        .map(|(direction, point_px)| ReferenceValue {
            source: "astropy 8.0.2, WCS STG",
            context: Context::new(StarState::default(), Observation::default()),
            parameters: vec![512.0, 380.0, 500.0],
            before: Light::from(direction),
            after: Light { point_px, ..Light::from(direction) },
            tolerance: 1e-10,
        })
        .collect()
    }

    fn source() -> &'static str {
        page_source!("stereographic.rs")
    }
}
