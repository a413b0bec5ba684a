//! How near centroids come to the statistical limit: `cargo bench --bench detect -- --study [--page FILE]`.

use std::fmt::Write as _;

use boresight::detect::{DetectOptions, Detection, Detections, detect, detect_windowed};
use boresight::frame::Frame;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::drawn::{Detector, Image, Sky, Star, electrons_for};
use super::learnt;

const SIGMAS_PX: [f64; 4] = [0.6, 0.8, 1.2, 2.0];
const SNRS: [f64; 5] = [10.0, 30.0, 100.0, 300.0, 1000.0];
pub(crate) const SIDE_PX: usize = 1024;
pub(crate) const PITCH_PX: usize = 40;
/// Stars lie so far from the middles of their cells, at most: none in another's window, and no rows of them, which would look like rows of a detector.
const ASIDE_PX: f64 = 12.0;
pub(crate) const BACKGROUND_E: f64 = 120.0;
/// A converter that holds the brightest: saturation has its own test.
pub(crate) const DETECTOR: Detector = Detector { gain_e_per_dn: 1.5, read_noise_e: 4.0, bias_dn: 100.0, top_dn: 4e6 };
/// Bins of the phase in which the mean error is taken.
const PHASES: usize = 10;

/// What a point of the study measured.
#[derive(Clone, Default)]
pub(crate) struct Score {
    pub(crate) stars: f64,
    pub(crate) found: f64,
    /// Σ of squared errors and of squared bounds, both axes, px².
    error2: f64,
    bound2: f64,
    /// Σ of errors in x and in y.
    error: [f64; 2],
    /// Σ (error / stated error)², both axes.
    pull2: f64,
    /// The same of the flux.
    flux_pull2: f64,
    /// Σ of flux over what it is.
    flux: f64,
    /// Σ of errors over bins of the phase, both axes, and how many.
    at_phase: [[[f64; 2]; PHASES]; 2],
    /// Σ of errors over the square of what was stated, and Σ of what was stated to the power −2, per axis.
    told: [[f64; 2]; 2],
}

impl Score {
    pub(crate) fn add(mut self, other: &Self) -> Self {
        let sums = self.at_phase.as_flattened_mut().iter_mut().chain(&mut self.told);
        for (own, theirs) in sums.zip(other.at_phase.as_flattened().iter().chain(&other.told)) {
            *own = [own[0] + theirs[0], own[1] + theirs[1]];
        }
        Self {
            stars: self.stars + other.stars,
            found: self.found + other.found,
            error2: self.error2 + other.error2,
            bound2: self.bound2 + other.bound2,
            error: [self.error[0] + other.error[0], self.error[1] + other.error[1]],
            pull2: self.pull2 + other.pull2,
            flux_pull2: self.flux_pull2 + other.flux_pull2,
            flux: self.flux + other.flux,
            at_phase: self.at_phase,
            told: self.told,
        }
    }

    fn take(&mut self, star: &Star<'_>, found: Option<&Detection>) {
        self.stars += 1.0;
        let Some(d) = found else { return };
        let (bound, _) = star.bound(BACKGROUND_E, &DETECTOR, false);
        let errors = [d.x_px - star.x, d.y_px - star.y];
        self.found += 1.0;
        self.bound2 += bound[0] + bound[1];
        self.error = [self.error[0] + errors[0], self.error[1] + errors[1]];
        let axes = [(d.covariance_px2[0], star.x), (d.covariance_px2[2], star.y)];
        for (axis, (error, (variance, truth))) in errors.into_iter().zip(axes).enumerate() {
            self.error2 += error * error;
            self.pull2 += error * error / variance;
            let bin = ((truth + 0.5).rem_euclid(1.0) * PHASES as f64) as usize;
            let bin = &mut self.at_phase[axis][bin.min(PHASES - 1)];
            *bin = [bin[0] + error, bin[1] + 1.0];
            self.told[axis] = [self.told[axis][0] + error / variance, self.told[axis][1] + 1.0 / variance];
        }
        self.flux += d.flux_dn * DETECTOR.gain_e_per_dn / star.electrons;
        self.flux_pull2 += ((d.flux_dn - star.electrons / DETECTOR.gain_e_per_dn) / d.flux_sigma_dn).powi(2);
    }

    /// 2-D error over the bound.
    pub(crate) fn over_bound(&self) -> f64 {
        (self.error2 / self.bound2).sqrt()
    }

    /// The same with errors counted from their mean: where in its image a star lies is a matter of definition.
    pub(crate) fn centred(mut self) -> Self {
        let n = self.found;
        self.error2 -= self.error.iter().map(|e| e * e / n).sum::<f64>();
        for axis in 0..2 {
            let mean = self.error[axis] / n;
            let [sum, weight] = self.told[axis];
            self.pull2 += mean * mean * weight - 2.0 * mean * sum;
            for bin in &mut self.at_phase[axis] {
                bin[0] -= mean * bin[1];
            }
        }
        self
    }

    /// Variance of the pulls per axis.
    pub(crate) fn pull2(&self) -> f64 {
        self.pull2 / (2.0 * self.found)
    }

    /// Mean of flux over what it is.
    #[allow(dead_code, reason = "a test reads it")]
    pub(crate) fn flux_ratio(&self) -> f64 {
        self.flux / self.found
    }

    /// The largest mean error of the phases, px.
    pub(crate) fn bias_px(&self) -> f64 {
        self.at_phase.as_flattened().iter().filter(|p| p[1] > 0.0).map(|p| (p[0] / p[1]).abs()).fold(0.0, f64::max)
    }
}

pub(crate) fn nearest(found: &Detections, x: f64, y: f64) -> Option<&Detection> {
    let distance = |d: &Detection| (d.x_px - x).hypot(d.y_px - y);
    found.stars.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).filter(|d| distance(d) < 2.0)
}

/// Random phases, each star alone.
pub(crate) fn places(side_px: usize, rng: &mut Pcg64) -> Vec<[f64; 2]> {
    let cells = side_px / PITCH_PX;
    let mut place = |cell: usize| (cell * PITCH_PX + PITCH_PX / 2) as f64 + rng.random_range(-ASIDE_PX..ASIDE_PX);
    (0..cells * cells).map(|i| [place(i % cells), place(i / cells)]).collect()
}

/// The frame that stars make.
pub(crate) fn sky_of(stars: &[Star<'_>], side_px: usize) -> Sky {
    let mut sky = Sky::new(side_px, side_px, BACKGROUND_E);
    for star in stars {
        sky.add(star);
    }
    sky
}

/// One frame of stars at random phases, each alone.
fn frame_of<'a>(image: &'a Image, electrons: f64, side_px: usize, rng: &mut Pcg64) -> (Sky, Vec<Star<'a>>) {
    let stars: Vec<Star<'a>> = places(side_px, rng).into_iter().map(|[x, y]| Star { x, y, electrons, image }).collect();
    (sky_of(&stars, side_px), stars)
}

/// Frames to draw: how many, columns and rows of each, and the seed.
#[derive(Clone, Copy)]
pub(crate) struct Frames {
    pub(crate) count: usize,
    pub(crate) side_px: usize,
    pub(crate) seed: u64,
}

impl Frames {
    pub(crate) fn rng(self, frame: usize) -> Pcg64 {
        Pcg64::seed_from_u64(self.seed * 1000 + frame as u64)
    }
}

/// Measures frames of stars of one image and brightness.
pub(crate) fn point(image: &Image, snr: f64, frames: Frames, options: &DetectOptions) -> Score {
    scored_by(image, snr, frames, |frame| detect(frame, options).expect("a frame that can be measured"))
}

fn scored_by(image: &Image, snr: f64, frames: Frames, measure: impl Fn(&Frame) -> Detections + Sync) -> Score {
    let electrons = electrons_for(snr, image, BACKGROUND_E, &DETECTOR);
    let one = |k: usize| {
        let mut rng = frames.rng(k);
        let (sky, stars) = frame_of(image, electrons, frames.side_px, &mut rng);
        scored(&stars, &measure(&sky.expose(&DETECTOR, &mut rng)))
    };
    (0..frames.count).into_par_iter().map(one).collect::<Vec<_>>().iter().fold(Score::default(), Score::add)
}

pub(crate) fn scored(stars: &[Star<'_>], found: &Detections) -> Score {
    let mut score = Score::default();
    for star in stars {
        score.take(star, nearest(found, star.x, star.y));
    }
    score
}

/// Largest error of noise-free images over their phases, px.
pub(crate) fn noise_free_bias_px(image: &Image, options: &DetectOptions, seed: u64) -> f64 {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut worst = 0.0_f64;
    for _ in 0..2 {
        let (sky, stars) = frame_of(image, 20_000.0, SIDE_PX, &mut rng);
        let found = detect(&sky.noiseless(&DETECTOR), options).expect("a frame that can be measured");
        let error = |s: &Star<'_>| nearest(&found, s.x, s.y).map_or(f64::INFINITY, |d| (d.x_px - s.x).abs().max((d.y_px - s.y).abs()));
        worst = stars.iter().map(error).fold(worst, f64::max);
    }
    worst
}

pub(crate) fn known(sigma_px: f64) -> DetectOptions {
    DetectOptions {
        psf_sigma_px: Some(sigma_px),
        gain_e_per_dn: Some(DETECTOR.gain_e_per_dn),
        read_noise_e: Some(DETECTOR.read_noise_e),
        ..DetectOptions::default()
    }
}

/// Windowed centroids of the same stars as in [`point`].
pub(crate) fn windowed(image: &Image, snr: f64, frames: Frames, options: &DetectOptions) -> Score {
    scored_by(image, snr, frames, |frame| detect_windowed(frame, options, None).expect("a frame that can be measured"))
}

/// The page, and errors against brightness: σ, electrons, bound, ours, windowed, all in px.
pub(crate) fn page(frames: usize) -> (String, Vec<[f64; 5]>) {
    let mut page = String::new();
    let mut line = |text: &str| {
        println!("{text}");
        let _ = writeln!(page, "{text}");
    };
    let stars = |frames: usize| frames * (SIDE_PX / PITCH_PX).pow(2);
    line(&format!("Centroids against the Cramér–Rao bound: `make bench-centroid`: {}", boresight::provenance::made_by(None)));
    line(&format!(
        "Stars at random phases in {BACKGROUND_E} e of sky per pixel, read noise {} e, {} e per DN; the bound frees position, flux and background.",
        DETECTOR.read_noise_e, DETECTOR.gain_e_per_dn
    ));
    line(
        "error/bound: 2-D rms over the bound's. pull var: variance of errors over stated errors, per axis. bias: the largest mean error of ten phases",
    );
    line(
        "of the pixel, with the chance that goes with it. SNR: flux over its error, at the bound. No star is lost where `found` is 1: none is chosen.",
    );
    let mut curve = Vec::new();
    let table = [
        ("Width, gain and read noise known", known as fn(f64) -> DetectOptions, frames),
        ("Nothing known", |_| DetectOptions::default(), frames.div_ceil(4)),
    ];
    for (name, options, frames) in table {
        line(&format!("\n{name}; {} stars a point", stars(frames)));
        line("σ/px   SNR    found   error/bound  pull var  flux pull var   bias/px   windowed: error/bound, pull var, bias/px");
        for (i, sigma) in SIGMAS_PX.into_iter().enumerate() {
            let image = Image::gaussian(sigma);
            for (k, snr) in SNRS.into_iter().enumerate() {
                let seed = (10 * i + k) as u64;
                let draw = |count| Frames { count, side_px: SIDE_PX, seed };
                let (s, w) =
                    (point(&image, snr, draw(frames), &options(sigma)), windowed(&image, snr, draw(frames.min(5)), &options(sigma)));
                line(&format!(
                    "{sigma:4.1} {snr:6.0}  {:.4}      {:7.4}    {:6.4}         {:6.4}  {:9.5}   {:7.3} {:8.3} {:9.5}",
                    s.found / s.stars,
                    s.over_bound(),
                    s.pull2(),
                    s.flux_pull2 / s.found,
                    s.bias_px(),
                    w.over_bound(),
                    w.pull2(),
                    w.bias_px()
                ));
                if options(sigma).psf_sigma_px.is_some() {
                    let electrons = electrons_for(snr, &image, BACKGROUND_E, &DETECTOR);
                    let bound = (s.bound2 / s.found).sqrt();
                    curve.push([sigma, electrons, bound, bound * s.over_bound(), (w.error2 / w.found).sqrt()]);
                }
            }
            let free = noise_free_bias_px(&image, &options(sigma), 7);
            line(&format!("{sigma:4.1} without noise, largest error over {} phases: {free:.1e} px", stars(2)));
        }
    }
    learnt::tables(frames.div_ceil(4), &mut line);
    line("\nError against brightness (width known), px; V of a zero point of 25 mag at 1 e");
    line("σ/px     V   bound    ours  windowed");
    for [sigma, electrons, bound, ours, windowed] in &curve {
        line(&format!("{sigma:4.1} {:5.2} {bound:7.4} {ours:7.4}  {windowed:8.4}", magnitude(*electrons)));
    }
    (page, curve)
}

pub(crate) fn magnitude(electrons: f64) -> f64 {
    25.0 - 2.5 * electrons.log10()
}
