//! `boresight blind`: the benchmark of concealed recordings.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use boresight::blind::generate::{FAMILIES, Family};
use boresight::blind::{
    HeldOutResult, ImageScore, ImageScoreResult, SCORE_FORMAT, ScoreResult, StepResult, answers, held_out_study, image_markdown,
    image_score, is_sealed, joined, make, markdown, opened, run, score,
};
use boresight::diagnose::DiagnoseOptions;
use boresight::recording::write_file;
use clap::{Args, Subcommand};

use super::options::heading;
use super::{Answer, output};

/// Arguments of `blind`.
#[derive(Debug, Args)]
pub(crate) struct BlindArgs {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    /// Make recordings, write their truths into a folder of its own and seal them
    Generate(GenerateArgs),
    /// Diagnose what is sealed and has no answer yet
    Run(RunArgs),
    /// Unseal the truths and score the answers
    Score(ScoreArgs),
    /// Unseal the truths of the families image-… and score the answers
    ScoreImages(ScoreImagesArgs),
    /// Validate the hold-out scores on answered nulls: run these with a loose --alpha, so that chance is proposed
    HeldOut(HeldOutArgs),
}

#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
struct Which {
    /// The family: null, hard-null, ladder, natural, confuser, two, absorbed, off-library; of frames of pixels: pixel-null, pixel-ladder,
    /// pixel-absorbed, pixel-off-library; of effects hidden in the pixels themselves: image-null, image-hard-null, image-ladder, image-two,
    /// image-several
    #[arg(long, value_parser = family, help_heading = heading::INPUT)]
    family: Family,
    /// The first index
    #[arg(long, default_value_t = 0, help_heading = heading::INPUT)]
    from: u32,
    /// The index behind the last [default: every case of the family once]
    #[arg(long, help_heading = heading::INPUT)]
    to: Option<u32>,
    /// Only every Nth index, from the Ith on, for N machines that share the work
    #[arg(long, value_name = "I/N", value_parser = shard, help_heading = heading::INPUT)]
    shard: Option<[u32; 2]>,
    /// The benchmark's folder
    #[arg(short, long, value_name = "DIR", value_parser = super::options::folder())]
    output: PathBuf,
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct GenerateArgs {
    #[command(flatten)]
    which: Which,
    /// The seed of all recordings of the folder
    #[arg(long, default_value_t = 1, help_heading = heading::INPUT)]
    seed: u64,
    /// Write the recordings into DIR/recordings too; `run` makes them anew, the same
    #[arg(long, help_heading = heading::OUTPUT)]
    write: bool,
}

#[derive(Debug, Args)]
struct RunArgs {
    #[command(flatten)]
    which: Which,
    /// Minimum number of null simulations per recording [default: as `diagnose`]
    #[arg(long, value_name = "N", help_heading = heading::STATISTICS)]
    nulls: Option<usize>,
    /// Family-wise probability of a false finding in a recording [default: as `diagnose`]
    #[arg(long, value_name = "P")]
    alpha: Option<f64>,
}

#[derive(Debug, Args)]
struct HeldOutArgs {
    /// The benchmark's folder
    #[arg(short, long, value_name = "DIR", value_parser = super::options::folder())]
    output: PathBuf,
    /// The commit that the page is to name
    #[arg(long, value_name = "HASH", default_value = "unknown")]
    commit: String,
    /// Also write the page into this file
    #[arg(long, value_name = "FILE.md")]
    page: Option<PathBuf>,
    /// Print the figures as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
struct ScoreArgs {
    /// The benchmark's folder
    #[arg(short, long, value_name = "DIR", value_parser = super::options::folder())]
    output: PathBuf,
    /// Also write the page of tables into this file
    #[arg(long, value_name = "FILE.md")]
    page: Option<PathBuf>,
    /// Print the figures as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
struct ScoreImagesArgs {
    /// The benchmark's folder
    #[arg(short, long, value_name = "DIR", value_parser = super::options::folder())]
    output: PathBuf,
    /// Folders of other shards of the same seed, scored with it
    #[arg(long, value_name = "DIR", num_args = 1.., help_heading = heading::INPUT)]
    also: Vec<PathBuf>,
    /// Scores of other parts of the same study (their score-images.json), joined to it: seed and program must be the same
    #[arg(long, value_name = "FILE.json", num_args = 1.., help_heading = heading::INPUT)]
    parts: Vec<PathBuf>,
    /// The commit that the page is to name
    #[arg(long, value_name = "HASH", default_value = "unknown")]
    commit: String,
    /// Also write the page of tables into this file
    #[arg(long, value_name = "FILE.md")]
    page: Option<PathBuf>,
    /// Print the figures as one JSON object on stdout, and nothing else
    #[arg(long)]
    json: bool,
}

fn family(text: &str) -> std::result::Result<Family, String> {
    let names: Vec<&str> = FAMILIES.iter().map(|family| family.name()).collect();
    Family::named(text).ok_or_else(|| format!("choose one of: {}", names.join(", ")))
}

/// I/N, the I from 1 to N.
fn shard(text: &str) -> std::result::Result<[u32; 2], String> {
    let parts = text.split_once('/').and_then(|(own, all)| Some([own.parse().ok()?, all.parse().ok()?]));
    parts.filter(|[own, all]| (1..=*all).contains(own)).ok_or_else(|| "give I/N, as 2/5: the second of five parts".to_owned())
}

impl Which {
    fn indices(&self) -> Result<Vec<u32>> {
        let to = self.to.unwrap_or_else(|| self.from.saturating_add(self.family.cycle()));
        if to <= self.from {
            bail!("--from {} --to {to}: there is no index between them; --to names the index behind the last", self.from);
        }
        let [own, all] = self.shard.unwrap_or([1, 1]);
        Ok((self.from..to).filter(|index| index % all == own - 1).collect())
    }

    fn deliver(&self, sealed: usize, answered: usize, seed: Option<u64>) -> Result<()> {
        let mut provenance = output::provenance();
        provenance.seed = seed;
        let object = StepResult::new(self.family, sealed, answered, provenance);
        if self.json {
            return output::print(&output::json_text(&object)?);
        }
        output::print(&format!("{}: {sealed} sealed in all, {answered} answered now\n", self.family.name()))
    }
}

/// The score that a file holds.
fn score_of(path: &Path) -> Result<ImageScore> {
    let text = std::fs::read_to_string(path).with_context(|| format!("--parts {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("--parts {}: it is no score-images.json", path.display()))
}

/// `boresight blind score-images`.
fn score_images(asked: &ScoreImagesArgs) -> Result<()> {
    let mut pairs = Vec::new();
    let is_page_alone = !asked.parts.is_empty() && !is_sealed(&asked.output);
    if is_page_alone {
        tracing::warn!("{}: no recordings are sealed here; the score is that of --parts and --also alone", asked.output.display());
    }
    for folder in asked.also.iter().chain((!is_page_alone).then_some(&asked.output)) {
        pairs.extend(opened(folder)?);
    }
    pairs.retain(|(truth, _)| truth.family.is_of_images());
    let first = pairs.first().map(|(truth, _)| truth.seed);
    if first.is_none() && asked.parts.is_empty() {
        bail!("{}: nothing of the families image-… is answered yet; run `boresight blind run` first", asked.output.display());
    }
    if pairs.iter().any(|(truth, _)| Some(truth.seed) != first) {
        bail!("--also: the folders hold recordings of different seeds; score each by itself");
    }
    let own = first.map(|_| image_score(&pairs));
    if own.as_ref().is_some_and(|own| own.recordings.values().map(BTreeSet::len).sum::<usize>() < pairs.len()) {
        bail!("--also: the folders hold the same recordings, which would count twice; leave one of them out");
    }
    let parts: Vec<ImageScore> = own.into_iter().map(Ok).chain(asked.parts.iter().map(|path| score_of(path))).collect::<Result<_>>()?;
    let score = joined(&parts).context("--parts")?;
    let mut provenance = output::provenance();
    provenance.seed = Some(score.seed);
    let object = ImageScoreResult { format: SCORE_FORMAT, score, provenance };
    let page = image_markdown(&object.score, &asked.commit);
    write_file(&asked.output.join("score-images.json"), output::json_text(&object)?.as_bytes())?;
    write_file(&asked.output.join("blind-pixels.md"), page.as_bytes())?;
    if let Some(path) = &asked.page {
        write_file(path, page.as_bytes()).with_context(|| format!("--page {}", path.display()))?;
    }
    output::print(&if asked.json { output::json_text(&object)? } else { page })
}

/// `boresight blind`.
pub(crate) fn blind(args: &BlindArgs) -> Result<Answer> {
    match &args.step {
        Step::Generate(generate) => {
            let which = &generate.which;
            let sealed = make(&which.output, which.family, which.indices()?, generate.seed, generate.write)?;
            which.deliver(sealed.files.len(), 0, Some(generate.seed))?;
        }
        Step::Run(run_args) => {
            let which = &run_args.which;
            let indices = which.indices()?;
            let defaults = DiagnoseOptions::default();
            let alpha = run_args.alpha.unwrap_or(defaults.alpha);
            if !(alpha > 0.0 && alpha < 1.0) {
                bail!("--alpha {alpha}: a probability between 0 and 1 is needed");
            }
            let options = DiagnoseOptions { nulls: run_args.nulls.unwrap_or(defaults.nulls), alpha, ..defaults };
            let bar = output::progress("diagnosing", indices.len());
            let answered = run(&which.output, which.family, indices, &options, || bar.inc(1))?;
            bar.finish_and_clear();
            which.deliver(0, answered, None)?;
        }
        Step::Score(score_args) => {
            let pairs = opened(&score_args.output)?;
            if pairs.is_empty() {
                bail!("{}: nothing is answered yet; run `boresight blind run` first", score_args.output.display());
            }
            let object = ScoreResult { score: score(&pairs), provenance: output::provenance() };
            let page = markdown(&object.score);
            write_file(&score_args.output.join("score.json"), output::json_text(&object)?.as_bytes())?;
            write_file(&score_args.output.join("blind.md"), page.as_bytes())?;
            if let Some(path) = &score_args.page {
                write_file(path, page.as_bytes()).with_context(|| format!("--page {}", path.display()))?;
            }
            output::print(&if score_args.json { output::json_text(&object)? } else { page })?;
        }
        Step::ScoreImages(asked) => score_images(asked)?,
        Step::HeldOut(held_out) => {
            let study = held_out_study(&answers(&held_out.output, Family::Null)?);
            if study.recordings == 0 {
                bail!("{}: no null is answered yet; run `boresight blind run --family null --alpha 0.5` first", held_out.output.display());
            }
            let page = study.markdown(&held_out.commit);
            if let Some(path) = &held_out.page {
                write_file(path, page.as_bytes()).with_context(|| format!("--page {}", path.display()))?;
            }
            let is_honest = study.is_honest();
            let object = HeldOutResult { format: SCORE_FORMAT, study, provenance: output::provenance() };
            output::print(&if held_out.json { output::json_text(&object)? } else { page })?;
            return Ok(if is_honest { Answer::Yes } else { Answer::No });
        }
    }
    Ok(Answer::Yes)
}
