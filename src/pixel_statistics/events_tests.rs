//! Cosmic rays of known number, and frames without any.

use super::*;
use crate::frame::Frame;
use crate::pixel_statistics::{CountStatistics, FrameStatistics, KnownCamera, PixelStatistics, SkyFrame, StarDisc};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal, Poisson};
use rand_pcg::Pcg64Mcg;

/// What is drawn.
#[derive(Clone)]
struct Night {
    side: usize,
    frames: usize,
    sky_e: f64,
    gain: f64,
    read_noise_e: f64,
    /// Width of a star, and the power of its wings where it is a Moffat image.
    sigma_px: f64,
    beta: Option<f64>,
    stars: usize,
    /// Whether faint stars are found too.
    finds_all: bool,
    hot: usize,
    jumping: usize,
    /// In every frame, and their light in standard deviations of the sky.
    rays: usize,
    ray_sigmas: f64,
    length_px: usize,
    /// What every second pixel of every second row sees less of the sky.
    mosaic: f64,
}

impl Default for Night {
    fn default() -> Self {
        Self {
            side: 256,
            frames: 8,
            sky_e: 100.0,
            gain: 0.7,
            read_noise_e: 5.0,
            sigma_px: 0.9,
            beta: None,
            stars: 40,
            finds_all: false,
            hot: 0,
            jumping: 0,
            rays: 0,
            ray_sigmas: 12.0,
            length_px: 1,
            mosaic: 0.0,
        }
    }
}

impl Night {
    /// Light of a star of unit flux in the pixel so far from it, by sums over parts of the pixel.
    fn image(&self, dx: f64, dy: f64) -> f64 {
        const PARTS: usize = 5;
        let at = |k: usize| (k as f64 + 0.5) / PARTS as f64 - 0.5;
        let light = |x: f64, y: f64| match self.beta {
            None => (-0.5 * (x * x + y * y) / self.sigma_px.powi(2)).exp() / (std::f64::consts::TAU * self.sigma_px.powi(2)),
            Some(beta) => {
                // As wide at half of the light as the Gaussian.
                let core2 = (1.1774 * self.sigma_px).powi(2) / (2.0_f64.powf(1.0 / beta) - 1.0);
                (beta - 1.0) / (std::f64::consts::PI * core2) * (1.0 + (x * x + y * y) / core2).powf(-beta)
            }
        };
        let parts = (0..PARTS * PARTS).map(|k| light(dx + at(k % PARTS), dy + at(k / PARTS)));
        parts.sum::<f64>() / (PARTS * PARTS) as f64
    }

    fn noise_e(&self) -> f64 {
        (self.sky_e + self.read_noise_e.powi(2)).sqrt()
    }

    fn frame(&self, rng: &mut Pcg64Mcg, hot: &[usize], jumping: &[usize]) -> (Frame, Vec<StarDisc>) {
        let pixels = self.side * self.side;
        let mut light: Vec<f64> =
            (0..pixels).map(|index| self.sky_e * (0.9 + 0.2 * (index / self.side) as f64 / self.side as f64)).collect();
        let mut discs = Vec::new();
        for _ in 0..self.stars {
            let at = [0, 1].map(|_| rng.random_range(0.0..self.side as f64));
            // From a tenth of the noise of a pixel up to far above it.
            let flux = self.noise_e() * 10.0_f64.powf(rng.random_range(-1.0..3.5));
            let is_found = flux > if self.finds_all { 5.0 } else { 20.0 } * self.noise_e();
            let reach = if self.beta.is_some() { 14.0 } else { 5.0 * self.sigma_px + 1.0 };
            for y in crate::pixel_statistics::sky_frame::covered(at[1], reach, self.side) {
                for x in crate::pixel_statistics::sky_frame::covered(at[0], reach, self.side) {
                    light[y * self.side + x] += flux * self.image(x as f64 - at[0], y as f64 - at[1]);
                }
            }
            if is_found {
                discs.push(StarDisc { x_px: at[0], y_px: at[1], radius_px: 4.0 * self.sigma_px + 2.0 });
            }
        }
        for index in hot {
            light[*index] += 30.0 * self.noise_e();
        }
        for index in jumping {
            light[*index] += if rng.random::<bool>() { 20.0 * self.noise_e() } else { 0.0 };
        }
        let filter = |index: usize| if index % 2 + index / self.side % 2 == 0 { 1.0 - self.mosaic } else { 1.0 };
        light.iter_mut().enumerate().for_each(|(index, own)| *own *= filter(index));
        let mut electrons: Vec<f64> = light.iter().map(|mean| Poisson::new(*mean).unwrap().sample(rng)).collect();
        for _ in 0..self.rays {
            let mut at = [0, 1].map(|_| rng.random_range(2..self.side - 2));
            let diagonal = rng.random::<bool>();
            for _ in 0..self.length_px {
                electrons[at[1] * self.side + at[0]] += self.ray_sigmas * self.noise_e();
                at = [(at[0] + 1).min(self.side - 1), (at[1] + usize::from(diagonal)).min(self.side - 1)];
            }
        }
        let read = Normal::new(0.0, self.read_noise_e).unwrap();
        let pixels_dn = electrons.iter().map(|own| ((own + read.sample(rng)) / self.gain + 200.0).round() as f32).collect();
        (Frame { width_px: self.side, height_px: self.side, pixels_dn, saturation_dn: 65_535.0 }, discs)
    }

    fn rays_found(&self, seed: u64) -> Option<CosmicRays> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let pixels = self.side * self.side;
        let pick = |count: usize, rng: &mut Pcg64Mcg| -> Vec<usize> { (0..count).map(|_| rng.random_range(0..pixels)).collect() };
        let (hot, jumping) = (pick(self.hot, &mut rng), pick(self.jumping, &mut rng));
        let all = (0..self.frames)
            .filter_map(|number| {
                let (frame, stars) = self.frame(&mut rng, &hot, &jumping);
                FrameStatistics::of(&SkyFrame {
                    number,
                    lowest_read_dn: 0.0,
                    frame: &frame,
                    stars: &stars,
                    bad: None,
                    exposure_s: Some(2.0),
                    is_compared: true,
                })
            })
            .collect();
        let known = KnownCamera { bias_dn: Some(200.0), gain_e_per_dn: Some(self.gain), narrowest_star_px: Some(self.sigma_px) };
        PixelStatistics::of(all, None::<CountStatistics>, &known).cosmic_rays
    }
}

#[test]
fn frames_without_rays_show_none() {
    let plain = Night::default();
    let nights = [
        ("plain", plain.clone()),
        ("all stars found", Night { finds_all: true, ..plain.clone() }),
        ("narrow", Night { sigma_px: 0.5, ..plain.clone() }),
        ("narrow, bright sky", Night { sigma_px: 0.5, sky_e: 5000.0, ..plain.clone() }),
        ("dark sky", Night { sky_e: 2.0, read_noise_e: 1.5, ..plain.clone() }),
        ("wings", Night { beta: Some(2.5), ..plain.clone() }),
        ("wings, narrow", Night { beta: Some(2.5), sigma_px: 0.6, ..plain.clone() }),
        ("hot", Night { hot: 60, ..plain.clone() }),
        ("jumping", Night { jumping: 30, frames: 16, ..plain.clone() }),
        ("hot and jumping, narrow", Night { hot: 40, jumping: 20, sigma_px: 0.5, frames: 16, ..plain.clone() }),
    ];
    for (name, night) in nights {
        for seed in 0..4 {
            let found = night.rays_found(seed).unwrap();
            assert_eq!(found.count, 0, "{name}, seed {seed}: {found:?}");
            assert_eq!(found.frames, night.frames);
        }
    }
}

#[test]
fn rays_are_counted() {
    let plain = Night { rays: 10, ..Night::default() };
    let nights = [
        ("pixels", Night { ray_sigmas: 10.0, ..plain.clone() }),
        ("bright pixels under narrow stars", Night { sigma_px: 0.5, ray_sigmas: 25.0, ..plain.clone() }),
        ("tracks", Night { length_px: 6, ray_sigmas: 30.0, ..plain.clone() }),
        ("beside hot and jumping pixels", Night { hot: 20, jumping: 20, frames: 16, ..plain.clone() }),
        ("under wings", Night { beta: Some(2.5), ray_sigmas: 15.0, ..plain.clone() }),
        // Four rays of ten have another beside them in one of the other frames.
        ("many small frames", Night { side: 128, frames: 120, rays: 6, stars: 10, ..plain.clone() }),
    ];
    for (name, night) in nights {
        let painted = (night.rays * night.frames) as f64;
        for seed in 50..53 {
            let found = night.rays_found(seed).unwrap();
            println!("{name}: {} of {painted}, {found:?}", found.count);
            assert!(found.count as f64 > 0.9 * painted * found.share && found.count as f64 <= painted, "{name}: {found:?}");
            let per_s = found.per_s.unwrap();
            assert!((per_s - 0.5 * found.per_frame).abs() < 1e-6 * per_s, "{name}: {found:?}");
        }
    }
}

#[test]
fn stars_as_sharp_as_rays_single_frames_and_mosaics_tell_nothing() {
    let night = Night { rays: 5, ..Night::default() };
    assert!(Night { sigma_px: 0.3, ..night.clone() }.rays_found(1).is_none());
    assert!(Night { mosaic: 0.6, sky_e: 400.0, ..night.clone() }.rays_found(1).is_none());
    assert!(Night { frames: 2, ..night }.rays_found(1).is_none());
}
