//! The examples of the library do what they say, on a recording of our own.

use std::path::PathBuf;
use std::process::Command;

use crate::cli::text;

/// An example as `cargo test` has built it, beside the tests.
fn example(name: &str) -> PathBuf {
    let own = std::env::current_exe().expect("a test knows its file");
    let profile = own.parent().and_then(std::path::Path::parent).expect("target/<profile>/deps");
    profile.join("examples").join(format!("{name}{}", std::env::consts::EXE_SUFFIX))
}

fn run(name: &str, path: &std::path::Path) -> String {
    let output = Command::new(example(name)).arg(path).output().unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("UTF-8")
}

#[test]
fn the_examples_simulate_identify_calibrate_and_diagnose() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.toml");
    std::fs::write(
        &scene,
        "format = \"boresight-scene/1\"\nseed = 4\ncamera = { width_px = 512, height_px = 512, focal_length_px = 1400.0 }\n\
         [series]\ncount = 6\nexposure_s = 1.0\nstart_utc = \"2026-03-01T20:00:00Z\"\n",
    )
    .unwrap();
    let simulated = run("simulate", &scene);
    assert_eq!(simulated.lines().count(), 6, "{simulated}");
    let night = folder.path().join("night");
    let made = crate::cli::run(&["simulate", text(&scene), "-o", text(&night), "--quiet"]);
    assert_eq!(made.code, 0, "{}", made.stderr);
    let identified = run("identify", &night);
    assert_eq!(identified.matches("centre [").count(), 6, "{identified}");
    let calibrated = run("calibrate", &night);
    assert!(calibrated.contains("f = 1") && calibrated.contains(" ± "), "{calibrated}");
    let diagnosed = run("diagnose", &night);
    assert!(diagnosed.contains("positions"), "{diagnosed}");
    // Not by any input: a file that is none is refused.
    let nothing = Command::new(example("identify")).arg(folder.path().join("none.fits")).output().unwrap();
    assert!(!nothing.status.success() && nothing.stdout.is_empty());
}
