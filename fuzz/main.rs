//! Damaged inputs over all readers, by a seed: `make fuzz`. Nothing may panic, hang, take all memory or be left half-written.
//!
//! Each reader's cases run in processes of their own, of a batch each, with limits on processor time and address space. `--zoo FILE` writes
//! the table of the zoo instead.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a command")]
#![allow(clippy::expect_used, missing_docs, reason = "a tool of the tests")]

mod damage;
mod numbers;
mod readers;
mod zoo;

use std::fmt::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use boresight::provenance::Provenance;
use clap::Parser;
use damage::{Chance, damaged};
use numbers::other_numbers;
use readers::Reader;
use rustix::time::{ClockId, clock_gettime};

/// Inputs that show a fault are kept here.
const KEPT: &str = "target/fuzz";
/// Cases of one process.
const BATCH: usize = 100;
/// The same where each renders.
const RENDERED_BATCH: usize = 5;
/// Processor time of one case that counts as a hang, s.
const HANG_S: f64 = 20.0;
/// Processor time of a process, s; a batch takes a few seconds, one that renders a minute.
const PROCESS_S: usize = 120;
/// Address space of a process.
const MEMORY_KIB: usize = 2 << 20;

#[derive(Parser)]
struct Arguments {
    /// Damaged inputs, shared evenly among the readers.
    #[arg(long, default_value_t = 21_000)]
    cases: usize,
    /// Seed of the damage.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Also runs whole verbs of this program on damaged inputs.
    #[arg(long)]
    boresight: Option<PathBuf>,
    /// Runs of whole verbs.
    #[arg(long, default_value_t = 280)]
    runs: usize,
    /// Writes the table here too.
    #[arg(long)]
    page: Option<PathBuf>,
    /// The revision that is tried, for the page.
    #[arg(long, default_value = "unknown")]
    commit: String,
    /// Writes the table of the zoo here, and nothing else.
    #[arg(long)]
    zoo: Option<PathBuf>,
    /// Within: reader, first case, end.
    #[arg(long, num_args = 3, hide = true)]
    worker: Vec<usize>,
}

/// What came of the cases of one reader.
#[derive(Clone, Debug, Default)]
struct Tally {
    cases: usize,
    read: usize,
    refused: usize,
    /// Refused through the guard: the decoder itself would have panicked.
    guarded: usize,
    faults: Vec<String>,
    most_s: f64,
}

fn seed_of(seed: u64, reader: usize, case: usize) -> u64 {
    seed.wrapping_mul(0x1_0000_0001).wrapping_add((reader as u64) << 40).wrapping_add(case as u64)
}

fn processor_s() -> f64 {
    let now = clock_gettime(ClockId::ProcessCPUTime); // of all threads
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// Runs cases and prints a line for each: number, outcome, seconds.
fn work(reader_index: usize, from: usize, to: usize, seed: u64) -> Result<()> {
    let reader = *Reader::ALL.get(reader_index).context("no such reader")?;
    let seeds = reader.seeds();
    ensure!(!seeds.is_empty() && seeds.iter().all(|(_, bytes)| !bytes.is_empty()), "{}: there is no good input", reader.name());
    for case in from..to {
        let folder = tempfile::tempdir()?;
        let chance = &mut Chance::new(seed_of(seed, reader_index, case));
        let input = if reader == Reader::Rendered { other_numbers(&seeds, chance) } else { damaged(&seeds, chance) };
        println!("{case} begun");
        // A case that ends the process is there to be looked at too.
        let kept = Path::new(KEPT).join(format!("{reader_index}-{case}-{}", input.0));
        std::fs::create_dir_all(KEPT)?;
        std::fs::write(&kept, &input.1)?;
        let start = processor_s();
        let outcome = catch_unwind(AssertUnwindSafe(|| reader.read(folder.path(), &input)));
        let seconds = processor_s() - start;
        let word = match outcome {
            Err(_) => "FAULT: a panic".to_owned(),
            Ok(_) if seconds > HANG_S => format!("FAULT: {seconds:.0} s"),
            Ok(Ok(())) => "read".to_owned(),
            Ok(Err(sentence)) => {
                eprintln!("{case}: {sentence}"); // for whoever runs one batch by hand
                judged(&sentence)
            }
        };
        println!("{case} {seconds:.3} {word}");
        if !word.starts_with("FAULT") {
            std::fs::remove_file(&kept)?;
        }
    }
    Ok(())
}

/// Whether a sentence is one, and in our words.
fn judged(sentence: &str) -> String {
    const NOT_OURS: [&str; 8] = ["Unknown(", "ChunkType", "Integer(", "Utf8Error", "ParseIntError", "panicked", "Some(", "Err("];
    if sentence.starts_with("FAULT") {
        return sentence.to_owned();
    }
    if sentence.trim().is_empty() || sentence.contains('\n') {
        return format!("FAULT: not one sentence: {}", sentence.replace('\n', "\\n"));
    }
    match NOT_OURS.iter().find(|words| sentence.contains(**words)) {
        Some(words) => format!("FAULT: a library's words ({words}): {sentence}"),
        None if sentence.contains("the decoder was not written for") => "guarded".to_owned(),
        None => "refused".to_owned(),
    }
}

/// A command with limits on processor time and memory.
fn limited(program: &Path, args: &[String]) -> Command {
    let mut command = Command::new("sh");
    let script = format!("ulimit -t {PROCESS_S}; ulimit -v {MEMORY_KIB}; exec \"$@\"");
    command.args(["-c", &script, "sh"]).arg(program).args(args).stdin(Stdio::null());
    command
}

fn fuzz(reader_index: usize, cases: usize, seed: u64) -> Result<Tally> {
    let mut tally = Tally { cases, ..Tally::default() };
    let own = std::env::current_exe()?;
    // What renders takes seconds a case: the limit is that of a process, and must be reached by hangs alone.
    let batch = if Reader::ALL.get(reader_index) == Some(&Reader::Rendered) { RENDERED_BATCH } else { BATCH };
    for from in (0..cases).step_by(batch) {
        let to = (from + batch).min(cases);
        let numbers = [reader_index, from, to].map(|number| number.to_string());
        let args = [&["--seed".to_owned(), seed.to_string(), "--worker".to_owned()][..], &numbers].concat();
        let output = limited(&own, &args).stderr(Stdio::null()).output()?;
        let text = String::from_utf8_lossy(&output.stdout);
        for line in text.lines().filter(|line| !line.ends_with("begun")) {
            let mut parts = line.splitn(3, ' ');
            let (case, seconds, word) = (parts.next().unwrap_or(""), parts.next().unwrap_or(""), parts.next().unwrap_or(""));
            tally.most_s = tally.most_s.max(seconds.parse().unwrap_or(0.0));
            match word {
                "read" => tally.read += 1,
                "refused" => tally.refused += 1,
                "guarded" => tally.guarded += 1,
                fault => tally.faults.push(format!("case {case}: {fault}")),
            }
        }
        if !output.status.success() {
            let last = text.lines().last().unwrap_or("before the first case");
            tally.faults.push(format!("the process ended by {} ({last})", output.status));
        }
    }
    Ok(tally)
}

/// Whole verbs on damaged inputs: exit codes 0 to 3, nothing half-written, within the limits.
fn verbs(program: &Path, runs: usize, seed: u64) -> Result<Tally> {
    let mut tally = Tally { cases: runs, ..Tally::default() };
    for run in 0..runs {
        let reader_index = run % Reader::ALL.len();
        let reader = Reader::ALL[reader_index];
        let folder = tempfile::tempdir()?;
        let input = damaged(&reader.seeds(), &mut Chance::new(seed_of(seed ^ 0xFF, reader_index, run)));
        let _ = reader.read(folder.path(), &input); // the files that belong beside it
        let path = folder.path().join(&input.0).display().to_string();
        let out = folder.path().join("out");
        let words: Vec<String> = match reader {
            Reader::Calibration => vec!["map", &path, "--json"],
            Reader::Manifest | Reader::StarList => vec!["identify", folder.path().to_str().context("a path of UTF-8")?, "--json"],
            Reader::Cameras => vec!["import", &path],
            Reader::Catalogue => vec!["catalog", "import", &path, "--help"],
            Reader::Scene | Reader::Rendered => vec!["simulate", &path, "--backend", "cpu"],
            Reader::Options => vec!["calibrate", folder.path().to_str().context("a path of UTF-8")?, "--options", &path],
            _ => vec!["detect", &path, "--centroid", "windowed"],
        }
        .into_iter()
        .map(str::to_owned)
        .collect();
        let writes = !matches!(reader, Reader::Calibration | Reader::Catalogue);
        let more = if writes { vec!["-o".to_owned(), out.display().to_string()] } else { Vec::new() };
        let output = limited(program, &[words, more, vec!["--threads".to_owned(), "1".to_owned()]].concat()).output()?;
        let stderr = String::from_utf8_lossy(&output.stderr);
        let left: Vec<PathBuf> = std::fs::read_dir(folder.path())?.flatten().map(|entry| entry.path()).collect();
        let partial = left.iter().any(|path| path.display().to_string().contains(".partial"));
        match output.status.code() {
            _ if stderr.contains("panicked") => tally.faults.push(format!("{} {run}: a panic: {stderr}", reader.name())),
            _ if partial => tally.faults.push(format!("{} {run}: something half-written is left", reader.name())),
            Some(0 | 3) => tally.read += 1,
            Some(1 | 2) => tally.refused += 1,
            _ => tally.faults.push(format!("{} {run}: ended by {}", reader.name(), output.status)),
        }
    }
    Ok(tally)
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    if let Some(path) = &arguments.zoo {
        return std::fs::write(path, zoo_table()).with_context(|| path.display().to_string());
    }
    if let &[reader, from, to] = arguments.worker.as_slice() {
        return work(reader, from, to, arguments.seed);
    }
    let each = arguments.cases.div_ceil(Reader::ALL.len());
    let mut table =
        format!("{:<27}{:>8}{:>8}{:>9}{:>9}{:>8}{:>10}\n", "reader", "inputs", "read", "refused", "guarded", "faults", "most s");
    let mut row = |name: &str, tally: &Tally| {
        let Tally { cases, read, refused, guarded, faults, most_s } = tally;
        let line = format!("{name:<27}{cases:>8}{read:>8}{refused:>9}{guarded:>9}{:>8}{most_s:>10.2}\n", faults.len());
        print!("{line}");
        table.push_str(&line);
    };
    let mut all = Tally::default();
    let mut join = |tally: &Tally| {
        all.cases += tally.cases;
        all.read += tally.read;
        all.refused += tally.refused;
        all.guarded += tally.guarded;
        all.faults.extend(tally.faults.iter().cloned());
        all.most_s = all.most_s.max(tally.most_s);
    };
    for (index, reader) in Reader::ALL.iter().enumerate() {
        let tally = fuzz(index, each, arguments.seed)?;
        row(reader.name(), &tally);
        join(&tally);
    }
    if let Some(program) = &arguments.boresight {
        let tally = verbs(program, arguments.runs, arguments.seed)?;
        row("whole verbs", &tally);
        join(&tally);
    }
    row("all", &all);
    for fault in &all.faults {
        println!("{fault}");
    }
    if let Some(path) = &arguments.page {
        let mut page = format!(
            "Damaged inputs over all readers: `make fuzz FUZZ=\"--cases {} --seed {}\"`, version {}, commit {}.\n\n",
            arguments.cases,
            arguments.seed,
            Provenance::new(Vec::new()).version,
            arguments.commit
        );
        let _ = write!(
            page,
            "read: the damage does no harm. refused: one sentence in our words. guarded: refused too, where the decoder of another crate panicked.\n\
             faults: a panic, more than {HANG_S:.0} s of processor time, more than {} MiB of address space, a library's words, something half-written.\n\
             most s: the longest case, processor time. Cases of a reader are a function of the seed alone.\n\n{table}",
            MEMORY_KIB >> 10
        );
        for fault in &all.faults {
            let _ = writeln!(page, "{fault}");
        }
        boresight::recording::write_file(path, page.as_bytes())?;
    }
    if !all.faults.is_empty() {
        bail!("{} faults", all.faults.len());
    }
    Ok(())
}

/// A line for every file of the zoo.
fn zoo_table() -> String {
    let folder = tempfile::tempdir().expect("a folder for scratch files");
    zoo::zoo().iter().map(|file| zoo::line(folder.path(), file) + "\n").collect()
}
