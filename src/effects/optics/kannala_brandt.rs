//! # Kannala–Brandt projection
//!
//! ## What it does
//!
//! A fisheye as it is built: the equidistant law with four further odd terms, which fit every law of fisheyes and the
//! lens's departures from it. OpenCV calls it `fisheye`.
//!
//! ## Equation
//!
//! r = f·(θ + k1·θ³ + k2·θ⁵ + k3·θ⁷ + k4·θ⁹), θ = angle from the boresight, rad; (x, y) = (x0, y0) + r·(X, Y)/√(X² + Y²).
//! The inverse is found by Newton's method on r², as a function of θ² smooth at the centre, and ends where r no longer grows.
//!
//! ## Parameters
//!
//! `x0`, `y0`: the principal point, px; `f`: focal length over pixel pitch, the scale at the centre, px; `k1_theta` …
//! `k4_theta`: the coefficients, pure numbers, those of OpenCV's `fisheye`. The equisolid law is k1 = −1/24, k2 = 1/1920.
//!
//! ## Signature
//!
//! As a pinhole, a fisheye misses the stars by a cubic that k1 absorbs in a narrow field: about 1 % of
//! the distance from the centre at 10°, more than k1 can take from 20° on. Rings, if only the k's are wrong.
//!
//! ## Confused with
//!
//! The k's with one another and with f, the more the smaller the field: below 40° only f and k1 can be told apart.
//! k1_theta with the distortion k1, which should then be held at zero.
//!
//! ## Neglected
//!
//! Tangential terms: those are p1, p2 of the distortion. The pupil's walk with the angle, which stars cannot show.
//!
//! ## Source
//!
//! J. Kannala and S. S. Brandt, IEEE TPAMI 28(8), 1335 (2006); the same in OpenCV, `fisheye`.

use super::field_angle::{angle_over_sine, sine_over_angle_and_cosine};
use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, ParameterSpec, ReferenceValue, Segment, StarState, invert};

/// The Kannala–Brandt projection.
#[derive(Clone, Copy, Debug)]
pub struct KannalaBrandt;

/// 1 + k1·u + k2·u² + k3·u³ + k4·u⁴ and its slope, u = θ².
fn polynomial<T: Real>(k: [T; 4], u: T) -> [T; 2] {
    let value = (((k[3] * u + k[2]) * u + k[1]) * u + k[0]) * u + 1.0;
    let slope = ((k[3] * 4.0 * u + k[2] * 3.0) * u + k[1] * 2.0) * u + k[0];
    [value, slope]
}

/// (r/f)² and its slope, as a function of u = θ².
fn square_of_radius<T: Real>(k: [T; 4], u: T) -> [T; 2] {
    let [value, slope] = polynomial(k, u);
    [u * value * value, value * (value + u * slope * 2.0)]
}

/// The first stretch of θ² on which (r/f)² reaches `target` or stops growing, or `None` if it does neither up to θ = π.
fn bracket(k: [f64; 4], target: f64) -> Option<[f64; 2]> {
    const STRETCHES: usize = 32;
    let edge = |number: usize| (std::f64::consts::PI * number as f64 / STRETCHES as f64).powi(2);
    for number in 1..=STRETCHES {
        let [reached, slope] = square_of_radius(k, edge(number));
        if reached >= target || slope <= 0.0 {
            return Some([edge(number - 1), edge(number)]);
        }
    }
    None
}

impl Displacement for KannalaBrandt {
    const ID: &'static str = "kannala-brandt";
    const FACTS: Facts = Facts { demo_sizes: &[("k1_theta", -0.4)], ..Facts::NONE };
    const SEGMENT: Segment = Segment::Projection;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "y0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "f", unit: "px", typical: 500.0, range: (1.0, 1e8) },
        ParameterSpec { name: "k1_theta", unit: "", typical: -0.04, range: (-10.0, 10.0) },
        ParameterSpec { name: "k2_theta", unit: "", typical: 0.01, range: (-10.0, 10.0) },
        ParameterSpec { name: "k3_theta", unit: "", typical: -0.005, range: (-10.0, 10.0) },
        ParameterSpec { name: "k4_theta", unit: "", typical: 0.002, range: (-10.0, 10.0) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y, _] = light.direction;
        let angle_over_sine = angle_over_sine(light.direction);
        let angle_square = (x * x + y * y) * angle_over_sine * angle_over_sine;
        let [growth, _] = polynomial([3, 4, 5, 6].map(|index| parameters[index]), angle_square);
        let scale = parameters[2] * angle_over_sine * growth;
        Light { point_px: [parameters[0] + x * scale, parameters[1] + y * scale], ..light }
    }

    fn ray<T: Real>(parameters: &[T], light: Light<T>) -> Option<[T; 3]> {
        let k = [3, 4, 5, 6].map(|index| parameters[index]);
        let [x, y] = light.point_px.map(|coordinate| coordinate / parameters[2]);
        let target = x * x + y * y;
        let [start, largest] = bracket(k.map(Real::value), target.value())?;
        let angle_square = invert(target, start, largest, |u| square_of_radius(k, u))?;
        let [growth, _] = polynomial(k, angle_square);
        let [sine_over_angle, cosine] = sine_over_angle_and_cosine(angle_square);
        let across = sine_over_angle / growth;
        Some([x * across, y * across, cosine])
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
        // opencv-python-headless 5.0.0.93: fisheye.projectPoints of the direction with K = [[500, 0, 512], [0, 500, 380], [0, 0, 1]] and D
        // = [-0.02, 0.004, -0.003, 0.001]. The last direction lies 99.9° from the boresight, where OpenCV has no image: numpy.
        [
            (
                "OpenCV 5.0.0, fisheye.projectPoints",
                [0.107_832_773_203_438_41, -0.215_665_546_406_876_82, 0.970_494_958_830_945_7],
                [566.389_141_982_820_5, 271.221_716_034_358_8],
            ),
            (
                "OpenCV 5.0.0, fisheye.projectPoints",
                [0.829_561_355_784_340_2, 0.518_475_847_365_212_6, 0.207_390_338_946_085_05],
                [1_071.746_289_201_966_2, 729.841_430_751_228_8],
            ),
            (
                "the published equation, numpy 2.4.6",
                [-0.572_598_334_313_868_2, 0.801_637_668_039_415_5, -0.171_779_500_294_160_45],
                [16.839_388_366_643_618, 1_073.224_856_286_699],
            ),
        ]
        .into_iter()
        .map(|(source, direction, point_px)| ReferenceValue {
            source,
            context: Context::new(StarState::default(), Observation::default()),
            parameters: vec![512.0, 380.0, 500.0, -0.02, 0.004, -0.003, 0.001],
            before: Light::from(direction),
            after: Light { point_px, ..Light::from(direction) },
            tolerance: 1e-10,
        })
        .collect()
    }

    fn source() -> &'static str {
        page_source!("kannala_brandt.rs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_image_ends_where_the_radius_no_longer_grows() {
        // r = f (θ − 0.2 θ³) is largest at θ = 1.291 rad, where it is 0.8607 f.
        let parameters = [0.0, 0.0, 500.0, -0.2, 0.0, 0.0, 0.0];
        let at = |radius: f64| {
            KannalaBrandt::ray(&parameters, Light { point_px: [radius * 300.0, radius * 400.0], ..Light::from([0.0, 0.0, 1.0]) })
        };
        for theta in [0.0, 1e-9, 0.3, 1.28_f64] {
            let [x, y, z] = at(theta - 0.2 * theta.powi(3)).unwrap();
            assert!((x.hypot(y).atan2(z) - theta).abs() < 1e-13, "{theta}");
        }
        assert!(at(0.862).is_none());
    }
}
