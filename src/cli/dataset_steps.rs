//! `boresight dataset finish`, `verify` and `export`: what is done with the shards of a dataset when they are made.

use std::path::PathBuf;

use anyhow::Result;
use boresight::dataset::{DatasetFile, ExportForm, VerifyOptions, VerifyResult, export_dataset, finish, verify};
use boresight::recording::ResultFolder;
use boresight::report::ParquetTables;
use clap::{Args, Subcommand, ValueEnum};

use super::dataset::FrameBar;
use super::options::heading;
use super::{Answer, Usage, examples, output};

/// Steps after the making of shards.
#[derive(Debug, Subcommand)]
pub(crate) enum DatasetStep {
    /// Write card, statistics and sums of a dataset whose shards many processes have made
    #[command(after_help = examples::DATASET_FINISH)]
    Finish(FinishArgs),
    /// Check a dataset: hashes, frames rendered again, labels against pixels, splits
    #[command(after_help = examples::DATASET_VERIFY)]
    Verify(VerifyArgs),
    /// Write a dataset in the form of another program, shard by shard
    #[command(after_help = examples::DATASET_EXPORT)]
    Export(ExportFormArgs),
}

/// Arguments of `dataset finish`.
#[derive(Debug, Args)]
pub(crate) struct FinishArgs {
    /// The folder of the dataset
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Print what the dataset is (dataset.json) as one JSON object on stdout, and nothing else
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

/// Arguments of `dataset verify`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::INPUT)]
pub(crate) struct VerifyArgs {
    /// The folder of the dataset
    #[arg(value_name = "DIR", help_heading = None)]
    folder: PathBuf,
    /// Make so many frames again, and hold their labels against their pixels; all shards are hashed in any case
    #[arg(long, value_name = "K", default_value_t = 100)]
    frames: u64,
    /// The seed by which they are chosen
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// The recipe at its first place, if it names files that the folder does not hold
    #[arg(long, value_name = "RECIPE.toml")]
    recipe: Option<PathBuf>,
    /// Read stars from this CSV file instead of the built-in Hipparcos stars
    #[arg(long, value_name = "FILE", help_heading = heading::CATALOGUE)]
    catalog: Option<PathBuf>,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long, help_heading = heading::OUTPUT)]
    json: bool,
}

/// Arguments of `dataset export`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct ExportFormArgs {
    /// The folder of the dataset
    #[arg(value_name = "DIR", help_heading = None)]
    folder: PathBuf,
    /// The form
    #[arg(long, value_name = "FORM")]
    to: FormChoice,
    /// The folder that it is written into
    #[arg(short, long, value_name = "OUT", value_parser = super::options::folder())]
    output: PathBuf,
    /// Write more than 100000 files, one or two for each frame
    #[arg(long)]
    many_files: bool,
    /// Replace an earlier export in OUT
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormChoice {
    /// COCO: a file of annotations for each shard, boxes and centres from the corner of the first pixel, PNG of 16 bits
    Coco,
    /// YOLO: a text file of boxes for each frame, data.yaml, PNG of 16 bits
    Yolo,
    /// FITS images, with the labels as JSON beside each
    Fits,
    /// Parquet with the image and the labels of each frame
    Parquet,
    /// FITS images with annotations as SatSim writes them for SatNet
    Satnet,
}

impl From<FormChoice> for ExportForm {
    fn from(choice: FormChoice) -> Self {
        match choice {
            FormChoice::Coco => Self::Coco,
            FormChoice::Yolo => Self::Yolo,
            FormChoice::Fits => Self::Fits,
            FormChoice::Parquet => Self::Parquet,
            FormChoice::Satnet => Self::Satnet,
        }
    }
}

impl DatasetStep {
    pub(super) fn run(&self) -> Result<Answer> {
        match self {
            Self::Finish(args) => finish_step(args),
            Self::Verify(args) => verify_step(args),
            Self::Export(args) => export_step(args),
        }
    }
}

fn finish_step(args: &FinishArgs) -> Result<Answer> {
    let dataset = finish(&args.folder)?;
    if args.json {
        output::print(&output::json_text(&dataset)?)?;
    } else {
        let (frames, shards) = (dataset.frames(), dataset.shards().len());
        let folder = args.folder.display();
        output::print(&format!("{folder}: {frames} frames in {shards} shards; whole, with card, statistics and SHA256SUMS\n"))?;
    }
    Ok(Answer::Yes)
}

fn verify_step(args: &VerifyArgs) -> Result<Answer> {
    let catalog = super::options::open_catalog(args.catalog.as_deref())?;
    let threads = rayon::current_num_threads();
    let options = VerifyOptions { frames: args.frames, seed: args.seed, recipe: args.recipe.clone(), threads };
    let progress = FrameBar::default();
    let result = verify(&args.folder, &catalog, &ParquetTables, &options, (&progress, output::provenance()))?;
    progress.finish();
    if args.json {
        output::print(&output::json_text(&result)?)?;
    } else {
        output::print(&verdict(&args.folder.display().to_string(), &result))?;
    }
    Ok(if result.is_right { Answer::Yes } else { Answer::No })
}

/// What was found, in words.
fn verdict(folder: &str, result: &VerifyResult) -> String {
    let mut text = format!(
        "{folder}: {} shards with {} frames read and hashed, {} frames made again\n",
        result.shards, result.frames, result.frames_rendered
    );
    if let Some(([x_px, y_px], [x_error_px, y_error_px])) = result.offset_px.zip(result.standard_error_px) {
        text += &format!(
            "labels: {} bright lone stars are {x_px:.4} ± {x_error_px:.4} px (x) and {y_px:.4} ± {y_error_px:.4} px (y) from them\n",
            result.stars_measured
        );
    }
    for why in &result.not_checked {
        text += &format!("not looked at: {why}\n");
    }
    for fault in &result.faults {
        text += &format!("fault: {}\n", fault.fault);
    }
    text + match result.faults.len() {
        0 => "nothing is wrong with what was looked at\n",
        _ => "the dataset is not what it says\n",
    }
}

fn export_step(args: &ExportFormArgs) -> Result<Answer> {
    /// More files than this are slow to list and to copy, and are asked for by name.
    const MAX_FILES: u64 = 100_000;
    let form = ExportForm::from(args.to);
    let frames = DatasetFile::read(&args.folder)?.frames();
    if form.has_file_for_each_frame() && frames > MAX_FILES && !args.many_files {
        let told = format!("this form has files for each of {frames} frames; add --many-files if that is meant, or export to parquet");
        return Err(Usage(told).into());
    }
    let _folder = ResultFolder::open(&args.output, "dataset", args.force)?;
    let progress = FrameBar::default();
    let counts = export_dataset(&args.folder, form, &args.output, &ParquetTables, &progress)?;
    progress.finish();
    output::print(&format!("{}: {} frames with {} lights\n", args.output.display(), counts.frames, counts.lights))?;
    Ok(Answer::Yes)
}
