//! # Pinhole projection
//!
//! ## What it does
//!
//! The ideal camera: a direction (X, Y, Z) in camera axes falls on x = x0 + f·X/Z, y = y0 + f·Y/Z. Every
//! other effect of the optics is a departure from it.
//!
//! ## Equation
//!
//! As above; its inverse is direction ∝ (x − x0, y − y0, f).
//!
//! ## Parameters
//!
//! `x0`, `y0`: the principal point, the pixel that the boresight falls on; `f`: focal length over pixel pitch. All in px.
//!
//! ## Signature
//!
//! A wrong f: a radial pattern, residuals ∝ radius (0.4 % of f is 2 px at 512 px from the centre). A wrong
//! principal point is nearly a rotation of the camera; what is left is quadratic in the field, (x0 error)·tan² of the field angle.
//!
//! ## Confused with
//!
//! Principal point with attitude, and with p1, p2 of the distortion in narrow fields; f with velocity along the
//! boresight (aberration).
//!
//! ## Neglected
//!
//! Nothing: it is the definition.
//!
//! ## Source
//!
//! Hartley and Zisserman, Multiple View Geometry, 2nd ed. (2004), section 6.1.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, ParameterSpec, ReferenceValue, Segment, StarState};

/// The pinhole projection with its principal point.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole;

/// A vector along the direction that falls on a point of the ideal focal plane (px); the inverse of the projection.
pub fn ray<T: Real>([x0, y0, f]: [T; 3], [x, y]: [T; 2]) -> [T; 3] {
    [x - x0, y - y0, f]
}

impl Displacement for Pinhole {
    const ID: &'static str = "pinhole";
    const FACTS: Facts = Facts { is_of_every_camera: true, not_shown: Some("every scene is taken through it"), ..Facts::NONE };
    const SEGMENT: Segment = Segment::Projection;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "x0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "y0", unit: "px", typical: 511.5, range: (-1e6, 1e6) },
        ParameterSpec { name: "f", unit: "px", typical: 3000.0, range: (1.0, 1e8) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y, z] = light.direction;
        let f = parameters[2];
        Light { point_px: [parameters[0] + x * f / z, parameters[1] + y * f / z], ..light }
    }

    fn ray<T: Real>(parameters: &[T], light: Light<T>) -> Option<[T; 3]> {
        Some([light.point_px[0], light.point_px[1], parameters[2]])
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
        // OpenCV 5.0.0 (opencv-python-headless 5.0.0.93): projectPoints([[0.1, -0.2, 0.9]], 0, 0, [[2000, 0, 512], [0, 2000, 380], [0, 0, 1]], None).
        let length = (0.01_f64 + 0.04 + 0.81).sqrt();
        let direction = [0.1 / length, -0.2 / length, 0.9 / length];
        let light = |point_px| Light { point_px, ..Light::from(direction) };
        vec![ReferenceValue {
            source: "OpenCV, projectPoints",
            context: Context::new(StarState::default(), Observation::default()),
            parameters: vec![512.0, 380.0, 2000.0],
            before: light([0.0, 0.0]),
            after: light([734.222_222_222_222_2, -64.444_444_444_444_43]),
            tolerance: 1e-10,
        }]
    }

    fn source() -> &'static str {
        page_source!("pinhole.rs")
    }
}
