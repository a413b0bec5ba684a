//! # Atmospheric refraction
//!
//! **What it is.** The air lifts every star towards the zenith: 57″ at 45° at sea level.
//!
//! **Equation.** R = A·tan z + B·tan³ z, z = observed zenith distance; applied to the true direction with one Newton step as in
//! SOFA's `atioq`: with ζ the true zenith distance, t = tan ζ, w = B·t²: R = (A + w)·t / (1 + (A + 3w)/cos² ζ).
//!
//! **Parameter.** `refraction_at_45deg_arcsec` = A + B, the refraction at an observed zenith distance of 45°; the ratio B/A is that of
//! the site's air. At its known size the value follows from pressure, temperature and humidity (SOFA's `refco` at 0.55 µm).
//!
//! **What it leaves when left out.** A displacement towards the zenith that grows downwards. Within a frame the attitude absorbs the
//! mean; left are a vertical compression (1 + R₄₅·tan² z, 2.8e-4·sec² z in scale) and higher terms.
//!
//! **Confused with.** Pixel aspect (if the camera is always held upright), focal length; frames at different altitudes separate them.
//!
//! **Neglected.** Below 3° altitude the formula is held at its value there. Dispersion with the star's colour; anomalous refraction.
//!
//! **Source.** SOFA routines `refco` and `atioq` (A. T. Young, Applied Optics 43, 1108 (2004), for the law); tested against `atioq`.

use crate::dual::{Real, add, constant, dot, normalize, scale};
use crate::effects::{Context, Displacement, Light, Observation, ParameterSpec, ReferenceValue, RefractionConstants, Segment, StarState};
use crate::units::ARCSEC_RAD;

/// Sine of the lowest altitude at which the law is evaluated (3°), as in SOFA.
const LOWEST_SINE: f64 = 0.05;
/// Smallest sine of the zenith distance, so that the zenith itself does no harm.
const SMALLEST_HORIZONTAL: f64 = 1e-6;

/// Atmospheric refraction.
#[derive(Clone, Copy, Debug)]
pub struct Refraction;

impl Displacement for Refraction {
    const ID: &'static str = "refraction";
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] =
        &[ParameterSpec { name: "refraction_at_45deg_arcsec", unit: "arcsec", typical: 57.0, range: (-1000.0, 1000.0) }];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let (Some(zenith), Some(air)) = (context.observation.zenith, context.observation.refraction) else {
            return light;
        };
        let strength = parameters[0] * (ARCSEC_RAD / (air.a_rad + air.b_rad));
        let (a, b) = (strength * air.a_rad, strength * air.b_rad);
        let up = constant::<T>(zenith);
        let vertical = dot(light.direction, up);
        let horizontal = add(light.direction, scale(up, -vertical));
        let squared = dot(horizontal, horizontal);
        let r = if squared.value() > SMALLEST_HORIZONTAL * SMALLEST_HORIZONTAL { squared.sqrt() } else { T::constant(SMALLEST_HORIZONTAL) };
        let sine = if vertical.value() > LOWEST_SINE { vertical } else { T::constant(LOWEST_SINE) };
        let tangent = r / sine;
        let w = b * tangent * tangent;
        let lift = (a + w) * tangent / ((a + w * 3.0) / (sine * sine) + 1.0);
        let cos_lift = T::constant(1.0) - lift * lift * 0.5;
        let shrink = cos_lift - lift * sine / r;
        let raised = scale(up, cos_lift * vertical + lift * r);
        Light { direction: normalize(add(scale(horizontal, shrink), raised)), ..light }
    }

    fn missing(observation: &Observation) -> Option<&'static str> {
        observation.zenith.is_none().then_some("the site or the time of the frames is not known, so the zenith is not")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0])
    }

    fn known(observation: &Observation) -> Option<Vec<f64>> {
        observation.zenith.and(observation.refraction).map(|air| vec![(air.a_rad + air.b_rad) / ARCSEC_RAD])
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: refco(1013.25 hPa, 10 °C, 0.5, 0.55 µm), then atioq for an observer at the pole (zenith = +z, no diurnal
        // aberration) with apio(0, 0, 0, π/2, 0, 0, 0, refa, refb); true zenith distances 30°, 70°, 86° at right ascension 20°.
        let air = RefractionConstants { a_rad: 0.000_282_193_161_438_045, b_rad: -3.158_916_769_301_904e-7 };
        let observation = Observation { zenith: Some([0.0, 0.0, 1.0]), refraction: Some(air), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        let full = vec![(air.a_rad + air.b_rad) / ARCSEC_RAD];
        [
            (
                [0.469_846_310_392_954_3, 0.171_010_071_662_834_38, 0.866_025_403_784_438_6],
                [0.469_713_816_018_067_94, 0.170_961_847_654_168_03, 0.866_106_793_466_266_3],
            ),
            (
                [0.883_022_221_559_489_1, 0.321_393_804_843_269_7, 0.342_020_143_325_668_7],
                [0.882_775_464_193_861_1, 0.321_303_992_507_095_1, 0.342_740_753_655_461_14],
            ),
            (
                [0.937_403_576_790_459_8, 0.341_186_999_446_399_7, 0.069_756_473_744_125_3],
                [0.937_198_867_738_714_1, 0.341_112_491_444_879_43, 0.072_804_879_572_315_92],
            ),
        ]
        .into_iter()
        .map(|(before, after)| ReferenceValue::of_direction("pyerfa 2.0.1.5, refco and atioq", context, full.clone(), before, after, 1e-13))
        .collect()
    }

    fn source() -> &'static str {
        include_str!("refraction.rs")
    }
}
