//! `make test` must not call a run good in which tests were left out: its script, run with a cargo that only pretends.
#![cfg(unix)]

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use crate::house::root;

/// Runs the script behind `make test` with a cargo that logs these lines, prints this result and ends with this code; gives back
/// whether the script calls it good, and its last line.
fn summarised(log: &[&str], result: &str, code: u8, variables: &[(&str, &Path)]) -> (bool, String) {
    let folder = tempfile::tempdir().unwrap();
    let cargo = folder.path().join("cargo");
    let lines = log.join("\n");
    std::fs::write(&cargo, format!("#!/bin/sh\necho '{lines}' >>\"$BORESIGHT_TEST_LOG\"\necho '{result}'\nexit {code}\n")).unwrap();
    std::fs::set_permissions(&cargo, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap());
    let mut command = Command::new("bash");
    command.arg(root().join(".ci/test")).env("PATH", path).env_remove("CI").env_remove("BORESIGHT_RECORDINGS");
    let output = command.envs(variables.iter().copied()).output().expect("bash runs");
    let text = String::from_utf8(output.stdout).unwrap();
    (output.status.success(), text.lines().last().unwrap_or_default().to_owned())
}

const GOOD: &str = "test result: ok. 7 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.00s";
const BAD: &str = "test result: FAILED. 6 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out; finished in 0.00s";
const GPU: &str = "gpu-test twins::all llvmpipe (LLVM 15.0.6, 256 bits)";
const RAN: &str = "recording-test identify::all ran";
const SKIPPED: &str = "recording-test calibrate::all skipped";

#[test]
fn a_good_run_is_good() {
    let (ci, recordings) = (("CI", Path::new("true")), ("BORESIGHT_RECORDINGS", Path::new("recordings")));
    assert_eq!(summarised(&[GPU, RAN], GOOD, 0, &[ci, recordings]), (true, "7 passed, 0 failed".to_owned()));
    assert!(summarised(&[GPU, SKIPPED], GOOD, 0, &[ci]).0, "recordings that nobody asked for may be skipped");
    assert!(summarised(&[], GOOD, 0, &[]).0);
}

#[test]
fn a_run_with_something_left_out_is_not() {
    let (ci, recordings) = (("CI", Path::new("true")), ("BORESIGHT_RECORDINGS", Path::new("recordings")));
    assert!(!summarised(&[RAN], GOOD, 0, &[ci]).0, "no GPU test");
    assert!(!summarised(&[GPU, RAN, SKIPPED], GOOD, 0, &[recordings]).0, "a recording test skipped");
    assert!(!summarised(&[GPU], GOOD, 0, &[recordings]).0, "no recording test");
    assert!(!summarised(&[GPU], "nothing", 0, &[]).0, "no test at all");
    assert!(!summarised(&[GPU], GOOD, 101, &[]).0, "cargo failed");
    assert_eq!(summarised(&[GPU], BAD, 101, &[]), (false, "6 passed, 1 failed".to_owned()));
}
