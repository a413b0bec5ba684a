//! `boresight dataset finish`: what is done with the shards of a dataset when they are made.

use std::path::PathBuf;

use anyhow::Result;
use boresight::dataset::finish;
use clap::{Args, Subcommand};

use super::options::heading;
use super::{Answer, examples, output};

/// Steps after the making of shards.
#[derive(Debug, Subcommand)]
pub(crate) enum DatasetStep {
    /// Write card, statistics and sums of a dataset whose shards many processes have made
    #[command(after_help = examples::DATASET_FINISH)]
    Finish(FinishArgs),
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

impl DatasetStep {
    pub(super) fn run(&self) -> Result<Answer> {
        match self {
            Self::Finish(args) => finish_step(args),
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
