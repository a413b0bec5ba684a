//! The files that a recipe follows from: its scene, tables of quantiles, and images that the scene or a draw names.
//!
//! They are hashed, since frames follow from them, and kept in the folder of the dataset, so that its frames can be made again from the folder alone.

use std::path::{Component, Path};
use std::sync::Arc;

use toml::{Table, Value};

use super::error::DatasetError;
use super::recipe::RecipeFile;

/// A file that frames follow from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SourceFile {
    /// As seen from the recipe.
    pub(super) name: String,
    pub(super) bytes: Arc<[u8]>,
}

/// Places of a scene that name an image.
const IMAGES: [(&str, &str); 2] = [("sky", "background_image"), ("psf", "image")];
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

impl SourceFile {
    /// Whether it can lie in the folder of the dataset under its own name, as seen from the recipe there.
    pub(super) fn is_kept(&self) -> bool {
        let mut parts = Path::new(&self.name).components().filter(|part| !matches!(part, Component::CurDir));
        let is_plain = parts.clone().all(|part| matches!(part, Component::Normal(_)));
        is_plain && parts.next().and_then(|part| part.as_os_str().to_str()).is_some_and(|first| !RESERVED.contains(&first))
    }
}

/// All of them. `folder` is that of the recipe, `scene_path` the scene.
pub(super) fn sources(recipe: &RecipeFile, scene: &Table, (folder, scene_path): (&Path, &str)) -> Result<Vec<SourceFile>, DatasetError> {
    let mut found: Vec<SourceFile> = Vec::new();
    let mut add = |name: String, path: &Path| -> Result<(), DatasetError> {
        if found.iter().any(|known| known.name == name) {
            return Ok(());
        }
        let bytes = std::fs::read(path).map_err(|source| DatasetError::Read { path: path.display().to_string(), source })?;
        found.push(SourceFile { name, bytes: bytes.into() });
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
        let path = folder.join(name);
        let bytes = std::fs::read(&path).map_err(|source| DatasetError::Read { path: path.display().to_string(), source })?;
        sources.push(SourceFile { name: name.to_owned(), bytes: bytes.into() });
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
    }

    #[test]
    fn what_lies_elsewhere_or_would_cover_the_dataset_is_not_kept() {
        let kept = |name: &str| SourceFile { name: name.to_owned(), bytes: Vec::new().into() }.is_kept();
        assert!(kept("scene.toml") && kept("./scenes/a.toml"));
        for name in ["../scene.toml", "/scene.toml", "a/../../b", "train/scene.toml", "README.md", ""] {
            assert!(!kept(name), "{name}");
        }
    }
}
