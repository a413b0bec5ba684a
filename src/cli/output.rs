//! What goes to stdout, to stderr and into files.

use std::io::{IsTerminal, Write};
use std::path::Path;

use anyhow::{Context, Result};
use boresight::provenance::Provenance;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use tracing_subscriber::filter::LevelFilter;

/// Starts the log on stderr.
pub(crate) fn set_up_log(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::WARN,
        (false, 1) => LevelFilter::INFO,
        (false, _) => LevelFilter::DEBUG,
    };
    // wgpu and its kin log for their own developers; RUST_LOG brings that back for those who want it.
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(format!("error,boresight={level}")));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .without_time()
        .with_target(false)
        .init();
}

/// Prints an error with its causes as one line on stderr.
#[allow(clippy::print_stderr, reason = "the one place where errors are printed")]
pub(crate) fn say_error(error: &anyhow::Error) {
    let mut text = String::new();
    for cause in error.chain().map(|cause| cause.to_string().replace('\n', " ")) {
        // Many messages end with their cause already.
        if !text.contains(&cause) {
            text += if text.is_empty() { "" } else { ": " };
            text += &cause;
        }
    }
    eprintln!("boresight: {text}");
}

/// Whether an error only means that the reader of stdout has gone.
pub(crate) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().filter_map(|cause| cause.downcast_ref::<std::io::Error>()).any(|cause| cause.kind() == std::io::ErrorKind::BrokenPipe)
}

/// Prints a result on stdout.
pub(crate) fn print(text: &str) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    stdout.write_all(text.as_bytes()).context("writing to stdout")?;
    stdout.flush().context("writing to stdout")?;
    Ok(())
}

/// Prints a result as JSON on stdout, piece by piece: that of many frames is larger than what it was made of.
fn print_json<T: Serialize>(value: &T) -> Result<()> {
    let mut stdout = std::io::BufWriter::with_capacity(1 << 16, std::io::stdout().lock());
    serde_json::to_writer_pretty(&mut stdout, value).map_err(std::io::Error::from).context("writing to stdout")?;
    stdout.write_all(b"\n").context("writing to stdout")?;
    stdout.flush().context("writing to stdout")
}

/// A result as JSON text.
pub(crate) fn json_text<T: Serialize>(value: &T) -> Result<String> {
    Ok(serde_json::to_string_pretty(value).context("writing the result as JSON")? + "\n")
}

/// The object as JSON on stdout if asked for, else the text for people; and the object as DIR/<verb>.json.
pub(crate) fn deliver<T: Serialize>(
    verb: &str,
    object: &T,
    json: bool,
    directory: Option<&Path>,
    text: impl FnOnce() -> String,
) -> Result<()> {
    if let Some(directory) = directory {
        std::fs::create_dir_all(directory).with_context(|| format!("creating {}", directory.display()))?;
        let path = directory.join(format!("{verb}.json"));
        boresight::recording::write_file(&path, json_text(object)?.as_bytes())?;
    }
    if json { print_json(object) } else { print(&text()) }
}

/// A progress bar on stderr; nothing where stderr is no terminal or the log is off.
pub(crate) fn progress(what: &'static str, count: usize) -> ProgressBar {
    let bar = if tracing::enabled!(tracing::Level::WARN) { ProgressBar::new(count as u64) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("{msg:>12} [{bar:30}] {pos}/{len} {eta}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(what);
    bar
}

/// A bar for work in a few steps of different length, each of which says what it does.
pub(crate) fn steps(count: usize) -> ProgressBar {
    let bar = if tracing::enabled!(tracing::Level::WARN) { ProgressBar::new(count as u64) } else { ProgressBar::hidden() };
    if let Ok(style) = ProgressStyle::with_template("  diagnosing [{bar:20}] {pos}/{len} {elapsed} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    bar
}

/// What a result of this command says of its own making; inputs, seed and adapter are added by the verb.
pub(crate) fn provenance() -> Provenance {
    Provenance::of_process()
}
