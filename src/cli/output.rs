//! Output: stdout, stderr and files.

use std::io::{IsTerminal, Write};
use std::path::Path;

use anyhow::{Context, Result};
use boresight::provenance::Provenance;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

/// Starts the log on stderr.
pub(crate) fn set_up_log(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::WARN,
        (false, 1) => LevelFilter::INFO,
        (false, _) => LevelFilter::DEBUG,
    };
    // wgpu and its kin log for their own developers; RUST_LOG brings that back for those who want it.
    let asked = std::env::var("RUST_LOG").ok().and_then(|text| text.parse::<Targets>().ok());
    let filter = asked.unwrap_or_else(|| Targets::new().with_default(LevelFilter::ERROR).with_target("boresight", level));
    let has_colour = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(has_colour).event_format(Plain);
    tracing_subscriber::registry().with(lines.with_filter(filter)).init();
}

/// A line of the log: what kind it is, then what it says. Errors, warnings and notes begin alike wherever they come from.
struct Plain;

impl<S, N> FormatEvent<S, N> for Plain
where
    S: tracing::Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(&self, context: &FmtContext<'_, S, N>, mut writer: Writer<'_>, event: &tracing::Event<'_>) -> std::fmt::Result {
        let (word, colour) = match *event.metadata().level() {
            tracing::Level::ERROR => ("error", "1;31"),
            tracing::Level::WARN => ("warning", "1;33"),
            tracing::Level::INFO => ("note", "1;36"),
            tracing::Level::DEBUG => ("detail", "2"),
            tracing::Level::TRACE => ("trace", "2"),
        };
        if writer.has_ansi_escapes() {
            write!(writer, "\x1b[{colour}m{word}:\x1b[0m ")?;
        } else {
            write!(writer, "{word}: ")?;
        }
        context.format_fields(writer.by_ref(), event)?;
        writeln!(writer)
    }
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
    eprintln!("error: {text}");
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

/// Prints text for people: on a terminal, lines that are wider than it are broken between words. Files and pipes get them as they are.
pub(crate) fn print_page(text: &str) -> Result<()> {
    /// Narrower terminals are not set in.
    const NARROWEST: usize = 40;
    let width = terminal_size::terminal_size_of(std::io::stdout()).map(|(width, _)| usize::from(width.0).max(NARROWEST));
    match width {
        None => print(text),
        Some(width) => print(&text.split_inclusive('\n').map(|line| folded(line, width)).collect::<String>()),
    }
}

/// A line broken between words so that it fits. What is behind the break stands under the beginning of the cell that is broken: cells of a table are
/// two blanks apart, or more.
fn folded(line: &str, width: usize) -> String {
    let letters: Vec<char> = line.trim_end_matches('\n').chars().collect();
    if letters.len() <= width {
        return line.to_owned();
    }
    let is_start = |at: &usize| *at >= 2 && letters[*at] != ' ' && letters[*at - 1] == ' ' && letters[*at - 2] == ' ';
    let of_line = letters.iter().take_while(|letter| **letter == ' ').count();
    let indent = (0..letters.len().min(2 * width / 3)).rfind(is_start).unwrap_or(of_line).min(width / 2);
    let (mut text, mut from) = (String::new(), 0);
    while letters.len() - from + if from == 0 { 0 } else { indent } > width {
        let room = if from == 0 { width } else { width - indent };
        let least = if from == 0 { indent } else { 0 };
        let cut = (from + least + 1..=from + room).rev().find(|at| letters[*at] == ' ').unwrap_or(from + room);
        text.extend(&letters[from..cut]);
        text.push('\n');
        text.push_str(&" ".repeat(indent));
        from = (cut..letters.len()).find(|at| letters[*at] != ' ').unwrap_or(letters.len());
    }
    text.extend(&letters[from..]);
    text.push('\n');
    text
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
        let path = directory.join(format!("{verb}.json"));
        boresight::recording::write_file(&path, json_text(object)?.as_bytes())?;
    }
    if json { print_json(object) } else { print_page(&text()) }
}

/// How long something takes, for the log.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock(std::time::Instant);

impl Clock {
    pub(crate) fn new() -> Self {
        Self(std::time::Instant::now())
    }
}

impl std::fmt::Display for Clock {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.2} s", self.0.elapsed().as_secs_f64())
    }
}

/// A list of effects in words.
pub(crate) fn listed(ids: &[impl AsRef<str>]) -> String {
    if ids.is_empty() { "none".to_owned() } else { ids.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(", ") }
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

#[cfg(test)]
mod tests {
    use super::folded;

    #[test]
    fn lines_are_broken_between_words_and_stand_under_their_cell() {
        assert_eq!(folded("short\n", 40), "short\n");
        let words = "one two three four five six seven eight nine ten\n";
        assert_eq!(folded(words, 20), "one two three four\nfive six seven eight\nnine ten\n");
        assert_eq!(folded("name  acts   alpha, beta, gamma\n", 22), "name  acts   alpha,\n           beta, gamma\n");
        for width in 20..60 {
            let text = folded(words, width) + &folded("id   a long second cell of the table with many words\n", width);
            assert!(text.lines().all(|line| line.chars().count() <= width), "{width}: {text}");
            assert_eq!(text.split_whitespace().count(), 21);
        }
    }
}
