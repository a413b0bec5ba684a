//! Single frames that differ: exposed otherwise, behind clouds.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::counted::Counted;
use super::expected_stars::StarMeasurement;
use super::frame_levels::{Air, TestedFrame};
use super::judge::{Asked, Judged, Pixels, judge};
use super::noise_kind::DeclaredDetector;
use super::single_frames::single_frames;
use super::tests::{FRAMES, asked, nothing, stars};
use crate::diagnose::channels::Channel;
use crate::pixel_statistics::{FrameNoise, PixelStatistics};

const BIAS_DN: f64 = 100.0;
const ODD: usize = 5;

fn judged(stars: &[StarMeasurement], statistics: &PixelStatistics) -> Judged {
    let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
    let detector = DeclaredDetector::default();
    let pixels = Pixels { statistics, detector: &detector, places: &places, views: &[] };
    judge(stars, Some(&pixels), FRAMES, &asked(1e-3), &[]).unwrap()
}

/// Air of which nobody knows how much each frame looks through.
fn air(is_there: bool) -> Air {
    Air { is_there, ..Air::default() }
}

/// The frames with their exposures.
fn timed(exposure_s: impl Fn(usize) -> Option<f64>) -> Vec<TestedFrame> {
    (0..FRAMES).map(|number| TestedFrame { number, exposure_s: exposure_s(number) }).collect()
}

/// Frames of one sky; that of one of them is brighter by a factor.
fn skies(factor: f64) -> PixelStatistics {
    let frame = |frame: usize| FrameNoise {
        frame,
        exposure_s: Some(1.0),
        level_dn: BIAS_DN + (400.0 + 2.0 * (frame % 3) as f64) * if frame == ODD { factor } else { 1.0 },
        sigma_dn: 5.0,
        row_variance_dn2: None,
        column_variance_dn2: None,
        parity_dn: None,
        middle_step_dn: None,
    };
    PixelStatistics { by_frame: (0..FRAMES).map(frame).collect(), ..PixelStatistics::default() }
}

/// What single frames show of stars of which one frame has `factor` times the light.
fn told(seed: u64, factor: f64, sky: f64) -> Vec<(String, f64)> {
    told_through(true, seed, factor, sky)
}

fn told_through(looks_through_air: bool, seed: u64, factor: f64, sky: f64) -> Vec<(String, f64)> {
    let mut stars = stars(seed, nothing);
    for star in stars.iter_mut().filter(|star| star.frame == ODD) {
        star.flux_dn *= factor;
        star.flux_sigma_dn *= factor.sqrt();
    }
    let statistics = skies(sky);
    let tested = timed(|_| Some(1.0));
    found(single_frames(&judged(&stars, &statistics), Some(&statistics), &air(looks_through_air), Some(BIAS_DN), &tested))
}

fn found(counted: Vec<Counted>) -> Vec<(String, f64)> {
    counted.into_iter().filter_map(|own| own.reported().1).map(|own| (own.id, own.parameters[0].value)).collect()
}

#[test]
fn a_frame_that_is_like_the_others_is_not_named() {
    for seed in 0..12 {
        assert_eq!(told(seed, 1.0, 1.0), [], "seed {seed}");
        // A sky alone that is brighter is no matter of the exposure.
        assert_eq!(told(seed, 1.0, 1.4), [], "seed {seed}");
    }
}

/// All frames see the same stars: the errors of the catalogue, 0.05 mag a star, are no part of what frames differ by.
#[test]
fn zero_points_differ_by_their_errors() {
    let mut pulls = Vec::new();
    for seed in 90..110 {
        let judged = judged(&stars(seed, nothing), &skies(1.0));
        let kind = judged.rows.kinds.iter().position(|kind| kind.channel == Channel::Flux).unwrap();
        let levels: Vec<[f64; 2]> = judged.standing().frame_levels[kind].values().copied().collect();
        let mean = levels.iter().map(|[level, _]| level).sum::<f64>() / levels.len() as f64;
        pulls.extend(levels.iter().map(|[level, sigma]| (level - mean) / sigma));
    }
    let rms = (pulls.iter().map(|pull| pull * pull).sum::<f64>() / pulls.len() as f64).sqrt();
    assert!(pulls.len() == 20 * FRAMES && (rms - 1.0).abs() < 0.2, "{rms}");
}

#[test]
fn stars_and_sky_tell_clouds_from_an_exposure() {
    for seed in 20..23 {
        let [clouds, exposure, zero_point] = [(0.7, 1.0), (0.7, 0.7), (1.4, 1.0)].map(|(factor, sky)| told(seed, factor, sky));
        assert!(matches!(&clouds[..], [(id, mag)] if id == "clouds" && (mag - 0.387).abs() < 0.06), "seed {seed}: {clouds:?}");
        assert!(matches!(&exposure[..], [(id, more)] if id == "exposure-time" && (more + 0.3).abs() < 0.05), "seed {seed}: {exposure:?}");
        assert!(matches!(&zero_point[..], [(id, mag)] if id == "zero-point" && (mag + 0.365).abs() < 0.06), "seed {seed}: {zero_point:?}");
    }
}

/// Six hundredths are what air does on a clear night; in space nothing does.
#[test]
fn without_air_a_small_difference_is_one() {
    for seed in 40..44 {
        assert_eq!(told_through(true, seed, 0.94, 0.94), [], "seed {seed}");
        assert_eq!(told_through(false, seed, 1.0, 1.0), [], "seed {seed}");
        let own = told_through(false, seed, 0.94, 0.94);
        assert!(matches!(&own[..], [(id, more)] if id == "exposure-time" && (more + 0.06).abs() < 0.02), "seed {seed}: {own:?}");
        // A sky that stays as it is tells of no exposure, and no clouds are there.
        let own = told_through(false, seed, 0.9, 1.0);
        assert!(matches!(&own[..], [(id, mag)] if id == "zero-point" && (mag - 0.114).abs() < 0.03), "seed {seed}: {own:?}");
    }
}

/// What is told where the light of every frame is off by a draw of its own, that of stars and that of the sky by these scatters (magnitudes).
fn scattering(looks_through_air: bool, seed: u64, stars_mag: f64, sky_mag: f64) -> Vec<(String, f64)> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x5ca7);
    // Draws of a known scatter, so that its size is the truth.
    let mut draws: [f64; FRAMES] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
    let mean = draws.iter().sum::<f64>() / FRAMES as f64;
    let rms = (draws.iter().map(|own| (own - mean).powi(2)).sum::<f64>() / FRAMES as f64).sqrt();
    for own in &mut draws {
        *own = (*own - mean) / rms;
    }
    let factor = |frame: usize, mag: f64| 10.0_f64.powf(-0.4 * mag * draws[frame]);
    let mut stars = stars(seed, nothing);
    for star in &mut stars {
        star.flux_dn *= factor(star.frame, stars_mag);
    }
    let mut statistics = skies(1.0);
    for frame in &mut statistics.by_frame {
        frame.level_dn = BIAS_DN + (frame.level_dn - BIAS_DN) * factor(frame.frame, sky_mag);
    }
    let tested = timed(|_| Some(1.0));
    found(single_frames(&judged(&stars, &statistics), Some(&statistics), &air(looks_through_air), Some(BIAS_DN), &tested))
}

/// Where none stands out: exposures that scatter take the sky along, clouds do not.
#[test]
fn zero_points_that_scatter_are_told() {
    for seed in 60..66 {
        // A clear night scatters by 0.02 mag.
        assert_eq!(scattering(true, seed, 0.02, 0.0), [], "seed {seed}");
        let exposure = scattering(true, seed, 0.04, 0.04);
        assert!(matches!(&exposure[..], [(id, size)] if id == "exposure-time" && (size - 0.037).abs() < 0.01), "seed {seed}: {exposure:?}");
        let clouds = scattering(true, seed, 0.1, 0.0);
        assert!(matches!(&clouds[..], [(id, _)] if id == "clouds"), "seed {seed}: {clouds:?}");
        let shutter = scattering(false, seed, 0.04, 0.0);
        assert!(matches!(&shutter[..], [(id, _)] if id == "zero-point"), "seed {seed}: {shutter:?}");
    }
}

/// Frames that look through more air lose more light: no clouds, where the air masses are known.
#[test]
fn extinction_is_no_cloud() {
    const MAG_PER_AIRMASS: f64 = 0.25;
    // As fields here and there have it, in no order.
    let mass = |frame: usize| 1.0 + 0.1 * ((5 * frame) % FRAMES) as f64;
    for seed in 70..73 {
        let mut stars = stars(seed, nothing);
        for star in &mut stars {
            star.flux_dn *= 10.0_f64.powf(-0.4 * MAG_PER_AIRMASS * mass(star.frame));
        }
        let known = Air { mass: stars.iter().map(|star| ((star.frame, star.star), mass(star.frame))).collect(), is_there: true };
        let (judged, statistics) = (judged(&stars, &skies(1.0)), skies(1.0));
        let tested = timed(|_| Some(1.0));
        let told = |air: &Air| found(single_frames(&judged, Some(&statistics), air, Some(BIAS_DN), &tested));
        let own = told(&known);
        assert!(matches!(&own[..], [(id, slope)] if id == "extinction" && (slope - MAG_PER_AIRMASS).abs() < 0.06), "seed {seed}: {own:?}");
        let unknown = told(&air(true));
        assert!(matches!(&unknown[..], [(id, _)] if id == "clouds"), "seed {seed}: {unknown:?}, the test could not fail");
    }
}

/// One low field shows extinction within it, and no frames that are left out can. The zero points of the others confirm it, and it is no clouds; where they
/// do not follow the air mass it stays withheld, and the dim frame is one behind clouds.
#[test]
fn zero_points_confirm_what_one_low_field_shows() {
    const MAG_PER_AIRMASS: f64 = 0.9;
    const LOW: usize = 4;
    let mass = |frame: usize| if frame == LOW { 2.4 } else { 1.0 + 0.04 * ((5 * frame) % FRAMES) as f64 };
    for seed in 74..77 {
        let told = |others_follow: bool| {
            let mut stars = stars(seed, nothing);
            for star in &mut stars {
                let within = if star.frame == LOW { 0.5 * star.image.at[1] } else { 0.0 };
                let of_frame = if others_follow || star.frame == LOW { mass(star.frame) } else { 1.0 };
                star.image.airmass = Some(mass(star.frame) + within);
                star.flux_dn *= 10.0_f64.powf(-0.4 * MAG_PER_AIRMASS * (of_frame - 1.0 + within));
            }
            let (tested, statistics) = (timed(|_| Some(1.0)), skies(1.0));
            let judged = judge(&stars, None, FRAMES, &Asked { tested: &tested, ..asked(1e-3) }, &[]).unwrap();
            let own = judged.proposed.iter().find(|own| judged.rows.questions[own.question].id == "extinction").expect("it is proposed");
            let single = found(single_frames(&judged, Some(&statistics), &Air::of(&stars, true), Some(BIAS_DN), &tested));
            (own.against.join("; "), own.held_out.by_zero_points, single)
        };
        let (against, by_zero_points, single) = told(true);
        assert!(against.is_empty() && single.is_empty(), "seed {seed}: {against}, {single:?}");
        let [slope, sigma] = by_zero_points.expect("no turn can confirm it: the test could not fail");
        assert!((slope - MAG_PER_AIRMASS).abs() < 4.0 * sigma, "seed {seed}: {slope} ± {sigma}");
        let (against, by_zero_points, single) = told(false);
        assert!(by_zero_points.is_none() && against.contains("took no part"), "seed {seed}: {against}");
        assert!(matches!(&single[..], [(id, mag)] if id == "clouds" && *mag > 0.5), "seed {seed}: {single:?}");
    }
}

/// A frame of which the exposure is not known may have been exposed in any way, and where none is known nothing was declared.
#[test]
fn an_unknown_exposure_is_no_other_than_declared() {
    let mut stars = stars(80, nothing);
    for star in stars.iter_mut().filter(|star| star.frame == ODD) {
        star.flux_dn *= 0.1;
    }
    let statistics = skies(0.1);
    let judged = judged(&stars, &statistics);
    let told = |exposure_s: &dyn Fn(usize) -> Option<f64>| {
        single_frames(&judged, Some(&statistics), &air(true), Some(BIAS_DN), &timed(exposure_s))
    };
    assert_eq!(found(told(&|_| Some(10.0))).first().map(|(id, _)| id.as_str()), Some("exposure-time"));
    // Of a tenth of the time there is a tenth of the light.
    assert_eq!(found(told(&|frame| Some(if frame == ODD { 1.0 } else { 10.0 }))), []);
    assert_eq!(found(told(&|frame| (frame != ODD).then_some(10.0))), []);
    let untold = told(&|_| None);
    let reasons: Vec<String> = untold.into_iter().take(3).map(|own| own.reported().0.reason).collect();
    assert!(reasons.len() == 3 && reasons.iter().all(|reason| reason.contains("no exposure time is known")), "{reasons:?}");
}

/// Without frames that are held against each other pixel by pixel patterns are not asked for, and that is said.
#[test]
fn patterns_without_pairs_are_not_asked_for() {
    let judged = judged(&stars(81, nothing), &skies(1.0));
    for id in ["prnu", "dark-current"] {
        assert!(judged.unasked.get(id).is_some_and(|reason| reason.contains("three different pointings")), "{id}: {:?}", judged.unasked);
    }
}
