//! The folder of a dataset: what it says of itself, and that it belongs to one recipe.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::error::DatasetError;
use super::frame_key::{DatasetSplit, FrameKey, ShardKey};
use super::leaks::SharedBySplits;
use super::pixel_labels::PIXEL_CLASSES;
use super::plan::{CPU, DatasetPlan, hexadecimal};
use super::recipe::{ApartBy, ImageFormat, SampleMember};
use super::shard::{HashedFile, ShardMark, done, write_bytes, write_json, write_text};
use super::source_files::{SourceFile, is_kept};
use crate::catalog::Catalog;
use crate::recording::OutputError;

/// The name of the format.
pub const DATASET_FORMAT: &str = "boresight-dataset/1";

/// `dataset.json`: what a dataset is. It follows from recipe, scene, catalogue and version alone, so it is the same wherever and however often the
/// dataset is made, and bears no command line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DatasetFile {
    /// Always `boresight-dataset/1`.
    pub format: String,
    /// Name of the dataset.
    pub name: String,
    /// Licence, as an SPDX expression; empty if none is stated.
    pub licence: String,
    /// Seed of all that is drawn.
    pub seed: u64,
    /// Version of the program.
    pub version: String,
    /// On what frames are rendered: `cpu`, or the adapter and its driver.
    pub backend: String,
    /// Hash of recipe, scene, tables, catalogue and version: of everything that the frames follow from.
    pub recipe_sha256: String,
    /// SHA-256 of the scene.
    pub scene_sha256: String,
    /// Where the stars are from.
    pub catalog: String,
    /// SHA-256 of the catalogue.
    pub catalog_sha256: String,
    /// How images are written.
    pub image: ImageFormat,
    /// What stands in every sample besides image and labels.
    pub members: Vec<SampleMember>,
    /// Frames of every shard.
    pub frames_per_shard: u64,
    /// The splits that have frames.
    pub splits: Vec<DescribedSplit>,
    /// What no two of them share.
    #[serde(default)]
    pub apart_by: Vec<ApartBy>,
    /// What each two of them share.
    pub leaks: Vec<SharedBySplits>,
    /// No boresight of a split is nearer than this to a cell of another one; 0 where splits are not apart by sky.
    pub guard_deg: f64,
    /// Half the diagonal of the widest field that is drawn.
    pub field_radius_deg: f64,
    /// What the values of masks mean.
    pub pixel_classes: Vec<DescribedName>,
    /// The files that the frames follow from and that are kept here, beside recipe.toml.
    pub sources: Vec<HashedFile>,
    /// Those that are not, since they lie above the folder of the recipe: frames can be made again only where they are.
    pub sources_elsewhere: Vec<String>,
}

impl DatasetFile {
    /// Reads `dataset.json` of a folder.
    pub fn read(folder: &Path) -> Result<Self, DatasetError> {
        let path = folder.join(DESCRIPTION).display().to_string();
        let refuse = |message: &str| Err(DatasetError::NoDataset { path: folder.display().to_string(), message: message.to_owned() });
        if folder.is_file() {
            return refuse(
                "is a file and not the folder of a dataset; give the folder (a recipe of the name of a step is given as ./NAME)",
            );
        }
        let text = match std::fs::read_to_string(folder.join(DESCRIPTION)) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return refuse("holds no dataset.json; make the dataset with `boresight dataset RECIPE.toml -o DIR`");
            }
            Err(source) => return Err(DatasetError::Read { path, source }),
        };
        let wrong = |message: String| DatasetError::Parse { path: path.clone(), message };
        let own: Self = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        match own.format.as_str() {
            DATASET_FORMAT => Ok(own),
            other => Err(wrong(format!("format = {other:?} must be {DATASET_FORMAT:?}"))),
        }
    }

    /// All its shards in order.
    #[must_use]
    pub fn shards(&self) -> Vec<ShardKey> {
        let of_split = |split: &DescribedSplit| {
            let own = DatasetSplit::ALL.into_iter().find(|known| known.name() == split.name);
            own.into_iter().flat_map(|own| (0..split.shards).map(move |index| ShardKey { split: own, index })).collect::<Vec<_>>()
        };
        self.splits.iter().flat_map(of_split).collect()
    }

    /// Its frames.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.splits.iter().map(|split| split.frames).sum()
    }
}

/// A split of a dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DescribedSplit {
    /// Its name.
    pub name: String,
    /// Its frames.
    pub frames: u64,
    /// Its shards.
    pub shards: u64,
    /// Its camera instances: no more than it has recordings.
    pub cameras: u64,
    /// Number of its first frame.
    pub first_frame: u64,
    /// Its cells of the sky, and all of them; 0 where splits are not apart by sky.
    pub sky_cells: [usize; 2],
    /// The share of the whole sky that its boresights may fall into; 0: they are single places.
    pub sky_share: f64,
}

impl DescribedSplit {
    /// Where in the sky its boresights may fall, in words.
    #[must_use]
    pub fn sky(&self) -> String {
        if self.sky_share > 0.0 { format!("{:.1} %", 100.0 * self.sky_share) } else { "single places".to_owned() }
    }
}

/// A name and what it stands for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DescribedName {
    /// The name.
    pub name: String,
    /// What it stands for.
    pub meaning: String,
}

fn described(names: &[(&str, &str)]) -> Vec<DescribedName> {
    names.iter().map(|(name, meaning)| DescribedName { name: (*name).to_owned(), meaning: (*meaning).to_owned() }).collect()
}

fn hashed(source: &SourceFile) -> HashedFile {
    HashedFile { file: source.name.clone(), sha256: hexadecimal(&source.sha256), bytes: source.bytes }
}

impl DatasetPlan {
    /// Hash of everything that the frames follow from.
    pub(super) fn identity(&self, catalog: &Catalog) -> String {
        let mut hasher = Sha256::new();
        hasher.update(&self.sha256);
        hasher.update(&catalog.sha256);
        // What a GPU makes never stands beside what a CPU or another one makes.
        if self.adapter != CPU {
            hasher.update(&self.adapter);
        }
        hexadecimal(&hasher.finalize())
    }

    /// What the dataset is.
    #[must_use]
    pub fn describe(&self, catalog: &Catalog) -> DatasetFile {
        let (recipe, size) = (&self.recipe, &self.recipe.size);
        let split = |split: &DatasetSplit| {
            let frames = size.frames.of(*split);
            (frames > 0).then(|| DescribedSplit {
                name: split.name().to_owned(),
                frames,
                shards: frames / size.frames_per_shard,
                cameras: recipe.cameras.of(*split).min(frames.div_ceil(size.frames_per_recording)),
                first_frame: FrameKey { split: *split, index: 0 }.number(),
                sky_cells: self.regions.as_ref().map_or([0; 2], |regions| regions.cells(split.rank())),
                sky_share: self
                    .regions
                    .as_ref()
                    .map_or(if self.points_anywhere() { 1.0 } else { 0.0 }, |regions| regions.share(split.rank())),
            })
        };
        DatasetFile {
            format: DATASET_FORMAT.to_owned(),
            name: recipe.name.clone(),
            licence: recipe.licence.clone().unwrap_or_default(),
            seed: recipe.seed,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            backend: self.adapter.clone(),
            recipe_sha256: self.identity(catalog),
            scene_sha256: self.scene_sha256.clone(),
            catalog: catalog.source.clone(),
            catalog_sha256: catalog.sha256.clone(),
            image: size.image,
            members: size.members.clone(),
            frames_per_shard: size.frames_per_shard,
            splits: DatasetSplit::ALL.iter().filter_map(split).collect(),
            apart_by: self.recipe.splits.apart_by.clone(),
            leaks: self.leaks(catalog),
            guard_deg: self.guard_deg,
            field_radius_deg: self.field_radius_deg,
            pixel_classes: described(&PIXEL_CLASSES),
            sources: self.sources.iter().filter(|source| source.is_kept()).map(hashed).collect(),
            sources_elsewhere: self.sources.iter().filter(|source| !source.is_kept()).map(|source| source.name.clone()).collect(),
        }
    }
}

/// The folder of a dataset, begun or gone on with.
#[derive(Debug)]
pub(super) struct DatasetFolder {
    pub(super) path: PathBuf,
}

pub(super) const DESCRIPTION: &str = "dataset.json";
pub(super) const RECIPE: &str = "recipe.toml";
pub(super) const SUMS: &str = "SHA256SUMS";
/// What is written when no shard is missing, besides the sums.
pub(super) const FINISHED: [&str; 3] = [CARD, CROISSANT, STATISTICS];
pub(super) const CARD: &str = "README.md";
pub(super) const CROISSANT: &str = "croissant.json";
pub(super) const STATISTICS: &str = "statistics.html";

/// What stands in a folder.
enum Described {
    /// A dataset with this description.
    By(String),
    /// Nothing, or what processes that begin write at first.
    New,
    /// Something else.
    Otherwise,
}

fn description_in(path: &Path) -> std::io::Result<Described> {
    std::fs::read_to_string(path.join(DESCRIPTION)).map(Described::By)
}

/// What stands in a folder.
fn described_by(path: &Path) -> std::io::Result<Described> {
    description_in(path).or_else(|_| second_look(path))
}

/// What stands in a folder that had no description at the first look. Another process may begin it at the same time: only where there is none now either
/// is what else is there somebody else's.
fn second_look(path: &Path) -> std::io::Result<Described> {
    if !path.exists() {
        return Ok(Described::New);
    }
    let mut entries = std::fs::read_dir(path)?.flatten();
    if entries.any(|entry| !entry.file_name().as_encoded_bytes().starts_with(b".boresight-")) {
        return Ok(description_in(path).unwrap_or(Described::Otherwise));
    }
    Ok(Described::New)
}

impl DatasetFolder {
    /// Begins the folder, or goes on with what it holds if that is of the same recipe; with `force` what is of another one is removed.
    pub(super) fn open(path: &Path, plan: &DatasetPlan, dataset: &DatasetFile, force: bool) -> Result<Self, DatasetError> {
        let error = |source| DatasetError::Output(OutputError::Write { path: path.to_owned(), source });
        if path.exists() && !path.is_dir() {
            return Err(OutputError::NotAFolder { path: path.to_owned() }.into());
        }
        let folder = Self { path: path.to_owned() };
        match described_by(path).map_err(error)? {
            Described::Otherwise => return Err(OutputError::Foreign { path: path.to_owned() }.into()),
            Described::By(text) => {
                // Read with few keys, so that one of another version is known too.
                #[derive(Deserialize)]
                struct Head {
                    recipe_sha256: String,
                }
                let is_same = serde_json::from_str::<Head>(&text).is_ok_and(|head| head.recipe_sha256 == dataset.recipe_sha256);
                if is_same {
                    // A process that was killed here may have left some of them out.
                    folder.write_sources(plan)?;
                    return Ok(folder);
                }
                if !force {
                    return Err(DatasetError::OtherRecipe { path: path.to_owned() });
                }
                // A recipe that fails takes nothing away.
                plan.try_frames()?;
                folder.clear(&text).map_err(error)?;
            }
            Described::New => plan.try_frames()?,
        }
        // The description comes first: it makes the folder known as that of the recipe, also to a process that begins at the same time.
        write_json(&path.join(DESCRIPTION), dataset)?;
        folder.write_sources(plan)?;
        Ok(folder)
    }

    /// Writes the recipe and what it names, as far as they are not there.
    fn write_sources(&self, plan: &DatasetPlan) -> Result<(), DatasetError> {
        let recipe = self.path.join(RECIPE);
        if !recipe.exists() {
            write_text(&recipe, &plan.text)?;
        }
        for source in plan.sources.iter().filter(|source| source.is_kept()) {
            let path = self.path.join(&source.name);
            if !path.exists() {
                write_bytes(&path, &source.read()?)?;
            }
        }
        Ok(())
    }

    /// Removes what an earlier run wrote, and nothing else; `description` is the text of its `dataset.json`.
    fn clear(&self, description: &str) -> std::io::Result<()> {
        let is_of = |name: &std::ffi::OsStr, end: &str| name.to_str().is_some_and(|name| name.ends_with(end));
        let own = DatasetSplit::ALL.iter().map(|split| (split.name().to_owned(), ".tar"));
        let of_tables = DatasetSplit::ALL.iter().map(|split| (format!("tables/{}", split.name()), ".parquet"));
        for (name, end) in own.chain(of_tables).chain([("tables".to_owned(), ".parquet"), ("shards".to_owned(), ".json")]) {
            let folder = self.path.join(name);
            for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
                if is_of(&entry.file_name(), end) {
                    std::fs::remove_file(entry.path())?;
                }
            }
            // What holds a file of the user's stays.
            let _ = std::fs::remove_dir(&folder);
        }
        let sources = serde_json::from_str::<DatasetFile>(description).map(|dataset| dataset.sources).unwrap_or_default();
        let sources = sources.into_iter().map(|source| source.file).filter(|name| is_kept(name));
        // The description goes last: while it is there the folder is known as that of a dataset.
        for name in sources.chain(FINISHED.map(str::to_owned)).chain([SUMS, RECIPE, DESCRIPTION].map(str::to_owned)) {
            match std::fs::remove_file(self.path.join(name)) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        Ok(())
    }

    /// The shards that are not made.
    pub(super) fn missing(&self, dataset: &DatasetFile) -> Result<Vec<ShardKey>, DatasetError> {
        let mut missing = Vec::new();
        for shard in dataset.shards() {
            if done(&self.path, shard, &dataset.recipe_sha256)?.is_none() {
                missing.push(shard);
            }
        }
        Ok(missing)
    }

    /// The marks of all shards, in order.
    pub(super) fn marks(&self, dataset: &DatasetFile) -> Result<Vec<(ShardKey, ShardMark)>, DatasetError> {
        let (mut marks, mut missing) = (Vec::new(), Vec::new());
        for shard in dataset.shards() {
            match done(&self.path, shard, &dataset.recipe_sha256)? {
                Some(mark) => marks.push((shard, mark)),
                None => missing.push(shard),
            }
        }
        match missing.first() {
            None => Ok(marks),
            Some(first) => Err(DatasetError::Missing {
                path: self.path.clone(),
                missing: missing.len(),
                all: missing.len() + marks.len(),
                first: first.file(),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;
    use crate::dataset::plan::tests::{SCENE, recipe};

    /// A description that another process wrote after the first look counts; files without one are somebody else's.
    #[test]
    fn a_description_that_came_meanwhile_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let look = || second_look(folder.path()).unwrap();
        assert!(matches!(look(), Described::New));
        std::fs::write(folder.path().join(".boresight-1"), "half").unwrap();
        assert!(matches!(look(), Described::New));
        std::fs::write(folder.path().join(RECIPE), "").unwrap();
        assert!(matches!(look(), Described::Otherwise));
        std::fs::write(folder.path().join(DESCRIPTION), "{}").unwrap();
        assert!(matches!(look(), Described::By(text) if text == "{}"));
    }

    /// Frames that fail where the ends of all draws do not: nothing is begun, and with `force` nothing is taken away.
    #[test]
    fn a_recipe_that_fails_leaves_everything_as_it_is() {
        let parent = tempfile::tempdir().unwrap();
        std::fs::write(parent.path().join("scene.toml"), SCENE).unwrap();
        let plan = || DatasetPlan::parse("r.toml", &recipe(""), parent.path()).unwrap();
        let mut failing = plan();
        failing.sha256 = "0".repeat(64);
        // After the ends were tried.
        failing.base.insert("detector".to_owned(), toml::Value::Table("bits = 8\nbias_dn = 300.0".parse().unwrap()));
        let path = parent.path().join("set");
        let open = |plan: &DatasetPlan, force| {
            let opened = DatasetFolder::open(&path, plan, &plan.describe(Catalog::embedded()), force);
            opened.map(|_| ()).map_err(|error| error.to_string())
        };
        let error = open(&failing, false).unwrap_err();
        assert!(error.contains("frame ") && error.contains("detector.bi"), "{error}");
        assert!(!path.exists());
        open(&plan(), false).unwrap();
        let before = std::fs::read_to_string(path.join(DESCRIPTION)).unwrap();
        open(&failing, true).unwrap_err();
        assert_eq!(std::fs::read_to_string(path.join(DESCRIPTION)).unwrap(), before);
    }

    /// Processes of one dataset that begin at the same time all find it theirs; what is another's stays another's.
    #[test]
    fn a_folder_is_begun_by_many_at_once() {
        const TOGETHER: usize = 4;
        let parent = tempfile::tempdir().unwrap();
        std::fs::write(parent.path().join("scene.toml"), SCENE).unwrap();
        let plan = DatasetPlan::parse("r.toml", &recipe(""), parent.path()).unwrap();
        let dataset = plan.describe(Catalog::embedded());
        for round in 0..100 {
            let (path, barrier) = (parent.path().join(round.to_string()), Barrier::new(TOGETHER));
            std::fs::create_dir(&path).unwrap();
            std::thread::scope(|scope| {
                let begin = || {
                    barrier.wait();
                    DatasetFolder::open(&path, &plan, &dataset, false).map(|_| ())
                };
                for own in (0..TOGETHER).map(|_| scope.spawn(begin)).collect::<Vec<_>>() {
                    assert!(own.join().unwrap().is_ok(), "round {round}");
                }
            });
        }
        // A process that was killed after the description left the rest to the next one.
        let killed = parent.path().join("0");
        for name in [RECIPE, "scene.toml"] {
            std::fs::remove_file(killed.join(name)).unwrap();
        }
        DatasetFolder::open(&killed, &plan, &dataset, false).map(|_| ()).unwrap();
        assert!(killed.join(RECIPE).exists() && killed.join("scene.toml").exists());
        let other = parent.path().join("other");
        std::fs::create_dir(&other).unwrap();
        std::fs::write(other.join("notes.txt"), "mine").unwrap();
        let refused = DatasetFolder::open(&other, &plan, &dataset, false).unwrap_err();
        assert!(matches!(refused, DatasetError::Output(OutputError::Foreign { .. })), "{refused}");
    }
}
