//! The scene of a frame, from the recipe and the number of the frame alone.

use hifitime::Epoch;
use sha2::{Digest, Sha256};
use toml::{Table, Value};

use super::chance::{AddressedChance, Stratum};
use super::distribution::{Distribution, radec_deg, rounded};
use super::draws::{Draw, DrawIndex};
use super::error::DatasetError;
use super::frame_key::{DatasetSplit, FrameKey};
use super::plan::{BORESIGHT, DatasetPlan, TIME, hexadecimal};
use super::recipe::{DrawLevel, FalseStarTable};
use super::scene_path::set;
use crate::camera::observation;
use crate::dual::dot;
use crate::scene::{Scene, SceneFile, SiteTable};

/// A frame before it is rendered.
#[derive(Clone, Debug)]
pub struct FrameScene {
    /// The frame.
    pub key: FrameKey,
    /// The number of its camera instance.
    pub camera: u64,
    /// The number of its recording.
    pub recording: u64,
    /// The number that both frames of a pair have; `None`: it is alone.
    pub pair: Option<u64>,
    /// Whether it has no stars on purpose.
    pub is_starless: bool,
    /// Lights that look like stars and are none, on purpose.
    pub false_stars: usize,
    /// The real frame under it, as seen from the recipe.
    pub background: Option<String>,
    /// Its tables, as a scene file has them.
    pub scene: Table,
}

/// Levels of what is drawn beside `[[draw]]`.
const CAMERA: u32 = DrawLevel::Camera as u32;
const FRAME: u32 = DrawLevel::Frame as u32;

impl DatasetPlan {
    /// The tables of a frame's scene.
    pub fn frame_scene(&self, key: FrameKey) -> Result<FrameScene, DatasetError> {
        let wrong = |message| DatasetError::Parse { path: self.path.clone(), message };
        let pair = self.pair(key);
        let mut scene = self.base.clone();
        let (switches, values): (Vec<&Draw>, Vec<&Draw>) = self.draws.iter().partition(|draw| draw.is_switch());
        for draw in values.into_iter().chain(switches) {
            // The direction follows when site and time are known.
            if draw.path.text != BORESIGHT {
                let at = self.index_of(draw, key, pair);
                let value =
                    if draw.path.text == TIME { self.time(draw, at, key.split) } else { draw.value(&|number| draw.unit(at, number)) };
                draw.apply(&mut scene, value).map_err(wrong)?;
            }
        }
        if let Some(draw) = self.draws.iter().find(|draw| draw.path.text == BORESIGHT) {
            let value = self.pointing(draw, self.index_of(draw, key, pair), key.split, &scene)?;
            draw.apply(&mut scene, value).map_err(wrong)?;
        }
        let camera = key.camera_number(&self.recipe.size, &self.recipe.cameras, self.cameras_are_apart());
        scene.insert("seed".to_owned(), Value::Integer(self.seed(key)));
        scene.insert("first_frame".to_owned(), Value::Integer(key.number().cast_signed()));
        let is_starless = self.chance(FRAME, "hard.no_stars").uniform(key.number(), 0) < self.recipe.hard.no_stars;
        if is_starless {
            set(&mut scene, "sky", "faintest_magnitude", Value::Float(NO_STARS));
        }
        let false_stars = self.add_false_stars(key, &mut scene)?;
        let background =
            self.background.as_ref().map(|files| files.put_by_chance(self.recipe.seed, (key, camera), self.size_px, &mut scene));
        let recording = key.recording_number(&self.recipe.size);
        let pair = pair.map(|(first, _)| FrameKey { split: key.split, index: first }.number());
        Ok(FrameScene { key, camera, recording, pair, is_starless, false_stars, background, scene })
    }

    /// The seed of the camera instance of a frame.
    pub(super) fn seed(&self, key: FrameKey) -> i64 {
        let of_seed = key.camera_number(&self.recipe.size, &self.recipe.cameras, self.seeds_are_apart());
        let [low, high, ..] = self.chance(CAMERA, "seed").words(of_seed, 0);
        // Whole numbers of TOML have 63 bits.
        (i64::from(high) << 32 | i64::from(low)) & i64::MAX
    }

    /// Checks the scenes of frames that are spread over each split, since draws that are all possible at their ends may not be so in between or together.
    pub fn try_frames(&self) -> Result<(), DatasetError> {
        const FRAMES_OF_A_SPLIT: u64 = 100;
        for split in DatasetSplit::ALL {
            let all = self.recipe.size.frames.of(split);
            let tried = all.min(FRAMES_OF_A_SPLIT);
            for index in (0..tried).map(|number| number * all / tried) {
                self.scene_of(&self.frame_scene(FrameKey { split, index })?)?;
            }
        }
        Ok(())
    }

    /// The tables of a frame's scene as a file that may lie anywhere: a real frame under it is named by where it is.
    pub fn scene_file(&self, key: FrameKey) -> Result<Table, DatasetError> {
        let mut scene = self.frame_scene(key)?.scene;
        self.resolve(&mut scene);
        Ok(scene)
    }

    /// The scene of a frame, checked.
    pub fn scene_of(&self, frame: &FrameScene) -> Result<Scene, DatasetError> {
        self.build(&format!("frame {:09}", frame.key.number()), frame.scene.clone())
    }
}

/// Where and when a frame is taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FramePlace {
    /// Its boresight in ICRS axes, where it is drawn by sphere or stands in the scene.
    pub(super) boresight: Option<[f64; 3]>,
    /// The middle of its exposure, seconds from 1900 of the clock TAI, where that is drawn or stands in the scene.
    pub(super) time_s: Option<f64>,
    /// The seed of its camera instance.
    pub(super) seed: i64,
}

impl DatasetPlan {
    /// Where and when a frame is taken. The rest of its scene is drawn only where the direction follows from that.
    pub(super) fn place(&self, key: FrameKey) -> Result<FramePlace, DatasetError> {
        let needs_scene = |draw: &Draw| {
            draw.path.text.starts_with(BORESIGHT)
                && (draw.path.text != BORESIGHT || matches!(draw.distribution, Distribution::Sky { lowest_altitude_deg: Some(_) }))
        };
        if self.draws.iter().any(needs_scene) {
            return Ok(self.frame_scene(key)?.place(self.seed(key)));
        }
        let pair = self.pair(key);
        let mut scene = Table::from_iter(self.base.get("frames").map(|frames| ("frames".to_owned(), frames.clone())));
        for draw in self.draws.iter().filter(|draw| [BORESIGHT, TIME].contains(&draw.path.text.as_str())) {
            let at = self.index_of(draw, key, pair);
            let value = if draw.path.text == TIME { self.time(draw, at, key.split) } else { self.pointing(draw, at, key.split, &scene)? };
            draw.apply(&mut scene, value).map_err(|message| DatasetError::Parse { path: self.path.clone(), message })?;
        }
        Ok(place_of(&scene, self.seed(key)))
    }

    /// The value of a draw of the time: in the part of the period that the split has.
    fn time(&self, draw: &Draw, at: DrawIndex, split: DatasetSplit) -> Value {
        let [from, to] = self.period(split);
        draw.value(&|number| from + (to - from) * draw.unit(at, number))
    }
}

/// Where and when the exposure of a scene is taken.
fn place_of(scene: &Table, seed: i64) -> FramePlace {
    let exposure = scene.get("frames").and_then(|frames| frames.get(0));
    let boresight = || {
        let radec = exposure?.get("boresight_radec_deg")?.as_array()?;
        let [ra, dec] = [0, 1].map(|place: usize| radec.get(place).and_then(Value::as_float).map(f64::to_radians));
        Some(crate::coordinates::Direction::<crate::coordinates::Icrs>::from_radec_rad(ra?, dec?).xyz)
    };
    let time_s = || tai_s(exposure?.get("time_utc")?.as_str()?);
    FramePlace { boresight: boresight(), time_s: time_s(), seed }
}

impl FrameScene {
    /// Where and when it is taken.
    pub(super) fn place(&self, seed: i64) -> FramePlace {
        place_of(&self.scene, seed)
    }

    /// SHA-256 of its scene as a file.
    pub(super) fn sha256(&self) -> Result<String, toml::ser::Error> {
        Ok(hexadecimal(&Sha256::digest(toml::to_string(&self.scene)?)))
    }
}

/// A time as seconds from 1900 of the clock TAI.
pub(super) fn tai_s(time_utc: &str) -> Option<f64> {
    Some(time_utc.parse::<Epoch>().ok()?.to_tai_seconds())
}

impl DatasetPlan {
    fn chance(&self, level: u32, name: &str) -> AddressedChance {
        AddressedChance::new(self.recipe.seed, level, name)
    }

    /// First and second frame of the pair that a frame belongs to.
    fn pair(&self, key: FrameKey) -> Option<(u64, u64)> {
        let first = key.index / 2 * 2;
        let is_whole = first + 1 < self.recipe.size.frames.of(key.split);
        let number = FrameKey { split: key.split, index: first }.number();
        let is_pair = is_whole && self.chance(FRAME, "hard.twins").uniform(number, 0) < self.recipe.hard.twins;
        is_pair.then_some((first, first + 1))
    }

    /// For which index of its level a draw is made.
    fn index_of(&self, draw: &Draw, key: FrameKey, pair: Option<(u64, u64)>) -> DrawIndex {
        let (size, cameras) = (&self.recipe.size, &self.recipe.cameras);
        let group = key.split.rank() as u32;
        // The second of a pair has the exposure of the first.
        let first = pair.filter(|_| draw.is_of_exposure()).map_or(key.index, |(first, _)| first);
        let key = FrameKey { split: key.split, index: first };
        match draw.level {
            DrawLevel::Dataset => DrawIndex { index: 0, stratum: Stratum { index: 0, count: 1, group: 0 } },
            DrawLevel::Camera => {
                let is_apart = self.cameras_are_apart();
                let all = DatasetSplit::ALL.iter().map(|split| cameras.of(*split)).max().unwrap_or(1);
                let (count, group) = if is_apart { (cameras.of(key.split), group) } else { (all, 0) };
                let stratum = Stratum { index: key.camera(size, cameras), count, group };
                DrawIndex { index: key.camera_number(size, cameras, is_apart), stratum }
            }
            DrawLevel::Recording => {
                let count = size.frames.of(key.split).div_ceil(size.frames_per_recording);
                DrawIndex { index: key.recording_number(size), stratum: Stratum { index: key.recording(size), count, group } }
            }
            DrawLevel::Frame => {
                DrawIndex { index: key.number(), stratum: Stratum { index: key.index, count: size.frames.of(key.split), group } }
            }
        }
    }

    /// Where a frame points: by its draw, in the sky of its split and above the lowest altitude.
    fn pointing(&self, draw: &Draw, at: DrawIndex, split: DatasetSplit, scene: &Table) -> Result<Value, DatasetError> {
        const TRIES: u32 = 20_000;
        let Distribution::Sky { lowest_altitude_deg } = draw.distribution else { return Ok(draw.value(&|number| draw.unit(at, number))) };
        let zenith = if lowest_altitude_deg.is_some() { zenith(scene) } else { None };
        let lowest = lowest_altitude_deg.unwrap_or(-90.0).to_radians().sin();
        for attempt in 0..TRIES {
            // The first is spread evenly, if that is asked for.
            let unit = |number: u32| if attempt == 0 { draw.unit(at, number) } else { draw.independent(at, 2 * attempt + number) };
            let direction = match &self.regions {
                Some(regions) => regions.direction(split.rank(), [unit(0), unit(1)]),
                None => super::distribution::direction(unit(0), unit(1)),
            };
            if zenith.is_none_or(|zenith| dot(direction, zenith) >= lowest) {
                return Ok(radec_deg(direction));
            }
        }
        let message = format!(
            "the sky of the split {} never stands above {}° at the time and place of the scene; choose a lower lowest_altitude_deg, or leave \"sky\" out of splits.apart_by",
            split.name(),
            lowest_altitude_deg.unwrap_or_default()
        );
        Err(DatasetError::Parse { path: self.path.clone(), message })
    }

    /// Adds lights that look like stars and are none, and says how many.
    fn add_false_stars(&self, key: FrameKey, scene: &mut Table) -> Result<usize, DatasetError> {
        let Some(table) = &self.recipe.hard.false_stars else { return Ok(0) };
        let chance = self.chance(FRAME, "hard.false_stars");
        if chance.uniform(key.number(), 0) >= table.share {
            return Ok(0);
        }
        let FalseStarTable { count: [fewest, largest], magnitudes, .. } = *table;
        let count = fewest + (chance.uniform(key.number(), 1) * f64::from(largest - fewest + 1)) as u32;
        let wrong = |error: toml::de::Error| DatasetError::Parse { path: self.scene_path.clone(), message: error.message().to_owned() };
        let file: SceneFile = Value::Table(scene.clone()).try_into().map_err(wrong)?;
        let faintest = self.faintest_magnitude();
        let [bright, faint] = magnitudes.unwrap_or([faintest - 5.0, faintest]);
        let list = scene.entry("streaks").or_insert_with(|| Value::Array(Vec::new()));
        for number in 0..count {
            let unit = |which| chance.uniform(key.number(), 2 + 3 * number + which);
            let place = [file.camera.width_px, file.camera.height_px].into_iter().zip(0..);
            let place: Vec<Value> = place.map(|(side, axis)| Value::Float(rounded(unit(axis) * side as f64 - 0.5))).collect();
            // As many for each magnitude more as there are stars: log N grows by 0.5 a magnitude, to the first digit.
            let magnitude = faint + (unit(2).max(1e-12).log10() / 0.5).max(bright - faint);
            let exposure_s = file.frames.first().map_or(0.0, |frame| frame.exposure_s);
            let electrons = file.detector.zero_point_e_per_s * 10.0_f64.powf(-0.4 * magnitude) * exposure_s;
            let streak = Table::from_iter([
                ("kind".to_owned(), Value::from("satellite")),
                ("frame".to_owned(), Value::Integer(0)),
                ("start_px".to_owned(), Value::Array(place.clone())),
                ("end_px".to_owned(), Value::Array(place)),
                ("electrons".to_owned(), Value::Float(rounded(electrons))),
            ]);
            if let Value::Array(list) = list {
                list.push(Value::Table(streak));
            }
        }
        Ok(count as usize)
    }

    /// The faintest star that the scene renders, before anything is drawn.
    pub(super) fn faintest_magnitude(&self) -> f64 {
        let stated = self.base.get("sky").and_then(|sky| sky.get("faintest_magnitude"));
        stated.and_then(|value| value.as_float().or(value.as_integer().map(|whole| whole as f64))).unwrap_or(9.0)
    }
}

/// No star is as bright.
const NO_STARS: f64 = -99.0;

/// The zenith of a scene's exposure, where it has a site and a time.
fn zenith(scene: &Table) -> Option<[f64; 3]> {
    let site: SiteTable = scene.get("site")?.clone().try_into().ok()?;
    let time: Epoch = scene.get("frames")?.get(0)?.get("time_utc")?.as_str()?.parse().ok()?;
    observation(Some(time), Some(&site.ground_site()), None).ok()?.zenith
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::plan::tests::{SCENE, plan_of, recipe};

    const DRAWS: &str = "[cameras]\ntrain = 2\ntest = 1\n[[draw]]\nper = \"camera\"\npath = \"camera.focal_length_px\"\nuniform = [250, 350]\n\
                         [[draw]]\nper = \"frame\"\npath = \"frames.rate_deg_s\"\nball = { radius = 0.5 }\nspread = \"even\"\n\
                         [[draw]]\nper = \"frame\"\npath = \"effects.prnu\"\nprobability = 0.5\n\
                         [[draw]]\nper = \"camera\"\npath = \"effects.prnu.relative\"\nlog_uniform = [0.001, 0.01]\n";

    fn scenes(plan: &DatasetPlan) -> Vec<Table> {
        let keys = DatasetSplit::ALL
            .into_iter()
            .flat_map(|split| (0..plan.recipe.size.frames.of(split)).map(move |index| FrameKey { split, index }));
        keys.map(|key| plan.frame_scene(key).unwrap().scene).collect()
    }

    #[test]
    fn a_further_draw_changes_no_other_value() {
        let plan = plan_of(&recipe(DRAWS), SCENE).unwrap();
        let more = "[[draw]]\nper = \"frame\"\npath = \"sky.background_e_per_px_s\"\nuniform = [1, 9]\n[[draw]]\nper = \"dataset\"\npath = \"camera.k1\"\nuniform = [0, 1e-9]\n";
        let further = plan_of(
            &recipe(&format!("{more}{DRAWS}").replace("[cameras]\ntrain = 2\ntest = 1\n", ""))
                .replace("[size]", "[cameras]\ntrain = 2\ntest = 1\n[size]"),
            SCENE,
        )
        .unwrap();
        for (mut with, without) in scenes(&further).into_iter().zip(scenes(&plan)) {
            assert!(with["camera"].as_table_mut().unwrap().remove("k1").is_some());
            assert!(with["sky"].as_table_mut().unwrap().remove("background_e_per_px_s").is_some());
            assert_eq!(with, without);
        }
        // In any order: the last alone is the last of all.
        let last = plan.frame_scene(FrameKey { split: DatasetSplit::Test, index: 3 }).unwrap().scene;
        assert_eq!(scenes(&plan).last(), Some(&last));
    }

    #[test]
    fn cameras_keep_their_values_and_frames_have_their_own() {
        let plan = plan_of(&recipe(DRAWS), SCENE).unwrap();
        let scenes = scenes(&plan);
        let of = |index: usize, table: &str, key: &str| scenes[index][table][key].clone();
        let focal_length = |index| of(index, "camera", "focal_length_px");
        assert_eq!(focal_length(0), focal_length(2));
        assert_ne!(focal_length(0), focal_length(1));
        assert_eq!(scenes[0]["seed"], scenes[2]["seed"]);
        assert_ne!(scenes[0]["seed"], scenes[1]["seed"]);
        assert_ne!(scenes[0]["first_frame"], scenes[2]["first_frame"]);
        assert_ne!(scenes[0]["frames"], scenes[2]["frames"]);
        let on = scenes.iter().filter(|scene| !scene["effects"].as_array().unwrap().is_empty()).count();
        assert!((1..scenes.len()).contains(&on), "{on} of {} have the effect", scenes.len());
        // Every one is a scene, and the text of it is the same scene.
        for key in [0, 7].map(|index| FrameKey { split: DatasetSplit::Train, index }) {
            let frame = plan.frame_scene(key).unwrap();
            let text = toml::to_string(&frame.scene).unwrap();
            assert_eq!(toml::from_str::<Table>(&text).unwrap(), frame.scene);
            assert_eq!(Scene::parse("s.toml", &text).unwrap().seed, plan.scene_of(&frame).unwrap().seed);
        }
    }

    /// The short way to place and time is that of the whole scene.
    #[test]
    fn places_are_those_of_the_scenes() {
        let draws = "[hard]\ntwins = 0.5\n[splits]\napart_by = [\"epoch\"]\n[[draw]]\nper = \"recording\"\npath = \"frames.time_utc\"\n\
                     times = [\"2026-01-01T00:00:00Z\", \"2026-01-13T00:00:00Z\"]\n[[draw]]\nper = \"frame\"\npath = \"camera.k1\"\nuniform = [0, 1e-9]\n";
        let pointed = format!("{SCENE}boresight_radec_deg = [10.0, 20.0]\n");
        let part = "[[draw]]\nper = \"frame\"\npath = \"frames.0.boresight_radec_deg.1\"\nuniform = [-10.0, 10.0]\n";
        for (scene, more) in [(SCENE, ""), (&pointed, ""), (&pointed, part)] {
            let plan = plan_of(&recipe(&format!("{draws}{more}")), scene).unwrap();
            for key in [(DatasetSplit::Train, 0), (DatasetSplit::Train, 5), (DatasetSplit::Test, 3)]
                .map(|(split, index)| FrameKey { split, index })
            {
                let place = plan.place(key).unwrap();
                assert_eq!(place, plan.frame_scene(key).unwrap().place(plan.seed(key)));
                assert!(place.boresight.is_some() && place.time_s.is_some());
                assert_eq!(plan.frame_scene(key).unwrap().scene["seed"].as_integer(), Some(place.seed));
            }
        }
        // A part of a direction that is drawn as a whole would be lost.
        let refused = plan_of(&recipe(part), SCENE).unwrap_err();
        assert!(refused.contains("line 11") && refused.contains("is a part of the direction, which is drawn as a whole"), "{refused}");
    }

    #[test]
    fn hard_frames_come_at_their_shares_and_pairs_share_the_sky() {
        let hard = "[hard]\nno_stars = 0.25\ntwins = 0.5\nfalse_stars = { share = 0.5, count = [2, 3] }\n";
        let text = recipe(hard).replace("train = 8, test = 4", "train = 200").replace("frames_per_shard = 4", "frames_per_shard = 100");
        let plan = plan_of(&text, SCENE).unwrap();
        let frames: Vec<FrameScene> =
            (0..200).map(|index| plan.frame_scene(FrameKey { split: DatasetSplit::Train, index }).unwrap()).collect();
        let share = |count: usize| count as f64 / 200.0;
        assert!((share(frames.iter().filter(|frame| frame.is_starless).count()) - 0.25).abs() < 0.15);
        assert!((share(frames.iter().filter(|frame| frame.false_stars > 0).count()) - 0.5).abs() < 0.18);
        assert!(frames.iter().all(|frame| [0, 2, 3].contains(&frame.false_stars)));
        let pairs: Vec<&[FrameScene]> = frames.chunks(2).filter(|pair| pair[0].pair.is_some()).collect();
        assert!((20..80).contains(&pairs.len()), "{}", pairs.len());
        for pair in pairs {
            assert_eq!((pair[0].pair, &pair[0].scene["frames"]), (pair[1].pair, &pair[1].scene["frames"]));
        }
        // So do pairs of cameras and recordings of their own that point each to one place.
        let text = recipe(
            "[cameras]\ntrain = 2\ntest = 2\n[hard]\ntwins = 1.0\n[[draw]]\nper = \"recording\"\npath = \"frames.boresight_radec_deg\"\nsphere = {}\n",
        );
        let of_recordings = plan_of(&text, SCENE).unwrap();
        let pair = [0, 1].map(|index| of_recordings.frame_scene(FrameKey { split: DatasetSplit::Train, index }).unwrap());
        assert!(pair[0].pair.is_some() && pair[0].recording != pair[1].recording);
        assert_eq!(pair[0].scene["frames"], pair[1].scene["frames"]);
        let alone = frames.chunks(2).find(|pair| pair[0].pair.is_none()).unwrap();
        assert_ne!(alone[0].scene["frames"], alone[1].scene["frames"]);
        let starless = frames.iter().find(|frame| frame.is_starless && frame.false_stars > 0).unwrap();
        assert_eq!(plan.scene_of(starless).unwrap().streaks.len(), starless.false_stars);
    }

    #[test]
    fn a_camera_on_the_ground_points_above_its_lowest_altitude() {
        let scene = format!(
            "{}\n[site]\nlatitude_deg = 47.0\nlongitude_deg = 11.0\n[series]\ncount = 1\nexposure_s = 1.0\nstart_utc = \"2026-03-01T22:00:00Z\"\nlowest_altitude_deg = 60.0\n",
            SCENE.replace("[[frames]]\nexposure_s = 1.0\n", "")
        );
        let plan = plan_of(&recipe(""), &scene).unwrap();
        let up = zenith(&plan.base).unwrap();
        for index in 0..8 {
            let boresight = plan.place(FrameKey { split: DatasetSplit::Train, index }).unwrap().boresight.unwrap();
            assert!(dot(boresight, up) >= 60.0_f64.to_radians().sin() - 1e-9);
        }
    }
}
