//! # Higher radial distortion: k2, k3
//!
//! ## What it does
//!
//! The magnification of a lens changes with the distance from the axis. The cubic term k1 of the reference model is the
//! first member of a series in odd powers of the radius; strong or fast lenses need the fifth (k2) and the seventh (k3) as well.
//!
//! ## Equation
//!
//! At the MEASURED point (x̄, ȳ) relative to the principal point, R² = (x̄² + ȳ²)/f²:
//! Δ = (k2·R⁴ + k3·R⁶)·(x̄, ȳ), and the ideal point is (x̄, ȳ) − Δ.
//!
//! ## Parameters
//!
//! `k2_norm`, `k3_norm`: pure numbers, since the radius counts in focal lengths. To first order they are OpenCV's k2 and
//! k3, which are added to the ideal point instead; a strong k1 of that convention brings −3·k1² to k2 of this one. k2 = 0.1 or k3 = 3
//! displaces a star by 0.05 px at 512 px from the axis with f = 2900 px.
//!
//! ## Signature
//!
//! Rings: residuals along the radius, the same in all frames and all around, that change sign between
//! the axis and the corner. 0.01 to 0.1 px at the edge are usual for a star tracker, up to 1 px for a consumer camera. f and k1 take
//! up 85 % of k2 and 71 % of k3 in a field of 20°.
//!
//! ## Confused with
//!
//! k2 and k3 with each other (the cosine of what is left of them is 0.988): naming one of the two needs stars in the
//! corners and a total signal of some 30 sigma, and without that only the class is known. In a narrow field also a plane plate in the
//! converging beam, whose remainder is the same as that of k2, and a wrong projection.
//!
//! ## Neglected
//!
//! R⁸ and beyond: with f = 2900 px it would have to be 30 times k3 to move a star at 512 px as much.
//!
//! ## Source
//!
//! D. C. Brown, Photogrammetric Engineering 37(8), 855 (1971); A. Conrady, MNRAS 79, 384 (1919).

use crate::dual::Real;
use crate::effects::{
    Context, Displacement, Facts, Light, ModelGroup, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState,
};

/// Radial distortion of the fifth and seventh order as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct RadialHighOrder;

impl Displacement for RadialHighOrder {
    const ID: &'static str = "radial-high-order";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::largest_px(0.1, "0.05 to 1 px at the edge of commercial lenses (Brown 1971)")),
        profile_covariates: &[("", "field-radius")],
        name_rank: 0,
        is_even_in_mirror: true,
        short_names: &[("k2", Some("k2_norm")), ("k3", Some("k3_norm"))],
        model_groups: &[
            ModelGroup { names: &["k2"], preference: 1, is_radial_term: true },
            ModelGroup { names: &["k3"], preference: 2, is_radial_term: true },
        ],
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "k2_norm", unit: "", typical: 0.1, range: (-1e3, 1e3) },
        ParameterSpec { name: "k3_norm", unit: "", typical: 3.0, range: (-1e5, 1e5) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let square = (x * x + y * y) / (light.focal_length_px * light.focal_length_px);
        let factor = (parameters[0] + parameters[1] * square) * square * square;
        Light { point_px: [x - factor * x, y - factor * y], ..light }
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
        // OpenCV adds its distortion to the point that it is given, this model takes its own away, so the signs are turned:
        // opencv-python-headless 5.0.0.93,
        // projectPoints([[410/2000, -330/2000, 1]], 0, 0, diag(2000, 2000, 1), [0, -k2, 0, 0, -k3]) with k2 = 0.4, k3 = -6.
        vec![ReferenceValue::of_point(
            "OpenCV, projectPoints with k2 and k3",
            Context::new(StarState::default(), Observation::default()),
            vec![0.4, -6.0],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [410.030_475_799_687_45, -330.024_529_302_187_43]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("radial_high_order.rs")
    }
}
