//! `boresight dataset verify`: a dataset as it was made is right, and each fault that is planted has its own sentence.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::cli::{run, text};

const SCENE: &str = "format = \"boresight-scene/1\"\ncamera = { width_px = 160, height_px = 120, focal_length_px = 350.0 }\n\
                     sky = { physics = \"none\", faintest_magnitude = 7.0 }\n[[frames]]\nexposure_s = 1.0\n";
const RECIPE: &str = "format = \"boresight-recipe/1\"\nname = \"checked\"\nseed = 5\nscene = \"scenes/sky.toml\"\n\
    [size]\nframes = { train = 8, test = 4 }\nframes_per_shard = 4\nmembers = [\"mask\", \"distance\", \"instances\"]\n\
    [cameras]\ntrain = 2\ntest = 1\n[splits]\napart_by = [\"camera\", \"sky\"]\nguard_deg = 3.0\n\
    [[draw]]\nper = \"frame\"\npath = \"frames.rate_deg_s\"\nball = { radius = 0.3 }\n";

/// A dataset as it was made, once for all tests.
pub(crate) static MADE: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("scenes")).unwrap();
    std::fs::write(folder.path().join("scenes/sky.toml"), SCENE).unwrap();
    std::fs::write(folder.path().join("recipe.toml"), RECIPE).unwrap();
    let made = run(&["dataset", text(&folder.path().join("recipe.toml")), "-o", text(&folder.path().join("set"))]);
    assert_eq!(made.code, 0, "{}", made.stderr);
    folder
});

fn copied(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copied(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// A copy that may be damaged.
fn set() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    copied(&MADE.path().join("set"), &set);
    (folder, set)
}

/// What verify finds: its exit code, and each fault with what was looked at.
fn found(set: &Path) -> (i32, Vec<String>) {
    let ran = run(&["dataset", "verify", text(set), "--frames", "1000", "--json"]);
    let result: Value = serde_json::from_str(&ran.stdout).unwrap_or_else(|error| panic!("{error}: {}{}", ran.stdout, ran.stderr));
    let told = |fault: &Value| format!("{}: {}", fault["check"].as_str().unwrap(), fault["fault"].as_str().unwrap());
    (ran.code, result["faults"].as_array().unwrap().iter().map(told).collect())
}

const BLOCK: usize = 512;

/// Changes the members of an archive, by their names; lengths may change.
fn edit(archive: &Path, change: &mut dyn FnMut(&str, Vec<u8>) -> Vec<u8>) {
    let bytes = std::fs::read(archive).unwrap();
    let (mut rest, mut edited) = (bytes.as_slice(), Vec::new());
    while rest[0] != 0 {
        let name = String::from_utf8(rest[..100].split(|byte| *byte == 0).next().unwrap().to_vec()).unwrap();
        let length = usize::from_str_radix(std::str::from_utf8(&rest[124..135]).unwrap(), 8).unwrap();
        let content = change(&name, rest[BLOCK..BLOCK + length].to_vec());
        let mut header = rest[..BLOCK].to_vec();
        header[124..135].copy_from_slice(format!("{:011o}", content.len()).as_bytes());
        header[148..156].copy_from_slice(b"        ");
        let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
        edited.extend(header);
        edited.extend(&content);
        edited.resize(edited.len().next_multiple_of(BLOCK), 0);
        rest = &rest[BLOCK + length.next_multiple_of(BLOCK)..];
    }
    edited.extend([0; 2 * BLOCK]);
    std::fs::write(archive, edited).unwrap();
}

/// Makes marks and sums those of the archives: what somebody does who writes wrong labels and does not know it.
fn signed_anew(set: &Path) {
    for mark in std::fs::read_dir(set.join("shards")).unwrap().map(|entry| entry.unwrap().path()) {
        let mut object: Value = serde_json::from_str(&std::fs::read_to_string(&mark).unwrap()).unwrap();
        let bytes = std::fs::read(set.join(object["file"].as_str().unwrap())).unwrap();
        object["bytes"] = bytes.len().into();
        object["sha256"] = Sha256::digest(&bytes).iter().fold(String::new(), |text, byte| format!("{text}{byte:02x}")).into();
        std::fs::write(&mark, serde_json::to_string_pretty(&object).unwrap() + "\n").unwrap();
    }
    let finished = run(&["dataset", "finish", text(set)]);
    assert_eq!(finished.code, 0, "{}", finished.stderr);
}

/// Changes all labels.
fn relabelled(change: &dyn Fn(&mut Value)) -> (i32, Vec<String>) {
    let (_folder, set) = set();
    for archive in ["train/000000.tar", "train/000001.tar", "test/000000.tar"] {
        edit(&set.join(archive), &mut |name, content| {
            if !name.ends_with("json") {
                return content;
            }
            let mut labels: Value = serde_json::from_slice(&content).unwrap();
            change(&mut labels);
            serde_json::to_vec(&labels).unwrap()
        });
    }
    signed_anew(&set);
    found(&set)
}

fn column(lights: &mut Value, name: &str, change: impl Fn(f64) -> f64) {
    for cell in lights[name].as_array_mut().unwrap() {
        let changed = change(cell.as_f64().unwrap());
        *cell = if cell.is_f64() { changed.into() } else { (changed.max(0.0) as u64).into() };
    }
}

fn exchanged(lights: &mut Value, a: &str, b: &str) {
    let first = lights[a].take();
    lights[a] = lights[b].take();
    lights[b] = first;
}

fn one_has(faults: &[String], told: &str) {
    assert!(faults.iter().any(|fault| fault.contains(told)), "{told} is not among {faults:#?}");
}

#[test]
fn a_dataset_as_it_was_made_is_right() {
    let set = MADE.path().join("set");
    let ran = run(&["dataset", "verify", text(&set), "--frames", "12"]);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    assert!(ran.stdout.contains("3 shards with 12 frames read and hashed, 12 frames made again"), "{}", ran.stdout);
    assert!(
        ran.stdout.contains("bright lone stars are") && ran.stdout.ends_with("nothing is wrong with what was looked at\n"),
        "{}",
        ran.stdout
    );
    assert!(!ran.stdout.contains("not looked at: "), "{}", ran.stdout);
}

/// Real frames under the stars: the dataset holds what it says, and is the same wherever its recipe lies.
#[test]
fn a_dataset_on_real_frames_is_right_and_the_same_in_another_folder() {
    let made = |folder: &Path| {
        std::fs::create_dir(folder.join("darks")).unwrap();
        for number in 0..2_u32 {
            let pixels: Vec<u16> =
                (0..160 * 120_u32).map(|place| 207 + (place.wrapping_mul(2_654_435_761 + number) >> 16) as u16 % 7).collect();
            let headers = boresight::recording::FitsHeaders::default();
            boresight::recording::write_fits_u16(&folder.join(format!("darks/{number}.fits")), 160, 120, &pixels, &headers).unwrap();
        }
        std::fs::create_dir(folder.join("scenes")).unwrap();
        std::fs::write(folder.join("scenes/sky.toml"), SCENE).unwrap();
        std::fs::write(folder.join("recipe.toml"), format!("{RECIPE}[background]\nframes = \"darks/*.fits\"\n")).unwrap();
        let set = folder.join("set");
        let made = run(&["dataset", text(&folder.join("recipe.toml")), "-o", text(&set)]);
        assert_eq!(made.code, 0, "{}", made.stderr);
        let ran = run(&["dataset", "verify", text(&set), "--frames", "12"]);
        assert!(ran.code == 0 && ran.stdout.contains("12 frames made again"), "{}{}", ran.stdout, ran.stderr);
        std::fs::read_to_string(set.join("SHA256SUMS")).unwrap()
    };
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    assert_eq!(made(folders[0].path()), made(folders[1].path()));
}

#[test]
fn axes_that_are_exchanged_mirrored_or_shifted_are_told_apart() {
    let (code, faults) = relabelled(&|labels| {
        for (a, b) in [("x_px", "y_px"), ("box_left_px", "box_top_px"), ("box_right_px", "box_bottom_px"), ("x_mid_px", "y_mid_px")] {
            exchanged(&mut labels["lights"], a, b);
        }
    });
    assert_eq!(code, 3);
    one_has(&faults, "labels: of ");
    one_has(&faults, "they fit with x and y exchanged");
    one_has(&faults, "masks: ");
    one_has(&faults, "has other bytes in json");
    one_has(&faults, "tables: tables/test/000000.stars.parquet does not say what the labels of its shard say");
    let (code, faults) = relabelled(&|labels| {
        let lights = &mut labels["lights"];
        column(lights, "x_px", |x| 159.0 - x);
        exchanged(lights, "box_left_px", "box_right_px");
        column(lights, "box_left_px", |x| 159.0 - x);
        column(lights, "box_right_px", |x| 159.0 - x);
    });
    assert_eq!(code, 3);
    one_has(&faults, "they fit with x mirrored");
    for (name, shift, told) in [("x_px", 0.5, "along columns (x)"), ("y_px", -0.5, "along rows (y)")] {
        let (code, faults) = relabelled(&|labels| column(&mut labels["lights"], name, |at| at + shift));
        assert_eq!(code, 3);
        one_has(&faults, told);
        assert!(!faults.iter().any(|fault| fault.contains("they fit with")), "{faults:?}");
    }
    // Places alone, beside boxes that are right.
    let (code, faults) = relabelled(&|labels| exchanged(&mut labels["lights"], "x_px", "y_px"));
    assert_eq!(code, 3);
    one_has(&faults, "so that places and boxes of the labels disagree");
}

#[test]
fn a_byte_a_shard_and_a_mark_that_are_wrong_are_told() {
    let (_folder, own) = set();
    let shard = own.join("train/000001.tar");
    let mut bytes = std::fs::read(&shard).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&shard, &bytes).unwrap();
    let (code, faults) = found(&own);
    assert_eq!((code, faults), (3, vec!["files: train/000001.tar is not the file that its mark has the hash of".to_owned()]));
    std::fs::remove_file(&shard).unwrap();
    let (code, faults) = found(&own);
    assert_eq!((code, faults.len()), (3, 1), "{faults:?}");
    one_has(&faults, "files: train/000001.tar is missing; make it again with");
    // What loaders would read beside the shards.
    let (_folder, own) = set();
    std::fs::copy(own.join("test/000000.tar"), own.join("train/000009.tar")).unwrap();
    assert_eq!(found(&own), (3, vec!["files: train/000009.tar belongs to no shard, and loaders would read it; remove it".to_owned()]));
    let (_folder, own) = set();
    std::fs::write(own.join("README.md"), "mine").unwrap();
    std::fs::remove_file(own.join("shards/test-000000.json")).unwrap();
    let (code, faults) = found(&own);
    assert_eq!(code, 3);
    one_has(&faults, "files: README.md is not the file that SHA256SUMS has the hash of");
    one_has(&faults, "files: shards/test-000000.json cannot be read");
    std::fs::remove_file(own.join("SHA256SUMS")).unwrap();
    one_has(&found(&own).1, "files: SHA256SUMS is missing; write it with");
    // A flipped bit within an image, signed anew.
    let (_folder, own) = set();
    let mut is_first = true;
    edit(&own.join("test/000000.tar"), &mut |name, mut content| {
        if name.ends_with("mask.png") && std::mem::take(&mut is_first) {
            let middle = content.len() / 2;
            content[middle] ^= 4;
        }
        content
    });
    signed_anew(&own);
    one_has(&found(&own).1, "frames: test/000000.tar: the frame 200000000, made again, has other bytes in mask.png");
}

#[test]
fn a_frame_a_camera_and_a_sky_that_stand_in_two_splits_are_told() {
    // A sample of train in the place of one of test, under the name of that one.
    let (_folder, own) = set();
    let mut stolen = Vec::new();
    edit(&own.join("train/000000.tar"), &mut |name, content| {
        if name.starts_with("000000002") {
            stolen.push((name.split_once('.').unwrap().1.to_owned(), content.clone()));
        }
        content
    });
    edit(&own.join("test/000000.tar"), &mut |name, content| match name.strip_prefix("200000001.") {
        Some(member) => stolen.iter().find(|(own, _)| own == member).unwrap().1.clone(),
        None => content,
    });
    signed_anew(&own);
    let (code, faults) = found(&own);
    assert_eq!(code, 3);
    one_has(&faults, "splits: a picture stands in two splits: the frame 200000001 of test is the frame 000000002 of train");
    one_has(&faults, "samples: test/000000.tar: the labels of the frame 200000001 are those of the frame 000000002 of train");
    one_has(&faults, "splits: the splits train and test share a camera and should share none");
    one_has(&faults, "splits: a boresight of train is 0.0000° from one of test");
    // A whole shard of another split.
    let (_folder, own) = set();
    std::fs::copy(own.join("train/000001.tar"), own.join("test/000000.tar")).unwrap();
    signed_anew(&own);
    let (code, faults) = found(&own);
    assert_eq!(code, 3);
    one_has(&faults, "samples: test/000000.tar has the frame 000000004 where the frame 200000000 belongs");
    one_has(&faults, "splits: 4 pictures stand in two splits");
}
