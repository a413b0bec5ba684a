//! Whether a calibration of clean data is as good as the data allow, and whether its standard errors are true.
//!
//! 1. Nights of 12 frames × 25 catalogue stars without wrong ones. Error of the mapping over its Cramér–Rao bound: the bound is the
//!    inverse of the Fisher information of the parameters solved, at the true camera, from single stars with a free attitude for
//!    each frame, with the true noise. An efficient estimator has 1.
//! 2. The same nights: pulls of the parameters, (found − true)/stated σ: mean and standard deviation, and the stated σ over the bound's.
//! 3. Many nights of 10 frames × 12 stars: how often the truth lies inside the stated 68.27 % and 95.45 % regions (one and two σ, of
//!    each parameter and of all together), beside what Student's and Fisher's distributions give for a σ that is itself estimated.
//!
//! Every number comes with its own counting error. They hang on the options alone, not on the number of threads.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a command")]

mod bound;
#[path = "../rivals/columns.rs"]
#[allow(dead_code, reason = "the methods that are compared elsewhere need more of it")]
mod columns;
mod results;

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use boresight::calibrate::trial::{Trial, TrialNight};
use boresight::calibrate::{CalibrateOptions, Calibration, Method, calibrate, mapping_error_px};
use boresight::camera::{Camera, PARAMETER_COUNT, PARAMETER_NAMES};
use boresight::catalog::Catalog;
use boresight::provenance::Provenance;
use boresight::recording::write_file;
use bound::bound;
use clap::Parser;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use results::{Counted, Coverage, Efficiency, Pulls, Report, text};
use statrs::distribution::{ContinuousCDF, FisherSnedecor, Normal, StudentsT};

/// Nights of one batch, after which the progress is said.
const BATCH: u64 = 1000;

/// Tests a calibrator's efficiency and its standard errors on clean data.
#[derive(Parser)]
struct Arguments {
    /// The method, by the name that it has on the command line of boresight.
    #[arg(long, default_value = "bundle")]
    method: String,
    /// F of the variable weights.
    #[arg(long, default_value_t = CalibrateOptions::default().f_threshold)]
    f_threshold: f64,
    /// The parameters to solve, separated by commas; the others are given their true values.
    #[arg(long, value_delimiter = ',', default_values_t = PARAMETER_NAMES.map(str::to_owned))]
    solve: Vec<String>,
    /// Nights for the bound and the pulls.
    #[arg(long, default_value_t = 1000)]
    sets: u64,
    /// Nights for the coverage.
    #[arg(long, default_value_t = 20_000)]
    coverage_sets: u64,
    /// 200 and 2000 nights.
    #[arg(long)]
    quick: bool,
    /// The nights' seeds count from here.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder that the results go into.
    #[arg(short, long, default_value = "outputs/clean-statistics")]
    output: PathBuf,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let (sets, coverage_sets) = if arguments.quick { (200, 2000) } else { (arguments.sets, arguments.coverage_sets) };
    ensure!(sets > 1 && coverage_sets > 1, "one night has no statistics: give 2 or more sets");
    let method: Method = serde_json::from_value(serde_json::Value::String(arguments.method.clone()))
        .with_context(|| format!("there is no method {:?}: `boresight calibrate --help` lists them", arguments.method))?;
    let options = CalibrateOptions {
        method,
        f_threshold: arguments.f_threshold,
        solve: arguments.solve.clone(),
        leave_out_imprecise: false,
        held_out: false,
        max_iterations: 400,
        ..CalibrateOptions::default()
    };
    let solved: Vec<usize> = (0..PARAMETER_COUNT).filter(|k| options.solve.iter().any(|name| name == PARAMETER_NAMES[*k])).collect();
    // What is wrong with the options is said by the first night, before it is counted as the failure of them all.
    calibrate(&night(&Trial::published(), &solved, arguments.seed).control_points, &options)?;
    let (efficiency, pulls) = efficiency(&options, &solved, arguments.seed, sets)?;
    // Nights of their own.
    let (coverage, coverage_failures) = coverage(&options, &solved, arguments.seed + sets, coverage_sets)?;
    let report = Report {
        format: "boresight-clean-statistics/1",
        method,
        solved: options.solve.clone(),
        efficiency,
        pulls,
        coverage_sets,
        coverage_failures,
        coverage,
        provenance: Provenance { seed: Some(arguments.seed), ..Provenance::of_process() },
    };
    let text = text(&report);
    println!("{text}");
    write_file(&arguments.output.join(format!("{}.txt", method.name())), text.as_bytes())?;
    let json = serde_json::to_string_pretty(&report)? + "\n";
    write_file(&arguments.output.join(format!("{}.json", method.name())), json.as_bytes())?;
    eprintln!("written to {}", arguments.output.display());
    Ok(())
}

/// A night whose parameters that are not solved stand at the truth.
fn night(trial: &Trial, solved: &[usize], seed: u64) -> TrialNight {
    let (truth, nominal) = (trial.truth.parameters(), trial.nominal.parameters());
    let start = std::array::from_fn(|k| if solved.contains(&k) { nominal[k] } else { truth[k] });
    Trial { nominal: trial.truth.with_parameters(start), ..*trial }.night(Catalog::embedded(), seed)
}

/// One value of each night, in order; `None` where the calibration failed.
fn of_nights<T: Send>(first_seed: u64, sets: u64, what: &str, value: impl Fn(u64) -> Option<T> + Sync) -> Vec<Option<T>> {
    let mut all = Vec::new();
    while (all.len() as u64) < sets {
        let first = first_seed + all.len() as u64;
        let last = (first + BATCH).min(first_seed + sets);
        all.par_extend((first..last).into_par_iter().map(&value));
        eprintln!("{what}: {} of {sets} nights", all.len());
    }
    all
}

/// Found minus true, and the stated σ, of a parameter.
fn deviation(result: &Calibration, truth: &Camera, k: usize) -> Option<(f64, f64)> {
    let found = result.parameters.iter().find(|parameter| parameter.name == PARAMETER_NAMES[k])?;
    Some((found.value - truth.parameters()[k], found.sigma))
}

fn efficiency(options: &CalibrateOptions, solved: &[usize], first_seed: u64, sets: u64) -> Result<(Efficiency, Vec<Pulls>)> {
    /// Of one night.
    struct Night {
        error_px2: f64,
        bound_px2: f64,
        /// Pull, and stated σ over the bound's, of each parameter solved.
        parameters: Vec<(f64, f64)>,
    }
    let trial = Trial::published();
    let nights = of_nights(first_seed, sets, "mapping and pulls", |seed| {
        let night = night(&trial, solved, seed);
        let result = calibrate(&night.control_points, options).ok()?;
        let (covariance, bound_px2) = bound(&night, solved, trial.noise_px)?;
        let parameters = solved.iter().map(|&k| {
            let (difference, sigma) = deviation(&result, &night.truth, k)?;
            Some((difference / sigma, sigma / covariance[(k, k)].sqrt()))
        });
        let error_px = mapping_error_px(&night.truth, &result.camera)?.rms_px;
        Some(Night { error_px2: error_px * error_px, bound_px2, parameters: parameters.collect::<Option<_>>()? })
    });
    let failures = nights.iter().filter(|night| night.is_none()).count() as u64;
    let nights: Vec<Night> = nights.into_iter().flatten().collect();
    ensure!(nights.len() > 1, "{failures} of {sets} nights have no result");
    let mean = |value: &dyn Fn(&Night) -> f64| counted(nights.iter().map(value));
    let (error, bound) = (mean(&|night| night.error_px2).value, mean(&|night| night.bound_px2).value);
    let ratio = (error / bound).sqrt();
    // Error of a ratio of means: that of the mean of (error² − ratio²·bound²).
    let rest = mean(&|night| night.error_px2 - ratio * ratio * night.bound_px2).sigma;
    let efficiency = Efficiency {
        sets,
        failures,
        rms_error_px: error.sqrt(),
        rms_bound_px: bound.sqrt(),
        ratio: Counted { value: ratio, sigma: rest / bound / (2.0 * ratio) },
    };
    let pulls = solved
        .iter()
        .enumerate()
        .map(|(index, &k)| {
            let mean_pull = mean(&|night| night.parameters[index].0);
            let variance = mean(&|night| (night.parameters[index].0 - mean_pull.value).powi(2));
            let scatter = variance.value.sqrt();
            Pulls {
                parameter: PARAMETER_NAMES[k].to_owned(),
                mean: mean_pull,
                standard_deviation: Counted { value: scatter, sigma: variance.sigma / (2.0 * scatter) },
                stated_over_bound: mean(&|night| night.parameters[index].1),
            }
        })
        .collect();
    Ok((efficiency, pulls))
}

/// What one night has to say about coverage.
struct Inside {
    degrees_of_freedom: f64,
    pulls: Vec<f64>,
    /// Squared length of all pulls together, correlations taken into account.
    square: f64,
}

fn coverage(options: &CalibrateOptions, solved: &[usize], first_seed: u64, sets: u64) -> Result<(Vec<Coverage>, u64)> {
    let trial = Trial { frames: 10, stars_per_frame: 12, ..Trial::published() };
    let nights = of_nights(first_seed, sets, "coverage", |seed| {
        let night = night(&trial, solved, seed);
        let result = calibrate(&night.control_points, options).ok()?;
        let pulls: Vec<f64> = solved
            .iter()
            .map(|&k| deviation(&result, &night.truth, k).map(|(difference, sigma)| difference / sigma))
            .collect::<Option<_>>()?;
        let correlation = |i: usize, j: usize| {
            if i == j { Some(1.0) } else { result.correlation(PARAMETER_NAMES[solved[i]], PARAMETER_NAMES[solved[j]]) }
        };
        let n = solved.len();
        let correlations: Vec<f64> = (0..n * n).map(|index| correlation(index % n, index / n)).collect::<Option<_>>()?;
        let pull_vector = DVector::from_vec(pulls.clone());
        let square = pull_vector.dot(&DMatrix::from_vec(n, n, correlations).cholesky()?.solve(&pull_vector));
        Some(Inside { degrees_of_freedom: result.degrees_of_freedom as f64, pulls, square })
    });
    let failures = nights.iter().filter(|night| night.is_none()).count() as u64;
    let nights: Vec<Inside> = nights.into_iter().flatten().collect();
    ensure!(nights.len() > 1, "{failures} of {sets} nights have no result");
    let degrees = nights.iter().map(|night| night.degrees_of_freedom).sum::<f64>() / nights.len() as f64;
    let share = |inside: &dyn Fn(&Inside) -> bool| {
        let counted_inside = nights.iter().filter(|night| inside(night)).count() as f64;
        let value = counted_inside / nights.len() as f64;
        Counted { value, sigma: (value * (1.0 - value) / nights.len() as f64).sqrt() }
    };
    let deviation = |index: usize| {
        let square = counted(nights.iter().map(|night| night.pulls[index].powi(2)));
        let value = square.value.sqrt();
        Counted { value, sigma: 0.5 * square.sigma / value }
    };
    let student = StudentsT::new(0.0, 1.0, degrees)?;
    let within = |limit: f64| student.cdf(limit) - student.cdf(-limit);
    let mut rows: Vec<Coverage> = solved
        .iter()
        .enumerate()
        .map(|(index, &k)| Coverage {
            region: PARAMETER_NAMES[k].to_owned(),
            pull_standard_deviation: Some(deviation(index)),
            one_sigma: share(&|night| night.pulls[index].abs() < 1.0),
            one_sigma_expected: within(1.0),
            two_sigma: share(&|night| night.pulls[index].abs() < 2.0),
            two_sigma_expected: within(2.0),
        })
        .collect();
    // The region of all parameters together holds as much as one and two σ of one do, if σ itself is estimated (Fisher's distribution).
    let normal = Normal::new(0.0, 1.0)?;
    let count = solved.len() as f64;
    let fisher = FisherSnedecor::new(count, degrees)?;
    let [one, two] = [1.0, 2.0].map(|limit| normal.cdf(limit) - normal.cdf(-limit));
    let [one_limit, two_limit] = [one, two].map(|share| count * fisher.inverse_cdf(share));
    rows.push(Coverage {
        region: "all together".to_owned(),
        pull_standard_deviation: None,
        one_sigma: share(&|night| night.square < one_limit),
        one_sigma_expected: one,
        two_sigma: share(&|night| night.square < two_limit),
        two_sigma_expected: two,
    });
    Ok((rows, failures))
}

/// Mean and its standard error.
fn counted(values: impl Iterator<Item = f64> + Clone) -> Counted {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let variance = values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Counted { value: mean, sigma: (variance / count).sqrt() }
}
