//! `boresight test`: requirements of a star tracker, ours or another, held against frames whose truth is known.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, Result, bail};
use boresight::recording::{FitsHeaders, ImageFileForm, ResultFolder, write_file, write_image};
use boresight::report::table;
use boresight::scene::{Scene, preset};
use boresight::suite::{
    AnswerForm, FramePicture, RequirementVerdict, SuiteOptions, SuitePlan, SuiteProgress, SuiteResult, SuiteRun, SuiteSource, TEST_FORMAT,
    annotations, compared, guess_conventions, init_suite, junit, listed, page, read_answers, run_suite, summary,
};
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;

use super::options::{OutputArgs, heading};
use super::test_text::text;
use super::{Answer, Usage, output, pictures};

/// Arguments of `test`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::STATISTICS)]
#[allow(clippy::struct_excessive_bools, reason = "switches that have nothing to do with each other")]
pub(crate) struct TestArgs {
    /// The suite
    #[arg(value_name = "SUITE.toml", help_heading = None, required_unless_present_any = ["init", "metrics"])]
    suite: Option<PathBuf>,
    /// Print a suite to begin from, with the cases of ECSS-E-ST-60-20C, for a preset or a scene
    #[arg(long, value_name = "PRESET|SCENE.toml", help_heading = heading::INPUT, exclusive = true)]
    init: Option<String>,
    /// List the metrics that a requirement may name
    #[arg(long, help_heading = heading::INPUT, exclusive = true)]
    metrics: bool,
    /// Say what is wrong with a file of answers, and run nothing
    #[arg(long, value_name = "FILE", help_heading = heading::INPUT)]
    check_answer: Option<PathBuf>,
    /// Hand over 20 frames, and say which of the 2 × 2 × 48 × 3 conventions the answers agree with
    #[arg(long, help_heading = heading::INPUT, conflicts_with = "check_answer")]
    guess_conventions: bool,
    /// Only cases whose names hold this; may be given several times
    #[arg(long, value_name = "WORDS", help_heading = heading::INPUT)]
    case: Vec<String>,
    /// Another seed than the suite's: fresh frames
    #[arg(long, value_name = "SEED", help_heading = heading::INPUT)]
    seed: Option<u64>,
    /// Read stars from this CSV file instead of the built-in Hipparcos stars
    #[arg(long, value_name = "FILE", help_heading = heading::CATALOGUE)]
    catalog: Option<PathBuf>,
    /// What becomes of the suite where frames do not decide a requirement
    #[arg(long, value_enum, default_value_t = UndecidedChoice::Fail)]
    undecided: UndecidedChoice,
    /// Also list metrics that are worse than in an earlier result (its test.json) by more than their bounds
    #[arg(long, value_name = "FILE")]
    baseline: Option<PathBuf>,
    /// Exit code 3 where something became worse
    #[arg(long, requires = "baseline")]
    no_regression: bool,
    /// Leave failures as they are: neither bisect sweeps nor switch effects off
    #[arg(long)]
    no_smallest: bool,
    /// Also write the verdicts as JUnit XML
    #[arg(long, value_name = "FILE", help_heading = heading::OUTPUT)]
    junit: Option<PathBuf>,
    /// Also print annotations of GitHub Actions, ten at most, and add a summary to the step ($GITHUB_STEP_SUMMARY)
    #[arg(long, help_heading = heading::OUTPUT, conflicts_with = "json")]
    github: bool,
    #[command(flatten)]
    output: OutputArgs,
}

/// What becomes of an undecided requirement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum UndecidedChoice {
    /// The suite fails
    Fail,
    /// It passes: for trends over many nights
    Pass,
}

/// Runs a suite, or one of its helps.
pub(crate) fn test(args: &TestArgs) -> Result<Answer> {
    if args.metrics {
        let rows: Vec<[String; 3]> = listed();
        output::print_page(&table(&["metric", "followed by", "what it is"], &rows))?;
        return Ok(Answer::Yes);
    }
    if let Some(name) = &args.init {
        output::print(&init(name)?)?;
        return Ok(Answer::Yes);
    }
    let Some(path) = &args.suite else { return Err(Usage("test needs a suite: boresight test SUITE.toml".to_owned()).into()) };
    let plan = SuitePlan::open(path, args.seed)?;
    if let Some(file) = &args.check_answer {
        return check_answer(&plan, file);
    }
    let catalog = super::options::open_catalog(args.catalog.as_deref())?;
    if args.guess_conventions {
        let guess = guess_conventions(&plan, &catalog)?;
        output::print_page(&(guess.sentences.join("\n") + "\n"))?;
        return Ok(if guess.agree_as_declared * 5 >= guess.answered * 4 && guess.answered > 0 { Answer::Yes } else { Answer::No });
    }
    run(args, &plan, &catalog, path)
}

fn run(args: &TestArgs, plan: &SuitePlan, catalog: &boresight::catalog::Catalog, path: &Path) -> Result<Answer> {
    let folder = args.output.open("test")?;
    if !args.case.is_empty() && !plan.cases.iter().any(|case| args.case.iter().any(|words| case.name.contains(words.as_str()))) {
        let names: Vec<&str> = plan.cases.iter().map(|case| case.name.as_str()).collect();
        bail!("--case {}: no case of {} is called so; there are: {}", args.case.join(", "), plan.path, names.join("; "));
    }
    let mut provenance = output::provenance();
    provenance.add_input(path)?;
    provenance.seed = Some(plan.file.seed);
    let clock = output::Clock::new();
    let options = SuiteOptions { only: args.case.clone(), keeps_failures: folder.is_some() && !args.no_smallest };
    let done = run_suite(plan, catalog, &options, &Bars::default())?;
    let baseline = args.baseline.as_deref().map(|file| compared(file, &done.cases)).transpose()?;
    let object = SuiteResult {
        format: TEST_FORMAT,
        suite: plan.path.clone(),
        system: plan.system_name(),
        seed: plan.file.seed,
        verdict: SuiteResult::verdict_of(&done.cases),
        cases: done.cases.clone(),
        baseline,
        provenance,
    };
    tracing::info!("{} cases in {clock}", object.cases.len());
    let undecided_passes = args.undecided == UndecidedChoice::Pass;
    if let Some(file) = &args.junit {
        write_file(file, junit(&object, undecided_passes).as_bytes())?;
    }
    if let Some(folder) = &folder {
        write_files(folder, args, &object, &done, path)?;
    }
    output::deliver("test", &object, args.output.json, args.output.output.as_deref(), || text(&object))?;
    if args.github {
        output::print(&annotations(&object))?;
        if let Some(file) = std::env::var_os("GITHUB_STEP_SUMMARY") {
            add_summary(Path::new(&file), &summary(&object))?;
        }
    }
    let is_met = match object.verdict {
        RequirementVerdict::Pass => true,
        RequirementVerdict::Fail => false,
        RequirementVerdict::Undecided => undecided_passes,
    };
    let is_worse = args.no_regression && object.baseline.as_ref().is_some_and(|baseline| !baseline.worse.is_empty());
    Ok(if is_met && !is_worse { Answer::Yes } else { Answer::No })
}

/// Adds to the summary of a step; what is there is of other steps.
fn add_summary(path: &Path, text: &str) -> Result<()> {
    use std::io::Write;
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    file.and_then(|mut file| file.write_all(text.as_bytes())).with_context(|| format!("adding to $GITHUB_STEP_SUMMARY, {}", path.display()))
}

/// Writes the page, and the frames of failures with their pictures.
fn write_files(folder: &ResultFolder, args: &TestArgs, object: &SuiteResult, done: &SuiteRun, suite: &Path) -> Result<()> {
    folder.begin()?;
    let mut shown = Vec::new();
    for frame in &done.failures {
        let at = folder.path().join(&frame.folder);
        write_file(&at.join("scene.toml"), frame.scene.as_bytes())?;
        write_file(&at.join("truth_and_answer.json"), output::json_text(&frame.truth_and_answer)?.as_bytes())?;
        write_image(&at.join("frame.png"), ImageFileForm::Png16, frame.size_px, (&frame.pixels_dn, frame.bits), &FitsHeaders::default())?;
        let picture = at.join("picture.png");
        if pictures::answered_frame(&picture, frame)? {
            shown.push(FramePicture {
                folder: frame.folder.clone(),
                png: std::fs::read(&picture).with_context(|| format!("reading {}", picture.display()))?,
            });
        }
    }
    for (path, scene) in &done.scenes {
        write_file(&folder.path().join(path), scene.as_bytes())?;
    }
    let mut commands = vec![format!("boresight test {} -o DIR --seed {}", suite.display(), object.seed)];
    commands.extend(args.baseline.iter().map(|file| format!("boresight test {} --baseline {}", suite.display(), file.display())));
    write_file(&folder.path().join("report.html"), page(object, &shown, &commands).as_bytes())?;
    Ok(())
}

/// The text of a suite for a preset or a scene.
fn init(name: &str) -> Result<String> {
    let is_file = Path::new(name).extension().is_some_and(|ending| ending == "toml");
    let (text, key) = if is_file {
        (std::fs::read_to_string(name).with_context(|| format!("{name}: the scene cannot be read"))?, format!("scene = {name:?}"))
    } else if let Some(found) = preset(name) {
        (found.toml.to_owned(), format!("preset = {name:?}"))
    } else {
        return Err(
            Usage(format!("there is no preset {name}; `boresight preset list` lists them, and a scene's name ends in .toml")).into()
        );
    };
    let scene = Scene::parse(name, &text)?;
    Ok(init_suite(&SuiteSource { key, scene: &scene, is_fixed: scene.is_fixed }))
}

/// Says what is wrong with a file of answers.
fn check_answer(plan: &SuitePlan, file: &Path) -> Result<Answer> {
    let bytes = std::fs::read(file).with_context(|| format!("{}: cannot be read", file.display()))?;
    let form = plan.file.system.as_ref().map_or(AnswerForm::Csv, |system| system.answer);
    let size_px = plan.cases.first().map_or([0, 0], boresight::suite::PlannedCase::size_px);
    let read = read_answers(form, &bytes, size_px);
    let mut text = format!("{}: {} answers\n", file.display(), read.answers.len());
    for fault in &read.faults {
        text += &format!("{}: {fault}\n", file.display());
    }
    let unread = read
        .answers
        .iter()
        .filter(|(_, answer)| answer.attitude.as_ref().is_some_and(|written| plan.conventions.read(written).is_none()))
        .count();
    if unread > 0 {
        text += &format!("{}: {unread} attitudes are no rotations under the declared conventions\n", file.display());
    }
    let is_good = read.faults.is_empty() && unread == 0;
    if is_good {
        text += "nothing is wrong with it; whether the conventions are those declared, --guess-conventions tells\n";
    }
    output::print_page(&text)?;
    Ok(if is_good { Answer::Yes } else { Answer::No })
}

/// A bar for each case.
#[derive(Default)]
struct Bars(Mutex<Option<ProgressBar>>);

impl Bars {
    fn with(&self, change: impl FnOnce(&mut Option<ProgressBar>)) {
        change(&mut self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    }
}

impl SuiteProgress for Bars {
    fn begin(&self, name: &str, words: &str, frames: usize) {
        tracing::debug!("{name} {words}: {frames} frames at most");
        self.with(|bar| *bar = Some(output::progress("frames", frames)));
    }

    fn frames(&self, count: usize) {
        self.with(|bar| {
            if let Some(bar) = bar {
                bar.inc(count as u64);
            }
        });
    }

    fn end(&self) {
        self.with(|bar| {
            if let Some(bar) = bar.take() {
                bar.finish_and_clear();
            }
        });
    }
}
