//! How calibrators bear wrong identifications: error of the mapping against the share of wrong stars.
//!
//! Nights of 12 frames × 25 catalogue stars from a known camera (see `boresight::calibrate::trial`), a share of the stars wrong in one
//! of three ways, each night given to every method. Figure of merit: mapping error, rms over the frame after the best rotation;
//! median and 90 % over the nights, where a night without a result counts as infinitely wrong. Writes a table, the numbers as JSON
//! and a plot. The numbers hang on `--sets` and `--seed` alone, not on the number of threads.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a command")]

mod rivals;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, ensure};
use boresight::calibrate::trial::{Trial, WrongStars};
use boresight::calibrate::{CalibrateOptions, Method, mapping_error_px};
use boresight::catalog::Catalog;
use boresight::provenance::Provenance;
use boresight::recording::write_file;
use boresight::report::{LogPanels, Panel, Series, SeriesStyle, table};
use clap::Parser;
use rayon::prelude::*;
use rivals::{Calibrator, HuberPairs, IdentifiedAnew, Library, Oracle, Ransac};
use serde::Serialize;

/// A mapping error above this is a failure.
const FAILED_PX: f64 = 10.0;
/// The joint method with the identifications as they are, and with new ones.
const BUNDLE: &str = "bundle";
const ANEW: &str = "bundle, identified anew";
/// The published iteration needs more solutions with F = 4 than it is given by default.
const MAX_ITERATIONS: usize = 400;
const KINDS: [(&str, &str, WrongStars); 3] = [
    ("random", "a direction 0.05° to 2° away", WrongStars::Random),
    ("near-neighbour", "one of the nearest catalogue stars", WrongStars::NearNeighbour),
    ("natural", "matched through the uncalibrated camera", WrongStars::NATURAL),
];

/// Compares calibrators on nights with wrong identifications.
#[derive(Parser)]
struct Arguments {
    /// Folder that the results go into.
    #[arg(short, long, default_value = "outputs/misidentification")]
    output: PathBuf,
    /// Nights for each share of wrong stars.
    #[arg(long, default_value_t = 100)]
    sets: u64,
    /// Eight nights, whatever `--sets` says.
    #[arg(long)]
    quick: bool,
    /// The nights' seeds count from here.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// One method at one share of one kind.
#[derive(Clone, Debug, Serialize)]
struct Outcome {
    kind: &'static str,
    wrong_share: f64,
    method: String,
    sets: u64,
    /// Absent where half of the nights have no result.
    median_px: Option<f64>,
    p90_px: Option<f64>,
    /// Root of the mean square over the nights; absent where one has no result.
    rms_px: Option<f64>,
    /// No result, or an error above 10 px.
    failures: usize,
    /// The iteration stopped at its limit; the camera where it stood is counted as it is.
    not_converged: usize,
}

/// What is written.
#[derive(Serialize)]
struct Report {
    format: &'static str,
    setting: Trial,
    first_seed: u64,
    outcomes: Vec<Outcome>,
    provenance: Provenance,
}

/// Every method, in the order of the plot's colours.
fn methods() -> Vec<Box<dyn Calibrator>> {
    let library = |name: &str, options: CalibrateOptions| -> Box<dyn Calibrator> {
        let options = CalibrateOptions { leave_out_imprecise: false, held_out: false, max_iterations: MAX_ITERATIONS, ..options };
        Box::new(Library { name: name.to_owned(), options })
    };
    let weights = |f_threshold: f64| CalibrateOptions { method: Method::VariableWeights, f_threshold, ..CalibrateOptions::default() };
    vec![
        library("least squares on pairs", CalibrateOptions { method: Method::LeastSquares, ..CalibrateOptions::default() }),
        library("variable weights, F = 10.83", weights(10.83)),
        library("variable weights, F = 4", weights(4.0)),
        Box::new(HuberPairs),
        Box::new(Ransac),
        library(BUNDLE, CalibrateOptions::default()),
        Box::new(IdentifiedAnew { name: ANEW.to_owned(), options: CalibrateOptions { held_out: false, ..CalibrateOptions::default() } }),
        Box::new(Oracle),
    ]
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let sets = if arguments.quick { 8 } else { arguments.sets };
    ensure!(sets > 0, "--sets 0 leaves nothing to compare: give 1 or more");
    let methods = methods();
    let start = Instant::now();
    let mut outcomes: Vec<Outcome> = Vec::new();
    for (kind, _, wrong_stars) in KINDS {
        for percent in (0..=60).step_by(10) {
            let wrong_share = f64::from(percent) / 100.0;
            // Without wrong stars the nights of all kinds are the same.
            let first_kind = outcomes.iter().filter(|outcome| outcome.wrong_share == 0.0 && outcome.kind == KINDS[0].0);
            let known: Vec<Outcome> = first_kind.map(|outcome| Outcome { kind, ..outcome.clone() }).collect();
            if percent == 0 && !known.is_empty() {
                outcomes.extend(known);
                continue;
            }
            let trial = Trial { wrong_stars, wrong_share, ..Trial::published() };
            outcomes.extend(compare(&trial, kind, &methods, arguments.seed, sets));
            eprintln!("{kind}, {percent} % wrong: {sets} nights, {:.1} s in all", start.elapsed().as_secs_f64());
        }
    }
    let text = format!("Made by `make study`: {}\n\n{}", boresight::provenance::made_by(Some(arguments.seed)), tables(&outcomes, sets));
    println!("{text}");
    write_file(&arguments.output.join("table.txt"), text.as_bytes())?;
    plot(&outcomes).write(&arguments.output.join("misidentification.png"))?;
    let provenance = Provenance { seed: Some(arguments.seed), ..Provenance::of_process() };
    let report =
        Report { format: "boresight-misidentification/1", setting: Trial::published(), first_seed: arguments.seed, outcomes, provenance };
    write_file(&arguments.output.join("misidentification.json"), (serde_json::to_string_pretty(&report)? + "\n").as_bytes())?;
    eprintln!("written to {}", arguments.output.display());
    Ok(())
}

/// Every method on the nights of one case.
fn compare(trial: &Trial, kind: &'static str, methods: &[Box<dyn Calibrator>], first_seed: u64, sets: u64) -> Vec<Outcome> {
    // For each night, for each method: its error, and whether it says that it converged.
    let nights: Vec<Vec<(f64, bool)>> = (first_seed..first_seed + sets)
        .into_par_iter()
        .map(|seed| {
            let night = trial.night(Catalog::embedded(), seed);
            let error = |method: &dyn Calibrator| {
                let answer = method.solve(&night, trial.noise_px, seed);
                let error = answer.and_then(|answer| mapping_error_px(&night.truth, &answer.camera));
                (error.map_or(f64::INFINITY, |error| error.rms_px), answer.is_none_or(|answer| answer.converged))
            };
            methods.iter().map(|method| error(method.as_ref())).collect()
        })
        .collect();
    methods
        .iter()
        .enumerate()
        .map(|(index, method)| {
            let mut errors: Vec<f64> = nights.iter().map(|night| night[index].0).collect();
            errors.sort_by(f64::total_cmp);
            let middle = f64::midpoint(errors[(errors.len() - 1) / 2], errors[errors.len() / 2]);
            let high = errors[(0.9 * errors.len() as f64).ceil() as usize - 1];
            Outcome {
                kind,
                wrong_share: trial.wrong_share,
                method: method.name(),
                sets,
                median_px: Some(middle).filter(|value| value.is_finite()),
                rms_px: Some((errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()).filter(|value| value.is_finite()),
                p90_px: Some(high).filter(|value| value.is_finite()),
                failures: errors.iter().filter(|error| **error > FAILED_PX).count(),
                not_converged: nights.iter().filter(|night| !night[index].1).count(),
            }
        })
        .collect()
}

/// For each kind a table: a line for each method, a column for each share.
fn tables(outcomes: &[Outcome], sets: u64) -> String {
    let mut text = format!(
        "Mapping error, px: median / 90 % of {sets} nights, then how many failed (no result, or above {FAILED_PX} px), then * if some did not converge.\n"
    );
    for (kind, title, _) in KINDS {
        let of_kind: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.kind == kind).collect();
        let mut shares: Vec<f64> = of_kind.iter().map(|outcome| outcome.wrong_share).collect();
        shares.dedup();
        let mut names: Vec<&str> = of_kind.iter().map(|outcome| outcome.method.as_str()).collect();
        names.truncate(of_kind.len() / shares.len().max(1));
        let header: Vec<String> =
            std::iter::once("method".to_owned()).chain(shares.iter().map(|share| format!("{:.0} %", 100.0 * share))).collect();
        let rows: Vec<Vec<String>> = names
            .iter()
            .map(|name| {
                let cells = of_kind.iter().filter(|outcome| outcome.method == *name).map(|outcome| cell(outcome));
                std::iter::once((*name).to_owned()).chain(cells).collect()
            })
            .collect();
        let header: Vec<&str> = header.iter().map(String::as_str).collect();
        text += &format!("\nWrong stars: {kind} ({title})\n{}", table(&header, &rows));
    }
    text + &ratios(outcomes)
}

/// How far the joint method is from what is possible: rms over the nights against the same adjustment with the wrong stars left out by the
/// truth, and, identified anew, against the night without wrong stars.
fn ratios(outcomes: &[Outcome]) -> String {
    let rms = |kind: &str, share: f64, method: &str| {
        let found = outcomes.iter().find(|o| o.kind == kind && o.wrong_share == share && o.method == method);
        found.and_then(|outcome| outcome.rms_px)
    };
    let oracle = Oracle.name();
    let mut shares: Vec<f64> = outcomes.iter().map(|outcome| outcome.wrong_share).collect();
    shares.sort_by(f64::total_cmp);
    shares.dedup();
    let mut rows = Vec::new();
    for (kind, _, _) in KINDS {
        for (method, against, clean) in [(BUNDLE, "wrong stars left out by the truth", false), (ANEW, "no wrong stars", true)] {
            let cells = shares.iter().map(|share| {
                let reference = if clean { rms(kind, 0.0, &oracle) } else { rms(kind, *share, &oracle) };
                rms(kind, *share, method)
                    .zip(reference)
                    .map_or_else(|| "–".to_owned(), |(own, reference)| format!("{:.3}", own / reference))
            });
            rows.push([kind.to_owned(), method.to_owned(), against.to_owned()].into_iter().chain(cells).collect::<Vec<_>>());
        }
    }
    let header: Vec<String> = ["wrong stars", "method", "against"]
        .map(str::to_owned)
        .into_iter()
        .chain(shares.iter().map(|share| format!("{:.0} %", 100.0 * share)))
        .collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    format!("\nRatio of the mapping errors, rms over the nights\n{}", table(&header, &rows))
}

fn cell(outcome: &Outcome) -> String {
    let number = |value: Option<f64>| match value {
        None => "∞".to_owned(),
        Some(value) if value < 0.1 => format!("{value:.4}"),
        Some(value) => format!("{value:.2}"),
    };
    let failures = if outcome.failures > 0 { format!(" {}", outcome.failures) } else { String::new() };
    let star = if outcome.not_converged > 0 { "*" } else { "" };
    format!("{} / {}{failures}{star}", number(outcome.median_px), number(outcome.p90_px))
}

/// A panel for each kind and each of the two figures.
fn plot(outcomes: &[Outcome]) -> LogPanels {
    let panel = |kind: &str, title: &str, value: fn(&Outcome) -> Option<f64>| {
        let of_kind = || outcomes.iter().filter(|outcome| outcome.kind == kind);
        let names = of_kind().filter(|outcome| outcome.wrong_share == 0.0).map(|outcome| outcome.method.clone());
        let series = names.map(|label| {
            let own = of_kind().filter(|outcome| outcome.method == label);
            let points = own.map(|outcome| [100.0 * outcome.wrong_share, value(outcome).unwrap_or(f64::INFINITY)]).collect();
            Series { label, style: SeriesStyle::Line, points }
        });
        Panel { title: title.to_owned(), series: series.collect() }
    };
    let medians = KINDS.iter().map(|(kind, title, _)| panel(kind, title, |outcome| outcome.median_px));
    let high = KINDS.iter().map(|(kind, _, _)| panel(kind, "", |outcome| outcome.p90_px));
    LogPanels {
        title: "Error of the calibrated mapping when stars are misidentified: 12 frames × 25 stars, 0.1 px noise".to_owned(),
        x_label: "wrong stars / %".to_owned(),
        y_labels: vec!["median mapping error / px".to_owned(), "90 % of the nights are below / px".to_owned()],
        columns: KINDS.len(),
        panels: medians.chain(high).collect(),
        y_range: [0.01, FAILED_PX],
    }
}
