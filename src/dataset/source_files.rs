//! The files that a recipe follows from: its scene, tables of quantiles, and images that the scene or a draw names.
//!
//! They are hashed, since frames follow from them, and kept in the folder of the dataset, so that its frames can be made again from the folder alone.

use std::io::Read;
use std::path::{Component, Path, PathBuf};

use sha2::{Digest, Sha256};
use toml::{Table, Value};

use super::error::DatasetError;
use super::recipe::RecipeFile;

/// A file that frames follow from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SourceFile {
    /// As seen from the recipe.
    pub(super) name: String,
    /// Where it is.
    path: PathBuf,
    /// Of its bytes. They stay in the file: frames under the stars may be many and large.
    pub(super) sha256: [u8; 32],
    /// How many they are.
    pub(super) bytes: u64,
}

/// Places of a scene that name an image.
const IMAGES: [(&str, &str); 3] = [("sky", "background_image"), ("psf", "image"), ("detector", "dark_frame")];
/// What a dataset has at the top of its folder.
const RESERVED: [&str; 12] = [
    "train",
    "validation",
    "test",
    "tables",
    "shards",
    "recipe.toml",
    "dataset.json",
    "README.md",
    "croissant.json",
    "statistics.html",
    "SHA256SUMS",
    ".boresight",
];

/// Whether a file can lie in the folder of the dataset under its own name, as seen from the recipe there.
pub(super) fn is_kept(name: &str) -> bool {
    let mut parts = Path::new(name).components().filter(|part| !matches!(part, Component::CurDir));
    let is_plain = parts.clone().all(|part| matches!(part, Component::Normal(_)));
    is_plain && parts.next().and_then(|part| part.as_os_str().to_str()).is_some_and(|first| !RESERVED.contains(&first))
}

impl SourceFile {
    /// Reads a file for its hash.
    fn new(name: String, path: &Path) -> Result<Self, DatasetError> {
        const PIECE: usize = 1 << 16;
        let (mut hasher, mut bytes, mut piece) = (Sha256::new(), 0, vec![0; PIECE]);
        let unread = |source| DatasetError::Read { path: path.display().to_string(), source };
        let mut file = std::fs::File::open(path).map_err(unread)?;
        loop {
            match file.read(&mut piece).map_err(unread)? {
                0 => return Ok(Self { name, path: path.to_owned(), sha256: hasher.finalize().into(), bytes }),
                count => {
                    hasher.update(&piece[..count]);
                    bytes += count as u64;
                }
            }
        }
    }

    /// Whether it can lie in the folder of the dataset.
    pub(super) fn is_kept(&self) -> bool {
        is_kept(&self.name)
    }

    /// Its bytes, if they still are what frames follow from.
    pub(super) fn read(&self) -> Result<Vec<u8>, DatasetError> {
        let path = self.path.display().to_string();
        let bytes = std::fs::read(&self.path).map_err(|source| DatasetError::Read { path: path.clone(), source })?;
        if <[u8; 32]>::from(Sha256::digest(&bytes)) == self.sha256 {
            Ok(bytes)
        } else {
            Err(DatasetError::Parse { path, message: "was changed since the recipe was read; run the command again".to_owned() })
        }
    }
}

/// All of them. `folder` is that of the recipe, `scene_path` the scene.
pub(super) fn sources(recipe: &RecipeFile, scene: &Table, (folder, scene_path): (&Path, &str)) -> Result<Vec<SourceFile>, DatasetError> {
    let mut found: Vec<SourceFile> = Vec::new();
    let mut add = |name: String, path: &Path| -> Result<(), DatasetError> {
        if found.iter().any(|known| known.name == name) {
            return Ok(());
        }
        found.push(SourceFile::new(name, path)?);
        Ok(())
    };
    let is_preset = recipe.scene.starts_with("preset:");
    if !is_preset {
        add(recipe.scene.clone(), Path::new(scene_path))?;
    }
    let beside = |path: &str, file: &str| Path::new(path).parent().unwrap_or(Path::new("")).join(file);
    // Images that a preset is given begin at the folder of the process: they are hashed, and bear a name that is not kept.
    let name = |file: &str| if is_preset { format!("../{file}") } else { beside(&recipe.scene, file).display().to_string() };
    for (table, key) in IMAGES {
        if let Some(file) = scene.get(table).and_then(|table| table.get(key)).and_then(Value::as_str) {
            add(name(file), &beside(scene_path, file))?;
        }
    }
    for draw in &recipe.draw {
        let is_image = IMAGES.iter().any(|(table, key)| draw.path == format!("{table}.{key}"));
        let drawn = draw.choice.as_ref().filter(|_| is_image).map_or(&[][..], |choice| &choice.values);
        for file in drawn.iter().filter_map(Value::as_str) {
            add(name(file), &beside(scene_path, file))?;
        }
        if let Some(table) = &draw.table {
            add(table.file.display().to_string(), &folder.join(&table.file))?;
        }
    }
    Ok(found)
}

/// Adds files by their names, as seen from the recipe in its folder.
pub(super) fn add_sources<'n>(
    sources: &mut Vec<SourceFile>,
    names: impl Iterator<Item = &'n str>,
    folder: &Path,
) -> Result<(), DatasetError> {
    for name in names {
        sources.push(SourceFile::new(name.to_owned(), &folder.join(name))?);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::plan::DatasetPlan;
    use crate::dataset::plan::tests::{SCENE, recipe};

    #[test]
    fn images_that_are_drawn_count_for_the_identity_of_a_dataset() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
        let draw = "[[draw]]\nper = \"frame\"\npath = \"sky.background_image\"\nchoice = { values = [\"a.fits\", \"b.fits\"] }\n";
        let level = |name: &str, level: f32| {
            let path = folder.path().join(name);
            let headers = crate::recording::FitsHeaders::default();
            crate::recording::write_fits_f32(&path, 64, 48, &vec![level; 64 * 48], &headers).unwrap();
        };
        level("a.fits", 1.0);
        level("b.fits", 2.0);
        let plan = || DatasetPlan::parse("r.toml", &recipe(draw), folder.path()).unwrap();
        let first = plan();
        let names: Vec<&str> = first.sources.iter().map(|source| source.name.as_str()).collect();
        assert_eq!(names, ["scene.toml", "a.fits", "b.fits"]);
        assert!(first.sources.iter().all(SourceFile::is_kept));
        level("b.fits", 3.0);
        assert_ne!(plan().sha256, first.sha256);
        // What was copied would not be what was hashed.
        let changed = first.sources[2].read().unwrap_err().to_string();
        assert!(changed.contains("b.fits: was changed since the recipe was read"), "{changed}");
    }

    /// A dark frame that the scene itself names is one of them.
    #[test]
    fn a_dark_frame_of_the_scene_counts_for_the_identity() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scene.toml"), format!("{SCENE}[detector]\ndark_frame = \"dark.fits\"\n")).unwrap();
        let dark = |level: u16| {
            let headers = crate::recording::FitsHeaders::default();
            crate::recording::write_fits_u16(&folder.path().join("dark.fits"), 64, 48, &vec![level; 64 * 48], &headers).unwrap();
        };
        let plan = || DatasetPlan::parse("r.toml", &recipe(""), folder.path()).unwrap();
        dark(200);
        let first = plan();
        assert!(first.sources.iter().any(|source| source.name == "dark.fits" && source.is_kept()), "{:?}", first.sources);
        dark(201);
        assert_ne!(plan().sha256, first.sha256);
    }

    #[test]
    fn what_lies_elsewhere_or_would_cover_the_dataset_is_not_kept() {
        assert!(is_kept("scene.toml") && is_kept("./scenes/a.toml"));
        for name in ["../scene.toml", "/scene.toml", "a/../../b", "train/scene.toml", "README.md", ""] {
            assert!(!is_kept(name), "{name}");
        }
    }
}
