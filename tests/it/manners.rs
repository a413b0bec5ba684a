//! How the program behaves towards whoever calls it: names that are no text, places that cannot be written, folders that hold results, signals, limits,
//! what it says and with which exit code.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::cli::{run, short_night, text};

fn program() -> Command {
    Command::new(assert_cmd::cargo::cargo_bin("boresight"))
}

fn output(args: &[&OsStr]) -> Output {
    program().args(args).stdin(Stdio::null()).output().unwrap()
}

/// The names in a folder, the hidden ones too.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A recording of a few frames of the short night.
fn night(folder: &Path, frames: usize) -> PathBuf {
    let scene = short_night(folder, &[("count = 12", &format!("count = {frames}"))]);
    let path = folder.join("night");
    let ran = run(&["simulate", text(&scene), "-o", text(&path), "--backend", "cpu", "--no-pixel-shifts"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    path
}

/// Every verb takes names that are no UTF-8, and what it says of its making holds them.
#[test]
fn names_that_are_no_text_are_names() {
    let folder = tempfile::tempdir().unwrap();
    let here = |name: &[u8]| folder.path().join(OsStr::from_bytes(name));
    std::fs::rename(night(folder.path(), 3), here(b"nu\xe9")).unwrap();
    std::fs::rename(folder.path().join("scene.toml"), here(b"sc\xe8ne.toml")).unwrap();
    let frame = here(b"nu\xe9/frames/\xe9.fits");
    std::fs::copy(here(b"nu\xe9/frames/0000.fits"), &frame).unwrap();
    let (out, camera) = (here(b"cal\xe9"), here(b"cal\xe9/calibrate.json"));
    let night = here(b"nu\xe9");
    let bytes = |text: &'static [u8]| OsStr::from_bytes(text).to_owned();
    let cases: Vec<Vec<OsString>> = vec![
        vec!["detect".into(), frame.clone().into(), "-o".into(), here(b"d\xe9").into()],
        vec!["identify".into(), frame.into(), "-o".into(), here(b"i\xe9").into(), "--fits".into()],
        vec!["calibrate".into(), night.clone().into(), "-o".into(), out.clone().into(), "--solve".into(), "f".into()],
        vec!["diagnose".into(), night.into(), "-o".into(), here(b"g\xe9").into(), "--nulls".into(), "100".into()],
        vec!["map".into(), camera.clone().into(), "--grid".into(), "2".into(), "-o".into(), here(b"m\xe9").into()],
        vec!["compare".into(), camera.clone().into(), camera.clone().into(), "-o".into(), here(b"c\xe9").into()],
        vec!["export".into(), camera.into(), "--to".into(), "opencv".into(), "-o".into(), here(b"cv\xe9.yml").into()],
        vec!["import".into(), here(b"cv\xe9.yml").into(), "--from".into(), "opencv".into(), "-o".into(), here(b"im\xe9").into()],
        vec!["simulate".into(), here(b"sc\xe8ne.toml").into(), "-o".into(), here(b"again\xe9").into()],
        vec!["effects".into(), "even-odd".into(), "--pictures".into(), here(b"p\xe9").into()],
        vec!["man".into(), "-o".into(), here(b"man\xe9").into()],
    ];
    for args in &cases {
        let ran = program().args(args).output().unwrap();
        let stderr = String::from_utf8_lossy(&ran.stderr);
        let is_done = ran.status.code() == Some(0) || args[0] == "diagnose" && ran.status.code() == Some(3);
        assert!(is_done && !stderr.contains("panicked"), "{args:?}: {:?} {stderr}", ran.status);
    }
    let told: Value = serde_json::from_slice(&std::fs::read(out.join("calibrate.json")).unwrap()).unwrap();
    let command: Vec<&str> = told["provenance"]["command"].as_array().unwrap().iter().map(|word| word.as_str().unwrap()).collect();
    assert!(command.iter().any(|word| word.starts_with("$'") && word.ends_with(r"cal\xE9'")), "{command:?}");
    // A word that is nothing at all is a sentence, before any work.
    for args in [vec![bytes(b"identif\xff")], vec!["preset".into(), "show".into(), bytes(b"\xfe")], vec!["effects".into(), bytes(b"\xfe")]]
    {
        let ran = program().args(&args).output().unwrap();
        assert_eq!(ran.status.code(), Some(2), "{args:?}");
    }
}

/// A folder that cannot be made is told before anything is read.
#[test]
fn a_place_that_cannot_be_written_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let target = folder.path().join("file/within");
    let absent = folder.path().join("absent");
    for verb in [
        vec!["detect"],
        vec!["identify"],
        vec!["calibrate"],
        vec!["diagnose"],
        vec!["map"],
        vec!["import"],
        vec!["export", "--to", "sip"],
        vec!["export", "--to", "opencv"],
        vec!["catalog", "import"],
    ] {
        let mut args: Vec<&OsStr> = verb.iter().map(OsStr::new).collect();
        args.extend([absent.as_os_str(), OsStr::new("-o"), target.as_os_str()]);
        let ran = output(&args);
        let stderr = String::from_utf8(ran.stderr).unwrap();
        assert_eq!(ran.status.code(), Some(1), "{verb:?}: {stderr}");
        assert!(stderr.contains("within: cannot be written") && !stderr.contains("absent"), "{verb:?}: {stderr}");
    }
    // A folder that was made for a run that failed goes again, with those above it.
    let ran = run(&["identify", text(&absent), "-o", text(&folder.path().join("new/deep"))]);
    assert_eq!((ran.code, names(folder.path())), (1, vec!["file".to_owned()]), "{}", ran.stderr);
}

/// The second run into a folder is refused; with --force nothing of the first stays, and nothing of the user's goes.
#[test]
fn a_folder_holds_the_results_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let night = night(folder.path(), 2);
    let out = folder.path().join("out");
    let frame = |number: usize| night.join(format!("frames/000{number}.fits"));
    let detect = |number: usize, more: &[&str]| run(&[&["detect", text(&frame(number)), "-o", text(&out)], more].concat());
    assert_eq!(detect(0, &[]).code, 0);
    std::fs::write(out.join("notes.txt"), "the user's own").unwrap();
    let first = names(&out);
    assert!(first.contains(&"0000-0000.png".to_owned()), "{first:?}");
    let again = detect(1, &[]);
    assert_eq!((again.code, names(&out)), (1, first.clone()), "{}", again.stderr);
    assert!(again.stderr.contains("out: holds an earlier result of `detect`") && again.stderr.contains("--force"), "{}", again.stderr);
    // What cannot be read leaves the earlier result where it is.
    let absent = run(&["detect", text(&folder.path().join("absent")), "-o", text(&out), "--force"]);
    assert_eq!((absent.code, names(&out)), (1, first));
    assert_eq!(detect(1, &["--force"]).code, 0);
    let second = names(&out);
    assert!(second.contains(&"0000-0001.png".to_owned()) && second.contains(&"notes.txt".to_owned()), "{second:?}");
    assert!(!second.iter().any(|name| name.starts_with("0000-0000")), "{second:?}");
    // Another verb has results of its own there; each replaces its own alone.
    let identify = |more: &[&str]| run(&[&["identify", text(&frame(0)), "-o", text(&out)], more].concat());
    assert_eq!(identify(&[]).code, 0);
    assert_eq!(identify(&[]).code, 1);
    assert_eq!(detect(0, &["--force"]).code, 0);
    assert!(names(&out).contains(&"identify.json".to_owned()) && names(&out).contains(&"0000-0000.wcs".to_owned()), "{:?}", names(&out));
    // Files that are named follow the same rule.
    let camera = folder.path().join("cal");
    assert_eq!(run(&["calibrate", text(&night), "--solve", "f", "-o", text(&camera)]).code, 0);
    let (file, from) = (folder.path().join("camera.yml"), camera.join("calibrate.json"));
    let export = |more: &[&str]| run(&[&["export", text(&from), "--to", "opencv", "-o", text(&file)], more].concat());
    assert_eq!(export(&[]).code, 0);
    let refused = export(&[]);
    assert!(refused.code == 1 && refused.stderr.contains("camera.yml: is there already"), "{}", refused.stderr);
    assert_eq!(export(&["--force"]).code, 0);
    // An update goes on with its own file in its own place.
    let update = |from: &Path, to: &Path| run(&["calibrate", text(&night), "--update", text(from), "-o", text(to)]).code;
    let sequel = folder.path().join("sequel");
    assert_eq!(update(&from, &sequel), 0);
    assert_eq!(update(&sequel.join("sequential.json"), &sequel), 0);
    assert_eq!(update(&from, &sequel), 1, "another file must not be lost");
}

/// A scene whose frames take long.
fn long_scene(folder: &Path) -> PathBuf {
    short_night(folder, &[("count = 12", "count = 100000")])
}

/// A run that signals end, also where this test was started with them ignored (a job of a script, `nohup`): the program keeps to that.
fn begin(scene: &Path, target: &Path) -> Child {
    let mut command = Command::new("env");
    command.args(["--default-signal=INT,TERM", text(Path::new(program().get_program()))]);
    command.args(["simulate", text(scene), "-o", text(target), "--backend", "cpu", "--threads", "1"]);
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

fn partial(folder: &Path) -> Vec<PathBuf> {
    names(folder).into_iter().filter(|name| name.ends_with(".partial")).map(|name| folder.join(name)).collect()
}

/// Waits for a condition.
fn wait_for<T>(what: &str, mut found: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(begun.elapsed() < Duration::from_secs(120), "{what} did not happen");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn first_frame(folder: &Path) {
    wait_for("a first frame", || partial(folder).iter().any(|path| path.join("frames/0000.fits").is_file()).then_some(()));
}

fn send(child: &Child, signal: &str) {
    let sent = Command::new("sh").args(["-c", &format!("kill -s {signal} {}", child.id())]).status().unwrap();
    assert!(sent.success());
}

#[test]
fn a_run_that_is_stopped_leaves_nothing() {
    for (signal, code) in [("INT", 130), ("TERM", 143)] {
        let folder = tempfile::tempdir().unwrap();
        let scene = long_scene(folder.path());
        let mut child = begin(&scene, &folder.path().join("night"));
        first_frame(folder.path());
        send(&child, signal);
        let status = child.wait().unwrap();
        let mut said = String::new();
        std::io::Read::read_to_string(&mut child.stderr.take().unwrap(), &mut said).unwrap();
        assert_eq!(status.code(), Some(code), "{signal}: {said}");
        assert!(said.contains(&format!("stopped by SIG{signal}")), "{said}");
        assert_eq!(names(folder.path()), ["scene.toml"], "{signal}");
    }
}

/// What a killed run left goes with the next; what a live one has in the making stays.
#[test]
fn leftovers_of_killed_runs_are_taken_away_and_live_ones_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let scene = long_scene(folder.path());
    let mut killed = begin(&scene, &folder.path().join("killed"));
    first_frame(folder.path());
    send(&killed, "KILL");
    killed.wait().unwrap();
    let left = partial(folder.path());
    assert_eq!(left.len(), 1);
    let mut live = begin(&scene, &folder.path().join("live"));
    let of_live =
        wait_for("the leftover to go", || partial(folder.path()).into_iter().find(|path| !left.contains(path) && !left[0].exists()));
    // A third run beside the live one takes nothing of it.
    let short = short_night(folder.path(), &[("count = 12", "count = 1")]);
    let third = run(&["simulate", text(&short), "-o", text(&folder.path().join("third")), "--backend", "cpu"]);
    assert_eq!(third.code, 0, "{}", third.stderr);
    assert!(of_live.is_dir(), "{:?}", names(folder.path()));
    wait_for("a frame of the live run", || of_live.join("frames/0000.fits").is_file().then_some(()));
    send(&live, "TERM");
    live.wait().unwrap();
    assert_eq!(names(folder.path()), ["scene.toml", "third"]);
}

/// A series of a million begins at once and holds none of its frames.
#[test]
fn a_long_series_begins_at_once_in_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let scene = short_night(folder.path(), &[("count = 12", "count = 1000000"), ("interval_s = ", "interval_s = 0.001 # ")]);
    let mut child = begin(&scene, &folder.path().join("night"));
    first_frame(folder.path());
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
    let cpu = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap_or_default();
    send(&child, "TERM");
    child.wait().unwrap();
    let peak_kb =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")).map(|rest| rest.trim().trim_end_matches(" kB").parse::<u64>().unwrap());
    assert!(peak_kb.is_some_and(|peak| peak < 400_000), "{peak_kb:?} kB");
    let ticks: Vec<u64> = cpu.rsplit(')').next().unwrap().split_whitespace().filter_map(|word| word.parse().ok()).collect();
    // Behind the state (a letter) stand ten numbers, then the time in user and system mode, hundredths of a second.
    let seconds = (ticks[10] + ticks[11]) as f64 / 100.0;
    assert!(seconds < 10.0, "{seconds} s of processor time before the first frame");
}

/// The frames of a series are those of a list with the same times and pointings, in any order.
#[test]
fn exposures_of_a_series_do_not_hang_on_the_order_in_which_they_are_asked_for() {
    use boresight::scene::{DEMO_TOML, Scene};
    for mount in ["", "[mount]\nkind = \"fixed\"\n"] {
        let toml = DEMO_TOML.replace("[series]", &format!("{mount}[series]"));
        let [forwards, backwards] = [Scene::parse("scene", &toml).unwrap(), Scene::parse("scene", &toml).unwrap()];
        let mut there: Vec<_> = (0..12).rev().map(|index| backwards.exposures.get(index)).collect();
        there.reverse();
        for (here, there) in forwards.exposures.iter().zip(&there) {
            assert_eq!((here.attitude, here.time), (there.attitude, there.time));
            assert_eq!(here.sky.observation(), there.sky.observation());
        }
        // The drift counts from the mean over all.
        let hours = || there.iter().map(|exposure| exposure.sky.observation().time_offset_h.unwrap());
        assert!(hours().sum::<f64>().abs() < 1e-9 && hours().any(|hour| hour.abs() > 1e-3));
        assert!(there.iter().map(|exposure| exposure.sky.observation().order_offset.unwrap()).sum::<f64>().abs() < 1e-12);
    }
}

/// Numbers that no frame can be made of in reasonable time are refused before the work, each by its name.
#[test]
fn scenes_of_extreme_numbers_are_refused_at_once() {
    use boresight::scene::{DEMO_TOML, Scene};
    let refused = |change: &str, to: &str| {
        assert!(DEMO_TOML.contains(change), "the demo scene has no {change:?}");
        let begun = Instant::now();
        let message = Scene::parse("scene.toml", &DEMO_TOML.replace(change, to)).unwrap_err().to_string();
        assert!(begun.elapsed() < Duration::from_secs(5), "{change} → {to} took {:?}", begun.elapsed());
        assert!(!message.contains('\n'), "{message}");
        message
    };
    for (change, to, parts) in [
        (
            "width_px = 1024\nheight_px = 1024",
            "width_px = 4096\nheight_px = 4096\nbinning = { factor = 4, method = \"sum\" }",
            vec!["camera.width_px = 4096", "2.684e8 own pixels"],
        ),
        (
            "exposure_s = 0.1\nlowest_altitude_deg = 35.0",
            "exposure_s = 10.0\n[cosmic_rays]\nexpected_per_s = 9e5",
            vec!["cosmic_rays.expected_per_s = 900000", "particles"],
        ),
        (
            "[series]",
            "[cosmic_rays]\nexpected_per_s = 1e4\nthickness_um = 2000.0\npitch_um = 0.5\n[series]",
            vec!["cosmic_rays.thickness_um = 2000", "points of light"],
        ),
        (
            "[series]",
            "[[streaks]]\nkind = \"satellite\"\nexpected_per_frame = 1e4\nelectrons = 1e5\n[series]",
            vec!["streaks[0].expected_per_frame", "trails"],
        ),
        ("[series]", "[jitter]\nsigma_arcsec = [0.0, 36000.0, 0.0]\n[series]", vec!["jitter.sigma_arcsec = 36000", "px of trembling"]),
        ("[series]", "[series]\nrate_deg_s = [0.0, 10000.0, 0.0]", vec!["series.rate_deg_s = 10000", "degrees by which the camera turns"]),
        ("exposure_s = ", "exposure_s = 1e300 # ", vec!["series.exposure_s = 1e300", "between 1e-9 and 100000 s"]),
        ("interval_s = ", "interval_s = 1e300 # ", vec!["series.interval_s", "1000000000 s"]),
        ("focal_length_px = 2900.0", "focal_length_px = 1e300", vec!["camera.focal_length_px = 1e300", "1e8 px"]),
        (
            "focal_length_px = 2900.0",
            "focal_length_px = 2900.0\nprojection = \"kannala-brandt\"\nprojection_parameters = [1e15, 0.0, 0.0, 0.0]",
            vec!["camera.projection_parameters = k1_theta = 1000000000000000", "no lens's"],
        ),
        ("zero_point_e_per_s = 2.0e6", "zero_point_e_per_s = 1e300", vec!["detector.zero_point_e_per_s", "1e14"]),
    ] {
        let message = refused(change, to);
        for part in parts {
            assert!(message.contains(part), "{part:?} is not in: {message}");
        }
    }
}

/// Starlight that is put down at millions of places along its ways is refused too, once it is known how many stars there are.
#[test]
fn frames_of_endless_starlight_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let ground = include_str!("../../fuzz/scenes/ground.toml");
    let scene = folder.path().join("scene.toml");
    let simulate = |text_of: &str| {
        std::fs::write(&scene, text_of).unwrap();
        run(&["simulate", text(&scene), "-o", text(&folder.path().join("night")), "--backend", "cpu", "--force"])
    };
    let wide = ground
        .replace("focal_length_px = 250.0", "focal_length_px = 0.5")
        .replace("faintest_magnitude = 5.5", "faintest_magnitude = 12.0")
        .replace("sigma_arcsec = [2.0, 2.0, 10.0]", "sigma_arcsec = [36000.0, 36000.0, 36000.0]");
    let refused = simulate(&wide);
    assert_eq!(refused.code, 1, "{}", refused.stderr);
    for part in ["exposure 0 asks for", "points of starlight", "sky.faintest_magnitude"] {
        assert!(refused.stderr.contains(part), "{part:?} is not in: {}", refused.stderr);
    }
    assert_eq!(simulate(ground).code, 0);
}

/// What an effect follows has to be in the scene; else it would do nothing and say nothing.
#[test]
fn an_effect_without_its_telemetry_is_refused() {
    use boresight::scene::Scene;
    let scene = |effect: &str, frame: &str| {
        let text = format!(
            "format = \"boresight-scene/1\"\n[camera]\nwidth_px = 64\nheight_px = 64\nfocal_length_px = 500.0\n[[effects]]\n{effect}\n\
             [[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [10.0, 20.0]\n{frame}\n"
        );
        Scene::parse("scene.toml", &text).map(drop).map_err(|error| error.to_string())
    };
    let thermal = "id = \"thermal-focal-length\"\nparameters = { relative_per_kelvin = 2e-5 }";
    let message = scene(thermal, "").unwrap_err();
    for part in ["effects[0]", "thermal-focal-length does nothing in exposure 0", "temperature", "temperature_c", "leave the effect out"] {
        assert!(message.contains(part), "{part:?} is not in: {message}");
    }
    scene(thermal, "temperature_c = 12.0").unwrap();
    let drift = "id = \"boresight-drift\"\nparameters = { x_px_per_kelvin = 0.1 }";
    assert!(scene(drift, "time_utc = \"2026-03-01T20:00:00Z\"").unwrap_err().contains("temperature"), "time is not what it follows");
    let pressure = "id = \"pressure-scale\"\nparameters = { relative_per_hpa = 1e-6 }";
    assert!(scene(pressure, "").unwrap_err().contains("pressure_hpa"));
}

/// A mistyped name is wrong usage; frames in which nothing can be found are an answer.
#[test]
fn exit_codes_say_what_kind_of_failure_it_was() {
    let folder = tempfile::tempdir().unwrap();
    for (args, code, part) in [
        (vec!["preset", "show", "cubesat-traker"], 2, "did you mean cubesat-tracker?"),
        (vec!["effects", "refracton"], 2, "did you mean refraction?"),
        (vec!["calibrate", "absent.png", "--projection", "fisheye"], 2, "equidistant, equisolid, stereographic, kannala-brandt"),
    ] {
        let ran = run(&args);
        assert_eq!(ran.code, code, "{args:?}: {}", ran.stderr);
        assert!(ran.stderr.contains(part) && ran.stderr.starts_with("error: "), "{args:?}: {}", ran.stderr);
    }
    let black = folder.path().join("black.png");
    image::ImageBuffer::from_pixel(128, 128, image::Luma([0_u16])).save(&black).unwrap();
    for verb in ["identify", "calibrate", "diagnose"] {
        let ran = run(&[verb, text(&black), "--json"]);
        assert_eq!(ran.code, 3, "{verb}: {}", ran.stderr);
        let object: Value = serde_json::from_str(&ran.stdout).unwrap();
        assert!(object["format"].as_str().unwrap().starts_with(&format!("boresight-{verb}/")), "{object}");
        assert!(object["provenance"]["inputs"][0]["path"].as_str().unwrap().contains("black.png"), "{object}");
    }
}

/// A limit on the difference of two cameras is an answer for a script.
#[test]
fn a_comparison_has_a_limit() {
    let folder = tempfile::tempdir().unwrap();
    let night = night(folder.path(), 3);
    let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
    assert_eq!(run(&["calibrate", text(&night), "--solve", "f", "-o", text(&a)]).code, 0);
    assert_eq!(run(&["calibrate", text(&night), "--solve", "f,k1", "-o", text(&b)]).code, 0);
    let [a, b] = [a, b].map(|folder| folder.join("calibrate.json"));
    let compare = |limit: &str| run(&["compare", text(&a), text(&b), "--json", "--max-px", limit]);
    let (kept, not) = (compare("1000"), compare("1e-9"));
    assert_eq!((kept.code, not.code), (0, 3), "{} {}", kept.stderr, not.stderr);
    let object: Value = serde_json::from_str(&not.stdout).unwrap();
    assert_eq!(object["limit"], serde_json::json!({ "max_px": 1e-9, "is_kept": false }));
    assert!(run(&["compare", text(&a), text(&b), "--max-px", "1e-9"]).stdout.contains("BEYOND THE LIMIT"));
}

/// Steps with their times at -v, frames at -vv, nothing at -q, also where no session has made a folder for the run.
#[test]
fn the_log_tells_what_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let night = night(folder.path(), 3);
    let said = |args: &[&str]| {
        let ran = program().args(args).env_remove("XDG_RUNTIME_DIR").env_remove("RUST_LOG").output().unwrap();
        (ran.status.code(), String::from_utf8(ran.stderr).unwrap())
    };
    let identify = ["identify", text(&night)];
    let (code, steps) = said(&[&identify[..], &["-v"]].concat());
    assert_eq!(code, Some(0));
    for part in [
        "note: 3 frames opened in ",
        "note: 3 frames measured in ",
        "note: identifying with the focal length",
        "3 of 3 frames identified in ",
    ] {
        assert!(steps.contains(part), "{part:?} is not in: {steps}");
    }
    assert!(!steps.contains("detail: "));
    let (_, details) = said(&[&identify[..], &["-vv"]].concat());
    assert_eq!(details.lines().filter(|line| line.starts_with("detail: ") && line.contains("rms")).count(), 3, "{details}");
    for (verb, more, part) in [("calibrate", &[][..], "note: solved in "), ("diagnose", &["--nulls", "100"], "note: diagnosed in ")] {
        let (_, steps) = said(&[&[verb, text(&night), "-v"], more].concat());
        assert!(steps.contains(part), "{part:?} is not in: {steps}");
    }
    let scene = folder.path().join("scene.toml");
    let (_, steps) = said(&["simulate", text(&scene), "-o", text(&folder.path().join("again")), "-v", "--backend", "cpu"]);
    assert!(steps.contains("note: rendered in "), "{steps}");
    for args in [
        &["doctor", "-q"][..],
        &["doctor", "--json", "-q"],
        &["simulate", text(&scene), "-o", text(&folder.path().join("third")), "-q", "--backend", "gpu"],
    ] {
        assert_eq!(said(args).1, "", "{args:?}");
    }
    assert!(!said(&["doctor"]).1.contains("XDG_RUNTIME_DIR"));
}

/// Every verb that has an answer gives it as one object.
#[test]
fn every_answer_is_to_be_had_as_an_object() {
    for (args, key) in [
        (&["preset", "list", "--json"][..], "presets"),
        (&["preset", "show", "cubesat-tracker", "--json"], "presets"),
        (&["effects", "refraction", "--json"], "page"),
        (&["effects", "--json"], "effects"),
        (&["schema", "--json"], "properties"),
    ] {
        let object = crate::cli::json(args);
        assert!(!object[key].is_null(), "{args:?}: {object}");
    }
}

/// The groups of the help are the same everywhere, and no option stands outside of one.
#[test]
fn options_stand_in_groups() {
    for verb in ["simulate", "detect", "identify", "calibrate", "diagnose", "map", "compare", "export", "import", "run", "demo", "doctor"] {
        let help = run(&[verb, "--help"]).stdout;
        assert!(!help.contains("\nOptions:"), "{verb}: {help}");
        assert!(help.contains("\nGlobal:") && help.contains("\nOutput:") && help.contains("\nExamples:"), "{verb}: {help}");
    }
    let help = run(&["calibrate", "--help"]).stdout;
    let places: Vec<usize> =
        ["\nInput:", "\nMeasuring:", "\nCatalogue:", "\nModel:", "\nIdentification:", "\nSolver:", "\nOutput:", "\nGlobal:"]
            .map(|heading| help.find(heading).unwrap_or_else(|| panic!("{heading} is not in {help}")))
            .to_vec();
    assert!(places[0] < places[6] && places[6] < places[7], "{places:?}");
}

/// Every example of every help does what it says.
#[test]
fn every_example_runs() {
    let folder = tempfile::tempdir().unwrap();
    let night = night(folder.path(), 4);
    let old = folder.path().join("old");
    assert_eq!(run(&["calibrate", text(&night), "-o", text(&folder.path().join("cal"))]).code, 0);
    assert_eq!(run(&["calibrate", text(&night), "-o", text(&old), "--solve", "f,k1"]).code, 0);
    let camera = folder.path().join("camera.yml");
    assert_eq!(run(&["export", text(&old.join("calibrate.json")), "--to", "opencv", "-o", text(&camera)]).code, 0);
    let mut table = "ra_deg,dec_deg,magnitude\n".to_owned();
    for star in boresight::catalog::Catalog::embedded().brighter_than(6.0) {
        let (ra, dec) = star.direction.radec_rad();
        table += &format!("{},{},{}\n", ra.to_degrees(), dec.to_degrees(), star.magnitude);
    }
    std::fs::write(folder.path().join("table.csv"), table).unwrap();
    crate::suite::suite_in(folder.path());
    crate::dataset::recipe_in(folder.path(), &crate::dataset::RECIPE.replace("train = 12", "train = 24"));
    let program = assert_cmd::cargo::cargo_bin("boresight");
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let help = run(&["--help"]).stdout;
    let verbs = help.split("Commands:\n").nth(1).unwrap().lines().take_while(|line| !line.trim().is_empty());
    let verbs: Vec<&str> =
        verbs.filter(|line| line.starts_with("  ") && !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next()).collect();
    assert!(verbs.len() >= 19, "{verbs:?}");
    // The steps of `dataset` work on what its own examples make.
    let steps = ["finish", "verify", "export"].map(|step| vec!["dataset", step]);
    for words in verbs.into_iter().filter(|verb| *verb != "help").map(|verb| vec![verb]).chain(steps) {
        let verb = words.join(" ");
        let help = run(&[words.as_slice(), &["--help"]].concat()).stdout;
        let examples: Vec<&str> = help
            .split("Examples:\n")
            .nth(1)
            .unwrap_or_default()
            .lines()
            .map(str::trim)
            .take_while(|line| line.starts_with("boresight "))
            .collect();
        assert!((2..=4).contains(&examples.len()), "{verb}: {examples:?}");
        for example in examples {
            let ran = Command::new("sh").args(["-c", example]).env("PATH", &path).current_dir(folder.path()).output().unwrap();
            let stderr = String::from_utf8_lossy(&ran.stderr);
            let is_answer = ran.status.code() == Some(0) || verb == "diagnose" && ran.status.code() == Some(3);
            assert!(is_answer, "{example}: {:?} {stderr}", ran.status.code());
        }
    }
    let pages = names(&folder.path().join("man1"));
    assert!(pages.contains(&"boresight-identify.1".to_owned()) && pages.contains(&"boresight-catalog-import.1".to_owned()), "{pages:?}");
    let page = std::fs::read_to_string(folder.path().join("man1/boresight-calibrate.1")).unwrap();
    assert!(page.starts_with(".ie") || page.starts_with(".TH") || page.contains(".TH"), "{}", &page[..80]);
    let completions = std::fs::read_to_string(folder.path().join("boresight.bash")).unwrap();
    assert!(completions.contains("--focal-length-px") && completions.contains("complete -F"));
}
