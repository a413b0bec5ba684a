//! Finding and measuring stars, on frames drawn here: not by the renderer, whose errors would hide ours.

use boresight::detect::{DetectError, DetectOptions, Detection, Detections, detect};
use boresight::frame::Frame;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal, Poisson};
use rand_pcg::Pcg64;
use statrs::function::erf::erf;

#[derive(Clone, Copy)]
struct Star {
    x: f64,
    y: f64,
    electrons: f64,
    sigma: f64,
}

/// Share of a star's light in the pixel at (`px`, `py`).
fn share(star: &Star, px: usize, py: usize) -> f64 {
    let axis = |p: usize, c: f64| {
        let t = |edge: f64| (p as f64 + edge - c) / (star.sigma * std::f64::consts::SQRT_2);
        0.5 * (erf(t(0.5)) - erf(t(-0.5)))
    };
    axis(px, star.x) * axis(py, star.y)
}

/// A frame in the making: expected electrons.
struct Sky {
    width: usize,
    height: usize,
    electrons: Vec<f64>,
}

impl Sky {
    fn new(width: usize, height: usize, background: f64) -> Self {
        Self { width, height, electrons: vec![background; width * height] }
    }

    fn add(&mut self, star: &Star) {
        let reach = (7.0 * star.sigma + 2.0).ceil();
        let span =
            |at: f64, length: usize| (at.round() - reach).max(0.0) as usize..((at.round() + reach + 1.0).max(0.0) as usize).min(length);
        for y in span(star.y, self.height) {
            for x in span(star.x, self.width) {
                self.electrons[y * self.width + x] += star.electrons * share(star, x, y);
            }
        }
    }

    fn add_all(&mut self, stars: &[Star]) {
        for star in stars {
            self.add(star);
        }
    }

    /// Photon noise, read noise, gain, bias, rounding, and what the converter cannot hold.
    fn expose(&self, detector: &Detector, rng: &mut Pcg64) -> Frame {
        let read = Normal::new(0.0, detector.read_noise_e).unwrap();
        let convert = |&mean: &f64| {
            let photons = if mean > 0.0 { Poisson::new(mean).unwrap().sample(rng) } else { 0.0 };
            let dn = (photons + read.sample(rng)) / detector.gain_e_per_dn + detector.bias_dn;
            ((dn / detector.step_dn).round() * detector.step_dn).clamp(0.0, detector.top_dn) as f32
        };
        let pixels_dn = self.electrons.iter().map(convert).collect();
        Frame { width_px: self.width, height_px: self.height, pixels_dn, saturation_dn: detector.top_dn as f32 }
    }

    fn noiseless(&self) -> Frame {
        let pixels_dn = self.electrons.iter().map(|&e| e as f32).collect();
        Frame { width_px: self.width, height_px: self.height, pixels_dn, saturation_dn: f32::MAX }
    }
}

struct Detector {
    gain_e_per_dn: f64,
    read_noise_e: f64,
    bias_dn: f64,
    step_dn: f64,
    top_dn: f64,
}

const SIXTEEN_BIT: Detector = Detector { gain_e_per_dn: 1.5, read_noise_e: 4.0, bias_dn: 100.0, step_dn: 1.0, top_dn: 65535.0 };
const EIGHT_BIT: Detector = Detector { gain_e_per_dn: 10.0, read_noise_e: 12.0, bias_dn: 0.0, step_dn: 1.0, top_dn: 255.0 };

impl Detector {
    /// Variance of a pixel in electrons that expects so many: photons, reading, rounding.
    fn variance_e2(&self, electrons: f64) -> f64 {
        electrons + self.read_noise_e.powi(2) + (self.gain_e_per_dn * self.step_dn).powi(2) / 12.0
    }
}

/// Cramér–Rao bound: inverse Fisher matrix of x, y, flux and background (and width). Returns σ_x, σ_y, σ_flux (electrons).
fn bound(star: &Star, background: f64, detector: &Detector, free_width: bool) -> [f64; 3] {
    let reach = (6.0 * star.sigma + 2.0) as usize;
    let (cx, cy) = (star.x.round() as usize, star.y.round() as usize);
    let count = if free_width { 5 } else { 4 };
    let mut fisher = nalgebra::DMatrix::<f64>::zeros(count, count);
    let h = 1e-4;
    for y in cy.saturating_sub(reach)..=cy + reach {
        for x in cx.saturating_sub(reach)..=cx + reach {
            let by = |change: fn(&mut Star, f64)| {
                let (mut up, mut down) = (*star, *star);
                change(&mut up, h);
                change(&mut down, -h);
                star.electrons * (share(&up, x, y) - share(&down, x, y)) / (2.0 * h)
            };
            let p = share(star, x, y);
            let row = [by(|s, h| s.x += h), by(|s, h| s.y += h), p, 1.0, by(|s, h| s.sigma += h)];
            let variance = detector.variance_e2(background + star.electrons * p);
            for i in 0..count {
                for j in 0..count {
                    fisher[(i, j)] += row[i] * row[j] / variance;
                }
            }
        }
    }
    let covariance = fisher.try_inverse().unwrap();
    [covariance[(0, 0)].sqrt(), covariance[(1, 1)].sqrt(), covariance[(2, 2)].sqrt()]
}

/// Electrons at which a star has a signal-to-noise ratio.
fn electrons_for(snr: f64, sigma: f64, background: f64, detector: &Detector) -> f64 {
    let (mut low, mut high) = (1.0_f64, 1e9_f64);
    for _ in 0..60 {
        let middle = (low * high).sqrt();
        let star = Star { x: 50.0, y: 50.0, electrons: middle, sigma };
        if middle / bound(&star, background, detector, false)[2] > snr { high = middle } else { low = middle }
    }
    low
}

fn nearest(found: &Detections, x: f64, y: f64) -> Option<&Detection> {
    let distance = |d: &Detection| (d.x_px - x).hypot(d.y_px - y);
    found.stars.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).filter(|d| distance(d) < 2.0)
}

#[derive(Default)]
struct Score {
    stars: usize,
    found: usize,
    /// Σ (error / bound)², over both axes.
    over_bound: f64,
    /// Σ (error / stated error)².
    pull: f64,
    flux_pull: f64,
    offset: f64,
}

/// Stars at random phases on a grid, so that each is alone.
fn trial(sigma: f64, snr: f64, frames: usize, options: &DetectOptions, seed: u64) -> Score {
    const SIDE: usize = 480;
    const PITCH: usize = 32;
    // a converter that holds the brightest: saturation has its own test
    let (background, detector) = (120.0, &Detector { top_dn: 4e6, ..SIXTEEN_BIT });
    let electrons = electrons_for(snr, sigma, background, detector);
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut score = Score::default();
    for _ in 0..frames {
        let mut sky = Sky::new(SIDE, SIDE, background);
        let mut stars = Vec::new();
        for i in 0..(SIDE / PITCH) * (SIDE / PITCH) {
            // no rows of stars: they would look like rows of a detector
            let at = |cell: usize, shift: f64| (cell * PITCH + PITCH / 2) as f64 + shift;
            let (columns, phase) = (SIDE / PITCH, [rng.random_range(-8.0..8.0), rng.random_range(-8.0..8.0)]);
            stars.push(Star { x: at(i % columns, phase[0]), y: at(i / columns, phase[1]), electrons, sigma });
        }
        for star in &stars {
            sky.add(star);
        }
        let found = detect(&sky.expose(detector, &mut rng), options).unwrap();
        for star in &stars {
            score.stars += 1;
            let Some(d) = nearest(&found, star.x, star.y) else { continue };
            let limit = bound(star, background, detector, false);
            let (ex, ey) = (d.x_px - star.x, d.y_px - star.y);
            score.found += 1;
            score.over_bound += (ex / limit[0]).powi(2) + (ey / limit[1]).powi(2);
            score.pull += ex * ex / d.covariance_px2[0] + ey * ey / d.covariance_px2[2];
            score.flux_pull += ((d.flux_dn - star.electrons / detector.gain_e_per_dn) / d.flux_sigma_dn).powi(2);
            score.offset += ex;
        }
    }
    score
}

#[test]
fn centroids_reach_the_cramer_rao_bound_and_state_their_error() {
    let known =
        |sigma| DetectOptions { psf_sigma_px: Some(sigma), gain_e_per_dn: Some(SIXTEEN_BIT.gain_e_per_dn), ..DetectOptions::default() };
    for (i, sigma) in [0.6, 1.0, 2.0].into_iter().enumerate() {
        for (k, snr) in [10.0, 100.0, 1000.0].into_iter().enumerate() {
            for (name, options) in [("psf and gain known", known(sigma)), ("nothing known", DetectOptions::default())] {
                let s = trial(sigma, snr, 5, &options, (10 * i + k) as u64);
                let n = s.found as f64;
                let (ratio, pull, flux_pull) = ((s.over_bound / (2.0 * n)).sqrt(), s.pull / (2.0 * n), s.flux_pull / n);
                println!(
                    "σ {sigma} SNR {snr:4} {name:18}: found {:.4}, error/bound {ratio:.3}, pull² {pull:.3}, flux pull² {flux_pull:.3}, mean {:.5} px",
                    n / s.stars as f64,
                    s.offset / n
                );
                assert!(n > 0.99 * s.stars as f64, "lost stars: {} of {}", s.found, s.stars);
                assert!(ratio < 1.10, "{ratio}");
                // faint stars alone tell the gain poorly
                let allowed = if snr < 20.0 && options.gain_e_per_dn.is_none() { 0.18 } else { 0.10 };
                assert!((pull - 1.0).abs() < allowed, "{pull}");
            }
        }
    }
}

#[test]
fn no_bias_with_the_phase_in_the_pixel() {
    for sigma in [0.6, 1.0, 2.0] {
        let mut worst = 0.0_f64;
        for i in 0..20_usize {
            // 25 phases a frame
            let mut sky = Sky::new(200, 200, 50.0);
            let stars: Vec<Star> = (0..25_usize)
                .map(|k| Star {
                    x: (20 + 40 * (k % 5)) as f64 + (k % 5 + 5 * (i % 4)) as f64 / 20.0 - 0.5,
                    y: (20 + 40 * (k / 5)) as f64 + (k / 5 + 5 * (i / 4)) as f64 / 25.0 - 0.5,
                    electrons: 20_000.0,
                    sigma,
                })
                .collect();
            sky.add_all(&stars);
            let found = detect(&sky.noiseless(), &DetectOptions::default()).unwrap();
            for s in &stars {
                let d = nearest(&found, s.x, s.y).unwrap();
                worst = worst.max((d.x_px - s.x).abs()).max((d.y_px - s.y).abs());
            }
        }
        println!("σ {sigma}: largest error over 500 phases {worst:.2e} px");
        assert!(worst < 0.002, "σ {sigma}: {worst}");
    }
}

#[test]
fn noise_alone_gives_as_many_stars_as_stated() {
    for (name, detector, background, sigma) in [
        ("16 bit", SIXTEEN_BIT, 200.0, None),
        ("16 bit, σ 2", SIXTEEN_BIT, 200.0, Some(2.0)),
        ("8 bit, bias 20", Detector { bias_dn: 20.0, ..EIGHT_BIT }, 100.0, None),
        ("8 bit, clipped at black", EIGHT_BIT, 0.0, None),
        ("8 bit, coarse and clipped", Detector { gain_e_per_dn: 25.0, ..EIGHT_BIT }, 0.0, None),
        ("8 bit, few photons", Detector { read_noise_e: 0.1, gain_e_per_dn: 1.0, ..EIGHT_BIT }, 0.05, None),
    ] {
        let (frames, asked) = (20, 1.0);
        let options = DetectOptions { psf_sigma_px: sigma, false_alarms_per_frame: asked, ..DetectOptions::default() };
        let mut rng = Pcg64::seed_from_u64(5);
        let sky = Sky::new(512, 400, background);
        let total: usize = (0..frames).map(|_| detect(&sky.expose(&detector, &mut rng), &options).unwrap().stars.len()).sum();
        println!("{name}: {} false stars a frame, {asked} asked for", total as f64 / f64::from(frames));
        assert!(total as f64 <= 2.0 * asked * f64::from(frames), "{name}: {total} in {frames} frames");
    }
}

fn field(width: usize, height: usize, count: usize, electrons: std::ops::Range<f64>, sigma: f64, rng: &mut Pcg64) -> Vec<Star> {
    let mut stars: Vec<Star> = Vec::new();
    while stars.len() < count {
        let (x, y) = (rng.random_range(12.0..width as f64 - 13.0), rng.random_range(12.0..height as f64 - 13.0));
        if stars.iter().all(|s| (s.x - x).hypot(s.y - y) > 20.0) {
            let brightness = (rng.random_range(electrons.start.ln()..electrons.end.ln())).exp();
            stars.push(Star { x, y, electrons: brightness, sigma });
        }
    }
    stars
}

#[test]
fn constant_frames_have_no_stars_and_no_error() {
    for value in [0.0, 7.0, 255.0, 1e-3] {
        let frame = Frame { width_px: 64, height_px: 48, pixels_dn: vec![value; 64 * 48], saturation_dn: 255.0 };
        let found = detect(&frame, &DetectOptions::default()).unwrap();
        assert!(found.stars.is_empty());
        assert!(found.noise_dn > 0.0 && found.background_dn == f64::from(value), "{found:?}");
    }
}

#[test]
fn stars_on_a_background_of_exactly_nothing_are_found() {
    let mut rng = Pcg64::seed_from_u64(3);
    let stars = field(300, 300, 40, 300.0..30_000.0, 1.1, &mut rng);
    let mut sky = Sky::new(300, 300, 0.0);
    sky.add_all(&stars);
    let mut whole = sky.noiseless();
    for v in &mut whole.pixels_dn {
        *v = v.round();
    }
    for frame in [sky.noiseless(), whole] {
        let found = detect(&frame, &DetectOptions::default()).unwrap();
        assert_eq!(found.stars.len(), stars.len());
        for s in &stars {
            let d = nearest(&found, s.x, s.y).expect("star not found");
            assert!((d.x_px - s.x).hypot(d.y_px - s.y) < 0.03 && (d.flux_dn / s.electrons - 1.0).abs() < 0.05, "{d:?}");
        }
    }
}

#[test]
fn brightest_come_first_and_the_count_is_limited() {
    let mut rng = Pcg64::seed_from_u64(4);
    let stars = field(300, 300, 30, 3_000.0..60_000.0, 1.3, &mut rng);
    let mut sky = Sky::new(300, 300, 50.0);
    sky.add_all(&stars);
    let frame = sky.expose(&SIXTEEN_BIT, &mut rng);
    let all = detect(&frame, &DetectOptions::default()).unwrap();
    let few = detect(&frame, &DetectOptions { max_stars: 7, ..DetectOptions::default() }).unwrap();
    assert!(all.stars.is_sorted_by(|a, b| a.flux_dn >= b.flux_dn));
    assert_eq!(few.stars, all.stars[..7]);
}

#[test]
fn threads_do_not_change_the_result() {
    let mut rng = Pcg64::seed_from_u64(6);
    let stars = field(400, 300, 60, 1_000.0..60_000.0, 1.0, &mut rng);
    let mut sky = Sky::new(400, 300, 50.0);
    sky.add_all(&stars);
    let frame = sky.expose(&SIXTEEN_BIT, &mut rng);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| detect(&frame, &DetectOptions::default()).unwrap())
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn hot_pixels_are_left_out_and_stars_kept() {
    for (sigma, seed) in [(0.6, 7), (1.2, 8)] {
        let mut rng = Pcg64::seed_from_u64(seed);
        let stars = field(500, 400, 60, 2_000.0..60_000.0, sigma, &mut rng);
        let mut sky = Sky::new(500, 400, 100.0);
        sky.add_all(&stars);
        let mut frame = sky.expose(&SIXTEEN_BIT, &mut rng);
        let mut hot = Vec::new();
        while hot.len() < 300 {
            let (x, y) = (rng.random_range(0..500_usize), rng.random_range(0..400_usize));
            if stars.iter().all(|s| (s.x - x as f64).hypot(s.y - y as f64) > 8.0) {
                frame.pixels_dn[y * 500 + x] += rng.random_range(60.0_f32.ln()..40_000.0_f32.ln()).exp().round();
                hot.push((x as f64, y as f64));
            }
        }
        let found = detect(&frame, &DetectOptions::default()).unwrap();
        let kept = stars.iter().filter(|s| nearest(&found, s.x, s.y).is_some_and(|d| (d.x_px - s.x).hypot(d.y_px - s.y) < 0.2)).count();
        let passed = hot.iter().filter(|h| nearest(&found, h.0, h.1).is_some()).count();
        println!("σ {sigma}: {kept} of {} stars, {passed} of {} hot pixels, {} in all", stars.len(), hot.len(), found.stars.len());
        assert!(kept >= 59 && passed <= 15, "σ {sigma}: {kept} stars, {passed} hot pixels");
    }
}

#[test]
fn saturated_stars_keep_their_place() {
    let mut rng = Pcg64::seed_from_u64(9);
    let mut worst = 0.0_f64;
    for detector in [Detector { top_dn: 4095.0, ..SIXTEEN_BIT }, EIGHT_BIT] {
        for declared in [true, false] {
            let mut sky = Sky::new(300, 300, 60.0);
            let bright = field(300, 300, 12, 300_000.0..3_000_000.0, 1.4, &mut rng);
            sky.add_all(&bright);
            let mut frame = sky.expose(&detector, &mut rng);
            if !declared {
                frame.saturation_dn = 65535.0;
            }
            let found = detect(&frame, &DetectOptions::default()).unwrap();
            for s in &bright {
                let d = nearest(&found, s.x, s.y).expect("saturated star lost");
                assert!(d.flags.saturated, "{d:?}");
                worst = worst.max((d.x_px - s.x).hypot(d.y_px - s.y));
            }
            assert!(found.stars.len() <= bright.len() + 4, "{} stars for {}", found.stars.len(), bright.len());
        }
    }
    println!("saturated stars: largest error {worst:.3} px");
    assert!(worst < 0.1, "{worst}");
}

#[test]
fn a_star_cut_by_the_edge_is_flagged_and_measured() {
    let mut rng = Pcg64::seed_from_u64(10);
    let stars = [(1.3, 100.2), (100.0, 198.4), (100.4, 100.1), (0.2, 0.4)].map(|(x, y)| Star { x, y, electrons: 30_000.0, sigma: 1.3 });
    let mut sky = Sky::new(200, 200, 60.0);
    sky.add_all(&stars);
    let found = detect(&sky.expose(&SIXTEEN_BIT, &mut rng), &DetectOptions::default()).unwrap();
    for (s, edge) in stars.iter().zip([true, true, false, true]) {
        let d = nearest(&found, s.x, s.y).expect("star not found");
        assert_eq!(d.flags.edge, edge);
        let error = (d.x_px - s.x).hypot(d.y_px - s.y);
        assert!(error < 5.0 * (d.covariance_px2[0] + d.covariance_px2[2]).sqrt(), "{error} px: {d:?}");
    }
}

#[test]
fn gradients_and_row_patterns_neither_hide_nor_make_stars() {
    let mut rng = Pcg64::seed_from_u64(11);
    let stars = field(600, 400, 80, 4_000.0..80_000.0, 1.2, &mut rng);
    let mut sky = Sky::new(600, 400, 0.0);
    for (i, e) in sky.electrons.iter_mut().enumerate() {
        let (x, y) = ((i % 600) as f64, (i / 600) as f64);
        // slope, glow from the right edge, vignetting, and rows that differ
        *e = 100.0 + 0.5 * x + 900.0 * ((x - 600.0) / 25.0).exp() - 1e-4 * (y - 200.0).powi(2) + if i / 600 % 4 == 0 { 30.0 } else { 0.0 };
    }
    sky.add_all(&stars);
    let found = detect(&sky.expose(&SIXTEEN_BIT, &mut rng), &DetectOptions::default()).unwrap();
    let kept = stars.iter().filter(|s| nearest(&found, s.x, s.y).is_some_and(|d| (d.x_px - s.x).hypot(d.y_px - s.y) < 0.3)).count();
    println!("{kept} of {} stars, {} found", stars.len(), found.stars.len());
    assert!(kept >= 79 && found.stars.len() <= kept + 6);
    let slope = found.stars.iter().filter(|d| d.x_px < 400.0).map(|d| d.background_gradient_dn[0]).sum::<f64>()
        / found.stars.iter().filter(|d| d.x_px < 400.0).count() as f64;
    assert!((slope - 0.5 / SIXTEEN_BIT.gain_e_per_dn).abs() < 0.1, "{slope}");
}

#[test]
fn trailed_and_defocused_stars_are_found_once_each() {
    let mut rng = Pcg64::seed_from_u64(12);
    for (name, length, angle, sigma) in
        [("trailed 12 px", 12.0, 0.5_f64, 1.0), ("trailed 20 px", 20.0, 2.0, 1.2), ("defocused", 0.0, 0.0, 4.0)]
    {
        let stars = field(500, 500, 40, 40_000.0..400_000.0, sigma, &mut rng);
        let stars: Vec<Star> = stars
            .into_iter()
            .enumerate()
            .map(|(i, s)| Star { x: (40 + 70 * (i % 7)) as f64 + s.x.fract(), y: (40 + 70 * (i / 7)) as f64 + s.y.fract(), ..s })
            .collect();
        let mut sky = Sky::new(500, 500, 100.0);
        for s in &stars {
            let steps = 41;
            for k in 0..steps {
                let t = (f64::from(k) / f64::from(steps - 1) - 0.5) * length;
                sky.add(&Star { x: s.x + t * angle.cos(), y: s.y + t * angle.sin(), electrons: s.electrons / f64::from(steps), ..*s });
            }
        }
        let found = detect(&sky.expose(&SIXTEEN_BIT, &mut rng), &DetectOptions::default()).unwrap();
        let errors: Vec<f64> = stars.iter().filter_map(|s| nearest(&found, s.x, s.y).map(|d| (d.x_px - s.x).hypot(d.y_px - s.y))).collect();
        let middle = boresight::statistics::median(&errors).unwrap();
        println!("{name}: {} of {} found, {} in all, median error {middle:.3} px", errors.len(), stars.len(), found.stars.len());
        assert!(errors.len() >= stars.len() - 1 && found.stars.len() <= stars.len() + 4, "{name}");
        assert!(middle < 0.15, "{name}: {middle}");
    }
}

#[test]
fn close_pairs_are_told_apart() {
    let mut rng = Pcg64::seed_from_u64(13);
    let mut sky = Sky::new(400, 400, 80.0);
    let mut stars = Vec::new();
    for i in 0..49_usize {
        let (x, y) = ((30 + 56 * (i % 7)) as f64 + rng.random::<f64>(), (30 + 56 * (i / 7)) as f64 + rng.random::<f64>());
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        stars.push(Star { x, y, electrons: 40_000.0, sigma: 1.2 });
        stars.push(Star { x: x + 6.5 * angle.cos(), y: y + 6.5 * angle.sin(), electrons: 15_000.0, sigma: 1.2 });
    }
    sky.add_all(&stars);
    let found = detect(&sky.expose(&SIXTEEN_BIT, &mut rng), &DetectOptions::default()).unwrap();
    let pulls: Vec<f64> = stars
        .iter()
        .map(|s| {
            let d = nearest(&found, s.x, s.y).expect("star of a pair lost");
            assert!(d.flags.blended);
            f64::midpoint((d.x_px - s.x).powi(2) / d.covariance_px2[0], (d.y_px - s.y).powi(2) / d.covariance_px2[2])
        })
        .collect();
    let mean = pulls.iter().sum::<f64>() / pulls.len() as f64;
    println!("pairs 6.5 px apart: pull² {mean:.2}");
    assert!(found.stars.len() <= stars.len() + 2 && mean < 1.5, "{} stars, pull² {mean}", found.stars.len());
}

#[test]
fn stars_of_near_pairs_do_not_draw_each_other() {
    let mut rng = Pcg64::seed_from_u64(14);
    let mut sky = Sky::new(450, 450, 120.0);
    let (mut stars, mut towards) = (Vec::new(), Vec::new());
    for i in 0..81_usize {
        let (x, y) = ((25 + 50 * (i % 9)) as f64 + rng.random::<f64>(), (25 + 50 * (i / 9)) as f64 + rng.random::<f64>());
        stars.push(Star { x, y, electrons: 30_000.0, sigma: 1.1 });
        // most stand alone and tell the image
        if i % 6 == 0 {
            let (s, c) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
            stars.push(Star { x: x + 4.0 * c, y: y + 4.0 * s, electrons: 30_000.0, sigma: 1.1 });
            towards.push((stars.len() - 2, [c, s]));
            towards.push((stars.len() - 1, [-c, -s]));
        }
    }
    sky.add_all(&stars);
    let options = DetectOptions { psf_sigma_px: Some(1.1), gain_e_per_dn: Some(SIXTEEN_BIT.gain_e_per_dn), ..DetectOptions::default() };
    let found = detect(&sky.expose(&SIXTEEN_BIT, &mut rng), &options).unwrap();
    let (mut drawn, mut pull2) = (0.0, 0.0);
    for (k, [c, s]) in &towards {
        let star = &stars[*k];
        let d = nearest(&found, star.x, star.y).expect("star of a pair lost");
        drawn += (d.x_px - star.x) * c + (d.y_px - star.y) * s;
        pull2 += f64::midpoint((d.x_px - star.x).powi(2) / d.covariance_px2[0], (d.y_px - star.y).powi(2) / d.covariance_px2[2]);
    }
    let n = towards.len() as f64;
    println!("pairs 4 px apart: drawn to each other by {:.4} px, pull² {:.2}", drawn / n, pull2 / n);
    // a star is sure to about 0.01 px, the mean of all to 0.002
    assert!((drawn / n).abs() < 0.006 && pull2 / n < 1.7, "{} {}", drawn / n, pull2 / n);
}

#[test]
fn frames_that_cannot_be_used_are_refused_with_a_reason() {
    let frame = |width_px, height_px, pixels_dn| Frame { width_px, height_px, pixels_dn, saturation_dn: 255.0 };
    let options = DetectOptions::default();
    let message = |f: &Frame, o: &DetectOptions| detect(f, o).unwrap_err().to_string();
    assert!(message(&frame(1, 1, vec![0.0]), &options).contains("1 × 1"));
    assert!(matches!(detect(&frame(3, 3, vec![0.0; 8]), &options), Err(DetectError::SizeMismatch { found: 8, .. })));
    let mut pixels = vec![0.0; 400];
    pixels[43] = f32::NAN;
    assert!(message(&frame(20, 20, pixels), &options).contains("column 3, row 2"));
    let good = frame(20, 20, vec![0.0; 400]);
    assert!(message(&good, &DetectOptions { gain_e_per_dn: Some(-1.0), ..options }).contains("gain_e_per_dn"));
    assert!(message(&good, &DetectOptions { false_alarms_per_frame: 0.0, ..options }).contains("false_alarms_per_frame"));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: Some(crate::common::regressions()), ..ProptestConfig::default() })]
    #[test]
    fn any_frame_gives_stars_or_an_error(width in 1_usize..50, height in 1_usize..50, kind in 0..5, seed: u64) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let pixels_dn: Vec<f32> = (0..width * height).map(|_| match kind {
            0 => 255.0,
            1 => f32::from(rng.random_range(0..=255_u8)),
            2 => if rng.random_bool(0.02) { 255.0 } else { 0.0 },
            3 => rng.random_range(-1e30..1e30),
            _ => if rng.random_bool(0.9) { 255.0 } else { f32::from(rng.random_range(0..=255_u8)) },
        }).collect();
        let frame = Frame { width_px: width, height_px: height, pixels_dn, saturation_dn: 255.0 };
        match detect(&frame, &DetectOptions::default()) {
            Ok(found) => for d in found.stars {
                prop_assert!(d.x_px.is_finite() && d.y_px.is_finite() && d.flux_dn > 0.0 && d.flux_sigma_dn > 0.0);
                prop_assert!(d.covariance_px2[0] > 0.0 && d.covariance_px2[2] > 0.0);
                prop_assert!(d.x_px > -20.0 && d.x_px < width as f64 + 20.0);
            },
            Err(e) => prop_assert!(width < 9 || height < 9, "{e}"),
        }
    }
}
