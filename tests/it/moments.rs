//! Moments of star images: what they are of images that are known, and whether their errors are what they say.

use boresight::detect::{DetectOptions, Detection, Moments, detect, detect_windowed};
use boresight::frame::Frame;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::centroids::drawn::{Detector, Image, Part, Sky, Star, electrons_for};

const DETECTOR: Detector = Detector { gain_e_per_dn: 1.5, read_noise_e: 4.0, bias_dn: 100.0, top_dn: 4e6 };
const BACKGROUND_E: f64 = 120.0;
const PITCH_PX: usize = 36;
const CELLS: usize = 8;

/// An elliptical Gaussian as a row of round ones, and its second moments.
fn ellipse(short_px: f64, long_px: f64, turned_rad: f64) -> (Image, [f64; 3]) {
    const PARTS: usize = 41;
    let (s, c) = turned_rad.sin_cos();
    let far = (long_px * long_px - short_px * short_px).sqrt();
    let along: Vec<f64> = (0..PARTS).map(|i| 0.2 * (i as f64 - (PARTS / 2) as f64)).collect();
    let weights: Vec<f64> = along.iter().map(|z| (-0.5 * z * z).exp()).collect();
    let all: f64 = weights.iter().sum();
    let part = |(z, w): (&f64, &f64)| Part { share: w / all, at_px: [far * z * c, far * z * s], sigma_px: short_px };
    let image = Image(along.iter().zip(&weights).map(part).collect());
    let truth = second(&image);
    (image, truth)
}

fn sum(image: &Image, term: impl Fn(&Part) -> f64) -> f64 {
    image.0.iter().map(|p| p.share * term(p)).sum()
}

fn second(image: &Image) -> [f64; 3] {
    let own = |p: &Part| p.sigma_px * p.sigma_px;
    [sum(image, |p| p.at_px[0].powi(2) + own(p)), sum(image, |p| p.at_px[0] * p.at_px[1]), sum(image, |p| p.at_px[1].powi(2) + own(p))]
}

/// The frame of stars of an image at random phases, each alone, and their places.
fn frame(image: &Image, electrons: f64, seed: u64, noisy: bool) -> (Frame, Vec<[f64; 2]>) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut sky = Sky::new(CELLS * PITCH_PX, CELLS * PITCH_PX, BACKGROUND_E);
    let mut places = Vec::new();
    for i in 0..CELLS * CELLS {
        let mut place = |cell: usize| (cell * PITCH_PX + PITCH_PX / 2) as f64 + rng.random_range(-6.0..6.0);
        let [x, y] = [place(i % CELLS), place(i / CELLS)];
        sky.add(&Star { x, y, electrons, image });
        places.push([x, y]);
    }
    (if noisy { sky.expose(&DETECTOR, &mut rng) } else { sky.noiseless(&DETECTOR) }, places)
}

fn known() -> DetectOptions {
    DetectOptions { gain_e_per_dn: Some(DETECTOR.gain_e_per_dn), read_noise_e: Some(DETECTOR.read_noise_e), ..DetectOptions::default() }
}

fn moments(stars: &[Detection], places: &[[f64; 2]]) -> Vec<Moments> {
    let near = |at: &[f64; 2]| stars.iter().find(|s| (s.x_px - at[0]).hypot(s.y_px - at[1]) < 1.5);
    let all: Vec<Moments> = places.iter().filter_map(|at| near(at)?.moments.as_deref().copied()).collect();
    assert_eq!(all.len(), places.len(), "every star has its moments");
    all
}

#[test]
fn moments_of_gaussians_are_their_own_whatever_the_phase() {
    for (short, long, tolerance) in [(0.6, 0.6, 1e-3), (0.6, 0.8, 1e-3), (1.2, 1.7, 1e-3), (2.0, 2.0, 1e-3)] {
        let (image, truth) =
            if short < long { ellipse(short, long, 0.6) } else { (Image::gaussian(short), [short * short, 0.0, short * short]) };
        let (frame, places) = frame(&image, 20_000.0, 1, false);
        let all = moments(&detect(&frame, &known()).unwrap().stars, &places);
        let off = |m: &Moments| (0..3).map(|k| (m.second_px2[k] - truth[k]).abs()).fold(0.0, f64::max) / (short * long);
        let worst = all.iter().map(off).fold(0.0, f64::max);
        let skew = all.iter().flat_map(|m| m.skewness).map(f64::abs).fold(0.0, f64::max);
        println!("{short} {long}: second moments to {worst:.1e} of their size, skewness {skew:.1e}");
        assert!(worst < tolerance && skew < 2e-3, "{short} {long}: {worst} {skew}");
        let first = all[0];
        assert!((first.width_px().unwrap() - (truth[0] * truth[2] - truth[1] * truth[1]).powf(0.25)).abs() < 1e-3 * long);
        let [e1, e2] = first.ellipticity().unwrap();
        let size = truth[0] + truth[2];
        assert!((e1 - (truth[0] - truth[2]) / size).abs() < 2e-3 && (e2 - 2.0 * truth[1] / size).abs() < 2e-3);
    }
}

/// Mean and variance of numbers over their stated errors, and the mean over the scatter.
fn pulls(values: impl Iterator<Item = (f64, f64)> + Clone) -> (f64, f64) {
    let n = values.clone().count() as f64;
    let mean = values.clone().map(|(error, sigma)| error / sigma).sum::<f64>() / n;
    (mean, values.map(|(error, sigma)| (error / sigma - mean).powi(2)).sum::<f64>() / n)
}

/// How far errors are from what they are said to be: the largest mean of pulls, and the least and largest variance.
fn of_frames(image: &Image, snr: f64, count: u64, measure: impl Fn(&Frame) -> Vec<Detection>) -> (f64, [f64; 2]) {
    let electrons = electrons_for(snr, image, BACKGROUND_E, &DETECTOR);
    let truth = second(image);
    let mut all = Vec::new();
    for seed in 0..count {
        let (frame, places) = frame(image, electrons, 100 + seed, true);
        all.extend(moments(&measure(&frame), &places));
    }
    let of_second = (0..3).map(|k| pulls(all.iter().map(move |m| (m.second_px2[k] - truth[k], m.second_sigma_px2[k]))));
    let of_skew = (0..2).map(|k| pulls(all.iter().map(move |m| (m.skewness[k], m.skewness_sigma[k]))));
    let told: Vec<(f64, f64)> = of_second.chain(of_skew).collect();
    let range = told.iter().fold([f64::INFINITY, 0.0_f64], |[low, high], (_, v)| [low.min(*v), high.max(*v)]);
    let mean = told.iter().map(|(m, _)| m.abs()).fold(0.0, f64::max);
    println!("SNR {snr}, {} stars: pulls' means within {mean:.3}, variances {range:.3?}", all.len());
    (mean, range)
}

#[test]
fn moments_under_noise_are_unbiased_and_state_their_errors() {
    // 640 stars: a mean of pulls is sure to 0.04, a variance to 5.6 %; four of these. What noise in the weight biases is below a tenth of σ.
    for (short, long, snr) in [(0.7, 0.7, 15.0), (1.2, 1.2, 30.0), (1.0, 1.4, 100.0)] {
        let image = if short < long { ellipse(short, long, 0.6).0 } else { Image::gaussian(short) };
        let (mean, [low, high]) = of_frames(&image, snr, 10, |frame| detect(frame, &known()).unwrap().stars);
        assert!(mean < 0.1 + 0.16, "{short} {long} {snr}: {mean}");
        assert!(low > 0.76 && high < 1.24, "{short} {long} {snr}: {low} {high}");
    }
}

#[test]
fn the_quick_way_has_moments_too() {
    let image = Image::gaussian(1.4);
    let options = DetectOptions { psf_sigma_px: Some(1.4), ..known() };
    let quick = |frame: &Frame| detect_windowed(frame, &options, None).unwrap().stars;
    let (places, stars) = {
        let (frame, places) = frame(&image, 20_000.0, 1, false);
        (places, quick(&frame))
    };
    for m in moments(&stars, &places) {
        assert!((m.second_px2[0] - 1.96).abs() < 4e-3 && m.second_px2[1].abs() < 4e-3 && m.skewness[0].abs() < 2e-3, "{m:?}");
    }
    for snr in [15.0, 60.0] {
        let (mean, [low, high]) = of_frames(&image, snr, 10, quick);
        assert!(mean < 0.1 + 0.16 && low > 0.76 && high < 1.24, "{mean} {low} {high}");
    }
}

#[test]
fn skewness_points_where_the_tail_is() {
    let part = |share: f64, x: f64, y: f64| Part { share, at_px: [x, y], sigma_px: 1.2 };
    // a fifth of the light to the right and up; the common centre is the origin
    let image = Image(vec![part(0.8, -0.24, 0.12), part(0.2, 0.96, -0.48)]);
    let [xx, xy, yy] = second(&image);
    assert!((sum(&image, |p| p.at_px[0])).abs() < 1e-12);
    // ⟨u |u|²⟩ with u = d over the mean width: the parts' own moments add their distance times four variances, which sum to nothing
    let width2 = f64::midpoint(xx, yy);
    let third = |k: usize| sum(&image, |p| p.at_px[k] * (p.at_px[0].powi(2) + p.at_px[1].powi(2))) / width2.powf(1.5);
    let (frame, places) = frame(&image, 20_000.0, 2, false);
    let (full, quick) = (detect(&frame, &known()).unwrap().stars, detect_windowed(&frame, &known(), None).unwrap().stars);
    for (stars, tolerance) in [(full, 0.1), (quick, 0.1)] {
        for m in moments(&stars, &places) {
            let [x, y] = m.skewness;
            assert!((x - third(0)).hypot(y - third(1)) < tolerance * third(0).hypot(third(1)), "{m:?}");
            assert!((m.second_px2[1] - xy).abs() < 0.05);
        }
    }
}
