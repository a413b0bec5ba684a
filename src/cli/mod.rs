//! The command line: one verb a file. Results go to stdout, progress and log to stderr.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 3 "ran, and the answer is no".

mod blind;
mod calibrate;
mod calibrate_text;
mod catalog;
mod channel_pictures;
mod compare;
mod dataset;
mod dataset_steps;
mod detect;
mod diagnose;
mod diagnose_files;
mod diagnose_text;
mod doctor;
mod effect_pictures;
mod effects;
mod examples;
mod export;
mod found_image;
mod identify;
mod identify_files;
mod import;
mod map;
mod options;
mod output;
mod pictures;
mod pipeline;
mod preset;
mod run;
mod schema;
mod shell;
mod signals;
mod signature;
mod simulate;
mod simulated_truth;
mod test;
mod test_text;
mod told;
mod update;
mod write_camera;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Whether the answer is yes or no; failures are errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// Done.
    Yes,
    /// Ran, and the answer is no: not identified, not converged, unexplained.
    No,
}

/// A command line that cannot be meant as it stands: exit code 2, as where the words of an option are wrong.
#[derive(Debug)]
pub(crate) struct Usage(pub(crate) String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// Simulates a star camera end to end, calibrates one from its images, and explains why the two differ.
#[derive(Debug, Parser)]
#[command(
    name = "boresight",
    version = boresight::provenance::version(),
    propagate_version = true,
    max_term_width = 120,
    disable_help_flag = true,
    disable_version_flag = true
)]
struct Arguments {
    /// Say more on stderr (-v: steps, -vv: details)
    #[arg(short, long, global = true, action = clap::ArgAction::Count, help_heading = options::heading::GLOBAL)]
    verbose: u8,
    /// Say nothing on stderr but errors
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = options::heading::GLOBAL)]
    quiet: bool,
    /// Use this many threads (default: all); results do not depend on it
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), help_heading = options::heading::GLOBAL)]
    threads: Option<u16>,
    /// Print this help; -h is shorter
    #[arg(short, long, global = true, action = clap::ArgAction::Help, help_heading = options::heading::GLOBAL)]
    help: Option<bool>,
    /// Print the version
    #[arg(short = 'V', long, global = true, action = clap::ArgAction::Version, help_heading = options::heading::GLOBAL)]
    version: Option<bool>,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Render a scene into a recording, with its truth beside it
    #[command(after_help = examples::SIMULATE)]
    Simulate(simulate::SimulateArgs),
    /// Make a labelled dataset from a recipe: a scene, and what of it is drawn by chance
    #[command(after_help = examples::DATASET)]
    Dataset(dataset::DatasetArgs),
    /// Find the stars in images and measure them
    #[command(after_help = examples::DETECT)]
    Detect(detect::DetectArgs),
    /// Identify the stars in images, without a prior attitude (lost in space)
    #[command(after_help = examples::IDENTIFY)]
    Identify(identify::IdentifyArgs),
    /// Solve for the camera: principal point, focal length, distortion
    #[command(after_help = examples::CALIBRATE)]
    Calibrate(calibrate::CalibrateArgs),
    /// Find the physical effects that the model lacks, their sizes, and what remains
    #[command(after_help = examples::DIAGNOSE)]
    Diagnose(diagnose::DiagnoseArgs),
    /// Print pixel → direction of a calibration on a grid
    #[command(after_help = examples::MAP)]
    Map(map::MapArgs),
    /// Compare two calibrations
    #[command(after_help = examples::COMPARE)]
    Compare(compare::CompareArgs),
    /// Write a calibrated camera in the format of another program
    #[command(after_help = examples::EXPORT)]
    Export(export::ExportArgs),
    /// Read the camera of another program
    #[command(after_help = examples::IMPORT)]
    Import(import::ImportArgs),
    /// Simulate, measure, identify and calibrate, and compare with the truth
    #[command(after_help = examples::RUN)]
    Run(run::RunArgs),
    /// `run` on a built-in scene: a night of the real sky
    #[command(after_help = examples::DEMO)]
    Demo(run::DemoArgs),
    /// Test a star tracker, ours or another, on frames whose truth is known, against requirements
    #[command(after_help = examples::TEST)]
    Test(test::TestArgs),
    /// Make a deeper catalogue from star tables of other programs
    #[command(subcommand, after_help = examples::CATALOG)]
    Catalog(catalog::CatalogCommand),
    /// Hide effects in simulated star lists and frames, diagnose them, and score the answers
    #[command(after_help = examples::BLIND)]
    Blind(blind::BlindArgs),
    /// List the effects that this build knows, or print the page of one
    #[command(after_help = examples::EFFECTS)]
    Effects(effects::EffectsArgs),
    /// Scenes of real cameras: list them, or print one as a file to begin from
    #[command(after_help = examples::PRESET)]
    Preset(preset::PresetArgs),
    /// Print the JSON Schema of a verb's result, of scenes, recordings or star lists
    #[command(after_help = examples::SCHEMA)]
    Schema(schema::SchemaArgs),
    /// Show GPU adapter, driver and versions, and check the GPU against the CPU
    #[command(after_help = examples::DOCTOR)]
    Doctor(doctor::DoctorArgs),
    /// Print shell completions of verbs, options and their values
    #[command(after_help = examples::COMPLETIONS)]
    Completions(shell::CompletionsArgs),
    /// Print the manual page of the program, or write those of all verbs
    #[command(after_help = examples::MAN)]
    Man(shell::ManArgs),
}

/// Runs the program.
pub(crate) fn main() -> ExitCode {
    let arguments = Arguments::parse();
    output::set_up_log(arguments.verbose, arguments.quiet);
    if let Err(error) = signals::watch() {
        tracing::warn!("{error:#}: an interrupted run will leave what it has in the making");
    }
    if let Some(threads) = arguments.threads
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global()
    {
        output::say_error(&anyhow::Error::new(error).context("--threads"));
        return ExitCode::from(1);
    }
    let answer = match &arguments.verb {
        Verb::Simulate(args) => simulate::simulate(args),
        Verb::Dataset(args) => dataset::dataset(args),
        Verb::Detect(args) => detect::detect(args),
        Verb::Identify(args) => identify::identify(args),
        Verb::Calibrate(args) => calibrate::calibrate(args),
        Verb::Diagnose(args) => diagnose::diagnose(args),
        Verb::Map(args) => map::map(args),
        Verb::Compare(args) => compare::compare(args),
        Verb::Export(args) => export::export(args),
        Verb::Import(args) => import::import(args),
        Verb::Run(args) => run::run(args),
        Verb::Demo(args) => run::demo(args),
        Verb::Test(args) => test::test(args),
        Verb::Catalog(command) => catalog::catalog(command),
        Verb::Blind(args) => blind::blind(args),
        Verb::Effects(args) => effects::effects(args),
        Verb::Preset(args) => preset::preset(args),
        Verb::Schema(args) => schema::schema(args),
        Verb::Completions(args) => shell::completions(args),
        Verb::Man(args) => shell::man(args),
        Verb::Doctor(args) => doctor::doctor(args),
    };
    match answer {
        Ok(Answer::Yes) => ExitCode::SUCCESS,
        Ok(Answer::No) => ExitCode::from(3),
        // Whoever reads stdout has seen enough (`boresight … | head`): not a failure.
        Err(error) if output::is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            output::say_error(&error);
            ExitCode::from(if error.is::<Usage>() { 2 } else { 1 })
        }
    }
}
