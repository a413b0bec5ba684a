//! `boresight dataset`: a recipe becomes labelled frames.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use boresight::catalog::Catalog;
use boresight::dataset::{
    DatasetFile, DatasetPlan, DatasetProgress, DatasetRun, DatasetSplit, DrawTable, FrameKey, SampleMember, ShardKey, ShardShare,
};
use boresight::recording::write_file;
use boresight::render::PsfTables;
use boresight::report::ParquetTables;
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;

use super::dataset_steps::DatasetStep;
use super::options::heading;
use super::{Answer, Usage, output};

/// Where the frames of a dataset are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum DatasetBackend {
    /// The CPU
    Cpu,
    /// Any Vulkan adapter, a software one (lavapipe) included; an error where there is none
    Gpu,
}

/// Arguments of `dataset`.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct DatasetArgs {
    #[command(subcommand)]
    step: Option<DatasetStep>,
    /// The recipe; one that is named like a step is given as ./NAME
    #[arg(value_name = "RECIPE.toml", help_heading = None, required = true)]
    recipe: Option<PathBuf>,
    /// The folder of the dataset; one that was begun is resumed
    #[arg(short, long, value_name = "DIR", value_parser = super::options::folder())]
    output: Option<PathBuf>,
    /// Make nothing, and tell what would be made: frames, shards, bytes, hours, what splits share
    #[arg(long, conflicts_with_all = ["scene", "frame", "shard"])]
    plan: bool,
    /// Make nothing, and print the scene of this frame, which `boresight simulate` renders to the same counts
    #[arg(long, value_name = "NUMBER", conflicts_with_all = ["frame", "shard"])]
    scene: Option<u64>,
    /// Make this frame alone, with all members, as files of DIR
    #[arg(long, value_name = "NUMBER", conflicts_with = "shard")]
    frame: Option<u64>,
    /// Only every Nth shard, from the Ith on (from 0), for N processes or machines that share the work
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: Option<[u32; 2]>,
    /// Read stars from this CSV file instead of the built-in Hipparcos stars
    #[arg(long, value_name = "FILE", help_heading = heading::CATALOGUE)]
    catalog: Option<PathBuf>,
    /// Where to render. The CPU gives the same bytes on every machine; a GPU gives its own, which never stand beside others in one DIR
    #[arg(long, value_enum, default_value_t = DatasetBackend::Cpu, help_heading = heading::RENDERING)]
    backend: DatasetBackend,
    /// Replace the dataset of another recipe that DIR holds
    #[arg(long)]
    force: bool,
    /// Print what the dataset is (dataset.json) as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

/// I/N, the I from 0 to N − 1: what arrays of batch systems count by.
fn shard(text: &str) -> std::result::Result<[u32; 2], String> {
    let parts = text.split_once('/').and_then(|(own, all)| Some([own.parse().ok()?, all.parse().ok()?]));
    parts.filter(|[own, all]| own < all).ok_or_else(|| "give I/N with I from 0 to N − 1, as 0/5: the first of five parts".to_owned())
}

/// Makes a dataset, or tells of it.
pub(crate) fn dataset(args: &DatasetArgs) -> Result<Answer> {
    let recipe = match (&args.step, &args.recipe) {
        (Some(step), _) => return step.run(),
        (None, Some(recipe)) => recipe,
        (None, None) => return Err(Usage("dataset needs a recipe: boresight dataset RECIPE.toml -o DIR".to_owned()).into()),
    };
    let mut plan = DatasetPlan::open(recipe)?;
    if args.backend == DatasetBackend::Gpu {
        plan = plan.on_gpu()?;
    }
    let catalog = super::options::open_catalog(args.catalog.as_deref())?;
    if let Some(number) = args.scene {
        let scene = plan.scene_file(frame(&plan, number)?)?;
        let text = toml::to_string(&scene).context("writing the scene as TOML")?;
        output::print(&format!("# Frame {number:09} of {}\n{text}", recipe.display()))?;
        return Ok(Answer::Yes);
    }
    if args.plan {
        return told(&plan, &catalog, args.json);
    }
    let Some(folder) = args.output.as_deref() else {
        return Err(Usage("dataset needs a folder: add -o DIR (or --plan, which makes nothing)".to_owned()).into());
    };
    if let Some(number) = args.frame {
        let key = frame(&plan, number)?;
        return one_frame(plan, &catalog, key, folder, args.force);
    }
    let description = plan.describe(&catalog);
    let [part, parts] = args.shard.unwrap_or([0, 1]).map(|number| number as usize);
    let progress = FrameBar::default();
    let clock = output::Clock::new();
    let threads = rayon::current_num_threads();
    let run = plan.make((folder, args.force), (&catalog, &description), &ParquetTables, ShardShare { part, parts }, threads, &progress)?;
    progress.finish();
    tracing::info!("{} shards made in {clock} by {threads} threads", run.made);
    if args.json {
        output::print(&output::json_text(&description)?)?;
    } else {
        output::print(&summary(folder, &description, run))?;
    }
    Ok(Answer::Yes)
}

/// The frame of a number, or which numbers there are.
fn frame(plan: &DatasetPlan, number: u64) -> Result<FrameKey> {
    let frames = &plan.recipe.size.frames;
    FrameKey::of_number(number, frames).with_context(|| {
        let of_split = |split: &DatasetSplit| {
            let first = FrameKey { split: *split, index: 0 }.number();
            (frames.of(*split) > 0).then(|| format!("{} to {} ({})", first, first + frames.of(*split) - 1, split.name()))
        };
        let known: Vec<String> = DatasetSplit::ALL.iter().filter_map(of_split).collect();
        format!("{}: there is no frame {number}; there are {}", plan.path, known.join(", "))
    })
}

/// What a run did, in words.
fn summary(folder: &Path, dataset: &DatasetFile, run: DatasetRun) -> String {
    let DatasetRun { made, skipped, missing } = run;
    let frames: u64 = dataset.splits.iter().map(|split| split.frames).sum();
    let rest = match missing {
        0 => "whole, with card, statistics and SHA256SUMS".to_owned(),
        1 => "1 shard is still to be made".to_owned(),
        _ => format!("{missing} shards are still to be made"),
    };
    format!("{}: {frames} frames; {made} shards made, {skipped} were done before; {rest}\n", folder.display())
}

/// Progress for people.
#[derive(Default)]
pub(super) struct FrameBar(OnceLock<ProgressBar>);

impl FrameBar {
    pub(super) fn finish(&self) {
        if let Some(bar) = self.0.get() {
            bar.finish_and_clear();
        }
    }
}

impl DatasetProgress for FrameBar {
    fn begin(&self, frames: u64) {
        self.0.get_or_init(|| output::progress("frames", frames as usize));
    }

    fn frame(&self) {
        if let Some(bar) = self.0.get() {
            bar.inc(1);
        }
    }
}

/// Makes one frame with all members.
fn one_frame(mut plan: DatasetPlan, catalog: &Catalog, key: FrameKey, folder: &Path, force: bool) -> Result<Answer> {
    plan.recipe.size.members = vec![SampleMember::Mask, SampleMember::Distance, SampleMember::Instances, SampleMember::Clean];
    let sample = plan.sample(catalog, &PsfTables::default(), key)?;
    for (name, bytes) in &sample.members {
        let path = folder.join(format!("{:09}.{name}", key.number()));
        if path.exists() && !force {
            bail!("{}: is there already; choose another folder, or add --force to replace it", path.display());
        }
        write_file(&path, bytes)?;
    }
    let names: Vec<&str> = sample.members.iter().map(|(name, _)| *name).collect();
    output::print(&format!("{}: frame {:09} with {} stars: {}\n", folder.display(), key.number(), sample.stars, names.join(", ")))?;
    Ok(Answer::Yes)
}

/// A draw in a line, as the recipe has it.
fn drawn(draw: &DrawTable) -> Result<String> {
    let mut table = toml::Table::try_from(draw).context("writing a draw as TOML")?;
    let mut word = |key: &str| table.remove(key).and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default();
    let (level, path, spread) = (word("per"), word("path"), word("spread"));
    let how: Vec<String> = table.iter().map(|(key, value)| format!("{key} = {value}")).collect();
    Ok(format!("drawn per {level}, {spread}: {path}, {}\n", how.join(", ")))
}

/// Tells what would be made.
fn told(plan: &DatasetPlan, catalog: &Catalog, json: bool) -> Result<Answer> {
    /// Frames by which time and bytes are estimated.
    const TRIED: u64 = 8;
    plan.try_frames()?;
    let dataset = plan.describe(catalog);
    if json {
        output::print(&output::json_text(&dataset)?)?;
        return Ok(Answer::Yes);
    }
    let size = &plan.recipe.size;
    let frames: u64 = dataset.splits.iter().map(|split| split.frames).sum();
    let split = DatasetSplit::ALL.into_iter().find(|split| size.frames.of(*split) > 0).context("a recipe has frames")?;
    let (tables, mut bytes, mut seconds) = (PsfTables::default(), 0, 0.0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().context("starting a thread")?;
    let tried = TRIED.min(size.frames.of(split));
    for index in 0..=tried {
        let begun = Instant::now();
        let sample = pool.install(|| plan.sample(catalog, &tables, FrameKey { split, index: index % tried }))?;
        // The first one warms up.
        if index > 0 {
            seconds += begun.elapsed().as_secs_f64();
            bytes += sample.members.iter().map(|(_, bytes)| 512 + bytes.len().next_multiple_of(512)).sum::<usize>();
        }
    }
    let each = |total: f64| total / tried as f64;
    let mut text = format!(
        "{}: {frames} frames in {} shards of {}; about {:.2} GB and {:.2} hours of one core ({:.0} kB and {:.1} ms a frame, from {tried} of them)\n",
        dataset.name,
        ShardKey::all(size).len(),
        size.frames_per_shard,
        1e-9 * each(bytes as f64) * frames as f64,
        each(seconds) * frames as f64 / 3600.0,
        1e-3 * each(bytes as f64),
        1e3 * each(seconds)
    );
    for split in &dataset.splits {
        text += &format!(
            "{}: {} frames from number {:09} on, {} shards, {} cameras, sky: {}\n",
            split.name,
            split.frames,
            split.first_frame,
            split.shards,
            split.cameras,
            split.sky()
        );
    }
    for leak in &dataset.leaks {
        let [a, b] = &leak.splits;
        let nearest = leak.nearest_boresights_deg.map_or_else(|| "not known".to_owned(), |angle| format!("{angle:.2}°"));
        let stars = leak.shared_stars.map_or_else(|| "not known".to_owned(), |share| format!("{:.2} %", 100.0 * share));
        let epochs = leak.nearest_epochs_s.map_or_else(|| "not known".to_owned(), |seconds| format!("{seconds} s"));
        text += &format!(
            "{a} and {b}: nearest boresights {nearest}, nearest times {epochs}, shared cameras {}, shared seeds {}, shared stars {stars}\n",
            leak.shared_cameras, leak.shared_seeds
        );
    }
    for draw in &plan.recipe.draw {
        text += &drawn(draw)?;
    }
    output::print(&text)?;
    Ok(Answer::Yes)
}
