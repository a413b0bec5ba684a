//! Recipes that cannot be meant: each has its own sentence, with line and remedy, and nothing is written.

use std::path::Path;

use crate::cli::{run, text};

const SCENE: &str = "format = \"boresight-scene/1\"\ncamera = { width_px = 64, height_px = 48, focal_length_px = 300.0 }\n\
                     sky = { physics = \"none\" }\n[[frames]]\nexposure_s = 1.0\n";

/// Line 14 is that of the draw's path.
const RECIPE: &str = "format = \"boresight-recipe/1\"\nname = \"tiny\"\nseed = 5\nscene = \"sky.toml\"\n[size]\n\
                      frames = { train = 8, test = 4 }\nframes_per_shard = 4\nimage = \"png16\"\n[splits]\napart_by = [\"sky\"]\nguard_deg = 3.0\n\
                      [[draw]]\nper = \"frame\"\npath = \"frames.rate_deg_s\"\nball = { radius = 0.5 }\n";

/// What is changed in the recipe, and what is told of it.
const KINDS: [(&str, &str, &[&str]); 36] = [
    ("seed = 5", "seed = ", &["line 3: "]),
    ("seed = 5", "seed = -5", &["line 3: ", "-5"]),
    ("seed = 5", "sead = 5", &["line 3: unknown key sead; did you mean seed?"]),
    ("recipe/1", "recipe/9", &["line 1: format = \"boresight-recipe/9\" must be \"boresight-recipe/1\""]),
    ("\"tiny\"", "\"ti ny\"", &["line 2: name = \"ti ny\" must be made of letters, digits, - and _"]),
    ("name = \"tiny\"\n", "", &["missing field `name`"]),
    ("sky.toml", "none.toml", &["none.toml: cannot be read"]),
    ("sky.toml", "preset:cubesat-traker", &["line 4: scene = ", "did you mean preset:cubesat-tracker?"]),
    ("train = 8", "train = 9", &["line 6: size.frames.train = 9 is no multiple of size.frames_per_shard = 4", "take 8 or 12"]),
    ("train = 8, test = 4", "train = 0", &["line 6: size.frames = nothing must give a split some frames"]),
    ("train = 8", "train = -8", &["line 6: ", "-8"]),
    ("train = 8", "training = 8", &["line 6: unknown key training; did you mean train?"]),
    ("train = 8", "train = 800_000_000", &["line 6: size.frames.train = 800000000 must be below"]),
    ("per_shard = 4", "per_shard = 0", &["line 7: size.frames_per_shard = 0 must lie between 1 and"]),
    ("per_shard = 4\n", "per_shard = 4\nframes_per_recording = 0\n", &["line 8: size.frames_per_recording = 0 must lie between 1 and"]),
    ("\"png16\"", "\"jpeg\"", &["line 8: unknown variant `jpeg`", "`png16`"]),
    ("\"png16\"\n", "\"png16\"\nmembers = [\"mask\", \"mask\"]\n", &["line 9: size.members = Mask stands there twice"]),
    ("[\"sky\"]", "[\"sku\"]", &["line 10: unknown variant `sku`", "`sky`"]),
    ("guard_deg = 3.0", "guard_deg = 80.0", &["line 11: splits.guard_deg = 80.00 leaves a split no sky to point at", "would do"]),
    ("guard_deg = 3.0", "guard_deg = -1.0", &["line 11: splits.guard_deg = -1 must lie between 0 and 180"]),
    ("[[draw]]", "[cameras]\ntrain = 0\n[[draw]]", &["line 13: cameras.train = 0 must lie between 1 and"]),
    ("per = \"frame\"", "per = \"picture\"", &["line 13: unknown variant `picture`", "`frame`"]),
    ("frames.rate_deg_s", "frames.rate_deg", &["line 14: ", "rate_deg", "did you mean"]),
    ("frames.rate_deg_s", "effects.hot-pixel", &["line 14: ", "hot-pixels"]),
    ("ball = { radius = 0.5 }\n", "", &["line 14: ", "has no distribution; give one of uniform"]),
    ("ball = { radius = 0.5 }\n", "ball = { radius = 0.5 }\nuniform = [0, 1]\n", &["has uniform and ball; give one of"]),
    ("radius = 0.5", "radius = 0.0", &["line 15: ", "must have a radius above 0"]),
    ("ball = { radius = 0.5 }", "uniform = [1, 0]", &["line 15: ", "must be two numbers, the lower first"]),
    ("ball = { radius = 0.5 }", "log_uniform = [0, 1]", &["line 15: ", "must be two numbers above 0"]),
    ("ball = { radius = 0.5 }", "normal = { mean = 0.0, sigma = 0.0 }", &["line 15: ", "must have a mean and a sigma above 0"]),
    ("ball = { radius = 0.5 }", "choice = { values = [], weights = [] }", &["line 15: ", "one weight for each of one value or more"]),
    ("ball = { radius = 0.5 }", "table = { file = \"no.csv\" }", &["no.csv"]),
    ("ball = { radius = 0.5 }", "probability = 0.5", &["line 15: ", "frames.rate_deg_s is 3 numbers"]),
    (
        "path = \"frames.rate_deg_s\"\nball = { radius = 0.5 }",
        "path = \"camera.focal_length_px\"\nuniform = [0, 400]",
        &["line 14: the draw of camera.focal_length_px at its lower end", "must lie between 0.01 and 1e8 px"],
    ),
    ("[[draw]]", "[hard]\nno_stars = 1.5\n[[draw]]", &["line 13: hard.no_stars = 1.5 must lie between 0 and 1"]),
    ("[[draw]]", "[background]\nframes = \"darks/*.fits\"\n[[draw]]", &["line 13: background.frames = \"darks/*.fits\"", "darks"]),
];

fn recipe_in(folder: &Path, recipe: &str) {
    std::fs::write(folder.join("sky.toml"), SCENE).unwrap();
    std::fs::write(folder.join("recipe.toml"), recipe).unwrap();
}

#[test]
fn every_kind_of_bad_recipe_has_its_sentence_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("set");
    let mut wrong = Vec::new();
    for (from, to, told) in KINDS {
        assert!(RECIPE.contains(from), "{from}");
        recipe_in(folder.path(), &RECIPE.replacen(from, to, 1));
        let ran = run(&["dataset", text(&folder.path().join("recipe.toml")), "-o", text(&target), "--quiet"]);
        let lines: Vec<&str> = ran.stderr.lines().collect();
        let is_told = lines.len() == 1 && told.iter().all(|words| ran.stderr.contains(words)) && ran.stderr.contains(".toml");
        if !is_told || ran.code != 1 || !ran.stdout.is_empty() || target.exists() {
            wrong.push(format!("{from} → {to}: {} {}, instead of {told:?}", ran.code, ran.stderr));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    recipe_in(folder.path(), RECIPE);
    assert_eq!(run(&["dataset", text(&folder.path().join("recipe.toml")), "-o", text(&target)]).code, 0);
}
