//! # Distortion: radial k1, decentring p1, p2
//!
//! ## What it does
//!
//! A lens images straight lines as curves: magnification changes with the distance from the axis (k1), and elements
//! that are not centred on one axis add a tangential part (p1, p2).
//!
//! ## Equation
//!
//! At the MEASURED point (x̄, ȳ) relative to the principal point, r² = x̄² + ȳ²:
//! Δx = k1·x̄·r² + p1·(3x̄² + ȳ²) + 2·p2·x̄·ȳ, Δy = k1·ȳ·r² + p2·(3ȳ² + x̄²) + 2·p1·x̄·ȳ, and the ideal point is (x̄ − Δx, ȳ − Δy).
//! The renderer inverts this.
//!
//! ## Parameters
//!
//! `k1` (px⁻²), `p1`, `p2` (px⁻¹). To first order k1 = k1_cv/f², p1 = p2_cv/f, p2 = p1_cv/f of OpenCV's convention,
//! which adds the distortion to the ideal point.
//!
//! ## Signature
//!
//! k1: residuals along the radius that grow as r³ (1 px at 512 px for k1 = 7.5e-9 px⁻²). p1, p2: a
//! quadratic field.
//!
//! ## Confused with
//!
//! k1 with the focal length in a narrow field; p1, p2 with the principal point.
//!
//! ## Neglected
//!
//! k2 and higher.
//!
//! ## Source
//!
//! D. C. Brown, Photogrammetric Engineering 32(3), 444 (1966); A. Conrady, MNRAS 79, 384 (1919); in this form: Wang, Cheng et
//! al., Applied Optics 54(21), 6425 (2015).

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, ParameterSpec, ReferenceValue, Segment, StarState};

/// Brown–Conrady distortion as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct BrownConrady;

/// The ideal point from the measured one, both relative to the principal point, px.
pub fn ideal_from_measured<T: Real>([k1, p1, p2]: [T; 3], [x, y]: [T; 2]) -> [T; 2] {
    let (xx, yy, xy) = (x * x, y * y, x * y);
    let radial = k1 * (xx + yy);
    let dx = radial * x + p1 * (xx * 3.0 + yy) + p2 * xy * 2.0;
    let dy = radial * y + p2 * (yy * 3.0 + xx) + p1 * xy * 2.0;
    [x - dx, y - dy]
}

impl Displacement for BrownConrady {
    const ID: &'static str = "brown-conrady";
    const FACTS: Facts = Facts { is_of_every_camera: true, demo_sizes: &[("k1", 2e-7), ("p1", 1e-6), ("p2", -1e-6)], ..Facts::NONE };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "k1", unit: "px^-2", typical: 5e-9, range: (-1e-4, 1e-4) },
        ParameterSpec { name: "p1", unit: "px^-1", typical: 1e-7, range: (-1e-2, 1e-2) },
        ParameterSpec { name: "p2", unit: "px^-1", typical: 1e-7, range: (-1e-2, 1e-2) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        Light { point_px: ideal_from_measured([parameters[0], parameters[1], parameters[2]], light.point_px), ..light }
    }

    fn unmet_requirement(_: &Observation) -> Option<&'static str> {
        None
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 3])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // OpenCV adds the distortion to the ideal point. Its point distorted with the coefficients (−k1·f², 0, −p2·f, −p1·f) must be the
        // ideal point of this model: opencv-python-headless 5.0.0.93, f = 2000:
        // projectPoints([[310/2000, -220/2000, 1]], 0, 0, diag(2000, 2000, 1), [-0.016, 0, 0.0006, -0.0004]) with k1 = 4e-9, p1 = 2e-7, p2 = -3e-7.
        vec![ReferenceValue::of_point(
            "OpenCV, projectPoints",
            Context::new(StarState::default(), Observation::default()),
            vec![4e-9, 2e-7, -3e-7],
            2000.0,
            [512.0; 2],
            [[310.0, -220.0], [309.712_56, -219.773_17]],
            1e-10,
        )]
    }

    fn source() -> &'static str {
        page_source!("brown_conrady.rs")
    }
}
