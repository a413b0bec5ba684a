//! # Error of the time tags
//!
//! ## What it does
//!
//! A clock that is wrong: the frames were taken earlier or later than they say, and the Earth has turned on by 15″ for each
//! second of it.
//!
//! ## Equation
//!
//! In the axes that hold at the time that the tag says, the direction is turned by −ω·τ about the Earth's axis,
//! ω = 15.041067″/s: the sky moves to the west.
//!
//! ## Parameters
//!
//! `offset_s`: τ, the true time of the exposure minus the one its time tag says (the sense of proper motion's
//! `epoch_offset_yr`). Positive: the frames were taken LATER than their tags say, as with a clock that is slow.
//!
//! ## Signature
//!
//! Nothing in the stars alone where every frame has an attitude of its own. With one attitude to the
//! ground for all frames, or attitudes from elsewhere: a shift to the west of 15″·cos δ per second.
//!
//! ## Confused with
//!
//! The attitude; the longitude of the site, completely.
//!
//! ## Neglected
//!
//! What else changes with time (aberration: below 0.1″ in an hour; the zenith, which stays the one that the tag gives).
//!
//! ## Source
//!
//! The Earth rotation angle of IAU 2000 Resolution B1.8; SOFA routine `era00`.

use crate::dual::{Real, constant, normalize, rotate};
use crate::effects::{Context, Displacement, Facts, Light, Observation, OrdinarySize, ParameterSpec, ReferenceValue, Segment, StarState};
use crate::units::ARCSEC_RAD;

/// The Earth's rotation, rad per second: 1.00273781191135448 turns a day.
const EARTH_RATE_RAD_S: f64 = 15.0 * 1.002_737_811_911_354_5 * ARCSEC_RAD;

/// Error of the time tags.
#[derive(Clone, Copy, Debug)]
pub struct TimeTag;

impl Displacement for TimeTag {
    const ID: &'static str = "time-tag";
    const FACTS: Facts =
        Facts { ordinary_size: Some(OrdinarySize::of(10.0, "a clock set by hand")), demo_sizes: &[("offset_s", 60.0)], ..Facts::NONE };
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "offset_s", unit: "s", typical: 10.0, range: (-43_200.0, 43_200.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let Some([_, _, pole]) = context.observation.earth_from_icrs else {
            return light;
        };
        Light { direction: normalize(rotate(light.direction, constant(pole), parameters[0] * -EARTH_RATE_RAD_S)), ..light }
    }

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.earth_from_icrs.is_none().then_some("the time of the frames is not known, so the Earth's axis is not")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn predicted(_: &Observation) -> Option<Vec<f64>> {
        None
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: c = c2i06a(2458694, 0.366), a = era00 30 s later minus era00; cᵀ · rz(a) · c · s2c(200°, 35°), which
        // has at the tagged time the direction to the ground that the star has 30 s later.
        let earth_from_icrs = [
            [0.999_998_248_159_157_4, 1.063_019_798_748_510_2e-8, -0.001_871_811_586_694_28],
            [2.241_446_326_288_476_5e-8, 0.999_999_999_844_171_1, 1.765_381_848_143_936_4e-5],
            [0.001_871_811_586_590_261_3, -1.765_382_951_041_116_8e-5, 0.999_998_248_003_328_6],
        ];
        let observation = Observation { earth_from_icrs: Some(earth_from_icrs), ..Observation::default() };
        let before = [-0.769_751_131_320_057_2, -0.280_166_499_593_235_5, 0.573_576_436_351_046];
        let after = [-0.770_362_165_040_235_4, -0.278_479_550_641_534_9, 0.573_577_609_874_208_5];
        let context = Context::new(StarState::default(), observation);
        vec![ReferenceValue::of_direction("pyerfa 2.0.1.5, era00, rz and c2i06a", context, vec![30.0], before, after, 1e-12)]
    }

    fn source() -> &'static str {
        page_source!("time_tag.rs")
    }
}
