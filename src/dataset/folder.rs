//! The folder of a dataset: what it says of itself, and that it belongs to one recipe.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::error::DatasetError;
use super::frame_key::{DatasetSplit, FrameKey, ShardKey};
use super::leaks::SharedBySplits;
use super::pixel_labels::PIXEL_CLASSES;
use super::plan::{DatasetPlan, hexadecimal};
use super::recipe::{ImageFormat, SampleMember};
use super::shard::{done, write_json, write_text};
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
    /// On what frames are rendered.
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
    /// What each two of them share.
    pub leaks: Vec<SharedBySplits>,
    /// No boresight of a split is nearer than this to a cell of another one; 0 where splits are not apart by sky.
    pub guard_deg: f64,
    /// Half the diagonal of the field.
    pub field_radius_deg: f64,
    /// What the values of masks mean.
    pub pixel_classes: Vec<DescribedName>,
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
    /// Its camera instances.
    pub cameras: u64,
    /// Number of its first frame.
    pub first_frame: u64,
    /// Its cells of the sky, and all of them; 0 where splits are not apart by sky.
    pub sky_cells: [usize; 2],
    /// The share of the whole sky that its boresights may fall into.
    pub sky_share: f64,
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

impl DatasetPlan {
    /// What the dataset is.
    #[must_use]
    pub fn describe(&self, catalog: &Catalog) -> DatasetFile {
        let (recipe, size) = (&self.recipe, &self.recipe.size);
        let mut hasher = Sha256::new();
        hasher.update(&self.sha256);
        hasher.update(&catalog.sha256);
        let split = |split: &DatasetSplit| {
            let frames = size.frames.of(*split);
            (frames > 0).then(|| DescribedSplit {
                name: split.name().to_owned(),
                frames,
                shards: frames / size.frames_per_shard,
                cameras: recipe.cameras.of(*split),
                first_frame: FrameKey { split: *split, index: 0 }.number(),
                sky_cells: self.regions.as_ref().map_or([0; 2], |regions| regions.cells(split.rank())),
                sky_share: self.regions.as_ref().map_or(1.0, |regions| regions.share(split.rank())),
            })
        };
        DatasetFile {
            format: DATASET_FORMAT.to_owned(),
            name: recipe.name.clone(),
            licence: recipe.licence.clone().unwrap_or_default(),
            seed: recipe.seed,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            backend: "cpu".to_owned(),
            recipe_sha256: hexadecimal(&hasher.finalize()),
            scene_sha256: self.scene_sha256.clone(),
            catalog: catalog.source.clone(),
            catalog_sha256: catalog.sha256.clone(),
            image: size.image,
            members: size.members.clone(),
            frames_per_shard: size.frames_per_shard,
            splits: DatasetSplit::ALL.iter().filter_map(split).collect(),
            leaks: self.leaks(catalog),
            guard_deg: self.guard_deg,
            field_radius_deg: self.field_radius_deg,
            pixel_classes: described(&PIXEL_CLASSES),
        }
    }
}

/// The folder of a dataset, begun or gone on with.
#[derive(Debug)]
pub(super) struct DatasetFolder {
    pub(super) path: PathBuf,
}

const DESCRIPTION: &str = "dataset.json";
const RECIPE: &str = "recipe.toml";
const SUMS: &str = "SHA256SUMS";

impl DatasetFolder {
    /// Begins the folder, or goes on with what it holds if that is of the same recipe; with `force` what is of another one is removed.
    pub(super) fn open(path: &Path, plan: &DatasetPlan, dataset: &DatasetFile, force: bool) -> Result<Self, DatasetError> {
        let error = |source| DatasetError::Output(OutputError::Write { path: path.to_owned(), source });
        if path.exists() && !path.is_dir() {
            return Err(OutputError::NotAFolder { path: path.to_owned() }.into());
        }
        let folder = Self { path: path.to_owned() };
        match std::fs::read_to_string(path.join(DESCRIPTION)) {
            Ok(text) => {
                // Read with few keys, so that one of another version is known too.
                #[derive(Deserialize)]
                struct Head {
                    recipe_sha256: String,
                }
                let is_same = serde_json::from_str::<Head>(&text).is_ok_and(|head| head.recipe_sha256 == dataset.recipe_sha256);
                if is_same {
                    return Ok(folder);
                }
                if !force {
                    return Err(DatasetError::OtherRecipe { path: path.to_owned() });
                }
                folder.clear().map_err(error)?;
            }
            Err(_) if path.exists() => {
                let entries = std::fs::read_dir(path).map_err(error)?.flatten();
                if entries.into_iter().any(|entry| !entry.file_name().as_encoded_bytes().starts_with(b".boresight-")) {
                    return Err(OutputError::Foreign { path: path.to_owned() }.into());
                }
            }
            Err(_) => {}
        }
        // The description comes first: it makes the folder known as that of the recipe, also to a process that begins at the same time.
        write_json(&path.join(DESCRIPTION), dataset)?;
        write_text(&path.join(RECIPE), &plan.text)?;
        Ok(folder)
    }

    /// Removes what an earlier run wrote, and nothing else.
    fn clear(&self) -> std::io::Result<()> {
        let is_of = |name: &std::ffi::OsStr, end: &str| name.to_str().is_some_and(|name| name.ends_with(end));
        let folders = DatasetSplit::ALL.iter().map(|split| (split.name(), ".tar")).chain([("shards", ".json")]);
        for (name, end) in folders {
            let folder = self.path.join(name);
            for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
                if is_of(&entry.file_name(), end) {
                    std::fs::remove_file(entry.path())?;
                }
            }
            // What holds a file of the user's stays.
            let _ = std::fs::remove_dir(&folder);
        }
        for name in [SUMS, RECIPE, DESCRIPTION] {
            match std::fs::remove_file(self.path.join(name)) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        Ok(())
    }

    /// Writes SHA256SUMS if every shard is done; says how many are not.
    pub(super) fn finish(&self, plan: &DatasetPlan, recipe_sha256: &str) -> Result<usize, DatasetError> {
        let mut sums: Vec<(String, String)> = Vec::new();
        let mut missing = 0;
        for shard in ShardKey::all(&plan.recipe.size) {
            match done(&self.path, shard, recipe_sha256)? {
                Some(mark) => {
                    let text = std::fs::read(self.path.join(shard.mark()));
                    let text = text.map_err(|source| DatasetError::Read { path: shard.mark(), source })?;
                    sums.push((shard.mark(), hexadecimal(&Sha256::digest(text))));
                    sums.push((mark.file, mark.sha256));
                }
                None => missing += 1,
            }
        }
        if missing > 0 {
            return Ok(missing);
        }
        for name in [DESCRIPTION, RECIPE] {
            let path = self.path.join(name);
            let bytes = std::fs::read(&path).map_err(|source| DatasetError::Read { path: path.display().to_string(), source })?;
            sums.push((name.to_owned(), hexadecimal(&Sha256::digest(bytes))));
        }
        sums.sort();
        let mut text = String::new();
        for (name, sum) in sums {
            text += &format!("{sum}  {name}\n");
        }
        write_text(&self.path.join(SUMS), &text)?;
        Ok(0)
    }
}
