//! Time to find and measure the stars of a frame of 1024 × 768 pixels; with `--study [FRAMES] [--page FILE] [--figure FILE]`
//! how near centroids come to the statistical limit.
#![allow(missing_docs, reason = "a bench is no interface")]
#![allow(clippy::unwrap_used, reason = "a bench that meets the unexpected must fail")]
#![allow(clippy::expect_used, reason = "as above")]
#![allow(clippy::print_stdout, reason = "its table is what a study is for")]

#[path = "detect/drawn.rs"]
mod drawn;
#[path = "detect/figure.rs"]
mod figure;
#[path = "detect/learnt.rs"]
mod learnt;
#[path = "detect/optics.rs"]
mod optics;
#[path = "detect/rendered.rs"]
mod rendered;
#[path = "detect/study.rs"]
mod study;

use std::fmt::Write as _;
use std::path::Path;

use boresight::detect::{DetectOptions, detect, detect_windowed};
use boresight::frame::Frame;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rustix::time::{ClockId, clock_gettime};

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let Some(at) = arguments.iter().position(|a| a == "--study") else {
        divan::main();
        return;
    };
    let frames = arguments.get(at + 1).and_then(|n| n.parse().ok()).unwrap_or(17);
    let after = |name: &str| arguments.iter().position(|a| a == name).and_then(|at| arguments.get(at + 1));
    let (mut page, curve) = study::page(frames);
    let mut line = |text: &str| {
        println!("{text}");
        page.push_str(text);
        page.push('\n');
    };
    optics::table(frames.div_ceil(4), &mut line);
    rendered::tables(frames.div_ceil(2), &mut line);
    page.push_str(&times());
    if let Some(file) = after("--page") {
        std::fs::write(file, page).unwrap();
    }
    if let Some(file) = after("--figure") {
        figure::draw(Path::new(file), &curve).unwrap();
    }
}

/// What a frame costs on one core, CPU time.
fn times() -> String {
    let cpu_ms = || {
        let now = clock_gettime(ClockId::ProcessCPUTime);
        1e3 * now.tv_sec as f64 + 1e-6 * now.tv_nsec as f64
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut text =
        String::from("\nCPU time of a frame of 1024 × 768 px on one core, ms per megapixel (median of 21): windowed, maximum likelihood\n");
    for stars in [0, 30, 100, 500] {
        let frame = frame(stars);
        let options = DetectOptions::default();
        let median = |measure: &(dyn Fn() + Sync)| {
            let mut all: Vec<f64> = (0..21)
                .map(|_| {
                    let before = cpu_ms();
                    pool.install(measure);
                    (cpu_ms() - before) / 0.786_432
                })
                .collect();
            all.sort_by(f64::total_cmp);
            all[10]
        };
        let quick = median(&|| drop(detect_windowed(&frame, &options, None)));
        let full = median(&|| drop(detect(&frame, &options)));
        let _ = writeln!(text, "{stars:4} stars {quick:8.2} {full:8.1}");
    }
    text.push_str(
        "cedar-detect states 1.2 ms per megapixel for its whole work (8-bit images, whole-pixel centroids refined by a quadratic).\n",
    );
    print!("{text}");
    text
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

#[divan::bench(args = [0, 100, 500])]
fn windowed_1024_768(bencher: divan::Bencher<'_, '_>, stars: usize) {
    let frame = frame(stars);
    bencher.bench_local(|| detect_windowed(&frame, &DetectOptions::default(), None));
}
