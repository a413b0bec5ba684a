//! # A projection that is not quite the model's
//!
//! ## What it does
//!
//! Wide-angle lenses compress the field on purpose: f·θ, 2f·sin(θ/2) and 2f·tan(θ/2) instead of f·tan θ. Taken for a pinhole
//! such a camera shows a strong radial distortion that follows the angle θ, which no polynomial in the radius does for long.
//!
//! ## Equation
//!
//! The measured radius is f·(tan θ + t·θ³), with θ = atan(r̄/f) evaluated from the MEASURED point (x̄, ȳ) relative to the
//! principal point, r̄² = x̄² + ȳ²: Δ = f·t·θ³·(x̄, ȳ)/r̄, and the ideal point is (x̄, ȳ) − Δ.
//!
//! ## Parameters
//!
//! `theta3_norm` (t), a pure number: to third order −1/3 for f·θ, −3/8 for 2f·sin(θ/2), −1/4 for 2f·tan(θ/2), 0 for a
//! pinhole. −1/3 displaces a star 10° from the axis by −5.2 px with f = 2900 px.
//!
//! ## Signature
//!
//! Residuals along the radius. With t = −1/3 and the edge at 512 px from the axis, f and k1 leave 0.006 px
//! rms of it if that edge is at 10°, 0.1 px at 20°, 0.5 px at 30°.
//!
//! ## Confused with
//!
//! k1, and what k1 leaves with higher radial distortion: with k2 and k3 free as well, 5e-6 px at 14°, 0.002 px at 30° and
//! 0.06 px at 45° are left (least squares on the equation above), so only wide fields tell them apart.
//!
//! ## Neglected
//!
//! θ⁵ and beyond, and the difference between the angle of the measured point and the true one, together 7θ⁵/15 of f for f·θ:
//! 0.2 px at 10° with f = 2900 px. A camera that truly has one of the other projections is better modelled by that projection.
//!
//! ## Source
//!
//! J. Kannala, S. Brandt, IEEE Trans. PAMI 28(8), 1335 (2006).

use super::field_angle::angle_over_sine;
use crate::dual::{Real, normalize};
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// The third order in the angle from the axis, as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct ProjectionMismatch;

impl Displacement for ProjectionMismatch {
    const ID: &'static str = "projection";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(1.0 / 3.0, "the cubic term of a fisheye beside a pinhole (Kannala and Brandt 2006)")),
        profile_covariates: &[("", "field-radius")],
        name_rank: 2,
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "theta3_norm", unit: "", typical: -1.0 / 3.0, range: (-1.0, 1.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        // θ/tan θ = (θ/sin θ)·cos θ stays finite on the axis, where θ and r̄ alone have no derivative.
        let ray = normalize([x, y, light.focal_length_px]);
        let angle_over_tangent = angle_over_sine(ray) * ray[2];
        let tangent_square = (x * x + y * y) / (light.focal_length_px * light.focal_length_px);
        let factor = parameters[0] * tangent_square * angle_over_tangent * angle_over_tangent * angle_over_tangent;
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
        // OpenCV's fisheye model puts a direction at f·(θ + k·θ³) from the centre, so the difference between k = 1/3 and k = 0 is the term of
        // this effect with t = -1/3: opencv-python-headless 5.0.0.93, [410, -330] + fisheye.distortPoints([[[410/600, -330/600]]],
        // diag(600, 600, 1), [1/3, 0, 0, 0]) - the same with [0, 0, 0, 0]. The second case is so close to the axis that a series is
        // used: [3, -4] and [1/2, 0, 0, 0].
        let case = |parameter: f64, points: [[f64; 2]; 2], tolerance: f64| {
            let context = Context::new(StarState::default(), Observation::default());
            ReferenceValue::of_point("OpenCV, fisheye.distortPoints", context, vec![parameter], 600.0, [512.0; 2], points, tolerance)
        };
        vec![
            case(-1.0 / 3.0, [[410.0, -330.0], [468.168_239_601_944_83, -376.818_339_191_809_3]], 1e-10),
            case(-0.5, [[3.0, -4.0], [3.000_104_159_433_339, -4.000_138_879_244_453]], 1e-10),
        ]
    }

    fn source() -> &'static str {
        page_source!("projection.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Jet;

    #[test]
    fn on_the_axis_it_does_nothing_and_has_derivatives() {
        let context = Context::new(StarState::default(), Observation::default());
        let zero = Jet::constant(0.0);
        let axis = Light {
            point_px: [Jet::variable(0.0, 0), Jet::variable(0.0, 1)],
            focal_length_px: Jet::constant(2000.0),
            ..Light::from([zero, zero, Jet::constant(1.0)])
        };
        let [x, y] = ProjectionMismatch::displace(&[Jet::variable(-0.3, 2)], axis, &context).point_px;
        for (component, slopes) in [(x, [1.0, 0.0, 0.0]), (y, [0.0, 1.0, 0.0])] {
            assert!(component.value.abs() < 1e-300, "{component:?}");
            assert!(component.partials.iter().zip(slopes).all(|(got, want)| (got - want).abs() < 1e-300), "{component:?}");
        }
    }
}
