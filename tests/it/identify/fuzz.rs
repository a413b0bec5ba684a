//! The solver on lists and options of any kind: always an answer in its time, and never an attitude that is no rotation.

use std::time::Duration;

use boresight::coordinates::{Apparent, Direction};
use boresight::detect::Detections;
use boresight::identify::{AttitudePrior, Identification, IdentifyOptions, Projection, catalog_directions, identify};
use proptest::prelude::*;
use proptest::test_runner::TestCaseResult;

use super::{BASE, DEG, Scene, Told, cpu_ms, detection, make, sky};

/// What may pass after the limit: a look at a batch of candidates, or the fit of one to thousands of detections.
const TOLERANCE_MS: f64 = if cfg!(debug_assertions) { 200.0 } else { 25.0 };

/// Numbers at which arithmetic breaks.
fn odd_number() -> impl Strategy<Value = f64> {
    let known =
        [0.0, -0.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, f64::MIN_POSITIVE, 1e-300, 1e300, 1e9, -0.5];
    prop_oneof![prop::sample::select(known.to_vec()), any::<f64>()]
}

/// Sizes of a frame as cameras have them, and small ones.
fn size() -> impl Strategy<Value = (usize, usize)> {
    prop_oneof![
        6 => (64_usize..5000, 64_usize..5000),
        1 => (1_usize..40, 1_usize..40),
        1 => (Just(1_usize), 1_usize..3000),
        1 => (1_usize..3000, Just(1_usize)),
    ]
}

/// Sizes that no camera has.
fn odd_size() -> impl Strategy<Value = (usize, usize)> {
    let side = || prop::sample::select(vec![0_usize, 1, 2, 1000, 100_000, 1_000_000, 1_000_001, 1 << 40, usize::MAX]);
    (side(), side())
}

/// Where the points of a list lie.
#[derive(Clone, Copy, Debug)]
enum Places {
    Anywhere,
    OnePoint,
    FewPoints,
    Line,
    Lattice,
    Outside,
    /// The stars of a frame, and points anywhere on top.
    Stars,
}

/// A list of up to 5000 stars in a frame of a size, some of them with numbers that are none.
fn list(size: impl Strategy<Value = (usize, usize)>) -> impl Strategy<Value = Detections> {
    use Places::{Anywhere, FewPoints, Lattice, Line, OnePoint, Outside, Stars};
    let places = prop::sample::select(vec![Anywhere, Anywhere, Stars, Stars, OnePoint, FewPoints, Line, Lattice, Outside]);
    let count = prop_oneof![4 => 0_usize..60, 2 => 0_usize..600, 1 => 4000_usize..5001];
    let faults = prop::collection::vec((0.0..1.0_f64, 0_usize..4, odd_number()), 0..12);
    (size, places, count, 0_u64..1000, faults).prop_map(|((width_px, height_px), places, count, seed, faults)| {
        let mut list = Detections { width_px, height_px, background_dn: 0.0, noise_dn: 1.0, stars: Vec::new() };
        if matches!(places, Stars) {
            list = make(&Scene { faintest: 7.0, mirrored: seed % 3 == 0, ..BASE }, Told::Nothing, seed).detections;
        }
        let (width, height) = (list.width_px as f64, list.height_px as f64);
        let part = |star: usize, step: f64| (star as f64 * step + seed as f64 * 0.001).fract();
        list.stars.extend((0..count).map(|star| {
            let (u, v) = (part(star, 0.754_877_666_247), part(star, 0.569_840_290_998));
            let (u, v) = match places {
                Anywhere | Stars => (u, v),
                OnePoint => (0.4, 0.6),
                FewPoints => (part(star % 5, 0.754_877_666_247), part(star % 5, 0.569_840_290_998)),
                Line => (u, 0.3 + 0.5 * u),
                Lattice => ((star % 17) as f64 / 17.0, (star / 17 % 13) as f64 / 13.0),
                Outside => (3.0 * u - 1.0, 3.0 * v - 1.0),
            };
            detection(u * width - 0.5, v * height - 0.5, 1e3 / (1.0 + part(star, 0.618_034) * 100.0))
        }));
        let all = list.stars.len();
        for (at, field, value) in faults {
            if let Some(star) = list.stars.get_mut((at * all as f64) as usize) {
                let [xx, ..] = &mut star.covariance_px2;
                *[&mut star.x_px, &mut star.y_px, &mut star.flux_dn, xx][field] = value;
            }
        }
        list
    })
}

/// Limits of the time from none left to a few looks at a batch.
fn time_limit() -> impl Strategy<Value = Option<Duration>> {
    prop_oneof![1 => Just(Duration::ZERO), 1 => Just(Duration::from_nanos(1)), 6 => (0_u64..40_000).prop_map(Duration::from_micros)]
        .prop_map(Some)
}

/// Options that can be meant.
fn options() -> impl Strategy<Value = IdentifyOptions> {
    let near = (prop::array::uniform2(-3.0..3.0_f64), prop::option::of(-3.0..3.0_f64), 0.001..3.1_f64);
    let near = near.prop_map(|([ra, dec], roll, within)| AttitudePrior::pointing(ra, dec / 2.0, roll, within));
    (
        prop::option::of(100.0..8000.0_f64),
        prop_oneof![0.0..0.3_f64, 0.0..10.0_f64],
        any::<bool>(),
        (0.51..149.0_f64, 0.51..149.0_f64).prop_filter("in order", |(from, to)| from < to),
        prop::option::weighted(0.3, prop::sample::select(vec![-1_i8, 1])),
        prop::option::weighted(0.2, near),
        prop::option::weighted(0.2, prop::sample::select(vec![Projection::Pinhole, Projection::Equidistant, Projection::Stereographic])),
        prop_oneof![Just(1e-6), 1e-9..1.0_f64],
        time_limit(),
    )
        .prop_map(|(nominal, tolerance, beyond, range_deg, parity, near, projection, probability, time_limit)| IdentifyOptions {
            nominal_focal_length_px: nominal,
            focal_length_tolerance: tolerance,
            search_beyond_tolerance: beyond,
            field_width_range_rad: [range_deg.0 * DEG, range_deg.1 * DEG],
            parity,
            near,
            projection,
            hypotheses_before: 0,
            max_false_match_probability: probability,
            time_limit,
            time_spent: Duration::ZERO,
        })
}

/// The same with one that cannot be.
fn odd_options() -> impl Strategy<Value = IdentifyOptions> {
    (options(), 0_usize..9, odd_number(), any::<i8>()).prop_map(|(mut options, which, number, parity)| {
        let near = AttitudePrior::pointing(1.0, 0.5, Some(2.0), 0.5);
        let odd = || Direction::<Apparent>::from_unit([0.6, number, 0.8]);
        match which {
            0 => options.nominal_focal_length_px = Some(number),
            1 => options.focal_length_tolerance = number,
            2 => options.field_width_range_rad[0] = number,
            3 => options.field_width_range_rad[1] = number,
            4 => options.field_width_range_rad.reverse(),
            5 => options.parity = Some(parity),
            6 => options.near = Some(AttitudePrior { within_rad: number, ..near }),
            7 => {
                options.near =
                    Some(if parity < 0 { AttitudePrior { boresight: odd(), ..near } } else { AttitudePrior { up: Some(odd()), ..near } });
            }
            _ => options.max_false_match_probability = number,
        }
        options
    })
}

/// Identifies, and looks at whatever comes out.
fn is_answered_in_time(list: &Detections, directions: &[Direction<Apparent>], options: &IdentifyOptions) -> TestCaseResult {
    let (catalog, index) = sky();
    let begin = cpu_ms();
    let answer = identify(list, catalog, index, directions, options);
    let took_ms = cpu_ms() - begin;
    if let Some(limit) = options.time_limit {
        let limit_ms = 1e3 * limit.as_secs_f64();
        prop_assert!(took_ms < limit_ms + TOLERANCE_MS, "{took_ms} ms where {limit_ms} ms are allowed");
    }
    match answer {
        Identification::NotIdentified { reason, .. } => {
            let reason = reason.to_string();
            prop_assert!(reason.len() > 20 && reason.ends_with('.') && !reason.contains('\n'), "{}", reason);
        }
        // Chance may bring a few points to a few stars where much is accepted; what is said of them is sound.
        Identification::Identified(solution) => {
            prop_assert!(solution.false_match_probability < options.max_false_match_probability);
            prop_assert!((solution.attitude.camera_from_icrs.norm() - 1.0).abs() < 1e-9);
            prop_assert!(
                solution.camera.focal_length_px > 0.0 && solution.camera.focal_length_px.is_finite() && solution.rms_px.is_finite()
            );
            for one in &solution.matches {
                prop_assert!(list.stars[one.detection].x_px.is_finite() && list.stars[one.detection].y_px.is_finite());
                prop_assert!(one.residual_px.iter().all(|along| along.is_finite()));
            }
        }
    }
    Ok(())
}

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: Some(crate::common::regressions()), ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config(300))]

    #[test]
    fn any_list_gets_an_answer_in_its_time(list in list(size()), options in options()) {
        is_answered_in_time(&list, &[], &options)?;
    }

    #[test]
    fn any_options_and_sizes_get_an_answer_in_their_time(list in list(prop_oneof![size(), odd_size()]), options in odd_options()) {
        is_answered_in_time(&list, &[], &options)?;
    }
}

proptest! {
    #![proptest_config(config(12))]

    #[test]
    fn without_a_limit_the_search_ends_too(list in list(size()), options in options()) {
        is_answered_in_time(&list, &[], &IdentifyOptions { time_limit: None, ..options })?;
    }

    #[test]
    fn directions_that_are_no_numbers_are_borne(list in list(size()), options in options(), step in 1_usize..50, number in odd_number()) {
        let mut directions = catalog_directions(sky().0);
        for direction in directions.iter_mut().step_by(step) {
            *direction = Direction::from_unit([number, 0.0, direction.xyz[2]]);
        }
        is_answered_in_time(&list, &directions, &options)?;
    }
}
