//! One process for all frames: a line of JSON in for each frame, a line out for its answer. The time between them is the latency.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use serde_json::json;

use super::super::answers::{AnswerStatus, TrackerAnswer, read_stream_line};
use super::super::error::SuiteError;
use super::super::frames::HandedFrame;
use super::super::suite_file::SystemTable;
use super::filled::{Places, command};
use super::handover::Handover;
use super::observed::ObservedAnswer;
use super::process::{LastWords, in_own_group, kill, peak_mib, words_of};

/// A process with its streams.
struct Running {
    child: Child,
    stdin: ChildStdin,
    lines: Receiver<String>,
    words: LastWords,
}

impl Drop for Running {
    fn drop(&mut self) {
        kill(&mut self.child);
    }
}

/// The program, started when the first frame comes, and again after it ended.
pub(super) struct StreamSystem {
    table: SystemTable,
    running: Option<Running>,
    is_warm: bool,
}

impl StreamSystem {
    pub(super) fn new(table: &SystemTable) -> Self {
        Self { table: table.clone(), running: None, is_warm: false }
    }

    fn start(&self) -> Result<Running, SuiteError> {
        let program = self.table.command.first().cloned().unwrap_or_default();
        let wrong = |source| SuiteError::Start { program: program.clone(), source };
        let mut command = command(&self.table.command, &Places::default());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        in_own_group(&mut command);
        let mut child = command.spawn().map_err(wrong)?;
        let closed = || wrong(std::io::Error::other("a stream is closed"));
        let stdin = child.stdin.take().ok_or_else(closed)?;
        let stdout = child.stdout.take().ok_or_else(closed)?;
        let words = LastWords::of(child.stderr.take().ok_or_else(closed)?);
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines() {
                let Ok(line) = line else { break };
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        Ok(Running { child, stdin, lines, words })
    }

    /// Hands frames over one after the other.
    pub(super) fn answers(&mut self, handover: &Handover<'_>, frames: &[HandedFrame]) -> Result<Vec<ObservedAnswer>, SuiteError> {
        if !self.is_warm {
            self.is_warm = true;
            for frame in frames.iter().cycle().take(if frames.is_empty() { 0 } else { self.table.warm_up }) {
                self.one(handover, frame)?;
            }
        }
        frames.iter().map(|frame| self.one(handover, frame)).collect()
    }

    fn one(&mut self, handover: &Handover<'_>, frame: &HandedFrame) -> Result<ObservedAnswer, SuiteError> {
        let folder = handover.folder.path();
        let image = handover.write_image(folder, frame)?;
        let truth = handover.write_truth(folder, frame)?;
        let [width_px, height_px] = handover.size_px;
        let mut line = json!({
            "frame": frame.number, "image": image, "width_px": width_px, "height_px": height_px,
            "time_utc": frame.truth.time.map(|time| time.to_isoformat() + "Z"), "exposure_s": frame.truth.exposure_s,
        });
        if let (Some(table), Some(truth)) = (line.as_object_mut(), &truth) {
            table.insert("truth".to_owned(), json!(truth));
        }
        let observed = self.asked(frame.number, &format!("{line}\n"));
        let _ = std::fs::remove_file(&image);
        if let Some(truth) = truth {
            let _ = std::fs::remove_file(truth);
        }
        observed
    }

    fn asked(&mut self, number: usize, line: &str) -> Result<ObservedAnswer, SuiteError> {
        if self.running.is_none() {
            self.running = Some(self.start()?);
        }
        let Some(running) = &mut self.running else { return Ok(ObservedAnswer::default()) };
        // What an earlier frame still says is no answer to this one.
        while running.lines.try_recv().is_ok() {}
        let begin = Instant::now();
        let sent = running.stdin.write_all(line.as_bytes()).and_then(|()| running.stdin.flush());
        let limit = Duration::from_secs_f64(self.table.timeout_s);
        let got = if sent.is_ok() { running.lines.recv_timeout(limit) } else { Err(RecvTimeoutError::Disconnected) };
        let seconds = begin.elapsed().as_secs_f64();
        let peak = peak_mib(&running.child);
        let answer = match got {
            Ok(line) => {
                let answer = read_stream_line(&line).of_frame(number);
                return Ok(ObservedAnswer { answer, latency_s: Some(seconds), peak_mib: peak });
            }
            Err(RecvTimeoutError::Timeout) => TrackerAnswer::without(AnswerStatus::TimedOut, running.words.line()),
            Err(RecvTimeoutError::Disconnected) => {
                let how = running.child.wait().map_or_else(|error| error.to_string(), words_of);
                running.words.settle();
                let words = running.words.line().map_or_else(String::new, |words| format!(": {words}"));
                TrackerAnswer::without(AnswerStatus::Crashed, Some(format!("{how}{words}")))
            }
        };
        // The next frame finds a program that was started anew.
        self.running = None;
        Ok(ObservedAnswer { answer, latency_s: Some(seconds), peak_mib: peak })
    }
}
