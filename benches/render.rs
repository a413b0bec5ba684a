//! What a frame costs: CPU time on each backend, beside other programs.
#![allow(missing_docs, reason = "a bench is no interface")]
#![allow(clippy::unwrap_used, reason = "a bench that meets the unexpected must fail")]
#![allow(clippy::print_stdout, reason = "its table is what a bench is for")]

use boresight::imaging::{Backend, EffectSetting, Exposure, Imager, ImagingConfig, StarImage};
use rustix::time::{ClockId, clock_gettime};

fn cpu_s() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as f64 + 1e-9 * now.tv_nsec as f64
}

fn stars(side: usize, count: usize) -> Vec<StarImage> {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand_pcg::Pcg64::seed_from_u64(12345);
    (0..count)
        .map(|_| {
            let inside = 12.0..side as f64 - 13.0;
            let (x_px, y_px) = (rng.random_range(inside.clone()), rng.random_range(inside));
            StarImage { x_px, y_px, electrons: 3e5 * 10.0_f64.powf(-0.4 * rng.random_range(0.0..5.0)), sigma_px: 1.2 }
        })
        .collect()
}

fn config(side: usize) -> ImagingConfig {
    ImagingConfig {
        width_px: side,
        height_px: side,
        seed: 1,
        point_spread: "gaussian_psf".to_owned(),
        effects: vec![
            EffectSetting::new("background", &[("background_e_per_px_s", 20.0)]),
            EffectSetting::new("photon_noise", &[]),
            EffectSetting::new("read_noise", &[("read_noise_e", 5.0)]),
            EffectSetting::new("adc", &[("gain_e_per_dn", 1.0), ("bias_dn", 100.0), ("full_well_e", 1e9), ("saturation_dn", 65_535.0)]),
        ],
    }
}

fn main() {
    for (side, count) in [(1024, 0), (1024, 2000), (2048, 2000), (4096, 2000), (4096, 32000)] {
        for backend in [Backend::Cpu, Backend::Gpu] {
            let imager = Imager::new(backend, &config(side)).unwrap();
            let stars = stars(side, count);
            let mut all = Vec::new();
            for frame in 0..6 {
                let begin = cpu_s();
                let image = imager.expose(&Exposure { stars: &stars, exposure_s: 1.0, frame_index: frame }).unwrap();
                std::hint::black_box(&image);
                all.push(1e3 * (cpu_s() - begin));
            }
            let first = all[0];
            all.sort_by(f64::total_cmp);
            println!("{side} {count} {backend:?} median {:.2} min {:.2} first {first:.1} ms", all[3], all[0]);
        }
    }
}
