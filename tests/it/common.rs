//! What several tests share.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

/// The folder of real recordings from BORESIGHT_RECORDINGS; `None`, reported by name, where the variable is not set.
///
/// With BORESIGHT_TEST_LOG=FILE a line `recording-test NAME ran|skipped` is added to that file.
///
/// # Panics
/// If the variable names no folder: a test that was asked for must not be left out unseen.
pub(crate) fn recordings_dir(test: &str) -> Option<PathBuf> {
    let directory = std::env::var_os("BORESIGHT_RECORDINGS").filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(directory) = &directory {
        assert!(directory.is_dir(), "BORESIGHT_RECORDINGS names {}, which is no folder", directory.display());
    } else {
        println!("skipped: {test} (BORESIGHT_RECORDINGS is not set)");
    }
    log(&format!("recording-test {test} {}", if directory.is_some() { "ran" } else { "skipped" }));
    directory
}

/// Adds a line to the file that BORESIGHT_TEST_LOG names, if it names one.
pub(crate) fn log(line: &str) {
    let Some(path) = std::env::var_os("BORESIGHT_TEST_LOG").filter(|value| !value.is_empty()) else {
        return;
    };
    let mut file = OpenOptions::new().create(true).append(true).open(&path).expect("BORESIGHT_TEST_LOG names a file that can be written");
    file.write_all(format!("{line}\n").as_bytes()).expect("BORESIGHT_TEST_LOG can be written");
}

/// Says that a test ran on the GPU: call it after the work on the adapter is done.
#[allow(dead_code, reason = "called by the tests of the renderer")]
pub(crate) fn log_gpu_test(test: &str, adapter: &str) {
    log(&format!("gpu-test {test} {adapter}"));
}

/// What proptest found once it tries first ever after: the cases stand beside the test, in FILE.regressions.
pub(crate) fn regressions() -> Box<dyn proptest::test_runner::FailurePersistence> {
    Box::new(proptest::test_runner::FileFailurePersistence::WithSource("regressions"))
}
