//! # Tilt of the detector
//!
//! ## What it does
//!
//! The detector is not perpendicular to the optical axis, so one side of it lies farther from the exit pupil than the other
//! and is magnified more.
//!
//! ## Equation
//!
//! At the MEASURED point (x̄, ȳ) relative to the principal point: Δ = (x̄, ȳ)·(x̄·τ_y − ȳ·τ_x)/f, the homography between the
//! two planes to first order in τ; the ideal point is (x̄, ȳ) − Δ.
//!
//! ## Parameters
//!
//! `tilt_x_rad`, `tilt_y_rad`: angles about the x and the y axis. With τ_y > 0 the side of +x, with τ_x < 0 that of +y is
//! the larger one. To first order they are OpenCV's −tauX and −tauY. 0.1° displaces a star at 512 px by 0.16 px with f = 2900 px.
//!
//! ## Signature
//!
//! In positions nothing at all: the homography is a rotation of the camera together with a shift of the
//! principal point. In the widths of the images a gradient of focus across the field.
//!
//! ## Confused with
//!
//! The frames' attitudes and the principal point, entirely. An attitude from elsewhere breaks this, or a distortion
//! whose centre is known.
//!
//! ## Neglected
//!
//! The second order in τ: it turns the image by τ_x·τ_y, which is a roll, and scales it by τ²/2, which is a focal length.
//!
//! ## Source
//!
//! OpenCV, calib3d, computeTiltProjectionMatrix; S. Wang, Y. Geng, R. Jin, Sensors 15, 31428 (2015), for its place in the error
//! model of a star tracker.

use crate::dual::Real;
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};

/// Tilt of the detector as a correction at the measured point.
#[derive(Clone, Copy, Debug)]
pub struct DetectorTilt;

impl Displacement for DetectorTilt {
    const ID: &'static str = "detector-tilt";
    const FACTS: Facts = Facts { ordinary_size: Some(OrdinarySize::of(1.7e-3, "a tenth of a degree (Fan et al. 2020)")), ..Facts::NONE };
    const SEGMENT: Segment = Segment::Focal;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "tilt_x_rad", unit: "rad", typical: 2e-3, range: (-0.1, 0.1) },
        ParameterSpec { name: "tilt_y_rad", unit: "rad", typical: 2e-3, range: (-0.1, 0.1) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        let [x, y] = light.point_px;
        let nearer = (x * parameters[1] - y * parameters[0]) / light.focal_length_px;
        Light { point_px: [x - x * nearer, y - y * nearer], ..light }
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
        // OpenCV puts an ideal point on a tilted sensor; its first order has the other sign, so the same angles take this model's measured
        // point to its ideal one. Its exact homography has a second order of τ²·x = 2e-7 px in this case: opencv-python-headless 5.0.0.93,
        // projectPoints([[410/2000, -330/2000, 1]], 0, 0, diag(2000, 2000, 1), [0]*12 + [1e-5, -3e-5]).
        vec![ReferenceValue::of_point(
            "OpenCV, projectPoints with tauX and tauY",
            Context::new(StarState::default(), Observation::default()),
            vec![1e-5, -3e-5],
            2000.0,
            [512.0; 2],
            [[410.0, -330.0], [410.001_845_192_804_2, -330.001_484_900_182_8]],
            3e-7,
        )]
    }

    fn source() -> &'static str {
        page_source!("detector_tilt.rs")
    }
}
