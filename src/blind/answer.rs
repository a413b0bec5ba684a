//! What a diagnosis answered about a concealed recording: one JSON line, kept without pictures and residuals.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::BlindError;
use super::generate::Family;
use super::pixels::PixelAnswer;
use super::rivals::RivalFits;
use crate::statistics::order::sort_by_key;

/// A parameter as found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnswerParameter {
    /// Name without the effect's.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard error.
    pub sigma: f64,
}

/// An effect named.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnswerFinding {
    /// Its id.
    pub id: String,
    /// Its parameters.
    pub parameters: Vec<AnswerParameter>,
    /// Where it was located.
    pub located_by: Vec<String>,
    /// Signal-to-noise ratio.
    pub snr: f64,
    /// Fall of χ² with it.
    #[serde(default)]
    pub delta_chi2: f64,
    /// Effects that cannot be told from it.
    pub set: Vec<String>,
    /// By channel, on frames and stars that took no part: χ² per degree of freedom without it, with all that was found, and the degrees of freedom.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub held_out_chi2: BTreeMap<String, [f64; 3]>,
}

/// The size of an effect that is not found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnswerSize {
    /// Its id.
    pub id: String,
    /// Its first parameter.
    pub parameter: AnswerParameter,
}

/// An effect proposed, named or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnswerProposal {
    /// Its id.
    pub id: String,
    /// Whether it is among those named.
    pub named: bool,
    /// Whether all star images together propose it.
    pub by_all_images: bool,
    /// χ² of its score on all star images.
    pub delta_chi2: f64,
    /// Fall of χ² where neither choice nor size was made.
    pub held_out_delta_chi2: f64,
    /// What was to be expected there of one of its size.
    pub held_out_expected: f64,
    /// Turns that chose it, of how many.
    pub chosen_again: [usize; 2],
}

/// The answer for one recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Family.
    pub family: Family,
    /// Index.
    pub index: u32,
    /// Seed.
    pub seed: u64,
    /// Version of the program that answered.
    pub version: String,
    /// Why there is no diagnosis, if there is none.
    pub error: Option<String>,
    /// `consistent`, `explained`, `unexplained` or `undecided`; empty without a diagnosis.
    pub verdict: String,
    /// What was named.
    pub findings: Vec<AnswerFinding>,
    /// All that was proposed, those named included.
    #[serde(default)]
    pub proposed: Vec<AnswerProposal>,
    /// The probability of an alarm by chance that was asked for.
    #[serde(default)]
    pub alpha: f64,
    /// If something is left without a name: what it follows.
    pub unknown_located_by: Option<Vec<String>>,
    /// What that resembles: ids with their cosines.
    #[serde(default)]
    pub unknown_resembles: Vec<(String, f64)>,
    /// Why those names do not stand.
    #[serde(default)]
    pub unknown_vetoes: Vec<String>,
    /// Effects that this build knows, and what it says of each: id and status.
    pub effects: Vec<(String, String)>,
    /// Covariates that the baseline's residuals follow, the one that explains most first.
    pub located: Vec<String>,
    /// By channel: χ² per degree of freedom of frames and stars that took no part, with all that is found without them, and its degrees of freedom.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub held_out_by_channel: BTreeMap<String, [f64; 2]>,
    /// Held-out χ² per degree of freedom of the model without and with what was found.
    pub held_out: [Option<f64>; 2],
    /// For what is hidden in pixels: the verdict of every channel that was looked at.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub channels: BTreeMap<String, String>,
    /// The same: effects that are significant and not named, with the reasons.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub withheld: BTreeMap<String, String>,
    /// The same: sizes of effects that are not found.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_found: Vec<AnswerSize>,
    /// Frames set aside for it.
    pub held_out_frames: Vec<usize>,
    /// The same data by other ways of mending.
    pub rivals: Option<RivalFits>,
    /// For frames of pixels: the answer about the same stars as star lists, and how the stars were found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels: Option<Box<PixelAnswer>>,
    /// Wall time of the diagnosis, s; for frames of pixels from painting to verdict.
    pub seconds: f64,
}

impl Answer {
    /// An answer that was not given.
    #[must_use]
    pub fn none(family: Family, index: u32, seed: u64, error: String) -> Self {
        Self {
            family,
            index,
            seed,
            version: crate::provenance::version().to_owned(),
            error: Some(error),
            verdict: String::new(),
            findings: Vec::new(),
            proposed: Vec::new(),
            alpha: 0.0,
            unknown_located_by: None,
            unknown_resembles: Vec::new(),
            unknown_vetoes: Vec::new(),
            effects: Vec::new(),
            located: Vec::new(),
            held_out_by_channel: BTreeMap::new(),
            held_out: [None; 2],
            channels: BTreeMap::new(),
            withheld: BTreeMap::new(),
            not_found: Vec::new(),
            held_out_frames: Vec::new(),
            rivals: None,
            pixels: None,
            seconds: 0.0,
        }
    }

    /// What is said of an effect; `None` if this build does not know it.
    #[must_use]
    pub fn status_of(&self, id: &str) -> Option<&str> {
        self.effects.iter().find(|(known, _)| known == id).map(|(_, status)| status.as_str())
    }
}

/// The file of a family's answers.
fn file(directory: &Path, family: Family) -> PathBuf {
    directory.join("answers").join(format!("{}.jsonl", family.name()))
}

/// Appends an answer, whole: a line that a crash cuts short is left out on reading.
pub fn append(directory: &Path, answer: &Answer) -> Result<(), BlindError> {
    let path = file(directory, answer.family);
    let fault = |source| BlindError::File { path: path.clone(), source };
    std::fs::create_dir_all(path.parent().unwrap_or(directory)).map_err(fault)?;
    let mut line = serde_json::to_string(answer).map_err(|error| BlindError::Json { path: path.clone(), message: error.to_string() })?;
    // A line that an earlier crash cut short must not swallow this one.
    let cut_short = std::fs::read(&path).is_ok_and(|bytes| bytes.last().is_some_and(|last| *last != b'\n'));
    if cut_short {
        line.insert(0, '\n');
    }
    line.push('\n');
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(&path).map_err(fault)?;
    file.write_all(line.as_bytes()).map_err(fault)
}

/// The answers that a family has, in order of index; lines cut short are passed over.
pub fn answers(directory: &Path, family: Family) -> Result<Vec<Answer>, BlindError> {
    let path = file(directory, family);
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(BlindError::File { path, source }),
    };
    let mut answers: Vec<Answer> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    // The first answer counts: there are no second tries.
    sort_by_key(&mut answers, |answer| answer.index);
    answers.dedup_by_key(|answer| answer.index);
    Ok(answers)
}
