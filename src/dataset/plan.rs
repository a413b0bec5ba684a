//! A recipe with its scene, checked: what every frame of a dataset follows from.

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use toml::{Table, Value};

use super::background_files::BackgroundFiles;
use super::check;
use super::distribution::Distribution;
use super::draws::{Draw, UPPER};
use super::error::DatasetError;
use super::frame_key::DatasetSplit;
use super::recipe::{ApartBy, DrawLevel, RecipeFile};
use super::scene_path::canonical_path;
use super::sky_regions::{NoSky, SkyRegions};
use super::source_files::{SourceFile, add_sources, sources};
use super::telemetry::idle_effect;
use crate::gpu::{Backend, Gpu, GpuError, Need};
use crate::recording::FrameSize;
use crate::scene::{Scene, preset, schema};
use crate::statistics::order::sort_by_key;

/// What is said of the CPU.
pub(super) const CPU: &str = "cpu";
/// Where the boresight of the one exposure stands.
pub(super) const BORESIGHT: &str = "frames.boresight_radec_deg";
const ROLL: &str = "frames.roll_deg";
/// Where the time of the one exposure stands.
pub(super) const TIME: &str = "frames.time_utc";

/// A recipe, ready.
#[derive(Clone, Debug)]
pub struct DatasetPlan {
    /// The recipe's name for messages.
    pub path: String,
    /// As written.
    pub recipe: RecipeFile,
    /// Its text.
    pub text: String,
    /// SHA-256 of all that the frames follow from, but the catalogue: recipe, scene, tables, version of the program.
    pub sha256: String,
    /// SHA-256 of the scene.
    pub scene_sha256: String,
    /// The files that the recipe names, and those that its scene and its draws name.
    pub(super) sources: Vec<SourceFile>,
    /// What scenes are called in messages; images that they name lie in its folder.
    pub(super) scene_path: String,
    /// The scene with its one exposure, before anything is drawn.
    pub(super) base: Table,
    /// In the order in which they are put in: those of the dataset first, those of the frame last.
    pub(super) draws: Vec<Draw>,
    pub(super) regions: Option<SkyRegions>,
    /// Where frames are rendered.
    pub(super) backend: Backend,
    /// On what, as `dataset.json` says it: `cpu`, or the adapter and its driver.
    pub(super) adapter: String,
    /// Real frames under the stars.
    pub(super) background: Option<BackgroundFiles>,
    /// Columns and rows of the frames.
    pub(super) size_px: [usize; 2],
    /// Half the diagonal of the widest field that is drawn.
    pub(super) field_radius_deg: f64,
    /// The faintest star that any frame shows.
    pub(super) faintest_magnitude: f64,
    /// The guard in force.
    pub(super) guard_deg: f64,
}

impl DatasetPlan {
    /// Reads a recipe and all that it names, and checks it.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        let name = path.display().to_string();
        let text = read(path)?;
        Self::parse(&name, &text, path.parent().unwrap_or(Path::new(".")))
    }

    /// Checks the text of a recipe; `path` is used in messages, and files that it names begin at `folder`.
    pub fn parse(path: &str, text: &str, folder: &Path) -> Result<Self, DatasetError> {
        Self::checked(path, text, folder).map_err(|error| with_line(error, path, text))
    }

    fn checked(path: &str, text: &str, folder: &Path) -> Result<Self, DatasetError> {
        let recipe = RecipeFile::parse(path, text)?;
        check::check(path, &recipe)?;
        let (scene_path, scene_text) = scene_text(path, &recipe.scene, folder)?;
        let parse = |message: String| DatasetError::Parse { path: scene_path.clone(), message };
        let whole: Table = crate::toml_file::tables(&scene_text).map_err(parse)?;
        let of_scene = |source| DatasetError::Scene { path: path.to_owned(), place: "its scene".to_owned(), source: Box::new(source) };
        Scene::check_series(&scene_path, &whole).map_err(of_scene)?;
        let Exposure { scene: base, lowest_altitude_deg, is_pointed } = one_exposure(path, &recipe.scene, whole)?;
        let root = schema();
        let mut draws = Vec::with_capacity(recipe.draw.len() + 2);
        for (number, table) in recipe.draw.iter().enumerate() {
            draws.push(Draw::new(path, folder, recipe.seed, number, table, &root)?);
        }
        check_parts_of_pointing(path, &recipe, &draws, is_pointed)?;
        let is_drawn = |draws: &[Draw], path: &str| draws.iter().any(|draw| draw.path.text == path);
        if !is_pointed && !is_drawn(&draws, BORESIGHT) {
            draws.extend(Draw::implied(recipe.seed, BORESIGHT, Distribution::Sky { lowest_altitude_deg }, &root));
            if !is_drawn(&draws, ROLL) {
                draws.extend(Draw::implied(recipe.seed, ROLL, Distribution::Uniform([0.0, 360.0]), &root));
            }
        }
        sort_by_key(&mut draws, |draw| draw.level);
        let mut sources = sources(&recipe, &base, (folder, &scene_path))?;
        let (size_px, is_apart) = (frame_size(&base), recipe.splits.apart_by.contains(&ApartBy::Camera));
        let size = FrameSize { width_px: size_px[0], height_px: size_px[1] };
        let background = BackgroundFiles::new(path, folder, &recipe, (size, is_apart))?;
        add_sources(&mut sources, background.iter().flat_map(BackgroundFiles::names), folder)?;
        let mut plan = Self {
            path: path.to_owned(),
            sha256: hash(text, &scene_text, &sources),
            sources,
            scene_sha256: hexadecimal(&Sha256::digest(&scene_text)),
            recipe,
            text: text.to_owned(),
            scene_path,
            base,
            draws,
            regions: None,
            backend: Backend::Cpu,
            adapter: CPU.to_owned(),
            background,
            size_px,
            field_radius_deg: 0.0,
            faintest_magnitude: f64::NEG_INFINITY,
            guard_deg: 0.0,
        };
        let tried = plan.try_draws()?;
        plan.field_radius_deg = tried.iter().map(|sky| sky.radius_deg).fold(0.0, f64::max);
        plan.faintest_magnitude = tried.iter().map(|sky| sky.faintest_magnitude).fold(f64::NEG_INFINITY, f64::max);
        plan.share_out_sky()?;
        plan.check_epochs()?;
        Ok(plan)
    }

    /// The same with frames rendered on a GPU: other bytes, within the tolerance of the twins, so another dataset.
    pub fn on_gpu(mut self) -> Result<Self, DatasetError> {
        let wrong = |source: GpuError| DatasetError::Imaging { path: self.path.clone(), key: 0, source: source.into() };
        let gpu = Gpu::open(Need::Any).map_err(wrong)?;
        (self.backend, self.adapter) = (Backend::Gpu, gpu.adapter().to_string());
        Ok(self)
    }

    /// Whether the camera is pointed over the sky by chance.
    pub(super) fn points_anywhere(&self) -> bool {
        self.draws.iter().any(|draw| draw.path.text == BORESIGHT && matches!(draw.distribution, Distribution::Sky { .. }))
    }

    /// Whether a split is the first that has frames.
    pub(super) fn is_first_split(&self, split: DatasetSplit) -> bool {
        DatasetSplit::ALL.into_iter().find(|split| self.recipe.size.frames.of(*split) > 0) == Some(split)
    }

    /// Whether no two splits share a camera instance.
    #[must_use]
    pub fn cameras_are_apart(&self) -> bool {
        self.recipe.splits.apart_by.contains(&ApartBy::Camera)
    }

    /// Whether no two splits share the seed of a camera instance.
    pub(super) fn seeds_are_apart(&self) -> bool {
        self.cameras_are_apart() || self.recipe.splits.apart_by.contains(&ApartBy::Seed)
    }

    /// The part of a drawn period that a split has, from 0 to 1: all of it, unless splits are apart by epoch.
    pub(super) fn period(&self, split: DatasetSplit) -> [f64; 2] {
        if !self.recipe.splits.apart_by.contains(&ApartBy::Epoch) {
            return [0.0, 1.0];
        }
        let frames = |splits: &[DatasetSplit]| splits.iter().map(|split| self.recipe.size.frames.of(*split)).sum::<u64>() as f64;
        let all = DatasetSplit::ALL;
        [&all[..split.rank()], &all[..=split.rank()]].map(|before| frames(before) / frames(&all))
    }

    /// Times can be apart where they are drawn for each recording or frame.
    fn check_epochs(&self) -> Result<(), DatasetError> {
        let is_drawn = |draw: &Draw| {
            draw.path.text == TIME && matches!(draw.distribution, Distribution::Times(_)) && draw.level >= DrawLevel::Recording
        };
        if !self.recipe.splits.apart_by.contains(&ApartBy::Epoch) || self.draws.iter().any(is_drawn) {
            return Ok(());
        }
        Err(DatasetError::Value {
            path: self.path.clone(),
            key: "splits.apart_by".to_owned(),
            value: format!("{:?}", self.recipe.splits.apart_by),
            remedy: format!("with \"epoch\" needs a [[draw]] of {TIME} by times, per recording or frame"),
        })
    }

    /// Gives each split its part of the sky, if that is asked for.
    fn share_out_sky(&mut self) -> Result<(), DatasetError> {
        if !self.recipe.splits.apart_by.contains(&ApartBy::Sky) {
            return Ok(());
        }
        let refuse = |key: &str, value: String, remedy: String| {
            Err(DatasetError::Value { path: self.path.clone(), key: key.to_owned(), value, remedy })
        };
        let is_drawn = |draw: &Draw| draw.path.text == BORESIGHT && matches!(draw.distribution, Distribution::Sky { .. });
        if !self.draws.iter().any(|draw| is_drawn(draw) && draw.level >= DrawLevel::Recording) {
            let remedy = format!("with \"sky\" needs a [[draw]] of {BORESIGHT} by sphere, per recording or frame");
            return refuse("splits.apart_by", format!("{:?}", self.recipe.splits.apart_by), remedy);
        }
        let guard_deg = self.recipe.splits.guard_deg.unwrap_or(self.field_radius_deg);
        let shares: Vec<u64> = DatasetSplit::ALL.iter().map(|split| self.recipe.size.frames.of(*split)).collect();
        match SkyRegions::new(self.recipe.seed, &shares, guard_deg) {
            Ok(regions) => {
                (self.regions, self.guard_deg) = (Some(regions), guard_deg);
                Ok(())
            }
            Err(NoSky { largest_guard_deg }) => {
                let largest = (100.0 * largest_guard_deg).floor() / 100.0;
                let told = if self.recipe.splits.guard_deg.is_some() { "" } else { " (half the diagonal of the field)" };
                let remedy = format!(
                    "leaves a split no sky to point at; {largest} would do: choose that or less (fields of two splits then share stars if they are wider), or leave \"sky\" out of splits.apart_by"
                );
                refuse("splits.guard_deg", format!("{guard_deg:.2}{told}"), remedy)
            }
        }
    }

    /// Tries the scene with every draw at its middle, each at its ends with the others at their middle, each two at crossed ends, and all at their ends at
    /// once. Gives what sky each of them sees.
    fn try_draws(&self) -> Result<Vec<SeenSky>, DatasetError> {
        // What can be switched off is on while others are tried.
        let middle = |draw: &Draw| if draw.is_switch() { 0.0 } else { 0.5 };
        let mut seen = vec![self.tried("with every draw at its middle", &middle)?];
        for index in 1..self.background.as_ref().map_or(0, BackgroundFiles::len) {
            self.tried_on(index, "with every draw at its middle", &middle)?;
        }
        for draw in &self.draws {
            for (words, at) in draw.ends() {
                let place = format!("the draw of {} {words}", draw.path.text);
                let unit = |other: &Draw| if std::ptr::eq(other, draw) { at } else { middle(other) };
                seen.push(self.tried(&place, &unit)?);
            }
        }
        for (words, at) in [("with every draw at its lower end", 0.0), ("with every draw at its upper end", UPPER)] {
            seen.push(self.tried(words, &|draw| if draw.is_switch() { 0.0 } else { at })?);
        }
        for (number, draw) in self.draws.iter().enumerate() {
            for other in &self.draws[..number] {
                self.try_crossed(draw, other, &middle)?;
            }
        }
        Ok(seen)
    }

    /// Tries two draws at ends that are not the same: what each of them may be alone, both together may not.
    fn try_crossed(&self, one: &Draw, other: &Draw, middle: &dyn Fn(&Draw) -> f64) -> Result<(), DatasetError> {
        let (Some(ends), Some(beside)) = (one.outermost(), other.outermost()) else { return Ok(()) };
        for ((words, at), (other_words, other_at)) in [(&ends[0], &beside[1]), (&ends[1], &beside[0])] {
            let place = format!("the draw of {} {words}, that of {} {other_words}", one.path.text, other.path.text);
            let unit = |draw: &Draw| {
                if std::ptr::eq(draw, one) {
                    *at
                } else if std::ptr::eq(draw, other) {
                    *other_at
                } else {
                    middle(draw)
                }
            };
            self.tried(&place, &unit)?;
        }
        Ok(())
    }

    fn tried(&self, place: &str, unit: &dyn Fn(&Draw) -> f64) -> Result<SeenSky, DatasetError> {
        self.tried_on(0, place, unit)
    }

    /// The same on a file of `[background]`, if there are any.
    fn tried_on(&self, index: usize, place: &str, unit: &dyn Fn(&Draw) -> f64) -> Result<SeenSky, DatasetError> {
        let mut scene = self.base.clone();
        let (switches, values): (Vec<&Draw>, Vec<&Draw>) = self.draws.iter().partition(|draw| draw.is_switch());
        for draw in values.into_iter().chain(switches) {
            let value = draw.value(&|_| unit(draw));
            let wrong = |message| DatasetError::Parse { path: self.path.clone(), message };
            draw.apply(&mut scene, value).map_err(wrong)?;
        }
        self.background.iter().for_each(|files| files.put_on_trial(index, &mut scene));
        let built = self.build(place, scene.clone())?;
        match idle_effect(&built, &scene) {
            None => Ok(SeenSky { radius_deg: field_radius_deg(&built), faintest_magnitude: built.sky.faintest_magnitude }),
            Some(what) => Err(DatasetError::Parse { path: self.path.clone(), message: format!("{place}: {what}") }),
        }
    }

    /// The scene of these tables; `place` is used in messages.
    pub(super) fn build(&self, place: &str, mut scene: Table) -> Result<Scene, DatasetError> {
        self.resolve(&mut scene);
        let wrong = |source| DatasetError::Scene { path: self.path.clone(), place: place.to_owned(), source: Box::new(source) };
        Scene::from_table(&self.scene_path, scene).map_err(wrong)
    }
}

impl DatasetPlan {
    /// Names the real frame under a scene by where it is: in the scene of a frame it has the name that the recipe gives it, so that labels and hashes are the
    /// same wherever the recipe lies.
    pub(super) fn resolve(&self, scene: &mut Table) {
        self.background.iter().for_each(|files| files.resolve(scene));
    }
}

/// Refuses a draw of a part of the direction where the whole is drawn: it would be lost.
fn check_parts_of_pointing(path: &str, recipe: &RecipeFile, draws: &[Draw], is_pointed: bool) -> Result<(), DatasetError> {
    if is_pointed && draws.iter().all(|draw| draw.path.text != BORESIGHT) {
        return Ok(());
    }
    let is_part = |draw: &Draw| draw.path.text.strip_prefix(BORESIGHT).is_some_and(|rest| rest.starts_with('.'));
    match draws.iter().position(is_part) {
        None => Ok(()),
        Some(number) => Err(DatasetError::Value {
            path: path.to_owned(),
            key: format!("draw[{number}].path"),
            value: format!("{:?}", recipe.draw[number].path),
            remedy: format!(
                "is a part of the direction, which is drawn as a whole; draw {BORESIGHT} by choice or sphere, or say in the scene where the camera points"
            ),
        }),
    }
}

/// The same with the line of the recipe that it speaks of.
fn with_line(error: DatasetError, recipe: &str, text: &str) -> DatasetError {
    let at = |key: &str| crate::toml_file::line_of(text, key).map_or_else(|| recipe.to_owned(), |line| format!("{recipe}: line {line}"));
    match error {
        DatasetError::Value { path, key, value, remedy } if path == recipe => DatasetError::Value { path: at(&key), key, value, remedy },
        DatasetError::Scene { path, place, source } if path == recipe => {
            let draws = RecipeFile::parse(recipe, text).map(|recipe| recipe.draw).unwrap_or_default();
            let of_place = draws.iter().position(|draw| place.starts_with(&format!("the draw of {} ", canonical_path(&draw.path))));
            let path = of_place.map_or(path, |number| at(&format!("draw[{number}].path")));
            DatasetError::Scene { path, place, source }
        }
        other => other,
    }
}

/// Columns and rows of a scene's frames; 0 where the scene does not say, which is refused when it is checked.
fn frame_size(scene: &Table) -> [usize; 2] {
    ["width_px", "height_px"].map(|key| {
        let side = scene.get("camera").and_then(|camera| camera.get(key)).and_then(Value::as_integer);
        side.and_then(|side| usize::try_from(side).ok()).unwrap_or(0)
    })
}

fn read(path: &Path) -> Result<String, DatasetError> {
    std::fs::read_to_string(path).map_err(|source| DatasetError::Read { path: path.display().to_string(), source })
}

/// The scene that a recipe names: what it is called, and its text.
fn scene_text(recipe: &str, scene: &str, folder: &Path) -> Result<(String, String), DatasetError> {
    let Some(name) = scene.strip_prefix("preset:") else {
        let path: PathBuf = folder.join(scene);
        return Ok((path.display().to_string(), read(&path)?));
    };
    let found = preset(name).ok_or_else(|| {
        let names: Vec<&str> = crate::scene::PRESETS.iter().map(|preset| preset.name).collect();
        let nearest = crate::toml_file::suggestion(name, &names)
            .map_or_else(|| format!("there are {}", names.join(", ")), |near| format!("did you mean preset:{near}?"));
        let (path, value) = (recipe.to_owned(), format!("{scene:?}"));
        DatasetError::Value { path, key: "scene".to_owned(), value, remedy: format!("is no preset: {nearest}") }
    })?;
    Ok((scene.to_owned(), found.toml.to_owned()))
}

/// The exposure of a sample.
struct Exposure {
    scene: Table,
    /// Of a series on the ground.
    lowest_altitude_deg: Option<f64>,
    /// Whether the scene says where the camera points.
    is_pointed: bool,
}

/// The lowest altitude of a series that names none.
const USUAL_ALTITUDE_DEG: f64 = 30.0;

/// A scene with one exposure: a series is pointed by chance, as it is when it is simulated.
fn one_exposure(recipe: &str, name: &str, mut scene: Table) -> Result<Exposure, DatasetError> {
    for key in ["seed", "first_frame"] {
        scene.remove(key);
    }
    let frames = scene.get("frames").and_then(Value::as_array).map_or(0, Vec::len);
    let Some(series) = scene.remove("series") else {
        if frames != 1 {
            let (path, value) = (recipe.to_owned(), format!("{name:?}"));
            let remedy = format!("must have a [series] or one [[frames]], the exposure of every sample; it has {frames}");
            return Err(DatasetError::Value { path, key: "scene".to_owned(), value, remedy });
        }
        let has = |key: &str| scene["frames"][0].get(key).is_some();
        let is_pointed = has("boresight_radec_deg") || has("attitude_samples");
        return Ok(Exposure { scene, lowest_altitude_deg: None, is_pointed });
    };
    let mut exposure = Table::new();
    for (from, to) in [("exposure_s", "exposure_s"), ("start_utc", "time_utc"), ("rate_deg_s", "rate_deg_s")] {
        if let Some(value) = series.get(from) {
            exposure.insert(to.to_owned(), value.clone());
        }
    }
    let stated = series.get("lowest_altitude_deg").and_then(|value| value.as_float().or(value.as_integer().map(|whole| whole as f64)));
    let lowest_altitude_deg = scene.contains_key("site").then_some(stated.unwrap_or(USUAL_ALTITUDE_DEG));
    scene.insert("frames".to_owned(), Value::Array(vec![Value::Table(exposure)]));
    Ok(Exposure { scene, lowest_altitude_deg, is_pointed: false })
}

/// What sky a scene sees.
#[derive(Clone, Copy, Debug)]
struct SeenSky {
    /// Half the diagonal of its field.
    radius_deg: f64,
    faintest_magnitude: f64,
}

/// Half the diagonal of the field of a camera, degrees.
fn field_radius_deg(scene: &Scene) -> f64 {
    let camera = &scene.camera;
    let context = scene.model.reference_context();
    let corners =
        [-0.5, camera.width_px as f64 - 0.5].into_iter().flat_map(|x_px| [-0.5, camera.height_px as f64 - 0.5].map(|y_px| (x_px, y_px)));
    let heights = corners.map(|(x_px, y_px)| {
        let corner = crate::coordinates::PixelPoint { x_px, y_px };
        scene.model.direction(corner, &context).map_or(-1.0, |direction| direction.xyz[2])
    });
    heights.fold(1.0_f64, f64::min).clamp(-1.0, 1.0).acos().to_degrees()
}

/// The hash of everything that frames follow from.
fn hash(text: &str, scene: &str, sources: &[SourceFile]) -> String {
    let mut hasher = Sha256::new();
    let mut add = |bytes: &[u8]| {
        hasher.update((bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    add(env!("CARGO_PKG_VERSION").as_bytes());
    add(text.as_bytes());
    add(scene.as_bytes());
    for source in sources {
        add(&source.sha256);
    }
    hexadecimal(&hasher.finalize())
}

/// Bytes as lower-case hexadecimal digits.
pub(super) fn hexadecimal(bytes: &[u8]) -> String {
    use std::fmt::Write as _;
    let mut text = String::with_capacity(2 * bytes.len());
    for byte in bytes {
        let _ = write!(text, "{byte:02x}"); // writing to a String cannot fail
    }
    text
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A small recipe, with more lines at its end.
    pub(in crate::dataset) fn recipe(more: &str) -> String {
        format!(
            "format = \"boresight-recipe/1\"\nname = \"small\"\nseed = 5\nscene = \"scene.toml\"\n\
             [size]\nframes = {{ train = 8, test = 4 }}\nframes_per_shard = 4\nmembers = [\"mask\", \"distance\"]\n{more}"
        )
    }

    pub(in crate::dataset) const SCENE: &str = "format = \"boresight-scene/1\"\ncamera = { width_px = 64, height_px = 48, focal_length_px = 300.0 }\n\
                         sky = { physics = \"none\" }\n[[frames]]\nexposure_s = 1.0\n";

    /// The plan of a recipe and a scene.
    pub(in crate::dataset) fn plan_of(recipe: &str, scene: &str) -> Result<DatasetPlan, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
        DatasetPlan::parse("r.toml", recipe, folder.path())
            .map_err(|error| error.to_string().replace(&folder.path().display().to_string(), "."))
    }

    #[test]
    fn a_draw_that_is_impossible_at_one_end_is_refused_before_the_first_frame() {
        let draw = |lines: &str| plan_of(&recipe(&format!("[[draw]]\nper = \"frame\"\n{lines}")), SCENE).map(|_| ());
        assert_eq!(draw("path = \"camera.focal_length_px\"\nuniform = [200, 400]"), Ok(()));
        assert_eq!(
            draw("path = \"camera.focal_length_px\"\nuniform = [0, 400]").unwrap_err(),
            "r.toml: line 11: the draw of camera.focal_length_px at its lower end: ./scene.toml: camera.focal_length_px = 0 must lie between 0.01 and 1e8 px"
        );
        let upper = draw("path = \"frames.exposure_s\"\nuniform = [1, 1.5e5]").unwrap_err();
        assert!(upper.contains("at its upper end: ./scene.toml: frames[0].exposure_s = "), "{upper}");
        let third = draw("path = \"psf.kind\"\nchoice = { values = [\"gaussian\", \"airie\"] }").unwrap_err();
        assert!(third.contains("at its value \"airie\"") || third.contains("psf"), "{third}");
        // Each may be as it is, and both together may not.
        let crossed = draw(
            "path = \"detector.bits\"\nchoice = { values = [8, 16] }\n[[draw]]\nper = \"frame\"\npath = \"detector.bias_dn\"\nuniform = [10, 300]",
        );
        let crossed = crossed.unwrap_err();
        assert!(crossed.contains("the draw of detector.b") && crossed.contains("that of detector.bi"), "{crossed}");
        let missing = draw("path = \"streaks.0.electrons\"\nuniform = [1, 2]").unwrap_err();
        assert!(missing.contains("streaks.0.electrons: the scene has 0 elements there"), "{missing}");
    }

    #[test]
    fn the_scene_must_have_one_exposure_and_be_there() {
        let two = plan_of(&recipe(""), &format!("{SCENE}[[frames]]\nexposure_s = 2.0\n")).unwrap_err();
        assert!(two.contains("must have a [series] or one [[frames]]") && two.contains("it has 2"), "{two}");
        let series = |lines: &str| plan_of(&recipe(""), &SCENE.replace("[[frames]]\n", &format!("[series]\n{lines}\n"))).map(|_| ());
        assert_eq!(series("count = 5"), Ok(()));
        let typed = series("count = 5\nrate_deg_sec = [0.0, 0.5, 0.0]").unwrap_err();
        assert!(
            typed.starts_with("r.toml: its scene: ./scene.toml: series: unknown key rate_deg_sec; did you mean rate_deg_s?"),
            "{typed}"
        );
        assert!(series("count = 0").unwrap_err().contains("series.count = 0 must lie between 1 and"));
        let beside = plan_of(&recipe(""), &format!("{SCENE}[series]\ncount = 5\nexposure_s = 1.0\n")).unwrap_err();
        assert!(beside.contains("series = given stands beside [[frames]]"), "{beside}");
        let preset = recipe("").replace("scene.toml", "preset:cubesat-traker");
        assert!(plan_of(&preset, SCENE).unwrap_err().ends_with("is no preset: did you mean preset:cubesat-tracker?"));
        assert!(plan_of(&recipe("").replace("scene.toml", "absent.toml"), SCENE).unwrap_err().contains("absent.toml: cannot be read"));
        let broken = plan_of(&recipe(""), &SCENE.replace("width_px", "width")).unwrap_err();
        assert!(broken.contains("unknown key width; did you mean width_px?"), "{broken}");
    }

    #[test]
    fn splits_of_the_sky_that_cannot_be_are_refused_with_the_guard_that_would_do() {
        let apart = |guard: &str| plan_of(&recipe(&format!("[splits]\napart_by = [\"sky\"]\n{guard}")), SCENE);
        let plan = apart("").unwrap();
        assert!((plan.field_radius_deg - (40.0_f64 / 300.0).atan().to_degrees()).abs() < 0.2, "{}", plan.field_radius_deg);
        assert_eq!(plan.guard_deg, plan.field_radius_deg);
        let refused = apart("guard_deg = 80.0").unwrap_err();
        assert!(refused.starts_with("r.toml: line 11: splits.guard_deg = 80.00 leaves a split no sky to point at; "), "{refused}");
        let largest: f64 = refused.split("point at; ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(apart(&format!("guard_deg = {largest}")).is_ok());
        let pointed =
            plan_of(&recipe("[splits]\napart_by = [\"sky\"]\n"), &format!("{SCENE}boresight_radec_deg = [1.0, 2.0]\n")).unwrap_err();
        assert!(pointed.contains("needs a [[draw]] of frames.boresight_radec_deg by sphere"), "{pointed}");
    }

    #[test]
    fn the_hash_follows_recipe_and_scene() {
        let hash = |recipe: &str, scene: &str| plan_of(recipe, scene).unwrap().sha256;
        let own = hash(&recipe(""), SCENE);
        assert_eq!(own, hash(&recipe(""), SCENE));
        assert_ne!(own, hash(&recipe("# a word\n"), SCENE));
        assert_ne!(own, hash(&recipe(""), &format!("{SCENE}# a word\n")));
    }
}
