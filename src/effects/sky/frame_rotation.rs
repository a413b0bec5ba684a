//! # Rotation of the frame of reference
//!
//! ## What it does
//!
//! Attitudes from elsewhere (a second head, a mount) may stand in other axes than the ICRS: those of the equinox of date
//! turn by 50″ a year against it (precession). To the camera the whole sky then seems turned.
//!
//! ## Equation
//!
//! The direction is turned by ρ about the pole of the ecliptic of J2000, towards growing ecliptic longitude.
//!
//! ## Parameters
//!
//! `rotation_arcsec`: ρ, the ecliptic longitude of a star in the recording's axes minus that in the ICRS. Axes of the
//! equinox of the year t give 50.3″·(t − 2000).
//!
//! ## Signature
//!
//! Nothing in the stars alone: a rigid rotation of the sky is a rotation of the attitudes. It shows
//! where attitudes are known from elsewhere or one attitude to the ground holds for all frames.
//!
//! ## Confused with
//!
//! The attitude, completely, as long as every frame has an attitude of its own.
//!
//! ## Neglected
//!
//! Nutation (17″), the motion of the ecliptic (0.5″ a year), the bias of the FK5 (0.02″).
//!
//! ## Source
//!
//! N. Capitaine et al., A&A 412, 567 (2003); the pole is that of SOFA's `ecm06` at J2000.

use crate::dual::{Real, constant, normalize, rotate};
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};
use crate::units::ARCSEC_RAD;

/// Pole of the ecliptic of J2000, ICRS axes: third row of pyerfa 2.0.1.5, ecm06(2451545.0, 0).
const ECLIPTIC_POLE: [f64; 3] = [-1.020_704_472_548_435_5e-7, -0.397_776_999_444_043_04, 0.917_482_129_914_955_6];

/// Rotation of the frame of reference.
#[derive(Clone, Copy, Debug)]
pub struct FrameRotation;

impl Displacement for FrameRotation {
    const ID: &'static str = "frame-rotation";
    const FACTS: Facts =
        Facts { ordinary_size: Some(OrdinarySize::of(1300.0, "precession of 26 years, 50.3 arcsec a year")), ..Facts::NONE };
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "rotation_arcsec", unit: "arcsec", typical: 1300.0, range: (-648_000.0, 648_000.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, _: &Context) -> Light<T> {
        Light { direction: normalize(rotate(light.direction, constant(ECLIPTIC_POLE), parameters[0] * ARCSEC_RAD)), ..light }
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
        // pyerfa 2.0.1.5: (l, b) = eqec06(J2000, 200°, −35°), then eceq06(J2000, l + 1330″, b).
        let before = [-0.769_751_131_320_057_2, -0.280_166_499_593_235_5, -0.573_576_436_351_046];
        let after = [-0.766_606_549_744_583_8, -0.284_711_019_426_666_2, -0.575_546_725_562_515_5];
        let context = Context::new(StarState::default(), Observation::default());
        vec![ReferenceValue::of_direction("pyerfa 2.0.1.5, eqec06 and eceq06", context, vec![1330.0], before, after, 1e-14)]
    }

    fn source() -> &'static str {
        page_source!("frame_rotation.rs")
    }
}
