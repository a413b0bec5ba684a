//! What it costs to join pixels and to put light behind filters where the frame lies, and to read it back and do it here.

use std::fmt::Write as _;

use boresight::effects::detector::colour_filters::filter_at;
use boresight::imaging::{
    Backend, BinnedImager, Binning, BinningPlace, EffectSetting, FilterLight, FrameExposure, Imager, ImagingConfig, PlacedStar, Stage,
};

use crate::{cpu_ms, exposure, median, sky};

const SIDE: usize = 2048;
const STARS: usize = 2000;
const ROUNDS: u32 = 5;

fn config(side: usize, ids: &[&str]) -> ImagingConfig {
    let effects = [
        EffectSetting::new("background", &[("background_e_per_px_s", 20.0)]),
        EffectSetting::new("photon_noise", &[]),
        EffectSetting::new("read_noise", &[("read_noise_e", 5.0)]),
        EffectSetting::new(
            "adc",
            &[("gain_e_per_dn", 4.0), ("bias_dn", 100.0), ("full_well_e", 1e5), ("saturation_dn", 65_535.0), ("bits", 16.0)],
        ),
    ];
    let effects = effects.into_iter().filter(|effect| ids.contains(&effect.id.as_str())).collect();
    ImagingConfig { width_px: side, height_px: side, seed: 1, point_spread: "gaussian_psf".to_owned(), effects }
}

/// Median CPU times of two ways, in turns, ms; the first round is not counted.
fn in_turns(mut ways: [&mut dyn FnMut(u32); 2]) -> [f64; 2] {
    let mut times = [Vec::new(), Vec::new()];
    for round in 0..=ROUNDS {
        for (way, times) in ways.iter_mut().zip(&mut times) {
            let begin = cpu_ms();
            way(round);
            if round > 0 {
                times.push(cpu_ms() - begin);
            }
        }
    }
    times.map(median)
}

fn on_chip(backend: Backend, stars: &[PlacedStar], binning: Binning) -> [f64; 2] {
    let there = BinnedImager::new(backend, &config(SIDE, &["background", "photon_noise", "read_noise", "adc"]), binning).unwrap();
    let native = Imager::new(backend, &config(SIDE, &["background", "photon_noise"])).unwrap();
    let after = Imager::new(backend, &config(SIDE / binning.factor, &["read_noise", "adc"])).unwrap();
    in_turns([
        &mut |round| {
            std::hint::black_box(there.expose_with(&exposure(stars, round), &[]).unwrap());
        },
        &mut |round| {
            let whole = native.electrons_after(Some(Stage::Digital), &exposure(stars, round)).unwrap();
            let joined = binning.join(&whole, SIDE, 1e5);
            std::hint::black_box(after.expose(&FrameExposure { sky_e: &joined, ..exposure(&[], round) }).unwrap());
        },
    ])
}

fn digital(backend: Backend, stars: &[PlacedStar], binning: Binning) -> [f64; 2] {
    let config = config(SIDE, &["background", "photon_noise", "read_noise", "adc"]);
    let there = BinnedImager::new(backend, &config, binning).unwrap();
    let native = Imager::new(backend, &config).unwrap();
    in_turns([
        &mut |round| {
            std::hint::black_box(there.expose_with(&exposure(stars, round), &[]).unwrap());
        },
        &mut |round| {
            let whole = native.expose(&exposure(stars, round)).unwrap();
            std::hint::black_box(binning.join_counts(&whole.pixels_dn, SIDE));
        },
    ])
}

fn filters(backend: Backend, stars: &[PlacedStar]) -> [f64; 2] {
    let imager = Imager::new(backend, &config(SIDE, &[])).unwrap();
    let lights = [0, 1, 2].map(|_| FilterLight { stars, planes: Vec::new() });
    in_turns([
        &mut |round| {
            std::hint::black_box(imager.behind_filters(&exposure(&[], round), &lights).unwrap());
        },
        &mut |round| {
            let mut behind = vec![0.0_f32; SIDE * SIDE];
            for number in 0..lights.len() {
                let through = imager.electrons_after(None, &exposure(stars, round)).unwrap();
                for (y, (row, through)) in behind.chunks_mut(SIDE).zip(through.chunks(SIDE)).enumerate() {
                    for (x, (pixel, through)) in row.iter_mut().zip(through).enumerate() {
                        if filter_at(x, y) == number {
                            *pixel = *through;
                        }
                    }
                }
            }
            std::hint::black_box(behind);
        },
    ])
}

/// The table.
pub(crate) fn joining(backends: &[(Backend, String)], text: &mut String) {
    let stars = sky(SIDE, STARS);
    let _ = writeln!(
        text,
        "\nCPU time of a frame of {SIDE}² with {STARS} stars, ms: done where the frame lies, and read back whole and done here\n"
    );
    for (backend, _) in backends {
        for factor in [2, 4] {
            let sum = Binning { factor, is_mean: false, place: BinningPlace::OnChip };
            let counts = Binning { is_mean: true, place: BinningPlace::Digital, ..sum };
            for (name, [there, here]) in [("electrons", on_chip(*backend, &stars, sum)), ("counts", digital(*backend, &stars, counts))] {
                let _ = writeln!(text, "{backend:>6}: {name:>9} joined {factor} × {factor}  {there:7.1} {here:7.1}");
            }
        }
        let [there, here] = filters(*backend, &stars);
        let _ = writeln!(text, "{backend:>6}: light behind filters    {there:7.1} {here:7.1}");
    }
}
