//! Answers as JSON: an object, a list of objects, or an object a line.

use serde::Deserialize;

use super::csv_file::check;
use super::types::{AnswerFile, AnswerStatus, AnsweredCamera, AnsweredStar, TrackerAnswer};
use crate::suite::conventions::WrittenAttitude;
use crate::toml_file::with_suggestion;

/// An answer as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    frame: Option<usize>,
    status: String,
    quaternion: Option<[f64; 4]>,
    matrix: Option<[[f64; 3]; 3]>,
    ra_deg: Option<f64>,
    dec_deg: Option<f64>,
    roll_deg: Option<f64>,
    time_s: Option<f64>,
    error: Option<String>,
    /// `[x, y]`, `[x, y, flux]` or `[x, y, flux, hip]`.
    centroids: Option<Vec<Vec<Option<f64>>>>,
    camera: Option<AnsweredCamera>,
}

/// Reads answers.
pub(super) fn read(text: &str) -> AnswerFile {
    let whole: Result<Vec<Written>, serde_json::Error> = if text.trim_start().starts_with('[') {
        serde_json::from_str(text)
    } else {
        serde_json::Deserializer::from_str(text).into_iter().collect()
    };
    let mut file = AnswerFile::default();
    match whole {
        Err(error) => file.faults.push(sentence(&error)),
        Ok(all) if all.is_empty() => file.faults.push("is empty".to_owned()),
        Ok(all) => {
            for written in all {
                let frame = written.frame;
                match answer(written) {
                    Ok(answer) => file.answers.push((frame, answer)),
                    Err(fault) => file.faults.push(match frame {
                        Some(frame) => format!("frame {frame}: {fault}"),
                        None => fault,
                    }),
                }
            }
        }
    }
    file
}

/// What serde says, with the place in front.
fn sentence(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let message = text.split(" at line ").next().unwrap_or_default();
    format!("line {}, column {}: {}", error.line(), error.column(), with_suggestion(message))
}

fn answer(written: Written) -> Result<TrackerAnswer, String> {
    let status = match written.status.as_str() {
        "solved" => AnswerStatus::Solved,
        "none" => AnswerStatus::None,
        "error" => AnswerStatus::Error,
        other => return Err(format!("status = {other:?}; write solved, none or error")),
    };
    let pointing = match (written.ra_deg, written.dec_deg, written.roll_deg) {
        (Some(ra), Some(dec), Some(roll)) => Some(WrittenAttitude::RaDecRoll([ra, dec, roll])),
        _ => None,
    };
    let attitude = written.quaternion.map(WrittenAttitude::Quaternion).or(written.matrix.map(WrittenAttitude::Matrix)).or(pointing);
    if status == AnswerStatus::Solved {
        let attitude = attitude.ok_or("status is solved, and there is neither quaternion, matrix nor ra_deg, dec_deg, roll_deg")?;
        check(&attitude)?;
    }
    let star = |numbers: &Vec<Option<f64>>| {
        let at = |place: usize| numbers.get(place).copied().flatten();
        match (at(0), at(1)) {
            (Some(x), Some(y)) if numbers.len() <= 4 => Ok(AnsweredStar { x, y, hip: at(3).map(|hip| hip as u32) }),
            _ => Err("a centroid is [x, y], [x, y, flux] or [x, y, flux, hip]".to_owned()),
        }
    };
    let centroids = written.centroids.as_ref().map(|all| all.iter().map(star).collect::<Result<Vec<_>, _>>()).transpose()?;
    Ok(TrackerAnswer {
        status,
        attitude: attitude.filter(|_| status == AnswerStatus::Solved),
        time_s: written.time_s,
        error: written.error,
        centroids,
        camera: written.camera,
    })
}
