//! # Atmospheric refraction
//!
//! ## What it does
//!
//! The air lifts every star towards the zenith: 57″ at 45° at sea level.
//!
//! ## Equation
//!
//! R = A·tan z + B·tan³ z, z = observed zenith distance; applied to the true direction with one Newton step as in
//! SOFA's `atioq`: with ζ the true zenith distance, t = tan ζ, w = B·t²: R = (A + w)·t / (1 + (A + 3w)/cos² ζ).
//!
//! ## Parameters
//!
//! `refraction_at_45deg_arcsec` = A + B, the refraction at an observed zenith distance of 45°; the ratio B/A is that of
//! the site's air, or of standard air (1013.25 hPa, 15 °C) where no site is known. At its known size the value follows from pressure,
//! temperature and humidity (SOFA's `refco` at 0.55 µm).
//! `zenith_east_rad`, `zenith_north_rad`: the zenith's offset from where the recording puts it, in the plane that touches the sphere there:
//! zenith ∝ ẑ + east·ê + north·n̂. Where the Earth's orientation is known, east and north are those of the turning Earth, so that one
//! pair holds for a night; elsewhere they are those of the ICRS. They are fitted only where the zenith was no more than guessed; without times
//! the one to the east is each frame's own, since the Earth turns between the frames.
//!
//! ## Signature
//!
//! A displacement towards the zenith that grows downwards. Within a frame the attitude absorbs the
//! mean; left are a vertical compression (1 + R₄₅·tan² z, 2.8e-4·sec² z in scale) and higher terms.
//!
//! ## Confused with
//!
//! The offsets of the zenith with each other if all frames look one way. Pixel aspect (if the camera is always held
//! upright), focal length; frames at different altitudes separate them.
//!
//! ## Neglected
//!
//! Below 3° altitude the formula is held at its value there. Dispersion with the star's colour; anomalous refraction.
//!
//! ## Source
//!
//! SOFA routines `refco` and `atioq` (A. T. Young, Applied Optics 43, 1108 (2004), for the law); tested against `atioq`.

use super::proper_motion::east_north;
use crate::dual::{Real, add, constant, dot, normalize, scale};
use crate::effects::{
    Context, Displacement, Facts, Light, Natural, Observation, OrdinarySize, ParameterSpec, ReferenceValue, RefractionConstants, Segment,
    StarState,
};
use crate::units::ARCSEC_RAD;

/// Sine of the lowest altitude at which the law is evaluated (3°), as in SOFA.
const LOWEST_SINE: f64 = 0.05;
/// Smallest sine of the zenith distance, so that the zenith itself does no harm.
const SMALLEST_HORIZONTAL: f64 = 1e-6;

/// Where nothing is known of the air, only this ratio of its constants is used: pyerfa 2.0.1.5, refco(1013.25 hPa, 15 °C, 0.5, 0.55 µm).
const STANDARD_AIR: RefractionConstants = RefractionConstants { a_rad: 0.000_277_195_406_842_925_06, b_rad: -3.171_695_036_812_495_7e-7 };

/// Atmospheric refraction.
#[derive(Clone, Copy, Debug)]
pub struct Refraction;

/// Unit vectors to the east and to the north at the zenith, ICRS axes: of the turning Earth where its orientation is known.
fn east_north_at(zenith: [f64; 3], earth_from_icrs: Option<[[f64; 3]; 3]>) -> ([f64; 3], [f64; 3]) {
    let Some(rows) = earth_from_icrs else {
        return east_north(zenith);
    };
    let (east, north) = east_north(rows.map(|row| dot(row, zenith)));
    let to_icrs = |v: [f64; 3]| [0, 1, 2].map(|column| rows[0][column] * v[0] + rows[1][column] * v[1] + rows[2][column] * v[2]);
    (to_icrs(east), to_icrs(north))
}

/// The zenith that a refraction with these parameters has in an exposure, ICRS axes: the one supposed and its offset.
#[must_use]
pub fn zenith_at(parameters: &[f64], observation: &Observation) -> Option<[f64; 3]> {
    let (zenith, [_, east_rad, north_rad]) = (observation.zenith?, *parameters.first_chunk::<3>()?);
    let (east, north) = east_north_at(zenith, observation.earth_from_icrs);
    Some(normalize([0, 1, 2].map(|axis| zenith[axis] + east_rad * east[axis] + north_rad * north[axis])))
}

impl Displacement for Refraction {
    const ID: &'static str = "refraction";
    const FACTS: Facts = Facts {
        ordinary_size: Some(OrdinarySize::of(57.0, "air at sea level (Stone 1996)")),
        profile_covariates: &[("", "zenith")],
        open_share: 0.04,
        searches_zenith: true,
        covariate: Some("zenith"),
        ..Facts::NONE
    };
    const SEGMENT: Segment = Segment::Sky;
    const PARAMETERS: &'static [ParameterSpec] = &[
        ParameterSpec { name: "refraction_at_45deg_arcsec", unit: "arcsec", typical: 57.0, range: (-1000.0, 1000.0) },
        ParameterSpec { name: "zenith_east_rad", unit: "rad", typical: 0.01, range: (-2.0, 2.0) },
        ParameterSpec { name: "zenith_north_rad", unit: "rad", typical: 0.01, range: (-2.0, 2.0) },
    ];

    fn displace<T: Real>(parameters: &[T], light: Light<T>, context: &Context) -> Light<T> {
        let Some(zenith) = context.observation.zenith else {
            return light;
        };
        let air = context.observation.refraction.unwrap_or(STANDARD_AIR);
        let strength = parameters[0] * (ARCSEC_RAD / (air.a_rad + air.b_rad));
        let (a, b) = (strength * air.a_rad, strength * air.b_rad);
        let (east, north) = east_north_at(zenith, context.observation.earth_from_icrs);
        let offset = add(scale(constant(east), parameters[1]), scale(constant(north), parameters[2]));
        let up = normalize(add(constant(zenith), offset));
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

    fn unmet_requirement(observation: &Observation) -> Option<&'static str> {
        observation.zenith.is_none().then_some("the site or the time of the frames is not known, so the zenith is not")
    }

    fn identity(_: &Context) -> Option<Vec<f64>> {
        Some(vec![0.0; 3])
    }

    fn predicted(observation: &Observation) -> Option<Vec<f64>> {
        let air = observation.zenith.and(observation.refraction).filter(|_| !observation.zenith_is_guessed)?;
        Some(vec![(air.a_rad + air.b_rad) / ARCSEC_RAD, 0.0, 0.0])
    }

    fn default_free(observation: &Observation) -> Vec<usize> {
        match (observation.zenith_is_guessed, observation.earth_from_icrs) {
            (false, _) => vec![0],
            (true, Some(_)) => vec![0, 1, 2],
            // Without times the zenith of each frame stands at an hour angle of its own.
            (true, None) => vec![0, 2],
        }
    }

    fn plausible_range() -> Option<Natural> {
        // From 5000 m of altitude in summer to the sea in a polar winter.
        Some(Natural { what: "refraction_at_45deg_arcsec", parameters: &[0], range: (27.0, 78.0) })
    }

    fn reference_values() -> Vec<ReferenceValue> {
        // pyerfa 2.0.1.5: refco(1013.25 hPa, 10 °C, 0.5, 0.55 µm), then atioq for an observer at the pole (zenith = +z, no diurnal
        // aberration) with apio(0, 0, 0, π/2, 0, 0, 0, refa, refb); true zenith distances 30°, 70°, 86° at right ascension 20°.
        let air = RefractionConstants { a_rad: 0.000_282_193_161_438_045, b_rad: -3.158_916_769_301_904e-7 };
        let observation = Observation { zenith: Some([0.0, 0.0, 1.0]), refraction: Some(air), ..Observation::default() };
        let context = Context::new(StarState::default(), observation);
        let full = (air.a_rad + air.b_rad) / ARCSEC_RAD;
        let mut cases: Vec<ReferenceValue> = [
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
        .map(|(before, after)| {
            ReferenceValue::of_direction("pyerfa 2.0.1.5, refco and atioq", context, vec![full, 0.0, 0.0], before, after, 1e-13)
        })
        .collect();
        // As above about a zenith moved by (0.02, -0.03) in its tangent plane (tpsts): from (50°, 40°) of the ICRS; and from 4.42° E,
        // 52.22° N of an Earth that is turned by rz(era00) · c2i06a of JD 2458694.366.
        let still =
            Observation { zenith: Some([0.492_403_876_506_104_07, 0.586_824_088_833_465_2, 0.642_787_609_686_539_3]), ..observation };
        let turning = Observation {
            zenith: Some([-0.071_657_204_649_587_66, -0.608_263_906_112_174_1, 0.790_493_684_695_183_1]),
            earth_from_icrs: Some([
                [-0.195_541_893_943_656_04, -0.980_695_287_088_520_2, 0.000_348_705_166_277_905_6],
                [0.980_693_562_757_659_8, -0.195_542_204_065_279_28, -0.001_839_128_864_544_579],
                [0.001_871_811_586_590_261_3, -1.765_382_951_041_116_8e-5, 0.999_998_248_003_328_6],
            ]),
            ..observation
        };
        for (observation, before, after) in [
            (
                still,
                [-0.086_824_088_833_465_23, 0.992_403_876_506_104_1, 0.087_155_742_747_658_17],
                [-0.086_577_883_846_537_88, 0.992_402_846_931_601_9, 0.087_412_009_648_028_45],
            ),
            (
                turning,
                [0.353_947_468_931_296_1, -0.883_885_607_372_668_1, 0.305_724_422_178_828_84],
                [0.353_827_874_919_561, -0.883_866_434_879_230_7, 0.305_918_224_732_993_2],
            ),
        ] {
            let context = Context::new(StarState::default(), observation);
            let source = "pyerfa 2.0.1.5, refco, atioq and tpsts";
            cases.push(ReferenceValue::of_direction(source, context, vec![full, 0.02, -0.03], before, after, 1e-13));
        }
        cases
    }

    fn source() -> &'static str {
        page_source!("refraction.rs")
    }
}
