//! What a frame costs in CPU time, on each backend and in other programs: in one run, in turns, so that what slows the machine slows all.
//!
//! `cargo bench --bench render -- [--python PROGRAM] [--page FILE] [--part NAME] [--only WORD]`: with a Python that has numpy and scipy (and
//! photutils, galsim) they are asked for the same frames through `benches/peers/render.py`; the page gets the same text as the terminal.
//! `--part` makes one part alone (times, accuracy, process, memory, joining, effects), `--only` the effects whose names hold the word.
#![allow(missing_docs, reason = "a bench is no interface")]
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a bench that meets the unexpected must fail")]
#![allow(clippy::print_stdout, reason = "its table is what a bench is for")]

mod effects;
mod joining;

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Write as _};
use std::process::{Child, Command, Stdio};

use boresight::imaging::{Backend, EffectSetting, FrameExposure, Imager, ImagingConfig, PlacedStar};
use boresight::scene::DEMO_TOML;
use rand::{RngExt, SeedableRng};
use rustix::time::{ClockId, clock_gettime};

/// Side in pixels, stars, rounds.
const CASES: [(usize, usize, usize); 5] = [(1024, 200, 7), (1024, 2000, 7), (2048, 2000, 5), (4096, 2000, 3), (4096, 32_000, 3)];
/// The case that every program is asked for; the slow ones are asked for no other.
const EVERYONE: (usize, usize) = (1024, 2000);
const SIGMA_PX: f64 = 1.2;

/// CPU time of this process, ms.
fn cpu_ms() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    1e3 * now.tv_sec as f64 + 1e-6 * now.tv_nsec as f64
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Magnitudes even over five, the brightest 300 000 electrons; no star near the edge.
fn sky(side: usize, count: usize) -> Vec<PlacedStar> {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(12_345);
    let place = 12.0..side as f64 - 13.0;
    (0..count)
        .map(|_| PlacedStar {
            x_px: rng.random_range(place.clone()),
            y_px: rng.random_range(place.clone()),
            electrons: 3e5 * 10.0_f64.powf(-0.4 * rng.random_range(0.0..5.0)),
            sigma_px: SIGMA_PX,
        })
        .collect()
}

fn imager(backend: Backend, side: usize, noise: bool) -> Imager {
    let mut effects = vec![
        EffectSetting::new("background", &[("background_e_per_px_s", if noise { 20.0 } else { 0.0 })]),
        EffectSetting::new(
            "adc",
            &[("gain_e_per_dn", 1.0), ("bias_dn", 100.0), ("full_well_e", 1e9), ("saturation_dn", 65_535.0), ("bits", 16.0)],
        ),
    ];
    if noise {
        effects.extend([EffectSetting::new("photon_noise", &[]), EffectSetting::new("read_noise", &[("read_noise_e", 5.0)])]);
    }
    let point_spread = "gaussian_psf".to_owned();
    Imager::new(backend, &ImagingConfig { width_px: side, height_px: side, seed: 1, point_spread, effects }).unwrap()
}

fn exposure(stars: &[PlacedStar], frame_index: u32) -> FrameExposure<'_> {
    FrameExposure { stars, sky_e: &[], exposure_s: 1.0, frame_index, temperature_c: None }
}

/// Another program, which makes a frame for each line that it is sent and answers with its CPU time.
struct Peers(Child, BufReader<std::process::ChildStdout>);

impl Peers {
    fn new(python: &str) -> Self {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/render.py");
        let mut child = Command::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("python starts");
        let answers = BufReader::new(child.stdout.take().unwrap());
        Self(child, answers)
    }

    /// CPU time of a frame, ms; `None` if the tool is not installed.
    fn ask(&mut self, tool: &str, side: usize, stars: usize) -> Option<f64> {
        writeln!(self.0.stdin.as_mut().unwrap(), "{tool} {side} {stars}").unwrap();
        let mut line = String::new();
        self.1.read_line(&mut line).unwrap();
        line.trim().parse().ok()
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        drop(self.0.stdin.take()); // it ends with its input
        drop(self.0.wait());
    }
}

/// Rows of the table of times.
fn times(python: Option<&str>, backends: &[(Backend, String)], text: &mut String) {
    let mut peers = python.map(Peers::new);
    let tools = ["numpy", "photutils", "galsim"];
    let _ = writeln!(text, "CPU time of a frame, ms (times that of numpy in the same run); first: the first frame of the process\n");
    let _ = write!(text, "{:>6} {:>6}", "side", "stars");
    for (backend, _) in backends {
        let _ = write!(text, "  {:>15} {:>6}", backend.to_string(), "first");
    }
    for tool in tools.iter().filter(|_| peers.is_some()) {
        let _ = write!(text, "  {tool:>16}");
    }
    text.push('\n');
    for (side, count, rounds) in CASES {
        let stars = sky(side, count);
        let imagers: Vec<_> = backends.iter().map(|(backend, _)| imager(*backend, side, true)).collect();
        let mut ours = vec![Vec::new(); imagers.len()];
        let mut theirs = vec![Vec::new(); tools.len()];
        for round in 0..=rounds as u32 {
            for (imager, times) in imagers.iter().zip(&mut ours) {
                let begin = cpu_ms();
                std::hint::black_box(imager.expose(&exposure(&stars, round)).unwrap());
                times.push(cpu_ms() - begin);
            }
            for (tool, times) in tools.iter().zip(&mut theirs) {
                if (*tool == "numpy" || (side, count) == EVERYONE)
                    && let Some(peers) = &mut peers
                {
                    times.extend(peers.ask(tool, side, count));
                }
            }
        }
        let warm = |times: &[f64]| (times.len() > 1).then(|| median(times[1..].to_vec()));
        let numpy = warm(&theirs[0]);
        let ratio = |ms: f64| numpy.map_or(String::new(), |numpy| format!("({:.3})", ms / numpy));
        let _ = write!(text, "{side:6} {count:6}");
        for times in &ours {
            let ms = warm(times).unwrap();
            let _ = write!(text, "  {ms:7.1} {:>7} {:6.0}", ratio(ms), times[0]);
        }
        for times in theirs.iter().filter(|_| peers.is_some()) {
            let _ = match warm(times) {
                Some(ms) => write!(text, "  {ms:7.0} {:>8}", ratio(ms)),
                None => write!(text, "  {:>16}", "–"),
            };
        }
        text.push('\n');
    }
}

/// Centroid and flux of lone stars without noise, at random places in the pixel.
fn accuracy(backends: &[(Backend, String)], text: &mut String) {
    const STEP: usize = 32;
    let side = 1024;
    let mut rng = rand_pcg::Pcg64::seed_from_u64(7);
    let stars: Vec<PlacedStar> = (0..(side / STEP).pow(2))
        .map(|i| {
            let mut place = |n: usize| (n * STEP + STEP / 2) as f64 + rng.random_range(-0.5..0.5);
            PlacedStar { x_px: place(i % (side / STEP)), y_px: place(i / (side / STEP)), electrons: 1e5, sigma_px: SIGMA_PX }
        })
        .collect();
    let _ = writeln!(text, "\nNoise-free stars ({}, σ {SIGMA_PX} px, 1e5 electrons)\n", stars.len());
    for (backend, _) in backends {
        let frame = imager(*backend, side, false).expected_electrons(&exposure(&stars, 0)).unwrap();
        let (mut squares, mut largest, mut flux_squares, mut flux_largest) = (0.0, 0.0_f64, 0.0, 0.0_f64);
        for (i, star) in stars.iter().enumerate() {
            let (left, top) = (i % (side / STEP) * STEP, i / (side / STEP) * STEP);
            let (mut sum, mut sum_x, mut sum_y) = (0.0, 0.0, 0.0);
            for (x, y) in (0..STEP * STEP).map(|n| (left + n % STEP, top + n / STEP)) {
                let electrons = f64::from(frame[y * side + x]);
                sum += electrons;
                sum_x += electrons * (x as f64 - star.x_px);
                sum_y += electrons * (y as f64 - star.y_px);
            }
            let shift = (sum_x / sum).hypot(sum_y / sum);
            let flux = sum / star.electrons - 1.0;
            squares += shift * shift;
            largest = largest.max(shift);
            flux_squares += flux * flux;
            flux_largest = flux_largest.max(flux.abs());
        }
        let rms = |sum: f64| (sum / stars.len() as f64).sqrt();
        let _ = writeln!(
            text,
            "{:>6}: centroid rms {:.1e}, largest {largest:.1e} px; flux rms {:.1e}, largest {flux_largest:.1e}",
            backend.to_string(),
            rms(squares),
            rms(flux_squares)
        );
    }
}

/// Resident memory, KiB.
fn resident_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap_or_default();
    line.trim().trim_end_matches(" kB").parse().unwrap_or(0)
}

/// Memory over many frames in a row.
fn memory(backends: &[(Backend, String)], text: &mut String) {
    let stars = sky(256, 100);
    let _ = writeln!(text, "\nResident memory over frames of 256² in a row\n");
    for (backend, _) in backends {
        let imager = imager(*backend, 256, true);
        let frames = if *backend == Backend::Cpu { 10_000 } else { 3_000 };
        let mut seen = Vec::new();
        for frame in 0..=frames {
            std::hint::black_box(imager.expose(&exposure(&stars, frame)).unwrap());
            if [frames / 10, frames].contains(&frame) {
                seen.push(resident_kib());
            }
        }
        let _ = writeln!(text, "{:>6}: {} KiB after {}, {} KiB after {frames}", backend.to_string(), seen[0], frames / 10, seen[1]);
    }
}

/// CPU time of children that have ended, ms, in ticks of 10 ms.
fn children_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = stat.rsplit(')').next().unwrap_or_default();
    let fields: Vec<&str> = after.split_whitespace().collect();
    [13, 14].into_iter().filter_map(|index| fields.get(index)?.parse::<f64>().ok()).sum::<f64>() * 10.0
}

/// One frame with the start of the process: reading the scene and the catalogue, the frame, FITS and truth.
fn process(backends: &[(Backend, String)], text: &mut String) {
    const RUNS: usize = 5;
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.toml");
    std::fs::write(&scene, DEMO_TOML.replace("count = 12", "count = 1")).unwrap();
    let cache = folder.path().join("shaders");
    let _ = writeln!(text, "\nCPU time of `boresight simulate` with one frame of 1024², ms\n");
    for (backend, _) in backends {
        let run = || {
            let begin = children_ms();
            let status = Command::new(env!("CARGO_BIN_EXE_boresight"))
                .args(["simulate", "--quiet", "--force", "--backend", &backend.to_string(), "-o"])
                .arg(folder.path().join("night"))
                .arg(&scene)
                .env("MESA_SHADER_CACHE_DIR", &cache)
                .stdout(Stdio::null())
                .status()
                .unwrap();
            assert!(status.success());
            children_ms() - begin
        };
        let first = run();
        let warm = (0..RUNS).map(|_| run()).sum::<f64>() / RUNS as f64;
        let _ = writeln!(text, "{:>6}: {warm:.0}, with an empty shader cache {first:.0}", backend.to_string());
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str| arguments.iter().position(|argument| argument == name).and_then(|at| arguments.get(at + 1).cloned());
    let backends: Vec<_> = [Backend::Cpu, Backend::Gpu]
        .into_iter()
        .filter_map(|backend| {
            let config = ImagingConfig { width_px: 16, height_px: 16, seed: 1, point_spread: "gaussian_psf".to_owned(), effects: vec![] };
            Some((backend, Imager::new(backend, &config).ok()?.adapter()))
        })
        .collect();
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or_default();
    let threads = std::thread::available_parallelism().unwrap();
    let mut text = format!("Made by `make bench-render` on {threads} threads of: {}\n", model.trim_start_matches([' ', '\t', ':']));
    text += &format!("{}\n\n", boresight::provenance::made_by(None));
    for (backend, adapter) in &backends {
        let _ = writeln!(text, "{backend}: {}", if *backend == Backend::Cpu { "the twins in Rust" } else { adapter });
    }
    text.push('\n');
    let wanted = option("--part");
    let is_wanted = |part: &str| wanted.as_deref().is_none_or(|wanted| wanted == part);
    let parts = ["times", "accuracy", "process", "memory", "joining", "effects"];
    assert!(parts.into_iter().any(is_wanted), "--part is one of {parts:?}");
    if is_wanted("times") {
        times(option("--python").as_deref(), &backends, &mut text);
    }
    if is_wanted("accuracy") {
        accuracy(&backends, &mut text);
    }
    if is_wanted("process") {
        process(&backends, &mut text);
    }
    if is_wanted("memory") {
        memory(&backends, &mut text);
    }
    if is_wanted("joining") {
        joining::joining(&backends, &mut text);
    }
    if is_wanted("effects") {
        effects::effects(&backends, option("--only").as_deref().unwrap_or_default(), &mut text);
    }
    print!("{text}");
    if let Some(page) = option("--page") {
        std::fs::write(page, text).unwrap();
    }
}
