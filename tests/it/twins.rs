//! GPU and CPU make the same frame: stage by stage, with a proof that the comparison can fail.
//!
//! BORESIGHT_GPU says what a machine without an adapter means: `require` (the default) a failure, `any` and `off` a skip by name.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

use boresight::effects::pixel::{AnyPixelEffect, pixel_effect};
use boresight::imaging::{
    Backend, EffectSetting, FrameExposure, Imager, ImagingConfig, ImagingError, PlacedStar, SplitLimits, compare_counts, twin_check,
};

use crate::common;

/// An imager on the GPU, or `None` where BORESIGHT_GPU allows to do without.
pub(crate) fn gpu(test: &str, config: &ImagingConfig, limits: SplitLimits) -> Option<Imager> {
    let wish = std::env::var("BORESIGHT_GPU").unwrap_or_default();
    match wish.as_str() {
        "off" => {
            println!("skipped: {test} (BORESIGHT_GPU=off)");
            return None;
        }
        "" | "any" | "require" => {}
        other => panic!("BORESIGHT_GPU={other}: use off, any or require"),
    }
    match Imager::with_limits(Backend::Gpu, config, limits) {
        Ok(imager) => {
            // Once a test, however many imagers it makes.
            static SEEN: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
            if SEEN.lock().unwrap_or_else(PoisonError::into_inner).insert(test.to_owned()) {
                common::log_gpu_test(test, &imager.adapter());
                println!("gpu test {test} on {}", imager.adapter());
            }
            Some(imager)
        }
        Err(ImagingError::Gpu(error)) if wish == "any" => {
            println!("skipped: {test} ({error})");
            None
        }
        Err(error) => {
            panic!("{test} needs a GPU adapter: {error}. Run `make test`, which installs mesa-vulkan-drivers, or set BORESIGHT_GPU=off")
        }
    }
}

pub(crate) fn cpu(config: &ImagingConfig) -> Imager {
    Imager::new(Backend::Cpu, config).expect("the configuration is sound")
}

/// What every camera has.
fn default_effects() -> Vec<EffectSetting> {
    ["background", "photon_noise", "read_noise", "adc"].map(|id| typical(pixel_effect(id).expect("it is registered"))).to_vec()
}

pub(crate) fn typical(effect: &dyn AnyPixelEffect) -> EffectSetting {
    let parameters: Vec<_> = effect.parameters().iter().map(|spec| (spec.name, spec.typical)).collect();
    EffectSetting::new(effect.id(), &parameters)
}

pub(crate) fn config(width_px: usize, height_px: usize, effects: Vec<EffectSetting>) -> ImagingConfig {
    ImagingConfig { width_px, height_px, seed: 0x0123_4567_89ab_cdef, point_spread: "gaussian_psf".to_owned(), effects }
}

/// Stars of 10² to 10⁷ electrons over and around the frame, with widths from 0.3 to 6 px; the same for the same seed.
pub(crate) fn sky(count: usize, width: usize, height: usize, seed: u32) -> Vec<PlacedStar> {
    let mut state = u64::from(seed) * 2 + 1;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..count)
        .map(|_| PlacedStar {
            x_px: (width as f64 + 20.0) * random() - 10.0,
            y_px: (height as f64 + 20.0) * random() - 10.0,
            electrons: 10.0_f64.powf(2.0 + 5.0 * random().powi(2)),
            sigma_px: 0.3 + 5.7 * random().powi(4),
        })
        .collect()
}

pub(crate) fn exposure(stars: &[PlacedStar], frame_index: u32) -> FrameExposure<'_> {
    FrameExposure { stars, sky_e: &[], exposure_s: 0.5, frame_index, temperature_c: None }
}

/// Pixels beyond 1e-5 of their electrons and beyond 1e-6 of the brightest of the stars that light them. `floor` is made from the twin's own
/// single stars. NaN is beyond everything.
pub(crate) fn beyond_tolerance(a: &[f32], b: &[f32], floor_e: &[f64]) -> usize {
    assert_eq!(a.len(), b.len());
    let far = |((a, b), floor): ((&f32, &f32), &f64)| {
        let (a, b) = (f64::from(*a), f64::from(*b));
        a != b && ((a - b).abs() > (1e-5 * b.abs()).max(*floor) || a.is_nan())
    };
    a.iter().zip(b).zip(floor_e).filter(|pair| far(*pair)).count()
}

/// 1e-6 of the brightest star whose square of ±8 σ holds the pixel.
fn floor_e(stars: &[PlacedStar], width: usize, height: usize) -> Vec<f64> {
    let mut floor = vec![0.0_f64; width * height];
    for star in stars {
        let reach = 8.0 * star.sigma_px + 1.5;
        for (i, floor) in floor.iter_mut().enumerate() {
            let (x, y) = ((i % width) as f64, (i / width) as f64);
            if (x - star.x_px).abs() < reach && (y - star.y_px).abs() < reach {
                *floor = floor.max(1e-6 * star.electrons);
            }
        }
    }
    floor
}

#[test]
fn expected_electrons_agree() {
    // Sides that are no multiples of a tile, and an odd number of pixels.
    for (width, height, count) in [(301, 259, 300), (64, 64, 1), (1, 1, 5), (17, 3, 40), (640, 37, 500)] {
        let config = config(width, height, vec![EffectSetting::new("background", &[("background_e_per_px_s", 3.0)])]);
        let stars = sky(count, width, height, 5);
        let Some(gpu) = gpu("expected_electrons_agree", &config, SplitLimits::default()) else { return };
        let on_gpu = gpu.expected_electrons(&exposure(&stars, 0)).unwrap();
        let on_cpu = cpu(&config).expected_electrons(&exposure(&stars, 0)).unwrap();
        assert!(on_cpu.iter().all(|e| *e >= 1.5));
        let floor = floor_e(&stars, width, height);
        assert_eq!(beyond_tolerance(&on_gpu, &on_cpu, &floor), 0, "{width} × {height} px with {count} stars");
    }
}

/// The negative control: the comparisons see a difference of twice the tolerance, in a pixel of a star and in one of the background, a
/// missing star, and noise of another seed, frame or width.
#[test]
fn the_comparison_can_fail() {
    let (width, height) = (200, 150);
    let config_1 = config(width, height, default_effects());
    let stars = sky(60, width, height, 6);
    let Some(gpu) = gpu("the_comparison_can_fail", &config_1, SplitLimits::default()) else { return };
    let twin = cpu(&config_1);
    let on_gpu = gpu.expected_electrons(&exposure(&stars, 0)).unwrap();
    let on_cpu = twin.expected_electrons(&exposure(&stars, 0)).unwrap();
    let floor = floor_e(&stars, width, height);
    assert_eq!(beyond_tolerance(&on_gpu, &on_cpu, &floor), 0);
    for pixel in [0, width * height / 2, width * height - 1] {
        let mut perturbed = on_gpu.clone();
        let tolerance = (1e-5 * f64::from(on_cpu[pixel])).max(floor[pixel]);
        perturbed[pixel] = (f64::from(on_cpu[pixel]) + 2.0 * tolerance) as f32;
        assert_eq!(beyond_tolerance(&perturbed, &on_cpu, &floor), 1, "pixel {pixel}");
        perturbed[pixel] = f32::NAN;
        assert_eq!(beyond_tolerance(&perturbed, &on_cpu, &floor), 1, "pixel {pixel}");
    }
    let fewer = gpu.expected_electrons(&exposure(&stars[1..], 0)).unwrap();
    assert!(beyond_tolerance(&fewer, &on_cpu, &floor) > 0, "a missing star is not seen");

    let on_gpu = gpu.expose(&exposure(&stars, 3)).unwrap();
    let on_cpu = twin.expose(&exposure(&stars, 3)).unwrap();
    let most = (1e-4 * (width * height) as f64) as usize;
    assert!(compare_counts(&on_gpu.pixels_dn, &on_cpu.pixels_dn).0 <= most);
    let other_frame = twin.expose(&exposure(&stars, 4)).unwrap();
    let other_seed = cpu(&ImagingConfig { seed: config_1.seed ^ (1 << 63), ..config_1.clone() }).expose(&exposure(&stars, 3)).unwrap();
    let mut effects = default_effects();
    effects[2] = EffectSetting::new("read_noise", &[("read_noise_e", 5.01)]);
    let other_noise = cpu(&config(width, height, effects)).expose(&exposure(&stars, 3)).unwrap();
    for other in [other_frame, other_seed, other_noise] {
        assert!(compare_counts(&on_gpu.pixels_dn, &other.pixels_dn).0 > most);
    }
}

#[test]
fn noisy_frames_agree() {
    for (frame_index, side) in [(0, 1024), (1, 1024), (7, 333)] {
        let config = config(side, side, default_effects());
        let stars = sky(side, side, side, 20 + frame_index);
        let Some(gpu) = gpu("noisy_frames_agree", &config, SplitLimits::default()) else { return };
        let on_gpu = gpu.expose(&exposure(&stars, frame_index)).unwrap();
        let on_cpu = cpu(&config).expose(&exposure(&stars, frame_index)).unwrap();
        let (differing, largest) = compare_counts(&on_gpu.pixels_dn, &on_cpu.pixels_dn);
        println!("{side}² px: {differing} differ, by at most {largest} DN");
        assert!(differing as f64 <= 1e-4 * (side * side) as f64 && largest <= 1, "{differing} pixels differ, by up to {largest} DN");
    }
}

#[test]
fn bytes_do_not_depend_on_threads_and_frames_not_on_their_series() {
    let config = config(300, 280, default_effects());
    let stars = sky(200, 300, 280, 10);
    let in_pool = |threads: usize, frame_index: u32| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| cpu(&config).expose(&exposure(&stars, frame_index)).unwrap())
    };
    let alone: Vec<_> = (0..4).map(|frame| in_pool(1, frame)).collect();
    let imager = cpu(&config);
    for frame in [3, 1, 0, 2, 3] {
        assert_eq!(in_pool(2, frame), alone[frame as usize], "two threads, frame {frame}");
        assert_eq!(in_pool(5, frame), alone[frame as usize], "five threads, frame {frame}");
        assert_eq!(imager.expose(&exposure(&stars, frame)).unwrap(), alone[frame as usize], "in a series, frame {frame}");
    }
    assert_ne!(alone[0], alone[1]);

    let test = "bytes_do_not_depend_on_threads_and_frames_not_on_their_series";
    let Some(series) = gpu(test, &config, SplitLimits::default()) else { return };
    let fewer = sky(20, 300, 280, 11); // another load in between: buffers that are kept must not show
    let frames: Vec<_> = (0..3).map(|frame| series.expose(&exposure(&stars, frame)).unwrap()).collect();
    series.expose(&exposure(&fewer, 9)).unwrap();
    series.expected_electrons(&exposure(&fewer, 9)).unwrap();
    for frame in [2, 0, 1] {
        assert_eq!(series.expose(&exposure(&stars, frame)).unwrap(), frames[frame as usize], "again, frame {frame}");
        let fresh = gpu(test, &config, SplitLimits::default()).expect("there was an adapter before");
        assert_eq!(fresh.expose(&exposure(&stars, frame)).unwrap(), frames[frame as usize], "alone, frame {frame}");
    }
}

/// Work that is split for the loop budget, for the size of buffers, or into bands gives the same bytes.
#[test]
fn split_work_gives_the_same_bytes() {
    let config = config(123, 211, default_effects());
    let stars = sky(400, 123, 211, 12);
    let Some(whole) = gpu("split_work_gives_the_same_bytes", &config, SplitLimits::default()) else { return };
    let (expected, frame) = (whole.expected_electrons(&exposure(&stars, 2)).unwrap(), whole.expose(&exposure(&stars, 2)).unwrap());
    for (entries_per_dispatch, buffer_bytes) in
        [(3, 128 << 20), (60_000, 123 * 4 * 16 + 1), (60_000, 123 * 4 * 40), (7, 500), (u32::MAX, 1 << 16)]
    {
        let limits = SplitLimits { entries_per_dispatch, buffer_bytes };
        let split = gpu("split_work_gives_the_same_bytes", &config, limits).expect("there was an adapter before");
        assert_eq!(split.expected_electrons(&exposure(&stars, 2)).unwrap(), expected, "{limits:?}");
        assert_eq!(split.expose(&exposure(&stars, 2)).unwrap(), frame, "{limits:?}");
    }
}

/// 150 000 stars on one tile: more than the 65 535 iterations after which llvmpipe leaves a loop without a word. None is lost.
#[test]
fn no_star_is_lost_to_the_loop_budget() {
    let config = config(16, 16, vec![]);
    let stars = vec![PlacedStar { x_px: 7.3, y_px: 8.1, electrons: 1.0, sigma_px: 0.8 }; 150_000];
    let Some(gpu) = gpu("no_star_is_lost_to_the_loop_budget", &config, SplitLimits::default()) else { return };
    for (name, imager) in [("GPU", gpu), ("CPU", cpu(&config))] {
        let total: f64 = imager.expected_electrons(&exposure(&stars, 0)).unwrap().iter().map(|e| f64::from(*e)).sum();
        // f32 adds 150 000 equal shares with rounding errors of one sign: 1e-3 at worst.
        assert!((total / 150_000.0 - 1.0).abs() < 2e-3, "{name}: {total} electrons of 150 000");
    }
}

/// Where the flux-weighted centroid of a perfect, pixel-integrated Gaussian stands relative to its true place, by Poisson's sum formula:
/// pixels sample it, and a centroid without a model shows that (Alexander and Ng 1991). Below 1e-6 px from σ = 0.8 on.
fn sampling_shift_px(place_px: f64, sigma_px: f64) -> f64 {
    let harmonic = |k: i32| {
        let turn = std::f64::consts::TAU * f64::from(k);
        let sign = if k % 2 == 0 { 2.0 } else { -2.0 };
        sign / turn * (-0.5 * (turn * sigma_px).powi(2)).exp() * (turn * place_px).sin()
    };
    (1..5).map(harmonic).sum()
}

/// Noise-free stars at 1600 random sub-pixel phases in a 4096² frame: the flux-weighted centroid is right within 1e-5 px (narrow images: after
/// the shift that sampling alone gives it), the flux within 1e-5.
#[test]
fn centroid_and_flux_are_accurate_in_a_large_frame() {
    let config = config(4096, 4096, vec![]);
    let mut stars = sky(1600, 4096, 4096, 13);
    for (i, star) in stars.iter_mut().enumerate() {
        star.x_px = 80.0 + 100.0 * (i % 40) as f64 + star.x_px.fract();
        star.y_px = 80.0 + 100.0 * (i / 40) as f64 + star.y_px.fract();
        star.sigma_px = [0.35, 0.5, 0.8, 1.0, 1.5, 2.4, 2.6, 4.0][i % 8];
    }
    let mut imagers = vec![("CPU", cpu(&config))];
    imagers.extend(gpu("centroid_and_flux_are_accurate_in_a_large_frame", &config, SplitLimits::default()).map(|gpu| ("GPU", gpu)));
    for (name, imager) in &imagers {
        let image = imager.expected_electrons(&exposure(&stars, 0)).unwrap();
        let (mut worst_px, mut worst_model_px, mut worst_flux) = (0.0_f64, 0.0_f64, 0.0_f64);
        for star in &stars {
            let (cx, cy) = (star.x_px.round() as usize, star.y_px.round() as usize);
            let (mut flux, mut x, mut y) = (0.0, 0.0, 0.0);
            for row in cy - 40..=cy + 40 {
                for column in cx - 40..=cx + 40 {
                    let e = f64::from(image[row * 4096 + column]);
                    flux += e;
                    x += e * (column as f64 - star.x_px);
                    y += e * (row as f64 - star.y_px);
                }
            }
            let (dx, dy) = (x / flux, y / flux);
            let [model_x, model_y] = [star.x_px, star.y_px].map(|place| sampling_shift_px(place, star.sigma_px));
            worst_model_px = worst_model_px.max((dx - model_x).abs()).max((dy - model_y).abs());
            if star.sigma_px >= 0.8 {
                worst_px = worst_px.max(dx.abs()).max(dy.abs());
            }
            worst_flux = worst_flux.max((flux / star.electrons - 1.0).abs());
        }
        println!(
            "{name}: centroid within {worst_px:.1e} px, narrow images within {worst_model_px:.1e} px of theory, flux within {worst_flux:.1e}"
        );
        assert!(
            worst_px < 1e-5 && worst_model_px < 1e-5 && worst_flux < 1e-5,
            "{name}: {worst_px:.1e} {worst_model_px:.1e} {worst_flux:.1e}"
        );
    }
}

/// Mean, variance and skewness of the GPU's own frames: light, photons, read noise and converter together.
#[test]
fn noise_of_a_frame_is_that_of_the_detector() {
    let side = 512;
    for (rate, frame_index) in [(1.0, 0), (16.0, 1), (200.0, 2), (2e4, 3)] {
        let mut effects = default_effects();
        effects[0] = EffectSetting::new("background", &[("background_e_per_px_s", rate)]);
        let config = config(side, side, effects);
        let mut imagers = vec![("CPU", cpu(&config))];
        imagers.extend(gpu("noise_of_a_frame_is_that_of_the_detector", &config, SplitLimits::default()).map(|gpu| ("GPU", gpu)));
        for (name, imager) in imagers {
            let image = imager.expose(&exposure(&[], frame_index)).unwrap();
            let n = image.pixels_dn.len() as f64;
            let mean = image.pixels_dn.iter().map(|c| f64::from(*c)).sum::<f64>() / n;
            let moment = |power: i32| image.pixels_dn.iter().map(|c| (f64::from(*c) - mean).powi(power)).sum::<f64>() / n;
            // gain 2, bias 200, read noise 5; rounding adds 1/12.
            let lambda = 0.5 * rate;
            let (expected, variance, third) = (200.0 + lambda / 2.0, (lambda + 25.0) / 4.0 + 1.0 / 12.0, lambda / 8.0);
            assert!((mean - expected).abs() < 4.5 * (variance / n).sqrt(), "{name}, {rate} e-/px/s: mean {mean} for {expected}");
            assert!((moment(2) / variance - 1.0).abs() < 4.5 * (2.0 / n).sqrt() + 5e-4, "{name}: variance {} for {variance}", moment(2));
            assert!((moment(3) - third).abs() < 4.5 * (15.0 / n).sqrt() * variance.powf(1.5), "{name}: third moment {}", moment(3));
        }
    }
}

#[test]
fn a_full_pixel_has_the_count_that_is_said() {
    let config = config(40, 40, default_effects());
    let stars = [PlacedStar { x_px: 20.0, y_px: 20.0, electrons: 1e9, sigma_px: 1.0 }];
    let imager = cpu(&config);
    let full = imager.saturation_dn().expect("there is a converter");
    assert_eq!(full, 50_200.0); // 10⁵ e- / 2 + 200
    let image = imager.expose(&exposure(&stars, 0)).unwrap();
    assert_eq!(f32::from(image.pixels_dn[20 * 40 + 20]), full);
    assert_eq!(f32::from(*image.pixels_dn.iter().max().unwrap()), full);
}

#[test]
fn a_wrong_configuration_is_one_clear_sentence() {
    let sentence = |config: &ImagingConfig| Imager::new(Backend::Cpu, config).unwrap_err().to_string();
    let read_noise = |name, value| vec![EffectSetting::new("read_noise", &[(name, value)])];
    for (config, words) in [
        (config(0, 5, vec![]), "0 × 5"),
        (config(5, 70_000, vec![]), "70000"),
        (ImagingConfig { point_spread: "airy".to_owned(), ..config(5, 5, vec![]) }, "gaussian_psf"),
        (config(5, 5, vec![EffectSetting::new("bloomin", &[])]), "photon-noise"),
        (config(5, 5, read_noise("read_noise", 5.0)), "read_noise_e"),
        (config(5, 5, vec![EffectSetting::new("read_noise", &[])]), "needs"),
        (config(5, 5, read_noise("read_noise_e", -1.0)), "-1"),
        (config(5, 5, read_noise("read_noise_e", f64::NAN)), "NaN"),
        (config(5, 5, [read_noise("read_noise_e", 1.0), read_noise("read_noise_e", 1.0)].concat()), "twice"),
    ] {
        let sentence = sentence(&config);
        assert!(sentence.contains(words), "{sentence}");
    }
    let imager = cpu(&config(5, 5, vec![]));
    assert!(matches!(imager.expose(&exposure(&[], 0)), Err(ImagingError::NoConverter)));
    let endless = FrameExposure { stars: &[], sky_e: &[], exposure_s: f64::INFINITY, frame_index: 0, temperature_c: None };
    assert!(matches!(imager.expected_electrons(&endless), Err(ImagingError::BadExposure { .. })));
    assert!("vulkan".parse::<Backend>().unwrap_err().to_string().contains("auto, gpu or cpu"));
    assert!(["auto", "gpu", "cpu"].iter().all(|word| word.parse::<Backend>().unwrap().to_string() == *word));
}

#[test]
fn the_twin_check_of_the_program_agrees() {
    let Some(gpu) = gpu("the_twin_check_of_the_program_agrees", &config(16, 16, vec![]), SplitLimits::default()) else { return };
    let report = twin_check().unwrap();
    println!("{report:?}");
    assert!(report.agrees() && report.adapter == gpu.adapter() && report.pixels == 65_536, "{report:?}");
}
