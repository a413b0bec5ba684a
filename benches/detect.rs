//! Time to find and measure the stars of a frame of 1024 × 768 pixels.
#![allow(missing_docs, reason = "a bench is no interface")]
#![allow(clippy::unwrap_used, reason = "a bench that meets the unexpected must fail")]

use boresight::detect::{DetectOptions, detect};
use boresight::frame::Frame;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};

fn main() {
    divan::main();
}

/// Stars of σ 1 px on noise of 10 DN.
fn frame(stars: usize) -> Frame {
    let (width_px, height_px) = (1024_usize, 768_usize);
    let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
    let normal = Normal::new(200.0, 10.0).unwrap();
    let mut pixels_dn: Vec<f32> = (0..width_px * height_px).map(|_| normal.sample(&mut rng)).collect();
    for _ in 0..stars {
        let (x, y) = (rng.random_range(8.0_f32..1015.0), rng.random_range(8.0_f32..759.0));
        let peak = rng.random_range(4.0_f32..9.0).exp();
        for py in y as usize - 6..y as usize + 7 {
            for px in x as usize - 6..x as usize + 7 {
                pixels_dn[py * width_px + px] += peak * (-0.5 * ((px as f32 - x).powi(2) + (py as f32 - y).powi(2))).exp();
            }
        }
    }
    for v in &mut pixels_dn {
        *v = v.round();
    }
    Frame { width_px, height_px, pixels_dn, saturation_dn: 65535.0 }
}

#[divan::bench(args = [0, 100, 500])]
fn detect_1024_768(bencher: divan::Bencher<'_, '_>, stars: usize) {
    let frame = frame(stars);
    bencher.bench_local(|| detect(&frame, &DetectOptions::default()));
}
