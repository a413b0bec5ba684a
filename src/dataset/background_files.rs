//! `[background]`: real frames under the stars, and which of them a frame of a dataset has.

use std::path::Path;

use toml::{Table, Value};

use super::chance::AddressedChance;
use super::error::DatasetError;
use super::frame_key::{DatasetSplit, FrameKey};
use super::recipe::{BackgroundTable, DrawLevel, RecipeFile};
use super::scene_path::set;
use crate::recording::{FrameSize, image_size};

/// A file of `[background]`.
#[derive(Clone, Debug, PartialEq, Eq)]
struct BackgroundFile {
    /// As seen from the recipe.
    name: String,
    /// Where it is, absolute: scenes of the recipe lie in another folder.
    path: String,
    size: FrameSize,
}

/// The files of `[background]`, shared out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct BackgroundFiles {
    files: Vec<BackgroundFile>,
    /// Which of them each split has: from, and up to.
    of_splits: [(usize, usize); 3],
    has_sky: bool,
}

/// Whether a name fits a pattern with `*` and `?`.
fn fits(pattern: &[char], name: &[char]) -> bool {
    match (pattern, name) {
        ([], []) => true,
        (['*', rest @ ..], _) => (0..=name.len()).any(|taken| fits(rest, &name[taken..])),
        (['?', rest @ ..], [_, more @ ..]) => fits(rest, more),
        ([own, rest @ ..], [letter, more @ ..]) => own == letter && fits(rest, more),
        _ => false,
    }
}

/// Names of files that a pattern fits, in order, with the folder that it names.
fn matching(pattern: &str, folder: &Path) -> std::io::Result<Vec<String>> {
    let (parent, name) = pattern.rsplit_once('/').map_or(("", pattern), |(parent, name)| (parent, name));
    let pattern: Vec<char> = name.chars().collect();
    let mut found = Vec::new();
    for entry in std::fs::read_dir(if parent.is_empty() { folder.to_owned() } else { folder.join(parent) })? {
        let Ok(name) = entry?.file_name().into_string() else { continue };
        if fits(&pattern, &name.chars().collect::<Vec<_>>()) && !name.starts_with('.') {
            found.push(if parent.is_empty() { name } else { format!("{parent}/{name}") });
        }
    }
    found.sort();
    Ok(found)
}

impl BackgroundFiles {
    /// Finds the files of a recipe. `size`: columns and rows of the frames; `is_apart`: whether splits share no camera.
    pub(super) fn new(
        path: &str,
        folder: &Path,
        recipe: &RecipeFile,
        (size, is_apart): (FrameSize, bool),
    ) -> Result<Option<Self>, DatasetError> {
        let Some(BackgroundTable { frames: pattern, has_sky }) = &recipe.background else { return Ok(None) };
        let refuse = |remedy: String| {
            let (path, key) = (path.to_owned(), "background.frames".to_owned());
            Err(DatasetError::Value { path, key, value: format!("{pattern:?}"), remedy })
        };
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let names = match matching(pattern, folder) {
            Ok(names) if names.is_empty() => {
                return refuse(format!("fits no file in {}; give the frames as in \"darks/*.fits\"", folder.display()));
            }
            Ok(names) => names,
            Err(error) => return refuse(format!("names a folder that cannot be read ({error})")),
        };
        let mut files = Vec::with_capacity(names.len());
        for name in names {
            let own = folder.join(&name);
            let of_file = |problem: String| DatasetError::Parse {
                path: path.to_owned(),
                message: format!("background.frames: {}: {problem}", own.display()),
            };
            let found = image_size(&own).map_err(|problem| of_file(problem.to_string()))?;
            if found.width_px < size.width_px || found.height_px < size.height_px {
                return Err(of_file(format!("it has {found}, fewer than the frames, {size}; give frames of that size or larger")));
            }
            let absolute = std::path::absolute(&own).map_err(|error| of_file(error.to_string()))?;
            let Some(absolute) = absolute.to_str().map(str::to_owned) else { return Err(of_file("its path is not UTF-8".to_owned())) };
            files.push(BackgroundFile { name, path: absolute, size: found });
        }
        if recipe.draw.iter().any(|draw| draw.path == "detector.read_noise_e") {
            return refuse("takes the place of read noise; leave the [[draw]] of detector.read_noise_e out".to_owned());
        }
        let splits: Vec<DatasetSplit> = DatasetSplit::ALL.into_iter().filter(|split| recipe.size.frames.of(*split) > 0).collect();
        let mut of_splits = [(0, files.len()); 3];
        if is_apart && splits.len() > 1 {
            if files.len() < splits.len() {
                let (has, needs) = (files.len(), splits.len());
                return refuse(format!(
                    "fits {has} file, and {needs} splits that share no camera need one each: give {needs}, or leave \"camera\" out of splits.apart_by"
                ));
            }
            share_out(files.len(), &splits, recipe, &mut of_splits);
        }
        Ok(Some(Self { files, of_splits, has_sky: *has_sky }))
    }

    /// The files, as seen from the recipe.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.files.iter().map(|file| file.name.as_str())
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.files.len()
    }

    /// Puts a file into a scene, with its window from a place; gives its name.
    fn put(&self, index: usize, scene: &mut Table, corner: [usize; 2]) -> String {
        let BackgroundFile { name, .. } = &self.files[index];
        set(scene, "detector", "dark_frame", Value::String(name.clone()));
        let corner = corner.map(|place| Value::Integer(place.cast_signed() as i64)).to_vec();
        set(scene, "detector", "dark_frame_corner_px", Value::Array(corner));
        if self.has_sky {
            set(scene, "sky", "background_e_per_px_s", Value::Float(0.0));
        }
        name.clone()
    }

    /// Names the file of a scene by where it is.
    pub(super) fn resolve(&self, scene: &mut Table) {
        let Some(Value::String(dark)) = scene.get_mut("detector").and_then(|detector| detector.get_mut("dark_frame")) else { return };
        if let Some(file) = self.files.iter().find(|file| file.name == *dark) {
            dark.clone_from(&file.path);
        }
    }

    /// Puts a file into a scene that is tried.
    pub(super) fn put_on_trial(&self, index: usize, scene: &mut Table) {
        self.put(index, scene, [0; 2]);
    }

    /// Puts that of a frame into its scene; gives its name. `size`: columns and rows of the frame.
    pub(super) fn put_by_chance(&self, seed: u64, (key, camera): (FrameKey, u64), size: [usize; 2], scene: &mut Table) -> String {
        let (from, to) = self.of_splits[key.split.rank()];
        let below = |unit: f64, count: usize| ((unit * count as f64) as usize).min(count - 1);
        let of_frame = AddressedChance::new(seed, DrawLevel::Frame as u32, "background.file");
        let index = from + below(of_frame.uniform(key.number(), 0), to - from);
        let of_camera = AddressedChance::new(seed, DrawLevel::Camera as u32, "background.corner");
        let FrameSize { width_px, height_px } = self.files[index].size;
        let room = [width_px - size[0] + 1, height_px - size[1] + 1];
        let corner = [0, 1].map(|axis: usize| below(of_camera.uniform(camera, axis as u32), room[axis]));
        self.put(index, scene, corner)
    }
}

/// Gives each split files of its own, as many to one another as frames, and one at least.
fn share_out(count: usize, splits: &[DatasetSplit], recipe: &RecipeFile, of_splits: &mut [(usize, usize); 3]) {
    let total: u64 = splits.iter().map(|split| recipe.size.frames.of(*split)).sum();
    let mut from = 0;
    for (place, split) in splits.iter().enumerate() {
        let after = splits.len() - place - 1;
        let share = (count as f64 * recipe.size.frames.of(*split) as f64 / total as f64).round() as usize;
        let own = if after == 0 { count - from } else { share.clamp(1, count - from - after) };
        of_splits[split.rank()] = (from, from + own);
        from += own;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalog;
    use crate::dataset::plan::DatasetPlan;
    use crate::dataset::plan::tests::{SCENE, recipe};
    use crate::recording::{FitsHeaders, write_fits_u16};
    use crate::render::PsfTables;

    #[test]
    fn patterns_are_those_of_a_shell() {
        let fits = |pattern: &str, name: &str| fits(&pattern.chars().collect::<Vec<_>>(), &name.chars().collect::<Vec<_>>());
        assert!(fits("*.fits", "a.fits") && fits("d?rk-*.fits", "dark-01.fits") && fits("a", "a") && fits("*", ""));
        assert!(!fits("*.fits", "a.fit") && !fits("?", "") && !fits("a*b", "acbd"));
    }

    /// Darks of 70 × 50 px about 210 counts, each with one hot pixel of its own.
    fn darks(folder: &Path, count: usize) {
        std::fs::create_dir_all(folder.join("darks")).unwrap();
        std::fs::write(folder.join("scene.toml"), SCENE).unwrap();
        for file in 0..count {
            let mut pixels: Vec<u16> = (0..70 * 50_u32).map(|place| 207 + (place.wrapping_mul(2_654_435_761) >> 16) as u16 % 7).collect();
            pixels[25 * 70 + 30 + file] = 9000;
            let path = folder.join(format!("darks/{file}.fits"));
            write_fits_u16(&path, 70, 50, &pixels, &FitsHeaders::default()).unwrap();
        }
    }

    #[test]
    fn frames_lie_on_files_of_their_split_and_differ_from_them_by_the_stars_alone() {
        let folder = tempfile::tempdir().unwrap();
        darks(folder.path(), 3);
        let text =
            recipe("[splits]\napart_by = [\"camera\"]\n[background]\nframes = \"darks/*.fits\"\nhas_sky = true\n[hard]\nno_stars = 1.0\n");
        let plan = DatasetPlan::parse("r.toml", &text, folder.path()).unwrap();
        let of = |split, index| plan.sample(Catalog::embedded(), &PsfTables::default(), FrameKey { split, index }).unwrap();
        let names: Vec<String> = (0..8).map(|index| of(DatasetSplit::Train, index).labels.background_file.clone()).collect();
        assert!(names.iter().all(|name| ["darks/0.fits", "darks/1.fits"].contains(&name.as_str())), "{names:?}");
        assert!(names.iter().any(|name| *name != names[0]), "{names:?}");
        let sample = of(DatasetSplit::Test, 0);
        assert_eq!(sample.labels.background_file, "darks/2.fits");
        // Without stars and sky the counts are those of the file, in a window of it.
        let (_, png) = sample.members.iter().find(|(name, _)| *name == "image.png").unwrap();
        let pixels = image::load_from_memory(png).unwrap().into_luma16().into_raw();
        let file = crate::recording::load_image(&folder.path().join("darks/2.fits")).unwrap();
        let is_at = |left: usize, top: usize| {
            (0..48).all(|y| (0..64).all(|x| f32::from(pixels[y * 64 + x]) == file.pixels_dn[(top + y) * 70 + left + x]))
        };
        assert!((0..=6).any(|left| (0..=2).any(|top| is_at(left, top))), "the frame is no window of its file");
        // 207 … 213 counts at a gain of 2: the spread of the file, not that of the table. The hot pixel is marked.
        assert!((sample.labels.read_noise_e - 2.0 * 2.0 * 1.4826).abs() < 1.5, "{}", sample.labels.read_noise_e);
        let (_, mask) = sample.members.iter().find(|(name, _)| *name == "mask.png").unwrap();
        let hot = image::load_from_memory(mask).unwrap().into_luma8().into_raw();
        let marked: Vec<usize> = (0..hot.len()).filter(|place| hot[*place] == 7).collect();
        assert_eq!(marked, [pixels.iter().position(|count| *count == 9000).unwrap()]);
        // The scene that is told renders to the same counts.
        let key = FrameKey { split: DatasetSplit::Test, index: 0 };
        let scene = toml::to_string(&plan.scene_file(key).unwrap()).unwrap();
        let scene = crate::scene::Scene::parse("elsewhere/s.toml", &scene).unwrap();
        let again = crate::render::Renderer::new(&scene, Catalog::embedded(), crate::render::Backend::Auto).unwrap().render(0).unwrap();
        assert_eq!(again.pixels_dn, pixels);
        // The same recipe in another folder gives the same bytes.
        let elsewhere = tempfile::tempdir().unwrap();
        darks(elsewhere.path(), 3);
        let moved = DatasetPlan::parse("r.toml", &text, elsewhere.path()).unwrap();
        let there = moved.sample(Catalog::embedded(), &PsfTables::default(), key).unwrap();
        assert_eq!(there.members, sample.members);
    }

    #[test]
    fn files_that_cannot_be_used_are_refused_before_the_first_frame() {
        let folder = tempfile::tempdir().unwrap();
        darks(folder.path(), 1);
        let told = |more: &str| DatasetPlan::parse("r.toml", &recipe(more), folder.path()).map(|_| ()).unwrap_err().to_string();
        assert!(told("[background]\nframes = \"darks/*.png\"\n").contains("background.frames = \"darks/*.png\" fits no file in"));
        assert!(told("[background]\nframes = \"no/*.fits\"\n").contains("names a folder that cannot be read"));
        let apart = told("[splits]\napart_by = [\"camera\"]\n[background]\nframes = \"darks/*.fits\"\n");
        assert!(apart.contains("fits 1 file, and 2 splits that share no camera need one each: give 2"), "{apart}");
        let drawn = told(
            "[background]\nframes = \"darks/*.fits\"\n[[draw]]\nper = \"frame\"\npath = \"detector.read_noise_e\"\nuniform = [1, 2]\n",
        );
        assert!(drawn.contains("takes the place of read noise"), "{drawn}");
        write_fits_u16(&folder.path().join("darks/1.fits"), 20, 20, &[200; 400], &FitsHeaders::default()).unwrap();
        let small = told("[background]\nframes = \"darks/*.fits\"\n");
        assert!(small.contains("1.fits: it has 20 × 20 px, fewer than the frames, 64 × 48 px"), "{small}");
        std::fs::write(folder.path().join("darks/1.fits"), "no image").unwrap();
        assert!(told("[background]\nframes = \"darks/*.fits\"\n").contains("1.fits: "));
    }
}
