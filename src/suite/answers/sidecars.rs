//! What may lie beside an answer: `centroids.csv` (`frame,x,y,flux,id`) and `camera.json`.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::types::{AnsweredCamera, AnsweredStar};
use crate::toml_file::with_suggestion;

/// A row of `centroids.csv`.
#[derive(Debug, Deserialize)]
struct Row {
    #[serde(default)]
    frame: Option<usize>,
    x: f64,
    y: f64,
    #[serde(default)]
    #[allow(dead_code, reason = "a column that may be there, and is not judged")]
    flux: Option<f64>,
    #[serde(default)]
    id: Option<u32>,
}

/// Reads `centroids.csv`: the star images by frame.
pub(in crate::suite) fn centroids_of(text: &str) -> Result<BTreeMap<Option<usize>, Vec<AnsweredStar>>, String> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let mut all: BTreeMap<Option<usize>, Vec<AnsweredStar>> = BTreeMap::new();
    for row in reader.deserialize::<Row>() {
        let Row { frame, x, y, id, .. } = row.map_err(|error| format!("centroids.csv: {}", error.to_string().replace('\n', " ")))?;
        all.entry(frame).or_default().push(AnsweredStar { x, y, hip: id.filter(|id| *id > 0) });
    }
    Ok(all)
}

/// Reads `camera.json`.
pub(in crate::suite) fn camera_of(text: &str) -> Result<AnsweredCamera, String> {
    serde_json::from_str(text).map_err(|error| format!("camera.json: {}", with_suggestion(&error.to_string())))
}
