//! A process for each frame.

use std::path::Path;
use std::time::Duration;

use super::super::answers::{AnswerStatus, TrackerAnswer, camera_of, centroids_of, read_answers};
use super::super::error::SuiteError;
use super::super::frames::HandedFrame;
use super::super::suite_file::SystemTable;
use super::filled::{Places, command};
use super::handover::Handover;
use super::observed::ObservedAnswer;
use super::process::{ProcessEnd, run};
use crate::parallel;

/// Hands frames over, each to a process of its own.
pub(super) fn answers(table: &SystemTable, handover: &Handover<'_>, frames: &[HandedFrame]) -> Result<Vec<ObservedAnswer>, SuiteError> {
    if table.workers == 1 {
        return frames.iter().map(|frame| one(table, handover, frame)).collect();
    }
    // Processes wait on each other's account: a pool of its own, beside that which renders.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(table.workers).build();
    let pool = pool.map_err(|error| SuiteError::Start { program: "threads".to_owned(), source: std::io::Error::other(error) })?;
    pool.install(|| parallel::try_map(frames, |frame| one(table, handover, frame)))
}

fn one(table: &SystemTable, handover: &Handover<'_>, frame: &HandedFrame) -> Result<ObservedAnswer, SuiteError> {
    let folder = handover.folder.path().join(format!("{:06}", frame.number));
    std::fs::create_dir_all(&folder).map_err(|source| SuiteError::Write { path: folder.display().to_string(), source })?;
    let image = handover.write_image(&folder, frame)?;
    let truth = handover.write_truth(&folder, frame)?;
    let answer = folder.join("answer");
    let places = Places {
        image: Some(&image),
        answer: Some(&answer),
        truth: truth.as_deref(),
        frame: Some(frame),
        size_px: handover.size_px,
        ..Places::default()
    };
    let command = command(&table.command, &places);
    let program = table.command.first().cloned().unwrap_or_default();
    let run = run(command, Duration::from_secs_f64(table.timeout_s)).map_err(|source| SuiteError::Start { program, source })?;
    let read = match &run.end {
        ProcessEnd::TimedOut => TrackerAnswer::without(AnswerStatus::TimedOut, run.last_words.clone()),
        ProcessEnd::Failed(how) => {
            let words = run.last_words.as_ref().map_or_else(String::new, |words| format!(": {words}"));
            TrackerAnswer::without(AnswerStatus::Crashed, Some(format!("{how}{words}")))
        }
        ProcessEnd::Done => answer_in(table, &folder, &answer, frame.number, handover.size_px),
    };
    // What is read is not needed any more: thousands of images would fill the memory.
    let _ = std::fs::remove_dir_all(&folder);
    Ok(ObservedAnswer { answer: read, latency_s: Some(run.seconds), peak_mib: run.peak_mib })
}

/// The answer of a frame with what lies beside it.
fn answer_in(table: &SystemTable, folder: &Path, path: &Path, number: usize, size_px: [usize; 2]) -> TrackerAnswer {
    let unreadable = |fault: String| TrackerAnswer::without(AnswerStatus::Unreadable, Some(fault));
    let Ok(bytes) = std::fs::read(path) else {
        // `solve-field` writes no file where it finds nothing.
        return match table.answer {
            super::super::suite_file::AnswerForm::AstrometryWcs => TrackerAnswer::without(AnswerStatus::None, None),
            _ => unreadable("ended well and wrote no answer".to_owned()),
        };
    };
    let mut answer = read_answers(table.answer, &bytes, size_px).of_frame(number);
    if let Ok(text) = std::fs::read_to_string(folder.join("centroids.csv")) {
        match centroids_of(&text) {
            Ok(mut all) => {
                answer.centroids = all
                    .remove(&Some(number))
                    .or_else(|| all.remove(&None))
                    .or_else(|| all.pop_first().map(|(_, stars)| stars))
                    .or(Some(Vec::new()));
            }
            Err(fault) => return unreadable(fault),
        }
    }
    if let Ok(text) = std::fs::read_to_string(folder.join("camera.json")) {
        match camera_of(&text) {
            Ok(camera) => answer.camera = Some(camera),
            Err(fault) => return unreadable(fault),
        }
    }
    answer
}
