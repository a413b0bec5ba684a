//! What is found, as numbers and as text.

use boresight::calibrate::Method;
use boresight::provenance::Provenance;
use boresight::report::table;
use serde::Serialize;

/// A number and its standard error from counting.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Counted {
    pub(crate) value: f64,
    pub(crate) sigma: f64,
}

/// The mapping against its bound.
#[derive(Debug, Serialize)]
pub(crate) struct Efficiency {
    pub(crate) sets: u64,
    pub(crate) failures: u64,
    pub(crate) rms_error_px: f64,
    pub(crate) rms_bound_px: f64,
    pub(crate) ratio: Counted,
}

/// The pulls of one parameter.
#[derive(Debug, Serialize)]
pub(crate) struct Pulls {
    pub(crate) parameter: String,
    pub(crate) mean: Counted,
    pub(crate) standard_deviation: Counted,
    /// Stated σ over the bound's, mean over the nights.
    pub(crate) stated_over_bound: Counted,
}

/// How often the truth lies inside.
#[derive(Debug, Serialize)]
pub(crate) struct Coverage {
    pub(crate) region: String,
    /// Standard deviation of the pulls; absent for the region of all parameters.
    pub(crate) pull_standard_deviation: Option<Counted>,
    pub(crate) one_sigma: Counted,
    pub(crate) one_sigma_expected: f64,
    pub(crate) two_sigma: Counted,
    pub(crate) two_sigma_expected: f64,
}

/// What is written.
#[derive(Serialize)]
pub(crate) struct Report {
    pub(crate) format: &'static str,
    pub(crate) method: Method,
    pub(crate) solved: Vec<String>,
    pub(crate) efficiency: Efficiency,
    pub(crate) pulls: Vec<Pulls>,
    pub(crate) coverage_sets: u64,
    pub(crate) coverage_failures: u64,
    pub(crate) coverage: Vec<Coverage>,
    pub(crate) provenance: Provenance,
}

/// As tables for people.
pub(crate) fn text(report: &Report) -> String {
    let with_error = |counted: Counted, digits: usize| format!("{:.digits$} ± {:.digits$}", counted.value, counted.sigma);
    let percent = |counted: Counted| format!("{:.2} ± {:.2}", 100.0 * counted.value, 100.0 * counted.sigma);
    let efficiency = &report.efficiency;
    let mut text = format!(
        "Made by `make study`: {}\n\n{} on clean data.\n\nMapping error {:.5} px rms over {} nights of 12 × 25 stars ({} failed), Cramér–Rao bound {:.5} px: ratio {}\n\n",
        boresight::provenance::made_by(report.provenance.seed),
        report.method.name(),
        efficiency.rms_error_px,
        efficiency.sets,
        efficiency.failures,
        efficiency.rms_bound_px,
        with_error(efficiency.ratio, 4)
    );
    let rows: Vec<[String; 4]> = report
        .pulls
        .iter()
        .map(|row| {
            [row.parameter.clone(), with_error(row.mean, 3), with_error(row.standard_deviation, 3), with_error(row.stated_over_bound, 4)]
        })
        .collect();
    text += &table(&["parameter", "mean pull", "sd of pulls", "stated σ / bound"], &rows);
    text += &format!("\nCoverage over {} nights of 10 × 12 stars ({} failed), %:\n\n", report.coverage_sets, report.coverage_failures);
    let rows: Vec<[String; 6]> = report
        .coverage
        .iter()
        .map(|row| {
            [
                row.region.clone(),
                row.pull_standard_deviation.map_or_else(String::new, |counted| with_error(counted, 4)),
                percent(row.one_sigma),
                format!("{:.2}", 100.0 * row.one_sigma_expected),
                percent(row.two_sigma),
                format!("{:.2}", 100.0 * row.two_sigma_expected),
            ]
        })
        .collect();
    text + &table(&["region", "sd of pulls", "in one σ", "expected", "in two σ", "expected"], &rows)
}
