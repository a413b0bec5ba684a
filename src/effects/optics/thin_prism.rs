//! # Thin prism
//!
//! ## What it does
//!
//! A lens element that is tilted, or a plate that is not plane-parallel, near the image: the displacement has one direction
//! everywhere and grows with the square of the distance from the axis.
//!
//! ## Equation
//!
//! With ρ² = (x̄² + ȳ²)/h², (x̄, ȳ) the MEASURED point relative to the principal point and h half the frame's width:
//! Δ = (s1·ρ², s2·ρ²), and the ideal point is (x̄, ȳ) − Δ.
//!
//! ## Parameters
//!
//! `s1_px`, `s2_px`: the displacement at half the frame's width from the principal point, px. OpenCV's s1 and s3, which are
//! added to the ideal point, are s1_px·f/h² and s2_px·f/h² to first order.
//!
//! ## Signature
//!
//! Nothing: p1 and p2 together with the frames' attitudes reproduce it, exactly in the second order.
//! 0.01 to 0.3 px before that.
//!
//! ## Confused with
//!
//! p1, p2 and the attitude, entirely. Only an attitude from elsewhere tells them apart, or a prism that disperses, which
//! then is a colour effect.
//!
//! ## Neglected
//!
//! Terms in ρ⁴; the dispersion of the prism.
//!
//! ## Source
//!
//! D. C. Brown, Photogrammetric Engineering 32(3), 444 (1966); J. Weng, P. Cohen, M. Herniou, IEEE Trans. PAMI 14(10), 965
//! (1992).

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Thin-prism distortion as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct ThinPrism;

impl Displacement for ThinPrism {
    const ID: &'static str = "thin-prism";
    const FACTS: Facts = Facts { ordinary_size: Some(OrdinarySize::of(0.05, "0.01 to 0.3 px (Brown 1966)")), ..Facts::NONE };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "s1_px", unit: "px", typical: 0.05, range: (-50.0, 50.0) },
        ParameterSpec { name: "s2_px", unit: "px", typical: 0.05, range: (-50.0, 50.0) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let Some(sensor) = context.observation.sensor else {
            return light;
        };
        let [x, y] = light.point_px;
        let (xi, eta) = (x / sensor.half_width_px(), y / sensor.half_width_px());
        let square = xi * xi + eta * eta;
        Light { point_px: [x - parameters[0] * square, y - parameters[1] * square], ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.sensor.is_none().then_some("the size of the frame is not known")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 2])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // OpenCV adds its distortion to the point that it is given, this model takes its own away, so the signs are turned:
        // opencv-python-headless 5.0.0.93, projectPoints([[410/2000, -330/2000, 1]], 0, 0, diag(2000, 2000, 1),
        // [0, 0, 0, 0, 0, 0, 0, 0, -0.2*2000/512**2, 0, 0.3*2000/512**2, 0]): s1 and s3 of a frame 1024 px wide.
        vec![ReferenceValue::of_point(
            "OpenCV, projectPoints with s1 and s3",
            Context::new(StarState::default(), Observation::of_sensor(1024, 768)),
            vec![0.2, -0.3],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [409.788_665_771_484_4, -329.682_998_657_226_56]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("thin_prism.rs")
    }
}
