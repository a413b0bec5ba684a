//! The attitude file of LOST (`--print-attitude`): a key and a number a line. Source: UWCubeSat/lost, src/io.cpp.

use super::csv_file::check;
use super::types::{AnswerFile, AnswerStatus, TrackerAnswer};
use crate::suite::conventions::WrittenAttitude;

/// Reads an attitude.
pub(super) fn read(text: &str) -> AnswerFile {
    let value = |key: &str| {
        let line = text.lines().find_map(|line| line.trim().strip_prefix(key)?.strip_prefix(' '));
        line.map(|number| number.trim().parse::<f64>().map_err(|_| format!("{key} {number} is no number")))
    };
    let answer = || -> Result<TrackerAnswer, String> {
        let known = value("attitude_known").ok_or("there is no line attitude_known: LOST writes one with --print-attitude")??;
        if known == 0.0 {
            return Ok(TrackerAnswer::without(AnswerStatus::None, None));
        }
        let number = |key: &str| value(key).ok_or_else(|| format!("attitude_known is 1, and the line {key} is missing"))?;
        let quaternion = [number("attitude_i")?, number("attitude_j")?, number("attitude_k")?, number("attitude_real")?];
        let attitude = WrittenAttitude::Quaternion(quaternion);
        check(&attitude)?;
        Ok(TrackerAnswer::solved(attitude))
    };
    match answer() {
        Ok(answer) => AnswerFile { answers: vec![(None, answer)], faults: Vec::new() },
        Err(fault) => AnswerFile::fault(fault),
    }
}
