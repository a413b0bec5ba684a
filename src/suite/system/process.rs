//! A child process: its end, its time, its memory, and what it said last on stderr.

use std::collections::VecDeque;
use std::io::Read;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How a process ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ProcessEnd {
    /// By itself, with success.
    Done,
    /// By itself, and not with success: in words.
    Failed(String),
    /// It was ended because it took too long.
    TimedOut,
}

/// The last words on stderr, kept by a thread.
#[derive(Debug)]
pub(super) struct LastWords {
    kept: Arc<Mutex<VecDeque<u8>>>,
    reader: Option<JoinHandle<()>>,
}

impl LastWords {
    const MAX_BYTES: usize = 4096;

    pub(super) fn of(mut stream: impl Read + Send + 'static) -> Self {
        let kept = Arc::new(Mutex::new(VecDeque::new()));
        let own = Arc::clone(&kept);
        let reader = std::thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(count) = stream.read(&mut piece) {
                if count == 0 {
                    break;
                }
                let mut kept = own.lock().unwrap_or_else(PoisonError::into_inner);
                kept.extend(&piece[..count]);
                let over = kept.len().saturating_sub(Self::MAX_BYTES);
                kept.drain(..over);
            }
        });
        Self { kept, reader: Some(reader) }
    }

    /// The last line that says something.
    pub(super) fn line(&self) -> Option<String> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes: Vec<u8> = kept.iter().copied().collect();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        text.lines().rev().map(str::trim).find(|line| !line.is_empty()).map(|line| line.chars().take(300).collect())
    }

    /// Waits a little until all was read: a grandchild may hold the stream open.
    pub(super) fn settle(&mut self) {
        let begin = Instant::now();
        while self.reader.as_ref().is_some_and(|reader| !reader.is_finished()) && begin.elapsed() < Duration::from_millis(100) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.reader = None;
    }
}

/// Makes the process the first of a group of its own, so that it ends with all that it started.
pub(super) fn in_own_group(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(not(unix))]
    let _ = command;
}

/// Ends a process with its group.
pub(super) fn kill(child: &mut Child) {
    #[cfg(unix)]
    if let Some(group) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
        // What has ended already is no fault.
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
    let _ = child.kill();
    let _ = child.wait();
}

/// Peak resident memory so far, MiB, where the system tells it.
pub(super) fn peak_mib(child: &Child) -> Option<f64> {
    let text = std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok().map(|kib| kib / 1024.0)
}

/// How a process ended, in words.
pub(super) fn words_of(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        let name = match signal {
            4 => " (illegal instruction)",
            6 => " (abort)",
            8 => " (arithmetic fault)",
            9 => " (killed)",
            11 => " (segmentation fault)",
            _ => "",
        };
        return format!("ended by signal {signal}{name}");
    }
    status.code().map_or_else(|| "ended without an exit code".to_owned(), |code| format!("ended with exit code {code}"))
}

/// What a run of a program to its end showed.
#[derive(Debug)]
pub(super) struct ProcessRun {
    pub(super) end: ProcessEnd,
    pub(super) seconds: f64,
    pub(super) peak_mib: Option<f64>,
    pub(super) last_words: Option<String>,
}

/// Runs a program to its end, or to the limit.
pub(super) fn run(mut command: Command, limit: Duration) -> std::io::Result<ProcessRun> {
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    in_own_group(&mut command);
    let begin = Instant::now();
    let mut child = command.spawn()?;
    let mut words = child.stderr.take().map(LastWords::of);
    let mut peak = None;
    let mut nap = Duration::from_micros(200);
    let end = loop {
        if let Some(status) = child.try_wait()? {
            break if status.success() { ProcessEnd::Done } else { ProcessEnd::Failed(words_of(status)) };
        }
        if begin.elapsed() > limit {
            kill(&mut child);
            break ProcessEnd::TimedOut;
        }
        peak = peak_mib(&child).or(peak);
        std::thread::sleep(nap);
        nap = (nap * 2).min(Duration::from_millis(2));
    };
    let seconds = begin.elapsed().as_secs_f64();
    if let Some(words) = &mut words {
        words.settle();
    }
    Ok(ProcessRun { end, seconds, peak_mib: peak, last_words: words.and_then(|words| words.line()) })
}
