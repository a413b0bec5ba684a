//! The dictionary of tetra3, cedar-solve and programs that keep their names, as JSON: `RA`, `Dec`, `Roll` in degrees, null where nothing was found.
//!
//! Their roll counts from the upward direction to celestial north, toward the left of the frame (`tetra3.py`: `arctan2(R[1, 2], R[2, 2])` with the
//! axes out, left, up); ours is the position angle of the upward direction, which is its opposite.

use serde_json::Value;

use super::csv_file::check;
use super::types::{AnswerFile, AnswerStatus, AnsweredStar, TrackerAnswer};
use crate::suite::conventions::WrittenAttitude;

/// Reads a dictionary, or one a line.
pub(super) fn read(text: &str) -> AnswerFile {
    let mut file = AnswerFile::default();
    for value in serde_json::Deserializer::from_str(text).into_iter::<Value>() {
        match value.map_err(|error| error.to_string()).and_then(|value| answer(&value)) {
            Ok(answer) => file.answers.push(answer),
            Err(fault) => {
                file.faults.push(fault);
                break;
            }
        }
    }
    if file.answers.is_empty() && file.faults.is_empty() {
        file.faults.push("is empty".to_owned());
    }
    file
}

fn answer(value: &Value) -> Result<(Option<usize>, TrackerAnswer), String> {
    let Some(table) = value.as_object() else { return Err("is no dictionary".to_owned()) };
    let number = |key: &str| table.get(key).and_then(Value::as_f64);
    if !table.contains_key("RA") {
        return Err("there is no RA: write the dictionary that solve_from_image returns".to_owned());
    }
    let frame = number("frame").map(|frame| frame as usize);
    // T_solve and T_extract are milliseconds.
    let time_s = number("T_solve").map(|solve| (solve + number("T_extract").unwrap_or(0.0)) * 1e-3);
    let (Some(ra), Some(dec), Some(roll)) = (number("RA"), number("Dec"), number("Roll")) else {
        return Ok((frame, TrackerAnswer { time_s, ..TrackerAnswer::without(AnswerStatus::None, None) }));
    };
    let attitude = WrittenAttitude::RaDecRoll([ra, dec, -roll]);
    check(&attitude)?;
    Ok((frame, TrackerAnswer { time_s, centroids: matched(table), ..TrackerAnswer::solved(attitude) }))
}

/// `matched_centroids` are rows and columns from the corner of the first pixel; `matched_catID` may be Hipparcos numbers.
fn matched(table: &serde_json::Map<String, Value>) -> Option<Vec<AnsweredStar>> {
    let centroids = table.get("matched_centroids")?.as_array()?;
    let ids = table.get("matched_catID").and_then(Value::as_array);
    let is_hipparcos = table.get("catalog").and_then(Value::as_str) == Some("hip_main");
    let star = |(index, pair): (usize, &Value)| {
        let hip = ids.filter(|_| is_hipparcos).and_then(|ids| ids.get(index)?.as_u64()).map(|hip| hip as u32);
        Some(AnsweredStar { x: pair.get(1)?.as_f64()? - 0.5, y: pair.get(0)?.as_f64()? - 0.5, hip })
    };
    centroids.iter().enumerate().map(star).collect()
}
