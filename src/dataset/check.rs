//! Range checks of every number of a recipe.

use super::error::DatasetError;
use super::frame_key::{DatasetSplit, MAX_CAMERAS, MAX_FRAMES};
use super::recipe::{RECIPE_FORMAT, RecipeFile};
use super::scene_path::canonical_path;

/// Shards larger than this lose too much when a run is killed.
const MAX_FRAMES_OF_A_SHARD: u64 = 1_000_000;

/// Checks what can be said without the scene.
pub(super) fn check(path: &str, recipe: &RecipeFile) -> Result<(), DatasetError> {
    let refuse =
        |key: &str, value: String, remedy: String| Err(DatasetError::Value { path: path.to_owned(), key: key.to_owned(), value, remedy });
    if recipe.format != RECIPE_FORMAT {
        return refuse("format", format!("{:?}", recipe.format), format!("must be {RECIPE_FORMAT:?}"));
    }
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '-' || letter == '_';
    if recipe.name.is_empty() || !recipe.name.chars().all(is_plain) {
        return refuse("name", format!("{:?}", recipe.name), "must be made of letters, digits, - and _".to_owned());
    }
    if let Some(licence) = recipe.licence.as_ref().filter(|licence| !is_licence(licence)) {
        let remedy = "must be an SPDX expression, as CC-BY-4.0 or LicenseRef-proprietary: the card and croissant.json name it".to_owned();
        return refuse("licence", format!("{licence:?}"), remedy);
    }
    let size = &recipe.size;
    if !(1..=MAX_FRAMES_OF_A_SHARD).contains(&size.frames_per_shard) {
        let remedy = format!("must lie between 1 and {MAX_FRAMES_OF_A_SHARD}");
        return refuse("size.frames_per_shard", size.frames_per_shard.to_string(), remedy);
    }
    if !(1..=MAX_FRAMES).contains(&size.frames_per_recording) {
        return refuse("size.frames_per_recording", size.frames_per_recording.to_string(), format!("must lie between 1 and {MAX_FRAMES}"));
    }
    for split in DatasetSplit::ALL {
        let (count, each, name) = (size.frames.of(split), size.frames_per_shard, split.name());
        if count >= MAX_FRAMES {
            return refuse(&format!("size.frames.{name}"), count.to_string(), format!("must be below {MAX_FRAMES}"));
        }
        if count % each != 0 {
            let (less, more) = (count / each * each, (count / each + 1) * each);
            let near = if less == 0 { more.to_string() } else { format!("{less} or {more}") };
            let remedy = format!("is no multiple of size.frames_per_shard = {each}, and loaders need equal shards: take {near}");
            return refuse(&format!("size.frames.{name}"), count.to_string(), remedy);
        }
        let cameras = recipe.cameras.of(split);
        if cameras > MAX_CAMERAS || (cameras == 0 && count > 0) {
            let remedy = format!("must lie between 1 and {MAX_CAMERAS}, since the split has frames");
            return refuse(&format!("cameras.{name}"), cameras.to_string(), remedy);
        }
    }
    if DatasetSplit::ALL.iter().all(|split| size.frames.of(*split) == 0) {
        return refuse("size.frames", "nothing".to_owned(), "must give a split some frames, as in frames = { train = 512 }".to_owned());
    }
    if let Some(place) = (1..size.members.len()).find(|place| size.members[..*place].contains(&size.members[*place])) {
        return refuse("size.members", format!("{:?}", size.members[place]), "stands there twice; name it once".to_owned());
    }
    if let Some(guard_deg) = recipe.splits.guard_deg.filter(|guard| !(0.0..180.0).contains(guard)) {
        return refuse("splits.guard_deg", guard_deg.to_string(), "must lie between 0 and 180".to_owned());
    }
    check_hard(&refuse, recipe)?;
    for (number, draw) in recipe.draw.iter().enumerate() {
        if let Some(before) = recipe.draw[..number].iter().position(|other| canonical_path(&other.path) == canonical_path(&draw.path)) {
            let remedy = format!("is drawn by draw[{before}] already; keep one of the two");
            return refuse(&format!("draw[{number}].path"), format!("{:?}", draw.path), remedy);
        }
    }
    Ok(())
}

/// Whether a text is written as an SPDX expression: names of licences, joined by AND, OR and WITH, with brackets.
fn is_licence(text: &str) -> bool {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-.+() ".contains(letter);
    let words: Vec<&str> = text.split([' ', '(', ')']).filter(|word| !word.is_empty()).collect();
    let is_joint = |word: &str| ["AND", "OR", "WITH"].contains(&word);
    text.chars().all(is_plain) && words.iter().enumerate().all(|(place, word)| is_joint(word) == (place % 2 == 1)) && words.len() % 2 == 1
}

fn check_hard(refuse: &dyn Fn(&str, String, String) -> Result<(), DatasetError>, recipe: &RecipeFile) -> Result<(), DatasetError> {
    let hard = &recipe.hard;
    let of_false_stars = hard.false_stars.as_ref().map_or(0.0, |table| table.share);
    for (key, share) in [("hard.no_stars", hard.no_stars), ("hard.false_stars.share", of_false_stars), ("hard.twins", hard.twins)] {
        if !(0.0..=1.0).contains(&share) {
            return refuse(key, share.to_string(), "must lie between 0 and 1".to_owned());
        }
    }
    let Some(table) = &hard.false_stars else { return Ok(()) };
    if table.count[0] > table.count[1] || table.count[1] > 1000 {
        return refuse(
            "hard.false_stars.count",
            format!("{:?}", table.count),
            "must be two whole numbers up to 1000, the lower first".to_owned(),
        );
    }
    if let Some(ends) = table.magnitudes.filter(|ends| !(ends[0] < ends[1] && ends.iter().all(|end| end.abs() <= 40.0))) {
        return refuse("hard.false_stars.magnitudes", format!("{ends:?}"), "must be two magnitudes, the brighter first".to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "format = \"boresight-recipe/1\"\nname = \"a\"\nscene = \"preset:cubesat-tracker\"\n\
                        [size]\nframes = { train = 8 }\nframes_per_shard = 4\n";

    fn checked(text: &str) -> Result<(), String> {
        check("r.toml", &RecipeFile::parse("r.toml", text).unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn every_bad_number_is_told_with_what_would_do() {
        assert_eq!(checked(GOOD), Ok(()));
        assert!(is_licence("MIT OR (Apache-2.0 WITH LLVM-exception)") && is_licence("LicenseRef-own") && !is_licence("MIT Apache-2.0"));
        for (from, to, told) in [
            ("recipe/1", "recipe/2", "r.toml: format = \"boresight-recipe/2\" must be \"boresight-recipe/1\""),
            ("\"a\"", "\"a/b\"", "r.toml: name = \"a/b\" must be made of letters"),
            (
                "train = 8",
                "train = 9",
                "r.toml: size.frames.train = 9 is no multiple of size.frames_per_shard = 4, and loaders need equal shards: take 8 or 12",
            ),
            ("train = 8", "train = 2", "take 4"),
            (
                "name = \"a\"",
                "name = \"a\"\nlicence = \"Proprietary: see LICENSE\"",
                "licence = \"Proprietary: see LICENSE\" must be an SPDX expression",
            ),
            ("train = 8", "train = 0", "size.frames = nothing must give a split some frames"),
            ("shard = 4", "shard = 0", "size.frames_per_shard = 0 must lie between 1 and"),
            ("shard = 4", "shard = 4\nframes_per_recording = 0", "size.frames_per_recording = 0 must lie between 1 and"),
            ("shard = 4\n", "shard = 4\nmembers = [\"mask\", \"mask\"]\n", "size.members = Mask stands there twice"),
            ("shard = 4\n", "shard = 4\n[cameras]\ntrain = 0\n", "cameras.train = 0 must lie between 1 and 10000"),
            ("shard = 4\n", "shard = 4\n[splits]\nguard_deg = -1.0\n", "splits.guard_deg = -1 must lie between 0 and 180"),
            ("shard = 4\n", "shard = 4\n[hard]\ntwins = 2.0\n", "hard.twins = 2 must lie between 0 and 1"),
            (
                "shard = 4\n",
                "shard = 4\n[hard]\nfalse_stars = { share = 0.1, count = [9, 1] }\n",
                "hard.false_stars.count = [9, 1] must be two whole numbers",
            ),
            (
                "shard = 4\n",
                "shard = 4\n[[draw]]\nper = \"frame\"\npath = \"camera.k1\"\nuniform = [0, 1]\n[[draw]]\nper = \"camera\"\npath = \"camera.k1\"\nuniform = [0, 1]\n",
                "draw[1].path = \"camera.k1\" is drawn by draw[0] already",
            ),
            (
                "shard = 4\n",
                "shard = 4\n[[draw]]\nper = \"frame\"\npath = \"frames.exposure_s\"\nuniform = [1, 2]\n[[draw]]\nper = \"frame\"\npath = \"frames.0.exposure_s\"\nuniform = [1, 2]\n",
                "draw[1].path = \"frames.0.exposure_s\" is drawn by draw[0] already",
            ),
        ] {
            let fault = checked(&GOOD.replacen(from, to, 1)).unwrap_err();
            assert!(fault.contains(told), "{fault}\ninstead of\n{told}");
        }
    }
}
