//! The worst frames of what failed, as they were handed over, with truth and answer: made again from their numbers.

use serde_json::json;
use toml::{Table, Value};

use super::error::SuiteError;
use super::plan::{CaseFrames, PlannedCase};
use super::result::WorstFrame;
use super::runner::Runner;
use super::samples::CaseScores;

/// A frame of a failure.
#[derive(Clone, Debug)]
pub struct FailureFrame {
    /// Its number in the case.
    pub number: usize,
    /// The folder for its files, within that of the result.
    pub folder: String,
    /// A scene of this frame alone, which `boresight simulate` renders to the same counts; of a recipe too.
    pub scene: String,
    /// Columns and rows.
    pub size_px: [usize; 2],
    /// Counts.
    pub pixels_dn: Vec<u16>,
    /// Bits of the converter.
    pub bits: u32,
    /// What is true of it, and what was answered.
    pub truth_and_answer: serde_json::Value,
    /// True places of the brighter stars.
    pub stars_px: Vec<[f64; 2]>,
    /// Answered places.
    pub centroids_px: Vec<[f64; 2]>,
}

/// Words as the name of a folder.
#[must_use]
pub fn folder_name(words: &str) -> String {
    let plain = |letter: char| if letter.is_alphanumeric() || letter == '.' { letter.to_ascii_lowercase() } else { '-' };
    let name: String = words.chars().map(plain).collect();
    let parts: Vec<&str> = name.split('-').filter(|part| !part.is_empty()).collect();
    let name = parts.join("-");
    let name = name.trim_matches(['.', '-']);
    if name.is_empty() { "case".to_owned() } else { name.to_owned() }
}

/// The text of a scene of one frame of a case.
pub(super) fn one_frame(case: &PlannedCase, tables: &Table, number: usize) -> String {
    case.scene_of(tables, number..number + 1).0
}

/// The worst frames of a case at a value of its sweep, which get the names of their folders.
pub(super) fn failure_frames(
    runner: &Runner<'_>,
    case: &PlannedCase,
    (value, words): (usize, &str),
    scores: &CaseScores,
    worst: &mut [WorstFrame],
) -> Result<Vec<FailureFrame>, SuiteError> {
    const BRIGHT: usize = 80;
    let mut all = Vec::new();
    for own in worst {
        let Some(scored) = scores.frames.iter().find(|frame| frame.number == own.frame) else { continue };
        let Some(batch) = case.batches(value, own.frame..own.frame + 1)?.into_iter().next() else { continue };
        let Some(frame) = batch.render(&case.name, runner.catalog, &crate::render::PsfTables::default())?.into_iter().next() else {
            continue;
        };
        let mut folder = format!("failures/{}", folder_name(&case.name));
        if !words.is_empty() {
            folder += &format!("/{}", folder_name(words));
        }
        folder += &format!("/frame-{:06}", own.frame);
        own.folder = Some(folder.clone());
        let of_table = |message| SuiteError::Parse { path: case.name.clone(), message };
        let scene = match &case.frames_of {
            CaseFrames::Scene { .. } => one_frame(case, &case.tables(value).map_err(of_table)?.unwrap_or_default(), own.frame),
            CaseFrames::Dataset(plan) => {
                let key = crate::dataset::FrameKey { split: crate::dataset::DatasetSplit::Test, index: own.frame as u64 };
                let wrong = |source| SuiteError::Dataset { case: case.name.clone(), source: Box::new(source) };
                toml::to_string(&Value::Table(plan.frame_scene(key).map_err(wrong)?.scene)).unwrap_or_default()
            }
        };
        let written = scored.written.as_ref().map(|written| match written {
            super::conventions::WrittenAttitude::Quaternion(numbers) => json!({"quaternion": numbers}),
            super::conventions::WrittenAttitude::Matrix(rows) => json!({"matrix": rows}),
            super::conventions::WrittenAttitude::RaDecRoll([ra, dec, roll]) => json!({"ra_deg": ra, "dec_deg": dec, "roll_deg": roll}),
        });
        let camera = &batch.scene.camera;
        all.push(FailureFrame {
            number: own.frame,
            folder,
            scene,
            size_px: [camera.width_px, camera.height_px],
            bits: batch.scene.detector.bits,
            truth_and_answer: json!({
                "frame": own.frame,
                "truth": {"camera_from_icrs": frame.truth.attitude, "ra_dec_roll_deg": own.radec_roll_deg, "velocity_km_s": frame.truth.velocity_km_s,
                          "stars": frame.truth.stars.iter().take(BRIGHT).map(|star| json!({"hip": star.hip, "x_px": star.x_mean_px, "y_px": star.y_mean_px, "snr": star.snr})).collect::<Vec<_>>()},
                "answer": {"in_words": own.answer, "attitude_as_written": written, "centroids_px": scored.places_px, "latency_s": scored.latency_s},
            }),
            stars_px: scored.bright_px.clone(),
            centroids_px: scored.places_px.clone(),
            pixels_dn: frame.pixels_dn,
        });
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    #[test]
    fn names_of_folders_are_plain() {
        assert_eq!(super::folder_name("Lost in space, slewing: 0.5 °/s"), "lost-in-space-slewing-0.5-s");
        assert_eq!((super::folder_name("../x").as_str(), super::folder_name("…").as_str()), ("x", "case"));
    }
}
