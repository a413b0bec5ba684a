//! One process for a folder of frames, and one file of answers.

use std::collections::BTreeMap;
use std::time::Duration;

use super::super::answers::{AnswerStatus, TrackerAnswer, camera_of, centroids_of, read_answers};
use super::super::error::SuiteError;
use super::super::frames::{FrameBatch, HandedFrame};
use super::super::suite_file::SystemTable;
use super::filled::{Places, command};
use super::handover::{Handover, write};
use super::observed::ObservedAnswer;
use super::process::{ProcessEnd, run};
use crate::recording::{FrameEntry, write_manifest_of};
use crate::scene::{declared_entry, declared_recording};

/// Hands a folder over: `frames/NNNNNN.ending`, `frames.csv` and, for programs that know it, `recording.toml`.
pub(super) fn answers(
    table: &SystemTable,
    handover: &Handover<'_>,
    batch: &FrameBatch,
    frames: &[HandedFrame],
) -> Result<Vec<ObservedAnswer>, SuiteError> {
    let folder = handover.folder.path().join("recording");
    let images = folder.join("frames");
    std::fs::create_dir_all(&images).map_err(|source| SuiteError::Write { path: images.display().to_string(), source })?;
    let mut list = "frame,file,time_utc,exposure_s\n".to_owned();
    for frame in frames {
        handover.write_image(&images, frame)?;
        handover.write_truth(&images, frame)?;
        let time = frame.truth.time.map_or_else(String::new, |time| time.to_isoformat() + "Z");
        list += &format!("{},frames/{},{time},{}\n", frame.number, handover.image_name(frame.number), frame.truth.exposure_s);
    }
    write(&folder.join("frames.csv"), list.as_bytes())?;
    let entries = frames.iter().map(|frame| {
        let file = Some(format!("frames/{}", handover.image_name(frame.number)).into());
        FrameEntry { file, ..declared_entry(&batch.scene, frame.in_scene) }
    });
    write_manifest_of(&folder, &declared_recording(&batch.scene), entries)?;
    let answer = handover.folder.path().join("answer");
    let places =
        Places { answer: Some(&answer), recording: Some(&folder), truth: Some(&images), size_px: handover.size_px, ..Places::default() };
    let program = table.command.first().cloned().unwrap_or_default();
    let limit = Duration::from_secs_f64(table.timeout_s * frames.len() as f64);
    let run = run(command(&table.command, &places), limit).map_err(|source| SuiteError::Start { program, source })?;
    let failed = match &run.end {
        ProcessEnd::Done => None,
        ProcessEnd::TimedOut => Some(TrackerAnswer::without(AnswerStatus::TimedOut, run.last_words.clone())),
        ProcessEnd::Failed(how) => {
            let words = run.last_words.as_ref().map_or_else(String::new, |words| format!(": {words}"));
            Some(TrackerAnswer::without(AnswerStatus::Crashed, Some(format!("{how}{words}"))))
        }
    };
    let read = std::fs::read(&answer).ok();
    let file = read.map(|bytes| read_answers(table.answer, &bytes, handover.size_px)).unwrap_or_default();
    let fault = file.faults.first().cloned();
    let mut by_frame: BTreeMap<usize, TrackerAnswer> =
        file.answers.into_iter().filter_map(|(number, answer)| Some((number?, answer))).collect();
    let beside = |name: &str| std::fs::read_to_string(handover.folder.path().join(name)).ok();
    let mut centroids = beside("centroids.csv").map(|text| centroids_of(&text)).transpose().unwrap_or_default();
    let camera = beside("camera.json").and_then(|text| camera_of(&text).ok());
    let missing = || match (&failed, &fault) {
        (Some(failed), _) => failed.clone(),
        (None, Some(fault)) => TrackerAnswer::without(AnswerStatus::Unreadable, Some(fault.clone())),
        (None, None) => TrackerAnswer::without(AnswerStatus::Unreadable, Some("the file of answers does not have this frame".to_owned())),
    };
    let latency_s = run.seconds / frames.len().max(1) as f64;
    let of = |frame: &HandedFrame| {
        let mut answer = by_frame.remove(&frame.number).unwrap_or_else(missing);
        if let Some(all) = &mut centroids {
            answer.centroids = answer.centroids.or_else(|| Some(all.remove(&Some(frame.number)).unwrap_or_default()));
        }
        answer.camera = answer.camera.or(camera);
        ObservedAnswer { latency_s: answer.time_s.or(Some(latency_s)), answer, peak_mib: run.peak_mib }
    };
    Ok(frames.iter().map(of).collect())
}
