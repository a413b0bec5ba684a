//! Single frames that differ: exposed otherwise, behind clouds, drawn out by a motion.

use std::f64::consts::TAU;

use super::counted::Counted;
use super::expected_stars::StarMeasurement;
use super::judge::{Judged, Pixels, judge};
use super::noise::DeclaredDetector;
use super::single_frames::single_frames;
use super::tests::{FRAMES, asked, nothing, stars};
use crate::pixel_statistics::{FrameNoise, PixelStatistics};

const BIAS_DN: f64 = 100.0;
const ODD: usize = 5;

fn judged(stars: &[StarMeasurement], statistics: &PixelStatistics) -> Judged {
    let places = (0..FRAMES).map(|frame| (frame, frame)).collect();
    let detector = DeclaredDetector::default();
    let pixels = Pixels { statistics, detector: &detector, places: &places, views: &[] };
    judge(stars, Some(&pixels), FRAMES, &asked(1e-3), &[]).unwrap()
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
    let numbers: Vec<usize> = (0..FRAMES).collect();
    found(single_frames(&judged(&stars, &statistics), Some(&statistics), (Some(BIAS_DN), looks_through_air), &numbers))
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

/// Images drawn out by `length_px`, in every frame along another direction; no rates are known.
fn moved(seed: u64, length_px: f64) -> Vec<(String, f64)> {
    let mut stars = stars(seed, nothing);
    for star in &mut stars {
        star.image.trail_px = None;
        let (sin, cos) = (TAU * 0.29 * star.frame as f64).sin_cos();
        // Where all lengths are the same the images are wider by the same, and that is the image; what goes with the time is a focus.
        let longer = length_px * (0.4 + 0.1 * ((5 * star.frame) % FRAMES) as f64);
        let added = longer * longer / 12.0;
        let moments = star.moments.as_mut().unwrap();
        for (value, more) in moments.second_px2.iter_mut().zip([cos * cos, sin * cos, sin * sin]) {
            *value += added * more;
        }
    }
    let numbers: Vec<usize> = (0..FRAMES).collect();
    found(single_frames(&judged(&stars, &PixelStatistics::default()), None, (None, true), &numbers))
}

#[test]
fn a_motion_is_told_by_its_frames() {
    for seed in 30..33 {
        assert_eq!(moved(seed, 0.0), [], "seed {seed}");
        let smear = moved(seed, 1.5);
        assert!(matches!(&smear[..], [(id, length)] if id == "motion-smear" && (length - 1.5).abs() < 0.2), "seed {seed}: {smear:?}");
    }
}
