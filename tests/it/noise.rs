//! Noise of whole frames: independent from pixel to pixel, from frame to frame and from stage to stage; and runs that are cut short.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use boresight::gpu::adapters;
use boresight::imaging::{Backend, EffectSetting, FrameExposure, Imager, ImagingConfig, Stage};

use crate::cli::{short_night, text};

const SIDE: usize = 256;

/// Frames of an even sky after a stage, less their mean and in units of their scatter.
fn frames(seed: u64, sky_e: f64, stage: Stage, count: u32) -> Vec<Vec<f64>> {
    let config = ImagingConfig {
        width_px: SIDE,
        height_px: SIDE,
        seed,
        point_spread: "gaussian_psf".to_owned(),
        effects: vec![
            EffectSetting::new("background", &[("background_e_per_px_s", sky_e)]),
            EffectSetting::new("photon_noise", &[]),
            EffectSetting::new("read_noise", &[("read_noise_e", 5.0)]),
        ],
    };
    let imager = Imager::new(Backend::Cpu, &config).unwrap();
    let standard = |frame_index| {
        let exposure = FrameExposure { stars: &[], sky_e: &[], exposure_s: 1.0, frame_index, temperature_c: None };
        let electrons = imager.electrons_after(Some(stage), &exposure).unwrap();
        let n = electrons.len() as f64;
        let mean = electrons.iter().map(|e| f64::from(*e)).sum::<f64>() / n;
        let variance = electrons.iter().map(|e| (f64::from(*e) - mean).powi(2)).sum::<f64>() / n;
        electrons.iter().map(|e| (f64::from(*e) - mean) / variance.sqrt()).collect()
    };
    (0..count).map(standard).collect()
}

/// Correlation in units of its standard error, of the numbers and of their squares.
fn correlations(a: &[f64], b: &[f64]) -> [f64; 2] {
    let n = a.len().min(b.len()) as f64;
    let sum = |f: fn(f64) -> f64| {
        let mean = |values: &[f64]| values.iter().map(|v| f(*v)).sum::<f64>() / values.len() as f64;
        let (mean_a, mean_b) = (mean(a), mean(b));
        let (mut product, mut squares) = (0.0, [0.0; 2]);
        for (x, y) in a.iter().zip(b) {
            let (x, y) = (f(*x) - mean_a, f(*y) - mean_b);
            product += x * y;
            squares = [squares[0] + x * x, squares[1] + y * y];
        }
        product / (squares[0] * squares[1]).sqrt() * n.sqrt()
    };
    [sum(|v| v), sum(|v| v * v)]
}

#[test]
fn pixels_are_independent_at_many_lags() {
    // Light below and above the point where photon noise changes its method, and read noise on top.
    for (sky_e, stage) in [(3.0, Stage::Charge), (20.0, Stage::Charge), (20.0, Stage::Readout)] {
        let frame = &frames(11, sky_e, stage, 1)[0];
        let (mut worst, mut lags) = (0.0_f64, 0);
        for lag in (0..12).flat_map(|dy| (0..12).map(move |dx| dy * SIDE + dx)).skip(1) {
            let seen = correlations(frame, &frame[lag..]);
            worst = seen.into_iter().fold(worst, |worst, one| worst.max(one.abs()));
            lags += 1;
        }
        assert_eq!(lags, 143);
        // The largest of 286 normal numbers exceeds 5 once in 6000 trials.
        assert!(worst < 5.0, "{sky_e} electrons, {stage:?}: {worst:.1} standard errors");
    }
    // The comparison can fail.
    let frame = &frames(11, 20.0, Stage::Charge, 1)[0];
    let smeared: Vec<f64> = frame.windows(2).map(|pair| pair[0] + 0.05 * pair[1]).collect();
    assert!(correlations(&smeared, &smeared[1..])[0] > 5.0);
}

#[test]
fn frames_seeds_and_stages_are_independent() {
    let ours = frames(11, 20.0, Stage::Charge, 6);
    let other_seed = frames(12, 20.0, Stage::Charge, 2);
    let with_read_noise = frames(11, 20.0, Stage::Readout, 1);
    // What read noise added, from the frame after it.
    let (photon, both) = (&ours[0], &with_read_noise[0]);
    let read: Vec<f64> = both.iter().zip(photon).map(|(both, photon)| both * 45.0_f64.sqrt() - photon * 20.0_f64.sqrt()).collect();
    for (first, frame) in ours.iter().enumerate() {
        for other in ours[first + 1..].iter().chain(&other_seed).chain([&read]) {
            for seen in correlations(frame, other) {
                // What the frame's own scatter lends to the difference of scales above is far below this.
                assert!(seen.abs() < 5.0, "frame {first}: {seen:.1} standard errors");
            }
        }
    }
}

#[test]
fn what_nobody_chose_is_hardware_or_the_cpu_and_said() {
    let config = ImagingConfig { width_px: 8, height_px: 8, seed: 1, point_spread: "gaussian_psf".to_owned(), effects: vec![] };
    let adapter = Imager::new(Backend::Auto, &config).unwrap().adapter();
    match adapters().iter().find(|adapter| !adapter.is_software) {
        None => assert_eq!(adapter, "cpu"),
        Some(hardware) => assert_eq!(adapter, hardware.to_string()),
    }
}

/// A run that is killed leaves nothing under the name that was asked for.
#[test]
fn a_killed_run_leaves_no_half_recording() {
    let folder = tempfile::tempdir().unwrap();
    let scene = short_night(folder.path(), &[("count = 12", "count = 500")]);
    let target = folder.path().join("night");
    let before = std::fs::read_dir(folder.path()).unwrap().count();
    let mut child = Command::new(env!("CARGO_BIN_EXE_boresight"))
        .args(["simulate", "--quiet", "--backend", "cpu", text(&scene), "-o", text(&target)])
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    // Not before it has begun to write.
    let begin = Instant::now();
    while std::fs::read_dir(folder.path()).unwrap().count() == before {
        assert!(begin.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none(), "nothing was written");
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success());
    assert!(!target.exists());
}
