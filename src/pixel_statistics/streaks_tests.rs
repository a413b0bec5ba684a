//! Streaks of known brightness among stars, and what is none.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::frame::Frame;

const SIDE: usize = 320;
const NOISE_DN: f64 = 5.0;

/// A frame of sky and stars, with what `light` adds; the stars' discs.
fn frame(seed: u64, stars: usize, light: impl Fn(f64, f64) -> f64) -> (Frame, Vec<StarDisc>) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let noise = Normal::new(0.0, NOISE_DN).unwrap();
    let places: Vec<([f64; 2], f64)> = (0..stars)
        .map(|_| ([0; 2].map(|_| rng.random_range(0.0..SIDE as f64)), 300.0 * 30.0_f64.powf(rng.random_range(0.0..1.0))))
        .collect();
    let mut pixels_dn = Vec::with_capacity(SIDE * SIDE);
    for index in 0..SIDE * SIDE {
        let (x, y) = ((index % SIDE) as f64, (index / SIDE) as f64);
        let of_star = |(at, flux): &([f64; 2], f64)| {
            let r2 = (x - at[0]).powi(2) + (y - at[1]).powi(2);
            if r2 < 64.0 { flux / std::f64::consts::TAU * (-0.5 * r2).exp() } else { 0.0 }
        };
        let value = 200.0 + 0.05 * x + places.iter().map(of_star).sum::<f64>() + light(x, y) + noise.sample(&mut rng);
        pixels_dn.push(value as f32);
    }
    let discs = places.iter().map(|(at, _)| StarDisc { x_px: at[0], y_px: at[1], radius_px: 6.0 }).collect();
    (Frame { width_px: SIDE, height_px: SIDE, pixels_dn, saturation_dn: 60_000.0 }, discs)
}

fn searched(number: usize, (frame, stars): &(Frame, Vec<StarDisc>)) -> StreakFrame {
    let sky_frame = SkyFrame { number, lowest_read_dn: 0.0, frame, stars, bad: None, exposure_s: Some(2.0), is_compared: false };
    let sky = SkyPixels::new(frame, &sky_mask(&sky_frame));
    StreakFrame::of(&sky_frame, &sky, &Deviations::of(&sky_frame, &sky))
}

/// Light of a line of Gaussian profile (σ 1 px), DN per px of length.
fn line([start, end]: [[f64; 2]; 2], dn_per_px: f64) -> impl Fn(f64, f64) -> f64 {
    let length = (end[0] - start[0]).hypot(end[1] - start[1]);
    let along = [(end[0] - start[0]) / length, (end[1] - start[1]) / length];
    move |x, y| {
        let at = [x - start[0], y - start[1]];
        let (on, off) = (at[0] * along[0] + at[1] * along[1], at[0] * along[1] - at[1] * along[0]);
        if on > 0.0 && on < length { dn_per_px / std::f64::consts::TAU.sqrt() * (-0.5 * off * off).exp() } else { 0.0 }
    }
}

#[test]
fn noise_stars_and_banding_make_no_streak() {
    for seed in 0..12 {
        let found = searched(0, &frame(seed, 60, |_, y| if (y as usize).is_multiple_of(7) { 4.0 } else { 0.0 }));
        assert!(!found.are_trails && found.found.is_empty(), "{seed}: {found:?}");
    }
}

/// From a signal-to-noise ratio of twenty on (of which the planes of the sky take a quarter) streaks are found where they are, steep and flat ones, whole ones and pieces.
#[test]
fn streaks_are_found_where_they_are() {
    let ways = [
        [[20.0, -30.0], [250.0, 350.0]],
        [[-30.0, 200.0], [350.0, 260.0]],
        [[60.0, 80.0], [160.0, 150.0]],
        [[200.0, 290.0], [290.0, 120.0]],
        [[-20.0, 310.0], [330.0, 12.0]],
    ];
    for (k, way) in ways.into_iter().enumerate() {
        let inside = |at: [f64; 2]| at.map(|along| along.clamp(0.0, SIDE as f64 - 1.0));
        let length = (inside(way[1])[0] - inside(way[0])[0]).hypot(inside(way[1])[1] - inside(way[0])[1]);
        for snr in [20.0, 60.0, 1500.0] {
            // Of a line of Gaussian profile: √(length / (2·√π)) times its light per px over the noise.
            let dn_per_px = snr * NOISE_DN / (length / (2.0 * std::f64::consts::PI.sqrt())).sqrt();
            let found = searched(0, &frame(100 + k as u64, 40, line(way, dn_per_px)));
            assert!(!found.are_trails && found.found.len() == 1, "{way:?} {snr}: {found:?}");
            let own = found.found[0];
            let off = |at: [f64; 2]| {
                let along = [(way[1][0] - way[0][0]), (way[1][1] - way[0][1])];
                ((at[0] - way[0][0]) * along[1] - (at[1] - way[0][1]) * along[0]).abs() / along[0].hypot(along[1])
            };
            assert!(off(own.start_px) < 3.0 && off(own.end_px) < 3.0, "{way:?} {snr}: {own:?}");
            assert!(own.length_px() > 0.75 * length && own.length_px() < 1.1 * length + 24.0, "{way:?} {snr}: {own:?} {length}");
        }
    }
}

/// A streak whose pieces were taken for stars is found whole all the same; where these stay stars it is not.
#[test]
fn a_chain_of_stars_is_a_streak() {
    let way = [[20.0, -30.0], [250.0, 350.0]];
    // A signal-to-noise ratio of about sixty.
    let (frame, mut stars) = frame(100, 40, line(way, 30.0));
    stars.extend((0..44).map(|k| {
        let share = (f64::from(k) + 0.5) / 44.0;
        let [x_px, y_px] = [0, 1].map(|axis| way[0][axis] + share * (way[1][axis] - way[0][axis]));
        StarDisc { x_px, y_px, radius_px: 6.0 }
    }));
    let sky_frame =
        SkyFrame { number: 0, lowest_read_dn: 0.0, frame: &frame, stars: &stars, bad: None, exposure_s: None, is_compared: false };
    let sky = SkyPixels::new(&frame, &sky_mask(&sky_frame));
    let deviations = Deviations::of(&sky_frame, &sky);
    let found = StreakFrame::of(&sky_frame, &sky, &deviations);
    assert!(!found.are_trails && found.found.len() == 1 && found.found[0].length_px() > 280.0, "{found:?}");
    let none = StreakFrame::among_stars(&sky_frame, &sky, &deviations);
    assert!(none.found.iter().all(|own| own.length_px() < 100.0), "{none:?}");
}

/// What is at the same place in two frames is the detector's; what is in one counts.
#[test]
fn what_stays_is_the_detectors() {
    let scratch = [[40.0, 30.0], [260.0, 280.0]];
    let (both, once) = (line(scratch, 30.0), line([[30.0, 250.0], [280.0, 60.0]], 30.0));
    let frames: Vec<StreakFrame> = (0..4)
        .map(|number| searched(number, &frame(number as u64, 40, |x, y| both(x, y) + if number == 2 { once(x, y) } else { 0.0 })))
        .collect();
    let counted = streaks(&frames).unwrap();
    assert_eq!((counted.count, counted.frames, counted.found[0].frame), (1, 4, 2), "{counted:?}");
    assert!((counted.per_s.unwrap() - 1.0 / 8.0).abs() < 1e-12);
}

/// With one frame alone nobody knows what is at the same place in others.
#[test]
fn one_frame_tells_no_streak_from_a_line_of_the_detector() {
    let one = searched(0, &frame(3, 40, line([[40.0, 30.0], [260.0, 280.0]], 30.0)));
    let other = searched(1, &frame(4, 40, |_, _| 0.0));
    assert_eq!(one.found.len(), 1, "{one:?}");
    assert_eq!(streaks(std::slice::from_ref(&one)), None);
    assert_eq!(streaks(&[one, other]).unwrap().count, 1);
}

/// Stars that are drawn out are no streaks.
#[test]
fn trails_of_stars_are_no_streaks() {
    let light =
        |x: f64, y: f64| (0..20).map(|k| line([[14.0 * f64::from(k), 40.0], [14.0 * f64::from(k) + 30.0, 90.0]], 200.0)(x, y)).sum::<f64>();
    let found = searched(0, &frame(5, 20, light));
    assert!(found.are_trails, "{found:?}");
    assert_eq!(streaks(&[found]), None);
}
