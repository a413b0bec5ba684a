//! Options that several verbs share.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result};
use boresight::camera::Physics;
use boresight::catalog::Catalog;
use boresight::effects::ids;
use boresight::guard::guarded;
use boresight::imaging::Backend;
use boresight::pipeline::{Centroid, Dark, MeasureOptions, SkyChoice};
use boresight::provenance::Provenance;
use boresight::recording::ResultFolder;
use boresight::scene::Scene;
use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Args, ValueEnum};

use super::output;
use super::told::ToldArgs;

/// The groups of options in the help of every verb, in the order in which the verbs declare them.
pub(crate) mod heading {
    /// What is read, and what its files do not say.
    pub(crate) const INPUT: &str = "Input";
    /// How stars are found and measured.
    pub(crate) const MEASURING: &str = "Measuring";
    /// Which stars take part.
    pub(crate) const CATALOGUE: &str = "Catalogue";
    /// What the model contains and which of its parameters are free.
    pub(crate) const MODEL: &str = "Model";
    /// How stars are named.
    pub(crate) const SEARCH: &str = "Identification";
    /// How the model is solved.
    pub(crate) const SOLVER: &str = "Solver";
    /// What is judged, and how sure that must be.
    pub(crate) const STATISTICS: &str = "Statistics";
    /// Going on from an earlier result.
    pub(crate) const UPDATE: &str = "Update";
    /// How frames are rendered.
    pub(crate) const RENDERING: &str = "Rendering";
    /// What is done wrong on purpose.
    pub(crate) const TRIAL: &str = "Trials of the method";
    /// Where results go.
    pub(crate) const OUTPUT: &str = "Output";
    /// What every verb takes.
    pub(crate) const GLOBAL: &str = "Global";
}

/// Where results go.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::OUTPUT)]
pub(crate) struct OutputArgs {
    /// Print the result as one JSON object on stdout, and nothing else
    #[arg(long)]
    pub(crate) json: bool,
    /// Also write the result, tables and pictures into this folder
    #[arg(short, long, value_name = "DIR", value_parser = folder())]
    pub(crate) output: Option<PathBuf>,
    /// Replace what an earlier run of this verb wrote there
    #[arg(long)]
    pub(crate) force: bool,
}

impl OutputArgs {
    /// The folder, made or refused before the work, for the results of a verb.
    pub(crate) fn open(&self, verb: &'static str) -> Result<Option<ResultFolder>> {
        Ok(self.output.as_deref().map(|folder| ResultFolder::open(folder, verb, self.force)).transpose()?)
    }
}

/// A folder that is there or can be made; a file in its place is noticed before the work, not after it.
pub(crate) fn folder() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new()
        .try_map(|path| if path.exists() && !path.is_dir() { Err("this is a file; name a folder".to_owned()) } else { Ok(path) })
}

/// What is read.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::INPUT)]
pub(crate) struct InputArgs {
    /// A recording (folder with recording.toml, or folder of FITS files) or images
    #[arg(required = true, value_name = "RECORDING|IMAGE", help_heading = None)]
    pub(crate) inputs: Vec<PathBuf>,
    /// Skip bad frames and list them in the result, instead of stopping at the first
    #[arg(long)]
    pub(crate) keep_going: bool,
    #[command(flatten)]
    pub(crate) told: ToldArgs,
}

/// How stars are measured.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = heading::MEASURING)]
pub(crate) struct MeasureArgs {
    /// Centroid estimator
    #[arg(long, value_enum, default_value_t = CentroidChoice::Gaussian)]
    centroid: CentroidChoice,
    /// Subtract the median of these dark frames (an image, or a folder of images) from every frame, and mask its hot pixels
    #[arg(long, value_name = "FILE|FOLDER")]
    dark: Option<PathBuf>,
    /// Detection threshold, signal-to-noise ratio [default: such that noise makes one false star a frame]
    #[arg(long, value_name = "SNR", value_parser = threshold, allow_negative_numbers = true)]
    detection_threshold: Option<f64>,
}

/// Reads a signal-to-noise ratio from 2 to 1000.
pub(crate) fn threshold(text: &str) -> std::result::Result<f64, String> {
    text.parse::<f64>().ok().filter(|snr| (2.0..=1000.0).contains(snr)).ok_or_else(|| "give a number from 2 to 1000".into())
}

/// What is taken for a star's place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum CentroidChoice {
    /// Maximum-likelihood fit of a Gaussian integrated over the pixels
    #[default]
    Gaussian,
    /// The same with an ePSF learned from the recording's own stars, where held-out stars prefer it
    Empirical,
    /// Windowed centroids: quick, not at the statistical limit
    Windowed,
}

impl MeasureArgs {
    /// Whether places are those of the Gaussian fit, which the usual sizes of effects within a pixel speak of.
    pub(crate) fn is_gaussian(&self) -> bool {
        self.centroid == CentroidChoice::Gaussian
    }

    /// Reads the darks.
    pub(crate) fn options(&self, time_limit: Option<Duration>) -> Result<MeasureOptions> {
        let centroid = match self.centroid {
            CentroidChoice::Gaussian => Centroid::Gaussian,
            CentroidChoice::Empirical => Centroid::Empirical,
            CentroidChoice::Windowed => Centroid::Windowed,
        };
        let dark = self.dark.as_deref().map(Dark::read).transpose().context("--dark")?;
        Ok(MeasureOptions { centroid, dark, detection_threshold: self.detection_threshold, time_limit, ..MeasureOptions::default() })
    }
}

/// Which stars, and what happens to their light.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::CATALOGUE)]
pub(crate) struct SkyArgs {
    /// Read stars from this file (CSV, or made by `boresight catalog import`) instead of the built-in Hipparcos stars
    #[arg(long, value_name = "FILE")]
    pub(crate) catalog: Option<PathBuf>,
    /// The effects of known size that the model contains: a list, `none`, or `known` (all that follow from the recording)
    /// [default: known; in `diagnose` proper-motion]
    #[arg(long, value_name = "LIST|none|known", help_heading = heading::MODEL)]
    physics: Option<Physics>,
}

impl SkyArgs {
    /// What was asked for, or everything that is known.
    pub(crate) fn choice(&self) -> SkyChoice {
        SkyChoice::from(self.physics.clone().unwrap_or(Physics::Known))
    }

    /// What was asked for, or proper motion alone: whatever else is there is then found and not assumed. An effect that nobody asked for
    /// is no reason to refuse a recording.
    pub(crate) fn choice_of_diagnosis(&self) -> SkyChoice {
        let own = || SkyChoice { physics: Physics::List(vec![ids::PROPER_MOTION.to_owned()]), assumes_time: true };
        self.physics.clone().map_or_else(own, SkyChoice::from)
    }

    /// The catalogue to use.
    pub(crate) fn catalog(&self) -> Result<std::borrow::Cow<'static, Catalog>> {
        open_catalog(self.catalog.as_deref())
    }
}

/// Where frames are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BackendChoice {
    /// A hardware GPU if there is one, else the CPU
    Auto,
    /// Any Vulkan adapter, a software one (lavapipe) included; an error where there is none
    Gpu,
    /// The CPU twins
    Cpu,
}

impl From<BackendChoice> for Backend {
    fn from(choice: BackendChoice) -> Self {
        match choice {
            BackendChoice::Auto => Self::Auto,
            BackendChoice::Gpu => Self::Gpu,
            BackendChoice::Cpu => Self::Cpu,
        }
    }
}

/// How a scene is rendered.
#[derive(Debug, Args)]
#[command(next_help_heading = heading::RENDERING)]
pub(crate) struct SceneArgs {
    /// Where to render
    #[arg(long, value_enum, default_value_t = BackendChoice::Auto)]
    pub(crate) backend: BackendChoice,
    /// Another seed than the scene's
    #[arg(long, value_name = "SEED")]
    pub(crate) seed: Option<u64>,
    /// Read stars from this CSV file instead of the built-in Hipparcos stars
    #[arg(long, value_name = "FILE", help_heading = heading::CATALOGUE)]
    pub(crate) catalog: Option<PathBuf>,
}

impl SceneArgs {
    /// Reads the text of a scene.
    pub(crate) fn read(path: &Path) -> Result<String> {
        std::fs::read_to_string(path).with_context(|| format!("{}: the scene cannot be read", path.display()))
    }

    /// Reads the text of a scene.
    pub(crate) fn parse(&self, name: &str, text: &str) -> Result<(Scene, Provenance)> {
        let scene = match self.seed {
            Some(seed) => Scene::parse_with_seed(name, text, seed)?,
            None => Scene::parse(name, text)?,
        };
        let mut provenance = output::provenance();
        provenance.add_input_bytes(name, text.as_bytes());
        provenance.seed = Some(scene.seed);
        Ok((scene, provenance))
    }

    /// The catalogue to render.
    pub(crate) fn catalog(&self, provenance: &mut Provenance) -> Result<std::borrow::Cow<'static, Catalog>> {
        if let Some(path) = &self.catalog {
            provenance.add_input(path)?;
        }
        open_catalog(self.catalog.as_deref())
    }
}

/// The catalogue of this file, or the built-in one.
pub(crate) fn open_catalog(path: Option<&Path>) -> Result<std::borrow::Cow<'static, Catalog>> {
    Ok(match path {
        None => std::borrow::Cow::Borrowed(Catalog::embedded()),
        Some(path) => std::borrow::Cow::Owned(guarded(|| Catalog::from_file(path)).context("--catalog")?.context("--catalog")?),
    })
}
