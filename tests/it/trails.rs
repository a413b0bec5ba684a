//! Stars that moved while they were exposed: found whole, placed and measured as their errors say; and images that only look like it.

use boresight::detect::{DetectOptions, Detection, detect};
use boresight::frame::Frame;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::centroids::drawn::{Detector, Image, Part, Sky, Star, electrons_for};

const DETECTOR: Detector = Detector { gain_e_per_dn: 1.5, read_noise_e: 4.0, bias_dn: 100.0, top_dn: 65535.0 };
const SKY_E: f64 = 120.0;
const SIGMA_PX: f64 = 1.1;
const TURNED_RAD: f64 = 0.5;
const CELLS: usize = 10;

fn trail(length_px: f64, bent_per_px: f64) -> Image {
    trail_turned(length_px, TURNED_RAD, bent_per_px)
}

/// A round star drawn out along a line, or along an arc of this curvature, as a row of round ones: closer than their width, they leave no ripples.
fn trail_turned(length_px: f64, turned_rad: f64, bent_per_px: f64) -> Image {
    let count = (length_px * 1.2).ceil().max(6.0) as usize;
    let (s, c) = turned_rad.sin_cos();
    let part = |k: usize| {
        let t = ((k as f64 + 0.5) / count as f64 - 0.5) * length_px;
        let aside = 0.5 * bent_per_px * (t * t - length_px * length_px / 12.0);
        Part { share: 1.0 / count as f64, at_px: [t * c - aside * s, t * s + aside * c], sigma_px: SIGMA_PX }
    };
    Image((0..count).map(part).collect())
}

/// Electrons of a star that would have this signal-to-noise ratio if it stood still.
fn electrons(snr: f64) -> f64 {
    electrons_for(snr, &Image::gaussian(SIGMA_PX), SKY_E, &DETECTOR)
}

/// A frame of stars of one image, each in a cell of its own, and their places.
fn frame(image: &Image, electrons: f64, pitch_px: usize, seed: u64, noisy: bool) -> (Frame, Vec<[f64; 2]>) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut sky = Sky::new(CELLS * pitch_px, CELLS * pitch_px, SKY_E);
    let mut places = Vec::new();
    for i in 0..CELLS * CELLS {
        let mut place = |cell: usize| (cell * pitch_px + pitch_px / 2) as f64 + rng.random_range(-8.0..8.0);
        let [x, y] = [place(i % CELLS), place(i / CELLS)];
        sky.add(&Star { x, y, electrons, image });
        places.push([x, y]);
    }
    (if noisy { sky.expose(&DETECTOR, &mut rng) } else { sky.noiseless(&DETECTOR) }, places)
}

fn known() -> DetectOptions {
    DetectOptions { gain_e_per_dn: Some(DETECTOR.gain_e_per_dn), read_noise_e: Some(DETECTOR.read_noise_e), ..DetectOptions::default() }
}

fn nearest(stars: &[Detection], [x, y]: [f64; 2]) -> Option<&Detection> {
    let far = |d: &Detection| (d.x_px - x).hypot(d.y_px - y);
    stars.iter().min_by(|a, b| far(a).total_cmp(&far(b))).filter(|d| far(d) < 4.0)
}

/// What was found of frames of one image: stars, those found, all detections; mean squared pulls of place (an axis) and flux; mean ratio of fluxes.
#[derive(Debug)]
struct Score {
    stars: usize,
    found: usize,
    detections: usize,
    place: f64,
    flux: f64,
    ratio: f64,
}

fn score(image: &Image, snr: f64, frames: u64) -> Score {
    let mut score = Score { stars: 0, found: 0, detections: 0, place: 0.0, flux: 0.0, ratio: 0.0 };
    let light = electrons(snr);
    for seed in 0..frames {
        let (frame, places) = frame(image, light, 56, 40 + seed, true);
        let found = detect(&frame, &known()).unwrap().stars;
        score.stars += places.len();
        score.detections += found.len();
        for ([x, y], d) in places.iter().filter_map(|at| Some((at, nearest(&found, *at)?))) {
            let (dx, dy, [xx, xy, yy]) = (d.x_px - x, d.y_px - y, d.covariance_px2);
            let flux_dn = light / DETECTOR.gain_e_per_dn;
            score.found += 1;
            score.place += (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (2.0 * (xx * yy - xy * xy));
            score.flux += ((d.flux_dn - flux_dn) / d.flux_sigma_dn).powi(2);
            score.ratio += d.flux_dn / flux_dn;
        }
    }
    let n = score.found as f64;
    Score { place: score.place / n, flux: score.flux / n, ratio: score.ratio / n, ..score }
}

#[test]
fn trails_are_found_whole_and_state_their_errors() {
    // at 20 px and a ratio of 30 no piece of a trail stands out of the noise by more than 5 σ or so
    for (length, snr) in [(2.0, 300.0), (5.0, 100.0), (12.0, 60.0), (20.0, 30.0)] {
        let s = score(&trail(length, 0.0), snr, 3);
        println!("{length} px, ratio {snr}: {s:?}");
        assert!(s.found == s.stars && s.detections <= s.stars + 6, "{s:?}");
        // 300 stars: the mean of squared pulls of place is sure to 6 %, of flux to 8 %; three of these, and 0.1
        assert!((s.place - 1.0).abs() < 0.1 + 0.18 && (s.flux - 1.0).abs() < 0.1 + 0.24, "{s:?}");
        // the ratio of the trail itself is up to 2.5 times less
        assert!((s.ratio - 1.0).abs() < 0.002 + 3.0 * 2.5 / (snr * 300.0_f64.sqrt()), "{s:?}");
    }
}

/// Stars of all brightnesses under a camera that rolled about the frame's middle: trails lie around it, and stars there stand still.
#[test]
fn trails_of_a_roll_are_measured_each_its_own_way() {
    const ROLL_RAD: f64 = 0.03;
    let (pitch, mut rng) = (56, Pcg64::seed_from_u64(11));
    let middle = 0.5 * ((CELLS * pitch) as f64 - 1.0);
    let (mut place2, mut flux2, mut count, mut all) = (0.0, 0.0, 0.0, 0);
    for _ in 0..2 {
        let mut sky = Sky::new(CELLS * pitch, CELLS * pitch, SKY_E);
        let mut stars = Vec::new();
        for i in 0..CELLS * CELLS {
            let mut place = |cell: usize| (cell * pitch + pitch / 2) as f64 + rng.random_range(-8.0..8.0);
            let (x, y) = (place(i % CELLS), place(i / CELLS));
            let (along_x, along_y) = (-ROLL_RAD * (y - middle), ROLL_RAD * (x - middle));
            let image = trail_turned(along_x.hypot(along_y), along_y.atan2(along_x), 0.0);
            let electrons = electrons(50.0) * rng.random_range(0.0_f64..2.0).exp();
            sky.add(&Star { x, y, electrons, image: &image });
            stars.push(([x, y], electrons / DETECTOR.gain_e_per_dn));
        }
        let found = detect(&sky.expose(&DETECTOR, &mut rng), &known()).unwrap().stars;
        all += found.len();
        for (at, flux_dn) in &stars {
            let d = nearest(&found, *at).expect("a star of a roll is lost");
            let (dx, dy, [xx, xy, yy]) = (d.x_px - at[0], d.y_px - at[1], d.covariance_px2);
            place2 += (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (2.0 * (xx * yy - xy * xy));
            flux2 += ((d.flux_dn - flux_dn) / d.flux_sigma_dn).powi(2);
            count += 1.0;
        }
    }
    println!("{all} detections of {count} stars, squared pulls of place {:.3}, of flux {:.3}", place2 / count, flux2 / count);
    // 200 stars: sure to 7 and 10 %; three of these, and 0.1
    assert!(all <= count as usize + 4 && (place2 / count - 1.0).abs() < 0.1 + 0.21 && (flux2 / count - 1.0).abs() < 0.1 + 0.3);
}

/// An elliptical Gaussian as a row of round ones.
fn ellipse(far_px: f64) -> Image {
    let along: Vec<f64> = (-24..=24).map(|k| 0.2 * f64::from(k)).collect();
    let all: f64 = along.iter().map(|z| (-0.5 * z * z).exp()).sum();
    let (s, c) = TURNED_RAD.sin_cos();
    let part = |z: &f64| Part { share: (-0.5 * z * z).exp() / all, at_px: [far_px * z * c, far_px * z * s], sigma_px: SIGMA_PX };
    Image(along.iter().map(part).collect())
}

#[test]
fn ellipses_of_optics_are_no_trails() {
    // a trail in the place of an ellipse loses the light of its ends, a hundredth of it and more
    for (far, snr) in [(1.0, 300.0), (2.5, 100.0), (2.5, 300.0)] {
        let s = score(&ellipse(far), snr, 2);
        println!("{far} px, ratio {snr}: {s:?}");
        assert!(s.found == s.stars && s.detections <= s.stars + 4, "{s:?}");
        assert!((s.ratio - 1.0).abs() < 0.002 && (s.place - 1.0).abs() < 0.32 && (s.flux - 1.0).abs() < 0.4, "{s:?}");
    }
}

/// Second moment along a trail under the Gaussian weight that has it too: under it every part is a Gaussian again, and the moment is half the weight's.
fn under_its_own_weight(image: &Image) -> f64 {
    let mut own = 10.0_f64;
    for _ in 0..200 {
        let (mut light, mut moment) = (0.0, 0.0);
        for part in &image.0 {
            let (at2, variance) = (part.at_px[0].powi(2) + part.at_px[1].powi(2), part.sigma_px.powi(2));
            let share = part.share * (-0.5 * at2 / (own + variance)).exp();
            light += share;
            moment += share * (at2 * (own / (own + variance)).powi(2) + own * variance / (own + variance));
        }
        own = 1.0 / (light / moment - 1.0 / own);
    }
    own
}

#[test]
fn faint_trails_have_the_moments_of_bright_ones() {
    let image = trail(12.0, 0.0);
    let second = |electrons: f64, noisy: bool, seed: u64| -> Vec<([f64; 3], [f64; 3])> {
        let (frame, places) = frame(&image, electrons, 56, seed, noisy);
        let found = detect(&frame, &known()).unwrap().stars;
        let of = |at: &[f64; 2]| nearest(&found, *at)?.moments.as_ref().map(|m| (m.second_px2, m.second_sigma_px2));
        places.iter().filter_map(of).collect()
    };
    let bright = second(60_000.0, false, 1);
    let truth: [f64; 3] = std::array::from_fn(|k| bright.iter().map(|m| m.0[k]).sum::<f64>() / bright.len() as f64);
    let (s, c) = TURNED_RAD.sin_cos();
    let along = truth[0] * c * c + 2.0 * truth[1] * s * c + truth[2] * s * s;
    let expected = under_its_own_weight(&image);
    println!("{truth:?}, along the trail {along:.3} px², expected {expected:.3}");
    assert!((along / expected - 1.0).abs() < 0.01, "{along} {expected}");
    let all: Vec<_> = (2..6).flat_map(|seed| second(electrons(30.0), true, seed)).collect();
    assert!(all.len() >= 396, "{}", all.len());
    for k in 0..3 {
        let pull = |(value, sigma): &([f64; 3], [f64; 3])| (value[k] - truth[k]) / sigma[k];
        let mean = all.iter().map(pull).sum::<f64>() / all.len() as f64;
        let square = all.iter().map(|m| pull(m).powi(2)).sum::<f64>() / all.len() as f64;
        println!("moment {k}: mean pull {mean:.3}, squared {square:.3}");
        // 400 stars: sure to 0.05 and 7 %; four of these, and a tenth of σ
        assert!(mean.abs() < 0.1 + 0.2 && (square - 1.0).abs() < 0.1 + 0.28, "{k}: {mean} {square}");
    }
}

#[test]
fn long_and_bent_trails_are_one_star_each() {
    // an arc is no line: its place is worse than a line's, by less than its sagitta
    for (length, bent, snr, most_px) in [(40.0, 0.0, 300.0, 0.3), (60.0, 0.0, 100.0, 1.5), (40.0, 0.004, 100.0, 1.5)] {
        let image = trail(length, bent);
        let (frame, places) = frame(&image, electrons(snr), 90, 7, true);
        let found = detect(&frame, &known()).unwrap().stars;
        let near: Vec<&Detection> = places.iter().filter_map(|at| nearest(&found, *at)).collect();
        println!("{length} px, bent by {bent}: {} of {}, {} detections", near.len(), places.len(), found.len());
        assert!(near.len() == places.len() && found.len() <= places.len() + 3);
        for (d, at) in near.iter().zip(&places) {
            assert!((d.x_px - at[0]).hypot(d.y_px - at[1]) < most_px, "{d:?}");
        }
    }
}

#[test]
fn trails_longer_than_any_window_are_no_error() {
    let (image, mut rng, mut sky) = (trail(150.0, 0.003), Pcg64::seed_from_u64(8), Sky::new(400, 300, SKY_E));
    for _ in 0..14 {
        let (x, y) = (rng.random_range(0.0..400.0), rng.random_range(0.0..300.0));
        sky.add(&Star { x, y, electrons: electrons(200.0), image: &image });
    }
    let found = detect(&sky.expose(&DETECTOR, &mut rng), &known()).unwrap();
    assert!(found.stars.iter().all(|d| d.flux_sigma_dn > 0.0 && d.covariance_px2.iter().all(|c| c.is_finite())));
}

#[test]
fn threads_do_not_change_trails() {
    let (frame, _) = frame(&trail(20.0, 0.0), electrons(30.0), 56, 9, true);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| detect(&frame, &known()).unwrap())
    };
    assert_eq!(run(1), run(3));
}
