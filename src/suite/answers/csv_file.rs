//! Answers as a table: `frame,status,qi,qj,qk,qw[,ra_deg,dec_deg,roll_deg][,time_s][,error]`, columns in any order.

use super::types::{AnswerFile, AnswerStatus, TrackerAnswer};
use crate::suite::conventions::WrittenAttitude;
use crate::toml_file::suggestion;

const COLUMNS: [&str; 11] = ["frame", "status", "qi", "qj", "qk", "qw", "ra_deg", "dec_deg", "roll_deg", "time_s", "error"];

/// Reads a table of answers.
pub(super) fn read(text: &str) -> AnswerFile {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let header: Vec<String> = match reader.headers() {
        Ok(header) => header.iter().map(str::to_owned).collect(),
        Err(error) => return AnswerFile::fault(format!("line 1: {error}")),
    };
    let mut file = AnswerFile::default();
    for name in header.iter().filter(|name| !COLUMNS.contains(&name.as_str())) {
        let meant = suggestion(name, &COLUMNS)
            .map_or_else(|| format!("it may have {}", COLUMNS.join(", ")), |near| format!("did you mean {near}?"));
        file.faults.push(format!("line 1: there is no column {name}; {meant}"));
    }
    let place = |name: &str| header.iter().position(|own| own == name);
    let quaternion = ["qi", "qj", "qk", "qw"].map(place);
    let pointing = ["ra_deg", "dec_deg", "roll_deg"].map(place);
    if place("status").is_none() {
        file.faults.push(format!("line 1: the column status is missing; the line is {:?}", header.join(",")));
    }
    if quaternion.contains(&None) && pointing.contains(&None) {
        file.faults.push("line 1: there is neither a quaternion (qi,qj,qk,qw) nor a pointing (ra_deg,dec_deg,roll_deg)".to_owned());
    }
    if !file.faults.is_empty() {
        return file;
    }
    for record in reader.records() {
        let record = match record {
            Ok(record) => record,
            Err(error) => {
                let line = error.position().map_or(0, csv::Position::line);
                file.faults.push(format!("line {line}: {}; the file may have been cut short", error.to_string().replace('\n', " ")));
                continue;
            }
        };
        let line = record.position().map_or(0, csv::Position::line);
        let cell = |name: &str| place(name).and_then(|at| record.get(at)).filter(|cell| !cell.is_empty());
        let number = |name: &str| match cell(name) {
            None => Ok(None),
            Some(cell) => cell.parse::<f64>().map(Some).map_err(|_| format!("line {line}: {name} = {cell:?} is no number")),
        };
        match row(&cell, &number, line) {
            Ok(one) => file.answers.push(one),
            Err(fault) => file.faults.push(fault),
        }
    }
    repeated(&mut file);
    file
}

/// One line.
fn row<'r>(
    cell: &dyn Fn(&str) -> Option<&'r str>,
    number: &dyn Fn(&str) -> Result<Option<f64>, String>,
    line: u64,
) -> Result<(Option<usize>, TrackerAnswer), String> {
    let frame = match cell("frame") {
        None => None,
        Some(cell) => Some(cell.parse::<usize>().map_err(|_| format!("line {line}: frame = {cell:?} is no whole number from 0"))?),
    };
    let status = match cell("status") {
        Some("solved") => AnswerStatus::Solved,
        Some("none") => AnswerStatus::None,
        Some("error") => AnswerStatus::Error,
        other => return Err(format!("line {line}: status = {:?}; write solved, none or error", other.unwrap_or_default())),
    };
    let all = |names: [&'static str; 4]| -> Result<Option<[f64; 4]>, String> {
        let [a, b, c, d] = names.map(number);
        Ok(match (a?, b?, c?, d?) {
            (Some(a), Some(b), Some(c), Some(d)) => Some([a, b, c, d]),
            _ => None,
        })
    };
    let quaternion = all(["qi", "qj", "qk", "qw"])?;
    let pointing = all(["ra_deg", "dec_deg", "roll_deg", "roll_deg"])?;
    let attitude = quaternion
        .map(WrittenAttitude::Quaternion)
        .or_else(|| pointing.map(|[ra, dec, roll, _]| WrittenAttitude::RaDecRoll([ra, dec, roll])));
    if status == AnswerStatus::Solved {
        let Some(attitude) = attitude else { return Err(format!("line {line}: status is solved, and the attitude is missing")) };
        check(&attitude).map_err(|fault| format!("line {line}: {fault}"))?;
    }
    let attitude = attitude.filter(|_| status == AnswerStatus::Solved);
    let time_s = number("time_s")?;
    Ok((frame, TrackerAnswer { status, attitude, time_s, error: cell("error").map(str::to_owned), ..TrackerAnswer::default() }))
}

/// What is wrong with the numbers of an attitude, whatever its conventions.
pub(super) fn check(attitude: &WrittenAttitude) -> Result<(), String> {
    match attitude {
        WrittenAttitude::Quaternion(numbers) => {
            let norm = numbers.iter().map(|own| own * own).sum::<f64>().sqrt();
            if (norm - 1.0).abs() <= crate::suite::conventions::MAX_OFF_UNIT {
                Ok(())
            } else {
                Err(format!("the quaternion has the length {norm:.4}, and one of a rotation has 1"))
            }
        }
        WrittenAttitude::RaDecRoll([ra, dec, roll]) => {
            if [ra, dec, roll].iter().all(|own| own.is_finite()) && dec.abs() <= 90.0 && ra.abs() <= 360.0 {
                Ok(())
            } else {
                Err(format!("ra_deg, dec_deg, roll_deg = {ra}, {dec}, {roll} is no pointing in degrees"))
            }
        }
        WrittenAttitude::Matrix(rows) => {
            let product = |a: usize, b: usize| (0..3).map(|k| rows[a][k] * rows[b][k]).sum::<f64>();
            let off = (0..3).flat_map(|a| (0..3).map(move |b| (a, b))).map(|(a, b)| (product(a, b) - f64::from(u8::from(a == b))).abs());
            if off.fold(0.0, f64::max) < 0.02 {
                Ok(())
            } else {
                Err("the matrix is no rotation: its rows are not perpendicular unit vectors".to_owned())
            }
        }
    }
}

fn repeated(file: &mut AnswerFile) {
    let mut seen = std::collections::BTreeSet::new();
    for (number, _) in &file.answers {
        if let Some(number) = number.filter(|number| !seen.insert(*number)) {
            file.faults.push(format!("the frame {number} is answered twice"));
        }
    }
    if file.answers.len() > 1 && file.answers.iter().any(|(number, _)| number.is_none()) {
        file.faults.push("there are several answers, and not all say to which frame: add the column frame".to_owned());
    }
}
