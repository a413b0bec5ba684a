//! `run --require`: limits on the result of a simulated night.

use std::str::FromStr;

use schemars::JsonSchema;
use serde::Serialize;

use super::result::RunResult;
use crate::toml_file::suggestion;

/// A limit that is asked for: `mapping_error_rms_px<=0.05`.
#[derive(Clone, Debug, PartialEq)]
pub struct RunLimit {
    metric: &'static str,
    /// Whether the value is not to lie above the limit; else not below.
    is_most: bool,
    limit: f64,
}

/// A limit that was asked for, and whether it is kept.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RunRequirement {
    /// What is limited.
    pub metric: &'static str,
    /// `<=` or `>=`.
    pub sign: &'static str,
    /// The limit.
    pub limit: f64,
    /// The value; absent: the night has none.
    pub value: Option<f64>,
    /// Whether it is kept; not where there is no value.
    pub is_met: bool,
}

/// What can be limited, of the camera that the joint method found.
const METRICS: [&str; 10] = [
    "identified_share",
    "wrong_identifications",
    "mapping_error_rms_px",
    "mapping_error_max_px",
    "residual_rms_px",
    "held_out_rms_px",
    "focal_length_error_px",
    "principal_point_error_px",
    "focal_length_error_sigma",
    "control_points",
];

impl FromStr for RunLimit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let split = text.split_once("<=").map(|parts| (parts, true)).or_else(|| text.split_once(">=").map(|parts| (parts, false)));
        let ((name, number), is_most) = split.ok_or_else(|| {
            format!("write a metric, <= or >=, and a number: mapping_error_rms_px<=0.05; the metrics are {}", METRICS.join(", "))
        })?;
        let name = name.trim();
        let metric = METRICS.into_iter().find(|known| *known == name).ok_or_else(|| match suggestion(name, &METRICS) {
            Some(near) => format!("there is no metric {name}; did you mean {near}?"),
            None => format!("there is no metric {name}; there are {}", METRICS.join(", ")),
        })?;
        let limit = number.trim().parse::<f64>().ok().filter(|limit| limit.is_finite());
        Ok(Self { metric, is_most, limit: limit.ok_or_else(|| format!("{number:?} is no number"))? })
    }
}

impl RunLimit {
    /// Whether a night keeps it.
    #[must_use]
    pub fn judged(&self, result: &RunResult) -> RunRequirement {
        let value = value(self.metric, result);
        let is_met = value.is_some_and(|value| if self.is_most { value <= self.limit } else { value >= self.limit });
        RunRequirement { metric: self.metric, sign: if self.is_most { "<=" } else { ">=" }, limit: self.limit, value, is_met }
    }
}

fn value(metric: &str, result: &RunResult) -> Option<f64> {
    let camera = || result.cameras.iter().find(|camera| camera.camera == "bundle");
    let error = |name: &str| {
        let row = result.parameters.iter().find(|row| row.name == name)?;
        Some((row.bundle? - row.truth, row.bundle_sigma))
    };
    match metric {
        "identified_share" => Some(result.frames_identified as f64 / result.frames as f64),
        "wrong_identifications" => Some(result.wrong_identifications as f64),
        "control_points" => Some(result.control_points as f64),
        "mapping_error_rms_px" => camera()?.mapping_error_rms_px,
        "mapping_error_max_px" => camera()?.mapping_error_max_px,
        "residual_rms_px" => camera()?.residual_rms_px,
        "held_out_rms_px" => camera()?.held_out_rms_px,
        "focal_length_error_px" => error("f").map(|(error, _)| error.abs()),
        "focal_length_error_sigma" => error("f").and_then(|(error, sigma)| Some(error.abs() / sigma?)),
        "principal_point_error_px" => Some(error("x0")?.0.hypot(error("y0")?.0)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_read_and_faults_told() {
        let limit: RunLimit = "mapping_error_rms_px <= 0.05".parse().unwrap();
        assert_eq!(limit, RunLimit { metric: "mapping_error_rms_px", is_most: true, limit: 0.05 });
        let fault = |text: &str| text.parse::<RunLimit>().unwrap_err();
        assert_eq!(fault("mapping_eror_rms_px<=1"), "there is no metric mapping_eror_rms_px; did you mean mapping_error_rms_px?");
        assert!(fault("residual_rms_px").contains("<= or >=") && fault("residual_rms_px<=small").contains("no number"));
    }
}
