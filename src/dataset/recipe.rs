//! What stands in a recipe file: its tables with their keys and defaults.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::error::DatasetError;
use crate::toml_file::tables;

/// The name of the file format.
pub const RECIPE_FORMAT: &str = "boresight-recipe/1";

/// A recipe as written: a scene, what of it is drawn by chance, and how many frames.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecipeFile {
    /// Always `boresight-recipe/1`.
    pub format: String,
    /// Name of the dataset: letters, digits, `-` and `_`.
    pub name: String,
    /// Seed of all that is drawn.
    #[serde(default)]
    pub seed: u64,
    /// The scene: `preset:NAME`, or a scene file; a path that is not absolute begins at the folder of the recipe.
    pub scene: String,
    /// Licence of the dataset, as an SPDX expression.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub licence: Option<String>,
    /// How many frames, and what stands in a sample.
    pub size: SizeTable,
    /// What no two splits share.
    #[serde(default)]
    pub splits: SplitTable,
    /// Camera instances of each split: each has its own seed (hot pixels, uneven response) and its own values of what is drawn per camera.
    #[serde(default = "one_camera")]
    pub cameras: SplitCounts,
    /// What is drawn.
    #[serde(default)]
    pub draw: Vec<DrawTable>,
    /// Real frames under the stars.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub background: Option<BackgroundTable>,
    /// Frames that are meant to be hard.
    #[serde(default)]
    pub hard: HardTable,
}

fn one_camera() -> SplitCounts {
    SplitCounts { train: 1, validation: 1, test: 1 }
}

/// A number for each split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SplitCounts {
    /// For training.
    pub train: u64,
    /// To choose by.
    pub validation: u64,
    /// To judge by.
    pub test: u64,
}

/// `[size]`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SizeTable {
    /// Frames of each split.
    pub frames: SplitCounts,
    /// Frames of every shard of every split; the frames of a split are a multiple of it, since loaders need equal shares.
    pub frames_per_shard: u64,
    /// Frames that follow one another from one camera and share what is drawn per recording.
    #[serde(default = "one_frame")]
    pub frames_per_recording: u64,
    /// How the image of a sample is written.
    #[serde(default)]
    pub image: ImageFormat,
    /// What stands in every sample besides image and labels.
    #[serde(default)]
    pub members: Vec<SampleMember>,
}

fn one_frame() -> u64 {
    1
}

/// How the image of a sample is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ImageFormat {
    /// PNG of 16 bits, grey, by the fast encoder.
    #[default]
    Png16,
    /// NumPy array of uint16, as it is.
    Npy,
    /// FITS, packed without loss by Rice coding.
    FitsRice,
}

impl ImageFormat {
    /// The file of a sample, behind the number of the frame and a dot.
    pub(super) fn member(self) -> &'static str {
        match self {
            Self::Png16 => "image.png",
            Self::Npy => "image.npy",
            Self::FitsRice => "image.fits",
        }
    }
}

/// What may stand in a sample besides image and labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SampleMember {
    /// What each pixel shows, PNG of 8 bits.
    Mask,
    /// How far each pixel is from the nearest star, PNG of 8 bits, in eighths of a pixel.
    Distance,
    /// Which light of the labels each pixel shows, counted from 1, PNG of 16 bits.
    Instances,
    /// Expected electrons without noise, NumPy array of float32.
    Clean,
}

/// `[splits]`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SplitTable {
    /// What no two splits share.
    pub apart_by: Vec<ApartBy>,
    /// With `sky`: no boresight of a split is nearer than this to a cell of another one. If absent, half the diagonal of the field of the scene's camera,
    /// so that no star is seen in two splits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guard_deg: Option<f64>,
}

/// What two splits may share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ApartBy {
    /// Camera instances.
    Camera,
    /// Parts of the sky.
    Sky,
    /// Times: of the period that a draw of `frames.time_utc` names, each split has a part by itself, train the first.
    Epoch,
    /// Seeds of camera instances: their noise, hot pixels and uneven response. Cameras that are apart have seeds of their own anyway.
    Seed,
}

/// `[[draw]]`: a value that takes the place of one of the scene. One of the ways to draw is given.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DrawTable {
    /// For what it is drawn anew.
    pub per: DrawLevel,
    /// Where the value stands in the scene: keys with dots. `frames` is the one exposure of a sample, `effects.ID` an effect and
    /// `effects.ID.NAME` a parameter of it, a number an element of a list.
    pub path: String,
    /// Evenly between two numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uniform: Option<[f64; 2]>,
    /// Evenly in the logarithm between two numbers above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_uniform: Option<[f64; 2]>,
    /// Normally.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal: Option<NormalTable>,
    /// One of several values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub choice: Option<ChoiceTable>,
    /// Three numbers, evenly within a ball about 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ball: Option<BallTable>,
    /// Right ascension and declination, evenly over the sky.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sphere: Option<SphereTable>,
    /// By quantiles from a file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<QuantileTable>,
    /// Evenly between two times, UTC.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<[String; 2]>,
    /// Whether an effect, or a table that may be left out, is there at all: the share of those in which it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub probability: Option<f64>,
    /// How the values of a split stand to one another.
    #[serde(default)]
    pub spread: DrawSpread,
}

/// For what a value is drawn anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DrawLevel {
    /// Once.
    Dataset,
    /// For each camera instance.
    Camera,
    /// For each recording.
    Recording,
    /// For each frame.
    Frame,
}

/// How the values of a split stand to one another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DrawSpread {
    /// Each by itself.
    #[default]
    Independent,
    /// The probabilities are cut into as many equal parts as there are values, and each part has one.
    Even,
}

/// `normal`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NormalTable {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sigma: f64,
    /// The part that is drawn from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within: Option<[f64; 2]>,
}

/// `choice`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChoiceTable {
    /// The values.
    #[schemars(with = "Vec<serde_json::Value>")]
    pub values: Vec<toml::Value>,
    /// How often each is taken, to one another; equally if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<Vec<f64>>,
}

/// `ball`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BallTable {
    /// Its radius, in the unit of the path.
    pub radius: f64,
}

/// `sphere`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SphereTable {
    /// Instead of a direction, three numbers: a vector of this length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// With a site and the time of the frame: the lowest altitude.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lowest_altitude_deg: Option<f64>,
}

/// `table`: a CSV file of two columns, `probability` from 0 to 1 and `value`, both rising; straight in between.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QuantileTable {
    /// The file; a path that is not absolute begins at the folder of the recipe.
    pub file: PathBuf,
}

/// `[background]`: real frames without stars take the place of read noise and dark current; counts become electrons by bias and gain of the detector.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BackgroundTable {
    /// The files, as `darks/*.fits`: `*` and `?` in the name stand for any letters and for one. A path that is not absolute begins at the folder of the
    /// recipe. Each frame takes one of them by chance; from files that are larger than the frame, each camera instance takes a window by chance. Splits
    /// that are apart by camera have files of their own.
    pub frames: String,
    /// Whether they hold light of the sky: then the scene's even background is left out.
    #[serde(default)]
    pub has_sky: bool,
}

/// `[hard]`: shares of frames that are meant to be hard, labelled as such.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HardTable {
    /// Share of frames without any star.
    pub no_stars: f64,
    /// Frames with lights that look like stars and are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub false_stars: Option<FalseStarTable>,
    /// Share of frames that are one of a pair: the second has the exposure of the first (pointing, motion, time) under another detector and sky.
    pub twins: f64,
}

/// `[hard.false_stars]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FalseStarTable {
    /// Share of frames.
    pub share: f64,
    /// Fewest and most of them in such a frame.
    pub count: [u32; 2],
    /// Brightest and faintest, as V magnitudes; if absent, from 5 magnitudes brighter than the faintest star rendered to that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub magnitudes: Option<[f64; 2]>,
}

impl RecipeFile {
    /// Reads the text of a recipe; `path` is used in messages.
    pub fn parse(path: &str, text: &str) -> Result<Self, DatasetError> {
        tables(text).map_err(|message| DatasetError::Parse { path: path.to_owned(), message })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: &str = r#"
        format = "boresight-recipe/1"
        name = "tracker"
        seed = 7
        scene = "preset:machine-vision-35mm"
        licence = "CC-BY-4.0"
        [size]
        frames = { train = 64, validation = 16 }
        frames_per_shard = 16
        image = "npy"
        members = ["mask", "distance"]
        [splits]
        apart_by = ["camera", "sky"]
        guard_deg = 2.0
        [cameras]
        train = 4
        validation = 2
        [[draw]]
        per = "camera"
        path = "camera.focal_length_px"
        normal = { mean = 2900.0, sigma = 15.0, within = [2850.0, 2950.0] }
        [[draw]]
        per = "frame"
        path = "frames.rate_deg_s"
        ball = { radius = 1.5 }
        spread = "even"
        [hard]
        no_stars = 0.02
        false_stars = { share = 0.1, count = [1, 50] }
    "#;

    #[test]
    fn a_recipe_is_read() {
        let recipe = RecipeFile::parse("r.toml", WHOLE).unwrap();
        assert_eq!((recipe.size.frames.train, recipe.size.frames.test, recipe.cameras.validation), (64, 0, 2));
        assert_eq!((recipe.size.image, recipe.size.frames_per_recording), (ImageFormat::Npy, 1));
        assert_eq!((recipe.draw[0].spread, recipe.draw[1].spread), (DrawSpread::Independent, DrawSpread::Even));
        assert_eq!(recipe.hard.false_stars.unwrap().count, [1, 50]);
    }

    #[test]
    fn a_wrong_key_is_told_with_its_line_and_the_right_one() {
        for (given, told) in [
            ("seed = 7\n", "seeed = 7\n"),
            ("path = \"frames.rate_deg_s\"", "paht = \"frames.rate_deg_s\""),
            ("ball = { radius = 1.5 }", "ball = { radius = \"wide\" }"),
            ("per = \"frame\"", "per = \"image\""),
        ]
        .into_iter()
        .zip([
            "r.toml: line 4: unknown key seeed; did you mean seed?",
            "r.toml: line 24: unknown key paht; did you mean path?",
            "r.toml: line 25: invalid type: string \"wide\", expected f64",
            "r.toml: line 23: unknown variant `image`, expected one of `dataset`, `camera`, `recording`, `frame`",
        ])
        .map(|((from, to), told)| (RecipeFile::parse("r.toml", &WHOLE.replacen(from, to, 1)), told))
        {
            assert_eq!(given.unwrap_err().to_string(), told);
        }
    }
}
