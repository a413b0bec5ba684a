//! `boresight test`: verdicts that keep what they claim, faults that are named, ways to a program under test.

mod planted;
mod statistics;
mod ways;

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::cli::{Ran, run, text};

/// The tracker that reads the truth and answers with a fault, as `cargo test` has built it beside the tests.
pub(super) fn planted_tracker() -> PathBuf {
    let own = std::env::current_exe().expect("a test knows its file");
    let profile = own.parent().and_then(Path::parent).expect("target/<profile>/deps");
    profile.join("examples").join(format!("planted_tracker{}", std::env::consts::EXE_SUFFIX))
}

/// A small camera in orbit about the Earth's own place: with a time, so that there is aberration.
pub(super) const SCENE: &str = "format = \"boresight-scene/1\"\n[camera]\nwidth_px = 256\nheight_px = 200\nfocal_length_px = 500.0\n\
                                [sky]\nfaintest_magnitude = 6.5\n\
                                [[frames]]\nexposure_s = 0.5\ntime_utc = \"2026-03-01T20:00:00Z\"\n";

/// A folder with the scene and a suite of these tables.
pub(super) fn folder(suite: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    std::fs::write(folder.path().join("suite.toml"), suite).unwrap();
    folder
}

/// A suite of a scene that lies beside it as scene.toml, for the tests of all verbs.
pub(crate) const SUITE: &str = "format = \"boresight-suite/1\"\n[[case]]\nname = \"all sky\"\nscene = \"scene.toml\"\nframes = 12\nattitudes = \"uniform\"\nwithin_arcsec = 900\n\
                                sweep = { path = \"detector.read_noise_e\", values = [5.0, 6.0], name = \"noise\" }\n\
                                [[case.require]]\nmetric = \"acquisition.correct_rate\"\nat_least = 0.7\nwhen = \"noise <= 6\"\n\
                                [[case.require]]\nmetric = \"attitude.cross_boresight_arcsec.rms\"\nat_most = 1e-6\nlevel = \"stretch\"\n";

/// Writes [`SUITE`] into a folder.
pub(crate) fn suite_in(folder: &Path) {
    std::fs::write(folder.join("suite.toml"), SUITE).unwrap();
}

/// Runs the suite of a folder; its JSON.
pub(super) fn tested(folder: &Path, more: &[&str]) -> (Ran, Value) {
    let suite = folder.join("suite.toml");
    let mut args = vec!["test", text(&suite), "--json", "--quiet"];
    args.extend(more);
    let run = run(&args);
    let value = serde_json::from_str(&run.stdout).unwrap_or(Value::Null);
    (run, value)
}
