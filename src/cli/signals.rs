//! Signals: an interrupted program leaves nothing half-written.

use anyhow::{Context, Result};
use boresight::recording::abandon;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

/// Waits for the signals that end a program on a thread of its own. The exit code is 128 and the signal's number, as a shell has it.
pub(crate) fn watch() -> Result<()> {
    // Whoever started the program with a signal ignored (`nohup`, a job of a script) wants it ignored.
    let wanted = [SIGHUP, SIGINT, SIGTERM].into_iter().filter(|signal| !is_ignored(*signal));
    let mut signals = Signals::new(wanted).context("listening for signals")?;
    let wait = move || {
        let Some(signal) = signals.forever().next() else { return };
        abandon();
        let name = match signal {
            SIGHUP => "SIGHUP",
            SIGINT => "SIGINT",
            _ => "SIGTERM",
        };
        super::output::say_error(&anyhow::anyhow!("stopped by {name}; what was not finished is removed"));
        // At once: other threads are still at work, and what ends a process in order would wait for them.
        signal_hook::low_level::exit(128 + signal);
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(wait).context("listening for signals")?;
    Ok(())
}

/// Whether this process was started with a signal ignored, where the system tells it.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
