//! Finds and measures the stars of the same 8-bit frames with cedar-detect and with boresight, one after the other in one thread, and prints what it
//! costs, what is found, what is found that is no star, and how far off it is. Built by `run.sh` beside a checkout of cedar-detect.

#[path = "cedar/algorithm.rs"]
mod algorithm;
#[path = "cedar/histogram_funcs.rs"]
mod histogram_funcs;
#[path = "cedar/image_funcs.rs"]
mod image_funcs;

use boresight::detect::{DetectOptions, Detections, detect, detect_windowed};
use boresight::frame::Frame;
use image::GrayImage;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rustix::time::{ClockId, clock_gettime};

const WIDTH_PX: usize = 1024;
const HEIGHT_PX: usize = 768;
const SIGMA_PX: f64 = 1.0;
const LEVEL_DN: f64 = 30.0;
const NOISE_DN: f64 = 2.0;
/// Peaks of the stars over the level, DN: from well below what both can find to nearly full.
const PEAKS_DN: [f64; 2] = [4.0, 200.0];
/// A detection is a star's within so many pixels.
const REACH_PX: f64 = 1.5;
/// Stars keep so far from the edge and from each other, px.
const APART_PX: f64 = 12.0;
const FRAMES: usize = 20;
const TURNS: usize = 11;

struct Star {
    at_px: [f64; 2],
    peak_dn: f64,
}

/// Stars, alone, whose brightness goes as a power law, as the sky's does.
fn stars(count: usize, rng: &mut rand_pcg::Pcg64) -> Vec<Star> {
    let mut stars: Vec<Star> = Vec::new();
    while stars.len() < count {
        let at_px = [rng.random_range(APART_PX..WIDTH_PX as f64 - APART_PX), rng.random_range(APART_PX..HEIGHT_PX as f64 - APART_PX)];
        if stars.iter().all(|s| (s.at_px[0] - at_px[0]).hypot(s.at_px[1] - at_px[1]) > 2.0 * APART_PX) {
            let peak_dn = PEAKS_DN[0] * (PEAKS_DN[1] / PEAKS_DN[0]).powf(rng.random_range(0.0_f64..1.0).powi(2));
            stars.push(Star { at_px, peak_dn });
        }
    }
    stars
}

fn frame(stars: &[Star], rng: &mut rand_pcg::Pcg64) -> GrayImage {
    let noise = Normal::new(LEVEL_DN, NOISE_DN).expect("a noise above 0");
    let mut counts: Vec<f64> = (0..WIDTH_PX * HEIGHT_PX).map(|_| noise.sample(rng)).collect();
    for star in stars {
        let [x, y] = star.at_px.map(|v| v.round() as usize);
        for py in y - 6..=y + 6 {
            for px in x - 6..=x + 6 {
                let d2 = (px as f64 - star.at_px[0]).powi(2) + (py as f64 - star.at_px[1]).powi(2);
                counts[py * WIDTH_PX + px] += star.peak_dn * (-0.5 * d2 / (SIGMA_PX * SIGMA_PX)).exp();
            }
        }
    }
    let bytes = counts.iter().map(|v| v.round().clamp(0.0, 255.0) as u8).collect();
    GrayImage::from_raw(WIDTH_PX as u32, HEIGHT_PX as u32, bytes).expect("as many pixels as the frame has")
}

fn cpu_ms() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    1e3 * now.tv_sec as f64 + 1e-6 * now.tv_nsec as f64
}

fn cedar(image: &GrayImage, binning: u32) -> Vec<[f64; 2]> {
    let noise = algorithm::estimate_noise_from_image(image);
    let (stars, _, _) = algorithm::get_stars_from_image(image, None, noise, 8.0, binning);
    // its coordinates are those of a pixel's corner
    stars.iter().map(|s| [s.centroid_x - 0.5, s.centroid_y - 0.5]).collect()
}

fn ours(image: &GrayImage, find: impl Fn(&Frame) -> Detections) -> Vec<[f64; 2]> {
    let pixels_dn = image.as_raw().iter().map(|v| f32::from(*v)).collect();
    let frame = Frame { width_px: WIDTH_PX, height_px: HEIGHT_PX, pixels_dn, saturation_dn: 255.0 };
    find(&frame).stars.iter().map(|s| [s.x_px, s.y_px]).collect()
}

/// What a program made of all frames.
struct Measured {
    /// CPU time per megapixel, the median of the turns.
    ms: f64,
    /// Distance of the nearest detection from each star, if it is the star's.
    off_px: Vec<Option<f64>>,
    /// Detections that are no star's.
    others: usize,
}

fn measured(frames: &[(GrayImage, Vec<Star>)], find: &dyn Fn(&GrayImage) -> Vec<[f64; 2]>) -> Measured {
    let mut times: Vec<f64> = (0..TURNS)
        .map(|turn| {
            let before = cpu_ms();
            std::hint::black_box(find(&frames[turn % frames.len()].0));
            (cpu_ms() - before) / (1e-6 * (WIDTH_PX * HEIGHT_PX) as f64)
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let mut all = Measured { ms: times[TURNS / 2], off_px: Vec::new(), others: 0 };
    for (image, stars) in frames {
        let places = find(image);
        let far = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        for star in stars {
            let nearest = places.iter().map(|p| far(p, &star.at_px)).fold(f64::INFINITY, f64::min);
            all.off_px.push((nearest < REACH_PX).then_some(nearest));
        }
        all.others += places.iter().filter(|p| stars.iter().all(|s| far(p, &s.at_px) >= REACH_PX)).count();
    }
    all
}

fn main() {
    println!(
        "Printed by `make bench-cedar CEDAR=DIR`, DIR a checkout of cedar-detect: {}\n\n\
         {FRAMES} frames of {WIDTH_PX} × {HEIGHT_PX} px, 8 bits, noise {NOISE_DN} DN, stars of σ {SIGMA_PX} px with peaks of {} to {} DN, one thread.\n\
         stars a frame   program                 ms/Mpx   found of all   no stars   2-D rms of the errors of those that all find, px",
        boresight::provenance::made_by(None), PEAKS_DN[0], PEAKS_DN[1]
    );
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    for count in [0, 30, 100, 300] {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(count as u64);
        let frames: Vec<(GrayImage, Vec<Star>)> = (0..FRAMES)
            .map(|_| {
                let stars = stars(count, &mut rng);
                (frame(&stars, &mut rng), stars)
            })
            .collect();
        let options = DetectOptions::default();
        let windowed = |image: &GrayImage| ours(image, |f| detect_windowed(f, &options, None).expect("a frame that can be measured"));
        let full = |image: &GrayImage| ours(image, |f| detect(f, &options).expect("a frame that can be measured"));
        let programs: [(&str, &(dyn Fn(&GrayImage) -> Vec<[f64; 2]> + Sync)); 4] = [
            ("cedar-detect, not binned", &|image| cedar(image, 1)),
            ("cedar-detect, binned 2×2", &|image| cedar(image, 2)),
            ("boresight, windowed", &windowed),
            ("boresight", &full),
        ];
        let of_all: Vec<Measured> = programs.iter().map(|(_, find)| pool.install(|| measured(&frames, &|image| find(image)))).collect();
        let common: Vec<usize> = (0..count * FRAMES).filter(|&star| of_all.iter().all(|m| m.off_px[star].is_some())).collect();
        for ((name, _), m) in programs.iter().zip(&of_all) {
            let found = m.off_px.iter().flatten().count();
            let square = common.iter().filter_map(|&star| m.off_px[star]).map(|off| off * off).sum::<f64>();
            let rms_px = (square.abs() / common.len().max(1) as f64).sqrt();
            println!("{count:13}   {name:26} {:6.2}   {found:5} of {:5}   {:8}   {rms_px:.4}", m.ms, count * FRAMES, m.others);
        }
    }
}
